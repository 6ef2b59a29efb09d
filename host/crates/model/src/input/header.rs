//! The header of a table: which column holds what.
//!
//! Names are taken without regard to case, and a unit may stand in brackets:
//! `x [mm]` is `x_mm`. Every column is known, mapped by the robot's joint names or
//! by the caller, or ignored because the caller says so; any other is refused.

use std::collections::{HashMap, HashSet};

use super::error::InputError;
use crate::excerpt;

/// Most measured points in one row.
pub const MOST_TARGETS: usize = 9;

/// How a table is to be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TableFormat {
    /// Joints of the robot.
    pub joints: usize,
    /// Names of the robot's joints, base to flange: columns of these names (or
    /// with `_deg`) are joint angles. May be empty.
    pub joint_names: Vec<String>,
    /// Columns that the caller names as the joint angles, base to flange; they are
    /// taken instead of `q1..`. Empty where the caller names none.
    pub joint_columns: Vec<String>,
    /// Columns that the caller wants left out.
    pub ignore: Vec<String>,
    /// A further column whose values name groups of rows.
    pub label: Option<String>,
}

impl TableFormat {
    /// The format for a robot with `joints` joints and nothing else known.
    pub fn new(joints: usize) -> Self {
        Self {
            joints,
            ..Self::default()
        }
    }
}

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Column {
    /// Angle of a joint (from 0), times `scale` in rad.
    Angle {
        joint: usize,
        scale: f64,
    },
    /// Torque of a joint (from 0), in N m.
    Torque {
        joint: usize,
    },
    /// Coordinate of a measured point, times `scale` in m; `target` 0 where the row
    /// has one point, else from 1.
    Coordinate {
        target: usize,
        axis: usize,
        scale: f64,
    },
    /// Part w, x, y or z of the tool's orientation.
    Quaternion(usize),
    /// Element of the tool's rotation matrix, row by row.
    Rotation(usize),
    Sphere,
    Place,
    Set,
    Label,
    /// The caller does not want it, or it has no name.
    Ignored,
    /// It has no name and must stay empty.
    Blank,
}

