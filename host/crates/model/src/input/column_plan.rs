//! Which column of a recorded table becomes which column of the table that is read.

use std::collections::HashMap;

use super::columns::{ColumnRole, TableFormat};
use super::error::InputError;
use super::header_names::{Carrier, angle_unit, fixed, is_other, plain};
use super::mapping::{ColumnMapping, Meaning};
use super::orientation::Orientation;
use crate::excerpt;

/// A column of the table that is read.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum OutColumn {
    /// Cells as they are, under a name.
    Copy { from: usize, name: String },
    /// Four columns of a quaternion from three cells.
    Quaternion { from: [usize; 3], kind: Orientation },
}

/// The columns of a recorded table and what becomes of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Plan {
    pub(super) columns: Vec<OutColumn>,
    /// Columns of the recorded table.
    pub(super) width: usize,
    /// Columns of joint angles.
    pub(super) joints: Vec<usize>,
    /// Columns that say where the tool was, spheres included.
    pub(super) targets: Vec<usize>,
    /// Those of them that are numbers.
    pub(super) measured: Vec<usize>,
    /// Columns of joints that carry the base of the chain.
    pub(super) carriers: Vec<Carrier>,
    /// Whether a row has several points, of which some may be hidden.
    pub(super) numbered: bool,
    pub(super) changed: bool,
    pub(super) notes: Vec<String>,
}

/// Names of joint columns before their number. `0` or `1` comes first.
const JOINTS: [&str; 11] = [
    "q",
    "q_",
    "j",
    "joint",
    "joint_",
    "a",
    "actual_q_",
    "state.q_",
    "joint_position_",
    "position_",
    "joint_angle_",
];
/// Columns that are known and not used.
const UNUSED: [&str; 14] = [
    "t",
    "time",
    "time_ms",
    "time_s",
    "timestamp",
    "stamp",
    "robot_time",
    "temperature_c",
    "temperature",
    "duration",
    "success_rate",
    "frame_index",
    "episode_index",
    "index",
];
/// How the controller's own values begin in recordings of Universal Robots (RTDE) and Franka (libfranka).
const CONTROLLER: [&str; 12] = [
    "actual_",
    "target_",
    "state.",
    "cmd.",
    "o_t_ee",
    "f_t_ee",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "joint_mode",
    "output_",
    "joint_control_output",
];
/// Most names that a note lists.
const LISTED: usize = 6;

fn listed(names: &[String]) -> String {
    let more = names.len().saturating_sub(LISTED);
    let mut words: Vec<String> = names.iter().take(LISTED).map(|n| excerpt(n)).collect();
    if more > 0 {
        words.push(format!("and {more} more"));
    }
    words.join(", ")
}

/// The joint of each column of a family such as `q0..q5`, and whether it is in degrees; nothing unless all are there.
fn family(names: &[String], joints: usize) -> HashMap<usize, (usize, bool)> {
    for prefix in JOINTS {
        for first in [1, 0] {
            let found: Option<HashMap<usize, (usize, bool)>> = (0..joints)
                .map(|joint| {
                    let wanted = format!("{prefix}{}", joint + first);
                    let at = names.iter().position(|name| angle_unit(name).0 == wanted)?;
                    Some((at, (joint, names[at].ends_with("_deg"))))
                })
                .collect();
            let further = format!("{prefix}{}", joints + first);
            if let Some(found) = found.filter(|f| !f.is_empty() && !names.iter().any(|n| angle_unit(n).0 == further)) {
                return found;
            }
        }
    }
    HashMap::new()
}

/// A set of three columns with an orientation, by their usual names.
fn usual(names: &[String]) -> Option<([usize; 3], Orientation)> {
    let at = |wanted: &str| names.iter().position(|n| n == wanted);
    let three = |wanted: [&str; 3], unit: &str| {
        let [a, b, c] = wanted.map(|w| at(&format!("{w}{unit}")));
        Some([a?, b?, c?])
    };
    let rpy = ["roll", "pitch", "yaw"];
    let vector = ["rotvec_x", "rotvec_y", "rotvec_z"];
    let kuka = Orientation::euler("zyx", true)?;
    three(rpy, "_deg")
        .map(|f| (f, Orientation::rpy(true)))
        .or_else(|| {
            three(rpy, "_rad")
                .or_else(|| three(rpy, ""))
                .map(|f| (f, Orientation::rpy(false)))
        })
        .or_else(|| three(["w", "p", "r"], "_deg").map(|f| (f, Orientation::rpy(true))))
        .or_else(|| {
            three(["a", "b", "c"], "_deg")
                .or_else(|| three(["a", "b", "c"], ""))
                .map(|f| (f, kuka))
        })
        .or_else(|| {
            let found = three(vector, "").or_else(|| three(vector, "_rad"))?;
            Some((found, Orientation::RotationVector { degrees: false }))
        })
}

