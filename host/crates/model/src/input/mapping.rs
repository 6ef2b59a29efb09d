//! How a caller names the columns of any table: `--columns point_mm=X,Y,Z euler_zyx_deg=A,B,C joints=a1,a2`.

use super::error::InputError;
use super::orientation::Orientation;
use crate::excerpt;

/// What named columns mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Meaning {
    Joints {
        degrees: bool,
    },
    Torques,
    Point {
        unit: &'static str,
    },
    /// Order of the parts: 0 is w.
    Quaternion([usize; 4]),
    Turned(Orientation),
    Sphere,
    Place,
    Set,
}

/// Columns of a table by their meaning.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColumnMapping {
    pub(super) entries: Vec<(Meaning, Vec<String>)>,
    /// Leave out the columns that nobody knows.
    pub ignore_rest: bool,
}

/// What may be written, for a message.
const KNOWN: &str = "joints=.. (rad), joints_deg=.., torques=.., point_mm=X,Y,Z (or point_m), \
                     quaternion=W,X,Y,Z, quaternion_xyzw=.., euler_zyx_deg=A,B,C (any three axes, in the order in which the \
                     body turns; deg or rad), rpy_deg=ROLL,PITCH,YAW, rotvec=RX,RY,RZ (or rotvec_deg), sphere=.., place=.., set=..";

impl ColumnMapping {
    /// Reads the words of `--columns`.
    ///
    /// # Errors
    /// A word that is not `MEANING=COLUMN,..` with as many columns as the meaning has.
    pub fn parse(words: &[String], ignore_rest: bool) -> Result<Self, InputError> {
        let refuse = |word: &str| InputError::Field {
            file: "command line".to_owned(),
            field: "--columns".to_owned(),
            value: format!("\"{}\"", excerpt(word)),
            remedy: format!("write MEANING=COLUMN,.. (names, or numbers from 1): {KNOWN}"),
        };
        let mut entries = Vec::new();
        for word in words {
            let (name, columns) = word.split_once('=').ok_or_else(|| refuse(word))?;
            let columns: Vec<String> = columns.split(',').map(|c| c.trim().to_owned()).collect();
            let meaning = meaning(&name.trim().to_lowercase()).ok_or_else(|| refuse(word))?;
            let needed = match meaning {
                Meaning::Joints { .. } | Meaning::Torques => columns.len(),
                Meaning::Point { .. } | Meaning::Turned(_) => 3,
                Meaning::Quaternion(_) => 4,
                Meaning::Sphere | Meaning::Place | Meaning::Set => 1,
            };
            if columns.len() != needed || columns.iter().any(String::is_empty) {
                return Err(refuse(word));
            }
            entries.push((meaning, columns));
        }
        Ok(Self { entries, ignore_rest })
    }

    /// Whether nothing is asked for.
    pub fn is_nothing(&self) -> bool {
        self.entries.is_empty() && !self.ignore_rest
    }

    /// Whether columns are named by their numbers, as in a table without a header.
    pub(super) fn by_number(&self) -> bool {
        let number = |c: &String| c.parse::<usize>().is_ok();
        !self.entries.is_empty() && self.entries.iter().all(|(_, columns)| columns.iter().all(number))
    }
}

fn meaning(name: &str) -> Option<Meaning> {
    let (stem, degrees) = match name.strip_suffix("_deg") {
        Some(stem) => (stem, true),
        None => (name.strip_suffix("_rad").unwrap_or(name), false),
    };
    Some(match (name, stem) {
        (_, "joints") => Meaning::Joints { degrees },
        ("torques", _) => Meaning::Torques,
        ("point_mm", _) => Meaning::Point { unit: "mm" },
        ("point_m", _) => Meaning::Point { unit: "m" },
        ("quaternion" | "quaternion_wxyz", _) => Meaning::Quaternion([0, 1, 2, 3]),
        ("quaternion_xyzw", _) => Meaning::Quaternion([1, 2, 3, 0]),
        ("sphere", _) => Meaning::Sphere,
        ("place", _) => Meaning::Place,
        ("set", _) => Meaning::Set,
        (_, "rpy") => Meaning::Turned(Orientation::rpy(degrees)),
        (_, "rotvec") => Meaning::Turned(Orientation::RotationVector { degrees }),
        (_, stem) => Meaning::Turned(Orientation::euler(stem.strip_prefix("euler_")?, degrees)?),
    })
}

/// Three finite numbers `X,Y,Z`, each at most `largest` either way; `option`
/// names them in a refusal.
///
/// # Errors
/// Anything else, with the remedy.
pub fn triple(option: &str, text: &str, largest: f64) -> Result<[f64; 3], InputError> {
    let refuse = |remedy: &str| InputError::Field {
        file: "command line".to_owned(),
        field: option.to_owned(),
        value: format!("\"{}\"", excerpt(text)),
        remedy: remedy.to_owned(),
    };
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    let [x, y, z] = words.as_slice() else {
        return Err(refuse("write three numbers separated by commas, such as 50,0,100"));
    };
    let mut out = [0.0; 3];
    for (slot, word) in out.iter_mut().zip([x, y, z]) {
        let value: f64 = word
            .parse()
            .map_err(|_| refuse("write three numbers separated by commas, such as 50,0,100"))?;
        if !value.is_finite() || value.abs() > largest {
            return Err(refuse(&format!(
                "each number is finite and at most {largest} either way"
            )));
        }
        *slot = value;
    }
    Ok(out)
}
