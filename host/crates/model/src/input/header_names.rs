//! The names of columns: spelling, units, and which name a wrong one is near to.

use super::columns::{ColumnRole, MOST_TARGETS, TableFormat};
use crate::excerpt;

/// One degree, in rad.
pub(super) const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// A name in lower case, with a unit in brackets as its ending.
pub(super) fn plain(name: &str) -> String {
    let name = name.trim().to_lowercase();
    let Some(inner) = name.strip_suffix(']').or_else(|| name.strip_suffix(')')) else {
        return name;
    };
    let Some((start, unit)) = inner.rsplit_once(['[', '(']) else {
        return name;
    };
    let unit = match unit.trim() {
        "°" | "degree" | "degrees" => "deg",
        "nm" | "n m" | "n·m" => "nm",
        unit => unit,
    };
    format!("{}_{unit}", start.trim_end())
}

/// A joint's angle: `name`, `name_rad` or `name_deg`.
pub(super) fn angle_unit(name: &str) -> (&str, f64) {
    match name.strip_suffix("_deg") {
        Some(rest) => (rest, DEGREE),
        None => (name.strip_suffix("_rad").unwrap_or(name), 1.0),
    }
}

pub(super) fn number(text: &str, most: usize) -> Option<usize> {
    text.parse::<usize>()
        .ok()
        .filter(|n| (1..=most).contains(n) && !text.starts_with(['+', '0']))
}

/// A column as every table may name it.
pub(super) fn fixed(name: &str) -> Option<ColumnRole> {
    match name {
        "" => return Some(ColumnRole::Blank),
        "sphere" => return Some(ColumnRole::Sphere),
        "place" => return Some(ColumnRole::Place),
        "set" => return Some(ColumnRole::Set),
        "qw" => return Some(ColumnRole::Quaternion(0)),
        "qx" => return Some(ColumnRole::Quaternion(1)),
        "qy" => return Some(ColumnRole::Quaternion(2)),
        "qz" => return Some(ColumnRole::Quaternion(3)),
        _ => {}
    }
    if let Some(rest) = name.strip_prefix("tau") {
        let joint = number(rest.strip_suffix("_nm").unwrap_or(rest), 99)?;
        return Some(ColumnRole::Torque { joint: joint - 1 });
    }
    if let [b'r', row @ b'1'..=b'3', column @ b'1'..=b'3'] = name.as_bytes() {
        return Some(ColumnRole::Rotation(
            usize::from(row - b'1') * 3 + usize::from(column - b'1'),
        ));
    }
    let (stem, scale) = angle_unit(name);
    if let Some(joint) = stem.strip_prefix('q').and_then(|rest| number(rest, 99)) {
        return Some(ColumnRole::Angle {
            joint: joint - 1,
            scale,
        });
    }
    let (stem, unit) = name.split_once('_')?;
    let scale = match unit {
        "mm" => 1e-3,
        "m" => 1.0,
        _ => return None,
    };
    let axis = match stem.as_bytes().first()? {
        b'x' => 0,
        b'y' => 1,
        b'z' => 2,
        _ => return None,
    };
    let target = match stem.get(1..)? {
        "" => 0,
        rest => number(rest, MOST_TARGETS)?,
    };
    Some(ColumnRole::Coordinate { target, axis, scale })
}

/// Whether a column of a name in lower case holds a joint of the robot that is not on its chain.
pub(super) fn is_other(name: &str, format: &TableFormat) -> bool {
    let stem = name.strip_suffix(".pos").unwrap_or(angle_unit(name).0);
    format
        .others
        .iter()
        .any(|other| [name, stem].contains(&plain(other).as_str()))
}