impl Plan {
    /// Names of the columns that are written.
    pub(super) fn names(&self) -> Vec<String> {
        let mut out = Vec::new();
        for column in &self.columns {
            match column {
                OutColumn::Copy { name, .. } => out.push(name.clone()),
                OutColumn::Quaternion { .. } => out.extend(["qw", "qx", "qy", "qz"].map(str::to_owned)),
            }
        }
        out
    }

    /// Plans the columns of a table with these names.
    /// Errors: a mapping that names a column that is not there.
    pub(super) fn new(
        file: &str,
        written: &[String],
        format: &TableFormat,
        mapping: &ColumnMapping,
    ) -> Result<Self, InputError> {
        let names: Vec<String> = written.iter().map(|n| plain(n)).collect();
        let mut plan = Self {
            width: names.len(),
            ..Self::default()
        };
        let mut new: Vec<Option<String>> = vec![None; names.len()];
        let mut gone = vec![false; names.len()];
        let mut turned = None;
        for (meaning, columns) in &mapping.entries {
            let found = columns.iter().map(|c| {
                names
                    .iter()
                    .position(|n| *n == plain(c))
                    .ok_or_else(|| InputError::Columns {
                        file: file.to_owned(),
                        what: format!("--columns names \"{}\", which is not in the table", excerpt(c)),
                        remedy: format!("name one of: {}", listed(written)),
                    })
            });
            let found = found.collect::<Result<Vec<usize>, InputError>>()?;
            plan.changed = true;
            for (k, &at) in found.iter().enumerate() {
                new[at] = Some(match meaning {
                    Meaning::Joints { degrees } => format!("q{}{}", k + 1, if *degrees { "_deg" } else { "" }),
                    Meaning::Torques => format!("tau{}", k + 1),
                    Meaning::Point { unit } => format!("{}_{unit}", ["x", "y", "z"][k % 3]),
                    Meaning::Quaternion(parts) => ["qw", "qx", "qy", "qz"][parts[k % 4]].to_owned(),
                    Meaning::Turned(_) => String::new(),
                    Meaning::Sphere => "sphere".to_owned(),
                    Meaning::Place => "place".to_owned(),
                    Meaning::Set => "set".to_owned(),
                });
            }
            if let (Meaning::Turned(kind), &[a, b, c]) = (meaning, found.as_slice()) {
                turned = Some(([a, b, c], *kind));
            }
        }
        let is_mapped = |meaning: fn(&Meaning) -> bool| mapping.entries.iter().any(|(m, _)| meaning(m));
        let own_joints = !format.joint_columns.is_empty() || is_mapped(|m| matches!(m, Meaning::Joints { .. }));
        if !own_joints {
            plan.joints_by_name(&names, format, &mut new);
        }
        if turned.is_none() && !is_mapped(|m| matches!(m, Meaning::Quaternion(_))) {
            let listed = [&format.joint_columns, &format.joint_names, &format.ignore];
            let own = |k: usize| {
                let is = |n: &String| plain(n) == names[k] || plain(n) == angle_unit(&names[k]).0;
                listed.iter().any(|list| list.iter().any(is))
            };
            turned = usual(&names).filter(|(from, _)| from.iter().all(|k| new[*k].is_none() && !own(*k)));
            if let Some((from, kind)) = turned {
                plan.changed = true;
                let columns = from.map(|k| written[k].as_str()).join(", ");
                plan.notes
                    .push(format!("the orientation is read from {columns}: {kind}"));
            }
        }
        if let Some((from, _)) = turned {
            for &k in &from {
                new[k] = Some(String::new());
            }
        }
        let known = |k: usize| {
            let name = &names[k];
            let is = |list: &[String]| list.iter().any(|n| plain(n) == *name || plain(n) == angle_unit(name).0);
            fixed(name).is_some()
                || is(&format.joint_names)
                || is(&format.joint_columns)
                || is(&format.ignore)
                || format.label.as_ref().is_some_and(|l| plain(l) == *name)
        };
        let (mut unused, mut beside) = (Vec::new(), Vec::new());
        for (k, name) in names.iter().enumerate() {
            if new[k].is_some() {
                continue;
            }
            // What the mapping gives goes before what the table names so.
            let shadowed = mapping.entries.iter().any(|(meaning, _)| shadows(meaning, name));
            let controller = CONTROLLER.iter().any(|c| name.starts_with(c));
            if !known(k) && is_other(name, format) {
                gone[k] = true;
                beside.push(written[k].clone());
                plan.carriers.extend(Carrier::new(format, k, &written[k]));
                continue;
            }
            let drop = !known(k) && (UNUSED.contains(&name.as_str()) || controller || mapping.ignore_rest);
            if shadowed || drop {
                gone[k] = true;
                unused.push(written[k].clone());
            }
        }
        if !unused.is_empty() {
            plan.changed = true;
            plan.notes
                .push(format!("columns that are not used: {}", listed(&unused)));
        }
        if !beside.is_empty() {
            plan.changed = true;
            let words = "columns of joints that are not on the chain are not used";
            plan.notes.push(format!("{words}: {}", listed(&beside)));
        }
        plan.lay_out(written, format, &new, &gone, turned);
        Ok(plan)
    }

