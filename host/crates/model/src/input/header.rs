//! The header of a table: which column holds what.
//!
//! Names are taken without regard to case, and a unit may stand in brackets:
//! `x [mm]` is `x_mm`. Every column is known, mapped by the robot's joint names or
//! by the caller, or ignored because the caller says so; any other is refused.

use std::collections::{HashMap, HashSet};

use super::columns::{ColumnRole, MOST_TARGETS, TableFormat, TableHeader};
use super::error::InputError;
use super::header_names::{DEGREE, angle_unit, fixed, hint, is_other, key, known, plain};
use crate::excerpt;

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
/// Errors: columns that are not known, stand twice, or are incomplete together.
pub(super) fn header(file: &str, names: Vec<String>, format: &TableFormat) -> Result<TableHeader, InputError> {
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
        let as_angle = |(joint, scale): (usize, f64)| ColumnRole::Angle { joint, scale };
        let column = if ignore.contains_key(&name) {
            Some(ColumnRole::Ignored)
        } else if let Some(found) = named(&own) {
            // `--joint-columns a_deg`: the name itself says the unit.
            let scale = if name.ends_with("_deg") { DEGREE } else { found.1 };
            Some(ColumnRole::Angle { joint: found.0, scale })
        } else {
            match fixed(&name) {
                Some(ColumnRole::Angle { .. }) if !own.is_empty() => None,
                Some(column) => Some(column),
                None if own.is_empty() && named(&robots).is_some() => named(&robots).map(as_angle),
                None if label.as_ref() == Some(&name) => Some(ColumnRole::Label),
                None if is_other(&name, format) => Some(ColumnRole::Ignored),
                None => None,
            }
        };
        if column.is_none() {
            first_hint = first_hint.or_else(|| hint(&name, format));
            unknown.push(name);
        }
        columns.push(match column {
            Some(ColumnRole::Angle { joint, scale }) => ColumnRole::Angle {
                joint,
                scale: scale * format.units.get(joint).copied().unwrap_or(1.0),
            },
            column => column.unwrap_or(ColumnRole::Ignored),
        });
    }
    if !unknown.is_empty() {
        let numbers = |n: &String| n.replace(',', ".").parse::<f64>().is_ok();
        if unknown.len() > 1 && unknown.iter().filter(|n| numbers(n)).count() > unknown.len() / 2 {
            return Err(refuse(
                "the first line holds numbers, not names of columns".to_owned(),
                format!(
                    "begin with a header line, or name the columns by their numbers: --columns joints=1,2,3 point_mm=4,5,6 for \
                     three joints; known names are {}",
                    known(format)
                ),
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
    let mut header = TableHeader {
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

impl TableHeader {
    fn has(&self, wanted: impl Fn(&ColumnRole) -> bool) -> bool {
        self.columns.iter().any(wanted)
    }

    /// Every joint has its angle, and every one or none its torque.
    fn joints(&mut self, format: &TableFormat) -> Result<(), (String, String)> {
        let n = format.joints;
        let angle = |k: usize| move |c: &ColumnRole| matches!(c, ColumnRole::Angle { joint, .. } if *joint == k);
        let torque = |k: usize| move |c: &ColumnRole| *c == ColumnRole::Torque { joint: k };
        self.torques = self.has(|c| matches!(c, ColumnRole::Torque { .. }));
        for column in &self.columns {
            let (what, joint) = match column {
                ColumnRole::Angle { joint, .. } => ("q", *joint),
                ColumnRole::Torque { joint } => ("tau", *joint),
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
            self.has(|c| matches!(c, ColumnRole::Coordinate { target, axis, .. } if (*target, *axis) == (t, a)))
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
        let quaternion = (0..4)
            .filter(|k| self.has(|c| *c == ColumnRole::Quaternion(*k)))
            .count();
        let rotation = (0..9).filter(|k| self.has(|c| *c == ColumnRole::Rotation(*k))).count();
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
        let spheres = self.columns.contains(&ColumnRole::Sphere);
        if spheres && (self.numbered || self.orientation) {
            return refuse(
                "there is a column sphere beside several targets or a pose",
                "give contacts with spheres in a table of their own",
            );
        }
        if self.targets == 0 && !spheres {
            return refuse(
                "nothing says where the TCP was",
                "give x_mm,y_mm,z_mm (absolute data) or sphere (closed-loop data)",
            );
        }
        Ok(())
    }
}