/// Two columns with the same key would fill the same cell.
pub(super) fn key(column: ColumnRole) -> Option<(u8, usize, usize)> {
    Some(match column {
        ColumnRole::Angle { joint, .. } => (0, joint, 0),
        ColumnRole::Torque { joint } => (1, joint, 0),
        ColumnRole::Coordinate { target, axis, .. } => (2, target, axis),
        ColumnRole::Quaternion(k) => (3, k, 0),
        ColumnRole::Rotation(k) => (4, k, 0),
        ColumnRole::Sphere => (5, 0, 0),
        ColumnRole::Place => (6, 0, 0),
        ColumnRole::Set => (7, 0, 0),
        ColumnRole::Label => (8, 0, 0),
        ColumnRole::Ignored | ColumnRole::Blank => return None,
    })
}

/// Columns that a table may have, for a message.
pub(super) fn known(format: &TableFormat) -> String {
    let n = format.joints;
    let joints = if format.joint_columns.is_empty() {
        format!("q1..q{n} (rad) or q1_deg..q{n}_deg")
    } else {
        "the joint columns that you named".to_owned()
    };
    let names = match format.joint_names.as_slice() {
        [first, .., last] if format.joint_columns.is_empty() => {
            format!(", the robot's own {}..{}", excerpt(first), excerpt(last))
        }
        _ => String::new(),
    };
    format!(
        "{joints}{names}, tau1..tau{n}, x_mm,y_mm,z_mm (or x_m.., or x1_mm..z{MOST_TARGETS}_mm for several targets), qw,qx,qy,qz or \
         r11..r33, sphere, place, set"
    )
}

/// The known name that an unknown one is nearest to, and what may be wrong with it.
pub(super) fn hint(name: &str, format: &TableFormat) -> Option<String> {
    let mut rest = name.chars();
    if rest.next().is_some_and(|axis| "xyz".contains(axis)) && rest.all(|c| c.is_ascii_digit()) {
        let of = |axis: &str| format!("{axis}{}", name.trim_start_matches(['x', 'y', 'z']));
        return Some(format!(
            "\"{name}\" has no unit: name it {name}_mm or {name}_m, or give --columns point_m={},{},{};",
            of("x"),
            of("y"),
            of("z")
        ));
    }
    if name.chars().count() > 20 {
        return None;
    }
    ["sphere", "place", "set", "x_mm", "y_mm", "z_mm", "q1", "q1_deg", "tau1"]
        .into_iter()
        .chain(format.joint_names.iter().map(String::as_str))
        .map(|known| (strsim::levenshtein(name, &known.to_lowercase()), known))
        .min_by_key(|found| found.0)
        .filter(|found| found.0 <= 2 && found.0 < name.chars().count())
        .map(|found| format!("did you mean \"{}\"?", excerpt(found.1)))
}

/// A joint that rests keeps its position to this (rad or m): servos hold to some mrad.
const STILL: f64 = 0.01;

/// A joint that carries the base of the chain, and how it moves in the rows.
#[derive(Clone, Debug)]
pub(super) struct Carrier {
    column: usize,
    pub(super) name: String,
    /// Its unit, in rad or m.
    scale: f64,
    /// Least and largest value so far, in its unit.
    range: Option<(f64, f64)>,
}

impl Carrier {
    pub(super) fn new(format: &TableFormat, column: usize, name: &str) -> Option<Self> {
        let lower = plain(name);
        let (stem, scale) = angle_unit(&lower);
        let is = |carrier: &String| [stem, lower.as_str()].contains(&plain(carrier).as_str());
        format.carriers.iter().any(is).then(|| Self {
            column,
            name: name.to_owned(),
            scale,
            range: None,
        })
    }

    /// Takes its value of a row.
    pub(super) fn see(&mut self, cells: &[String]) {
        let Some(value) = cells.get(self.column).and_then(|cell| decimal(cell)) else {
            return;
        };
        let (least, most) = self.range.unwrap_or((value, value));
        self.range = Some((value.min(least), value.max(most)));
    }

    /// Whether the base is elsewhere in some rows.
    pub(super) fn moves(&self) -> bool {
        self.range
            .is_some_and(|(least, most)| (most - least) * self.scale > STILL)
    }
}

/// A number with a decimal point or comma.
pub(super) fn decimal(cell: &str) -> Option<f64> {
    cell.parse().ok().or_else(|| cell.replacen(',', ".", 1).parse().ok())
}