    /// Joint columns by the names that the robot or its software gives.
    fn joints_by_name(&mut self, names: &[String], format: &TableFormat, new: &mut [Option<String>]) {
        let canonical = (1..=format.joints).all(|k| names.iter().any(|n| angle_unit(n).0 == format!("q{k}")));
        if canonical {
            return;
        }
        let robots: Vec<String> = format.joint_names.iter().map(|n| plain(n)).collect();
        let named = |name: &String| {
            let stem = name.strip_suffix(".pos")?;
            robots.iter().position(|r| r == stem)
        };
        let positions: Vec<Option<usize>> = names.iter().map(named).collect();
        if !robots.is_empty() && positions.iter().flatten().count() == robots.len() {
            for (k, joint) in positions.iter().enumerate() {
                if let Some(joint) = joint {
                    new[k] = Some(format!("q{}_deg", joint + 1));
                }
            }
            self.changed = true;
            self.notes
                .push("joint columns named .pos are taken as degrees".to_owned());
            return;
        }
        if !robots.is_empty()
            && robots
                .iter()
                .all(|r| names.iter().any(|n| angle_unit(n).0 == r || n == r))
        {
            return;
        }
        for (k, (joint, degrees)) in family(names, format.joints) {
            new[k] = Some(format!("q{}{}", joint + 1, if degrees { "_deg" } else { "" }));
            self.changed = true;
        }
        if self.changed
            && let Some(first) = new
                .iter()
                .position(|n| n.as_deref().is_some_and(|n| n == "q1" || n == "q1_deg"))
        {
            self.notes
                .push(format!("joint 1 is taken from the column {}", excerpt(&names[first])));
        }
    }

    /// The columns in the order of the table.
    fn lay_out(
        &mut self,
        written: &[String],
        format: &TableFormat,
        new: &[Option<String>],
        gone: &[bool],
        turned: Option<([usize; 3], Orientation)>,
    ) {
        let robots: Vec<String> = format
            .joint_names
            .iter()
            .chain(&format.joint_columns)
            .map(|n| plain(n))
            .collect();
        for k in (0..written.len()).filter(|k| !gone[*k]) {
            if let Some((from, kind)) = turned
                && from.contains(&k)
            {
                if from[0] == k {
                    self.columns.push(OutColumn::Quaternion { from, kind });
                }
                self.measured.push(k);
                continue;
            }
            let name = new[k].clone().unwrap_or_else(|| written[k].clone());
            let lower = plain(&name);
            match fixed(&lower) {
                Some(ColumnRole::Angle { .. }) => self.joints.push(k),
                Some(ColumnRole::Coordinate { target, .. }) => {
                    self.targets.push(k);
                    self.measured.push(k);
                    self.numbered |= target > 0;
                }
                Some(ColumnRole::Quaternion(_) | ColumnRole::Rotation(_)) => self.measured.push(k),
                Some(ColumnRole::Sphere) => self.targets.push(k),
                None if robots.iter().any(|r| *r == lower || *r == angle_unit(&lower).0) => self.joints.push(k),
                _ => {}
            }
            self.columns.push(OutColumn::Copy { from: k, name });
        }
    }
}

/// Whether a mapped meaning replaces the column that is usually named so.
fn shadows(meaning: &Meaning, name: &str) -> bool {
    matches!(
        (meaning, fixed(name)),
        (Meaning::Joints { .. }, Some(ColumnRole::Angle { .. }))
            | (Meaning::Torques, Some(ColumnRole::Torque { .. }))
            | (Meaning::Point { .. }, Some(ColumnRole::Coordinate { .. }))
            | (
                Meaning::Quaternion(_) | Meaning::Turned(_),
                Some(ColumnRole::Quaternion(_) | ColumnRole::Rotation(_))
            )
            | (Meaning::Sphere, Some(ColumnRole::Sphere))
            | (Meaning::Place, Some(ColumnRole::Place))
            | (Meaning::Set, Some(ColumnRole::Set))
    )
}