/// The columns of a table and what they are together.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Header {
    /// Names as written.
    pub(super) names: Vec<String>,
    pub(super) columns: Vec<Column>,
    /// Points in a row: 0, 1, or more where they are numbered.
    pub(super) targets: usize,
    /// Whether the points are numbered.
    pub(super) numbered: bool,
    /// Whether rows hold the orientation of the tool.
    pub(super) orientation: bool,
    pub(super) torques: bool,
}

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// A name in lower case, with a unit in brackets as its ending.
fn plain(name: &str) -> String {
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
fn angle_unit(name: &str) -> (&str, f64) {
    match name.strip_suffix("_deg") {
        Some(rest) => (rest, DEGREE),
        None => (name.strip_suffix("_rad").unwrap_or(name), 1.0),
    }
}

fn number(text: &str, most: usize) -> Option<usize> {
    text.parse::<usize>()
        .ok()
        .filter(|n| (1..=most).contains(n) && !text.starts_with(['+', '0']))
}

/// A column as every table may name it.
fn fixed(name: &str) -> Option<Column> {
    match name {
        "" => return Some(Column::Blank),
        "sphere" => return Some(Column::Sphere),
        "place" => return Some(Column::Place),
        "set" => return Some(Column::Set),
        "qw" => return Some(Column::Quaternion(0)),
        "qx" => return Some(Column::Quaternion(1)),
        "qy" => return Some(Column::Quaternion(2)),
        "qz" => return Some(Column::Quaternion(3)),
        _ => {}
    }
    if let Some(rest) = name.strip_prefix("tau") {
        let joint = number(rest.strip_suffix("_nm").unwrap_or(rest), 99)?;
        return Some(Column::Torque { joint: joint - 1 });
    }
    if let [b'r', row @ b'1'..=b'3', column @ b'1'..=b'3'] = name.as_bytes() {
        return Some(Column::Rotation(
            usize::from(row - b'1') * 3 + usize::from(column - b'1'),
        ));
    }
    let (stem, scale) = angle_unit(name);
    if let Some(joint) = stem.strip_prefix('q').and_then(|rest| number(rest, 99)) {
        return Some(Column::Angle {
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
    Some(Column::Coordinate { target, axis, scale })
}

/// Two columns with the same key would fill the same cell.
fn key(column: Column) -> Option<(u8, usize, usize)> {
    Some(match column {
        Column::Angle { joint, .. } => (0, joint, 0),
        Column::Torque { joint } => (1, joint, 0),
        Column::Coordinate { target, axis, .. } => (2, target, axis),
        Column::Quaternion(k) => (3, k, 0),
        Column::Rotation(k) => (4, k, 0),
        Column::Sphere => (5, 0, 0),
        Column::Place => (6, 0, 0),
        Column::Set => (7, 0, 0),
        Column::Label => (8, 0, 0),
        Column::Ignored | Column::Blank => return None,
    })
}

/// Columns that a table may have, for a message.
fn known(format: &TableFormat) -> String {
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

/// Letters that must change to make one word of another (Levenshtein).
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut corner = i;
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let next = row[j + 1];
            row[j + 1] = (corner + usize::from(x != *y)).min(row[j] + 1).min(next + 1);
            corner = next;
        }
    }
    row.last().copied().unwrap_or_default()
}

/// The known name that an unknown one is nearest to, and what may be wrong with it.
fn hint(name: &str, format: &TableFormat) -> Option<String> {
    if ["x", "y", "z"].contains(&name) {
        return Some(format!("\"{name}\" has no unit: name it {name}_mm or {name}_m"));
    }
    if name.chars().count() > 20 {
        return None;
    }
    ["sphere", "place", "set", "x_mm", "y_mm", "z_mm", "q1", "q1_deg", "tau1"]
        .into_iter()
        .chain(format.joint_names.iter().map(String::as_str))
        .map(|known| (distance(name, &known.to_lowercase()), known))
        .min_by_key(|found| found.0)
        .filter(|found| found.0 <= 2 && found.0 < name.chars().count())
        .map(|found| format!("did you mean \"{}\"?", excerpt(found.1)))
}

/// The columns that the caller names are as many as the joints, each once.
fn check_joint_columns(format: &TableFormat) -> Result<(), InputError> {
    let names = &format.joint_columns;
    let refuse = |value: String, remedy: String| InputError::Field {
        file: "command line".to_owned(),
        field: "--joint-columns".to_owned(),
        value,
        remedy,
    };
    if !names.is_empty() && names.len() != format.joints {
        return Err(refuse(
            format!("{} names", names.len()),
            format!("name the columns of all {} joints, base to flange", format.joints),
        ));
    }
    let mut seen = HashSet::new();
    match names.iter().find(|name| !seen.insert(plain(name))) {
        Some(name) => Err(refuse(
            format!("\"{}\"", excerpt(name)),
            "stands twice: give each joint a column of its own".to_owned(),
        )),
        None => Ok(()),
    }
}

/// Reads a header.
///
/// # Errors
/// Columns that are not known, stand twice, or are incomplete together.
pub(super) fn header(file: &str, names: Vec<String>, format: &TableFormat) -> Result<Header, InputError> {
    let refuse = |what: String, remedy: String| InputError::Columns {
        file: file.to_owned(),
        what,
        remedy,
    };
    check_joint_columns(format)?;
    let lower = |names: &[String]| -> HashMap<String, usize> {
        let pairs = names.iter().zip(0..).map(|(name, k)| (plain(name), k));
        pairs.collect()
    };
    let (own, robots) = (lower(&format.joint_columns), lower(&format.joint_names));
    let ignore = lower(&format.ignore);
    let label = format.label.as_deref().map(plain);
    let mut columns = Vec::with_capacity(names.len());
    let mut unknown = Vec::new();
    let mut first_hint = None;
    for name in &names {
        let name = plain(name);
        let named = |map: &HashMap<String, usize>| {
            let exact = map.get(&name).map(|joint| (*joint, 1.0));
            let (stem, scale) = angle_unit(&name);
            exact.or_else(|| map.get(stem).map(|joint| (*joint, scale)))
        };
        let as_angle = |(joint, scale): (usize, f64)| Column::Angle { joint, scale };
        let column = if ignore.contains_key(&name) {
            Some(Column::Ignored)
        } else if let Some(found) = named(&own) {
            // `--joint-columns a_deg`: the name itself says the unit.
            let scale = if name.ends_with("_deg") { DEGREE } else { found.1 };
            Some(Column::Angle { joint: found.0, scale })
        } else {
            match fixed(&name) {
                Some(Column::Angle { .. }) if !own.is_empty() => None,
                Some(column) => Some(column),
                None if own.is_empty() && named(&robots).is_some() => named(&robots).map(as_angle),
                None if label.as_ref() == Some(&name) => Some(Column::Label),
                None => None,
            }
        };
        if column.is_none() {
            first_hint = first_hint.or_else(|| hint(&name, format));
            unknown.push(name);
        }
        columns.push(column.unwrap_or(Column::Ignored));
    }
    if !unknown.is_empty() {
        let numbers = |n: &String| n.replace(',', ".").parse::<f64>().is_ok();
        if unknown.len() > 1 && unknown.iter().filter(|n| numbers(n)).count() > unknown.len() / 2 {
            return Err(refuse(
                "the first line holds numbers, not names of columns".to_owned(),
                format!("begin with a header line; known are {}", known(format)),
            ));
        }
        return Err(InputError::UnknownColumns {
            file: file.to_owned(),
            columns: unknown,
            hint: first_hint.map(|h| format!("{h} ")).unwrap_or_default(),
            known: known(format),
        });
    }
    let mut taken: HashMap<(u8, usize, usize), &str> = HashMap::new();
    for (column, name) in columns.iter().zip(&names) {
        let Some(key) = key(*column) else { continue };
        if let Some(twin) = taken.insert(key, name) {
            return Err(refuse(
                format!("columns \"{}\" and \"{}\" say the same", excerpt(twin), excerpt(name)),
                "keep one of them".to_owned(),
            ));
        }
    }
    let mut header = Header {
        names,
        columns,
        targets: 0,
        numbered: false,
        orientation: false,
        torques: false,
    };
    header.joints(format).map_err(|(what, remedy)| refuse(what, remedy))?;
    header.targets().map_err(|(what, remedy)| refuse(what, remedy))?;
    Ok(header)
}

impl Header {
    fn has(&self, wanted: impl Fn(&Column) -> bool) -> bool {
        self.columns.iter().any(wanted)
    }

    /// Every joint has its angle, and every one or none its torque.
    fn joints(&mut self, format: &TableFormat) -> Result<(), (String, String)> {
        let n = format.joints;
        let angle = |k: usize| move |c: &Column| matches!(c, Column::Angle { joint, .. } if *joint == k);
        let torque = |k: usize| move |c: &Column| *c == Column::Torque { joint: k };
        self.torques = self.has(|c| matches!(c, Column::Torque { .. }));
        for column in &self.columns {
            let (what, joint) = match column {
                Column::Angle { joint, .. } => ("q", *joint),
                Column::Torque { joint } => ("tau", *joint),
                _ => continue,
            };
            if joint >= n {
                return Err((
                    format!("there is a column {what}{}, but the robot has {n} joints", joint + 1),
                    "name the robot that these data are of, or remove the column".to_owned(),
                ));
            }
        }
        let missing: Vec<usize> = (0..n).filter(|k| !self.has(angle(*k))).collect();
        if missing.len() == n {
            return Err((
                "there are no joint columns".to_owned(),
                format!("name them q1..q{n} (rad) or q1_deg..q{n}_deg, or list yours with --joint-columns"),
            ));
        }
        if let Some(&k) = missing.first() {
            let name = format
                .joint_columns
                .get(k)
                .map_or_else(|| format!("q{}", k + 1), |c| excerpt(c));
            return Err((
                format!("column {name} is missing; the robot has {n} joints"),
                "give every joint, or name the robot that these data are of".to_owned(),
            ));
        }
        match (0..n).find(|k| !self.has(torque(*k))) {
            Some(k) if self.torques => Err((
                format!("column tau{} is missing", k + 1),
                "give the torques of all joints or of none".to_owned(),
            )),
            _ => Ok(()),
        }
    }

    /// The columns that say where the tool was are complete.
    fn targets(&mut self) -> Result<(), (String, String)> {
        let has = |t: usize, a: usize| {
            self.has(|c| matches!(c, Column::Coordinate { target, axis, .. } if (*target, *axis) == (t, a)))
        };
        let whole: Vec<usize> = (0..=MOST_TARGETS).filter(|&t| (0..3).any(|a| has(t, a))).collect();
        for &target in &whole {
            if let Some(axis) = (0..3).find(|&a| !has(target, a)) {
                let number = if target == 0 { String::new() } else { target.to_string() };
                let axis = ["x", "y", "z"][axis];
                return Err((
                    format!("a measured point needs x, y and z: {axis}{number}_mm is missing"),
                    format!("give x{number}_mm, y{number}_mm and z{number}_mm (or x{number}_m..)"),
                ));
            }
        }
        self.numbered = whole.last().is_some_and(|last| *last > 0);
        self.targets = whole.len();
        if self.numbered {
            if whole.first() == Some(&0) {
                return Err((
                    "there are both x_mm and x1_mm".to_owned(),
                    "number all points of a row (x1_mm, x2_mm, ..), or give one".to_owned(),
                ));
            }
            if let Some(gap) = (1..=whole.len()).find(|t| !whole.contains(t)) {
                return Err((
                    format!("x{gap}_mm is missing, but there are later points"),
                    "number the points of a row from 1 without gaps".to_owned(),
                ));
            }
        }
        let quaternion = (0..4).filter(|k| self.has(|c| *c == Column::Quaternion(*k))).count();
        let rotation = (0..9).filter(|k| self.has(|c| *c == Column::Rotation(*k))).count();
        self.orientation = quaternion + rotation > 0;
        let refuse = |what: &str, remedy: &str| Err((what.to_owned(), remedy.to_owned()));
        match (quaternion, rotation) {
            (0 | 4, 0) | (0, 9) => {}
            (_, 0) => return refuse("a quaternion needs four columns", "give qw, qx, qy and qz"),
            (0, _) => {
                return refuse(
                    "a rotation matrix needs nine columns",
                    "give r11..r13, r21..r23 and r31..r33",
                );
            }
            _ => {
                return refuse(
                    "there are both a quaternion and a rotation matrix",
                    "keep qw,qx,qy,qz or r11..r33",
                );
            }
        }
        if self.orientation && (self.targets != 1 || self.numbered) {
            return refuse(
                "an orientation needs one position beside it",
                "give x_mm, y_mm and z_mm with it",
            );
        }
        if self.targets == 0 && !self.columns.contains(&Column::Sphere) {
            return refuse(
                "nothing says where the TCP was",
                "give x_mm,y_mm,z_mm (absolute data) or sphere (closed-loop data)",
            );
        }
        Ok(())
    }
}
