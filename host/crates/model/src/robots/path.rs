//! A path through a tree of joints: any number of joints that turn or slide, each at a position of its own or one that
//! follows from others.
//!
//! ```text
//!   columns (measured) ──▶ positions (rad, m), one per joint ──▶ frames ──▶ tip
//!                 linear: position = offset + Σ factor · column
//! ```
//!
//! The table of a [`RobotModel`] holds the turning joints alone. The path is what it leaves out too: sliding joints,
//! joints that mimic others, and the columns that a recording of this arm has.

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::robot::Pose;

use super::error::RobotFileError;
use super::frames::{compose, inverse, rot_axis, row_transform};
use super::model::{Origin, RobotModel};
use super::urdf::{JointMotion, Urdf, UrdfChain, UrdfJoint};
use super::urdf_in::axis_towards_tip;
use crate::excerpt;

/// Longest line of joints that each mimic the next.
const MOST_LEADERS: usize = 20;

/// How a joint moves along or about its axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// About its axis; positions in rad.
    Turns,
    /// Along its axis; positions in m.
    Slides,
}

/// A joint of a path.
#[derive(Clone, Debug, PartialEq)]
pub struct PathJoint {
    /// Its name; empty where nobody named it.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// Its frame at position zero, in the frame of the joint before it (of the base for the first).
    pub origin: Pose<f64>,
    /// Unit axis in its own frame.
    pub axis: Vector3<f64>,
    /// Columns that drive it, each with its factor.
    pub terms: Vec<(usize, f64)>,
    /// Its position with all columns at zero, in rad or m.
    pub offset: f64,
}

impl PathJoint {
    /// The motion at a position (rad or m), in its own frame.
    pub fn motion(&self, position: f64) -> Pose<f64> {
        match self.kind {
            JointKind::Turns => Pose {
                rotation: rot_axis(&self.axis, position),
                position: Vector3::zeros(),
            },
            JointKind::Slides => Pose {
                rotation: Matrix3::identity(),
                position: self.axis * position,
            },
        }
    }
}

/// Joints from a base to a tip.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPath {
    /// Names of the joints whose positions are measured.
    pub columns: Vec<String>,
    /// The joints, base to tip.
    pub joints: Vec<PathJoint>,
    /// The tip in the frame of the last joint.
    pub end: Pose<f64>,
}

/// The frames of a path at one configuration, in the base frame.
#[derive(Clone, Debug)]
pub struct PathFrames {
    /// Each joint's frame before its motion.
    pub before: Vec<Pose<f64>>,
    /// Each joint's frame behind its motion.
    pub behind: Vec<Pose<f64>>,
    /// The tip.
    pub tip: Pose<f64>,
}

/// How a point and its body move per unit of a parameter, in the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist {
    /// Motion of the point, in m per unit.
    pub linear: Vector3<f64>,
    /// Turn of the body, in rad per unit.
    pub angular: Vector3<f64>,
}

impl JointPath {
    /// The first joint that slides or follows others: the columns of the path are not the angles of its table.
    pub fn odd_joint(&self) -> Option<&PathJoint> {
        let odd = |(k, joint): &(usize, &PathJoint)| {
            joint.kind != JointKind::Turns || joint.offset != 0.0 || joint.terms != [(*k, 1.0)]
        };
        self.joints.iter().enumerate().find(odd).map(|(_, joint)| joint)
    }

    /// Positions of all joints (rad, m) for measured `columns`; a missing column is zero.
    pub fn positions(&self, columns: &[f64]) -> Vec<f64> {
        let column = |k: usize| columns.get(k).copied().unwrap_or_default();
        let terms = |joint: &PathJoint| joint.terms.iter().map(|&(k, factor)| factor * column(k)).sum::<f64>();
        self.joints.iter().map(|joint| joint.offset + terms(joint)).collect()
    }

    /// Positions of the turning joints alone: the angles (rad) of the robot's table.
    pub fn table_angles(&self, positions: &[f64]) -> Vec<f64> {
        let pairs = self.joints.iter().zip(positions);
        pairs
            .filter(|(joint, _)| joint.kind == JointKind::Turns)
            .map(|(_, q)| *q)
            .collect()
    }

    /// All frames at joint `positions` (rad, m).
    pub fn frames(&self, positions: &[f64]) -> PathFrames {
        let mut frames = PathFrames {
            before: Vec::with_capacity(self.joints.len()),
            behind: Vec::with_capacity(self.joints.len()),
            tip: Pose::identity(),
        };
        let mut at = Pose::identity();
        for (joint, &position) in self.joints.iter().zip(positions) {
            let before = compose(&at, &joint.origin);
            at = compose(&before, &joint.motion(position));
            frames.before.push(before);
            frames.behind.push(at);
        }
        frames.tip = compose(&at, &self.end);
        frames
    }

    /// How `point` (m, base frame), fixed to the tip, moves per rad or m of joint `k`.
    pub fn joint_column(&self, frames: &PathFrames, k: usize, point: &Vector3<f64>) -> Twist {
        let (Some(joint), Some(frame)) = (self.joints.get(k), frames.behind.get(k)) else {
            return Twist {
                linear: Vector3::zeros(),
                angular: Vector3::zeros(),
            };
        };
        let axis = frame.rotation * joint.axis;
        match joint.kind {
            JointKind::Turns => Twist {
                linear: axis.cross(&(point - frame.position)),
                angular: axis,
            },
            JointKind::Slides => Twist {
                linear: axis,
                angular: Vector3::zeros(),
            },
        }
    }

    /// How `point` (m, base frame), fixed to the tip, moves when the origin of joint `k` is shifted along its own x, y
    /// and z (per m) and turned about them (per rad); for `k` equal to the number of joints, the tip.
    pub fn origin_columns(&self, frames: &PathFrames, k: usize, point: &Vector3<f64>) -> [Twist; 6] {
        let frame = frames.before.get(k).unwrap_or(&frames.tip);
        std::array::from_fn(|n| {
            let axis: Vector3<f64> = frame.rotation.column(n % 3).into();
            if n < 3 {
                Twist {
                    linear: axis,
                    angular: Vector3::zeros(),
                }
            } else {
                Twist {
                    linear: axis.cross(&(point - frame.position)),
                    angular: axis,
                }
            }
        })
    }
}

/// The columns that drive a joint of a URDF, by name and factor, and its offset.
fn law(urdf: &Urdf, joint: &UrdfJoint) -> Result<(String, f64, f64), RobotFileError> {
    let (mut at, mut factor, mut offset) = (joint, 1.0, 0.0);
    for _ in 0..MOST_LEADERS {
        let Some(mimic) = &at.mimic else {
            return Ok((at.name.clone(), factor, offset));
        };
        offset += factor * mimic.offset;
        factor *= mimic.multiplier;
        match urdf.joints.iter().find(|j| j.name == mimic.leader) {
            Some(leader) => at = leader,
            None => break,
        }
    }
    Err(RobotFileError::Value {
        path: urdf.path.clone(),
        field: format!("joint \"{}\": mimic", joint.name),
        value: joint.mimic.as_ref().map_or_else(String::new, |m| m.leader.clone()),
        remedy: "name a joint of the file that moves by itself".to_owned(),
    })
}

fn of_urdf(urdf: &Urdf, chain: &UrdfChain) -> Result<JointPath, RobotFileError> {
    let mut path = JointPath {
        columns: Vec::new(),
        joints: Vec::new(),
        end: Pose::identity(),
    };
    let mut origin = Pose::identity();
    for (k, &i) in chain.path.iter().enumerate() {
        let joint = &urdf.joints[i];
        // What stands before the joint's motion, and what follows it.
        let (before, behind) = if k < chain.up {
            (Pose::identity(), inverse(&joint.origin))
        } else {
            (joint.origin, Pose::identity())
        };
        origin = compose(&origin, &before);
        let kind = match joint.motion {
            JointMotion::Turns => JointKind::Turns,
            JointMotion::Slides => JointKind::Slides,
            JointMotion::Fixed | JointMotion::Other => {
                origin = compose(&origin, &behind);
                continue;
            }
        };
        let (column, factor, offset) = law(urdf, joint)?;
        let number = path
            .columns
            .iter()
            .position(|c| *c == column)
            .unwrap_or(path.columns.len());
        if number == path.columns.len() {
            path.columns.push(column);
        }
        path.joints.push(PathJoint {
            name: joint.name.clone(),
            kind,
            origin: std::mem::replace(&mut origin, behind),
            axis: axis_towards_tip(urdf, chain, k, i),
            terms: vec![(number, factor)],
            offset,
        });
    }
    path.end = origin;
    Ok(path)
}

impl RobotModel {
    /// The joints from the root frame to the flange, sliding and following ones included.
    ///
    /// # Errors
    /// A joint that mimics one that the file does not hold.
    pub fn joint_path(&self) -> Result<JointPath, RobotFileError> {
        match &self.origin {
            Origin::Urdf(source) => of_urdf(&source.0, &source.1),
            Origin::BuiltIn | Origin::Toml => Ok(self.table_path()),
        }
    }

    /// The joints of the table as a path, root frame to flange: each turns by an angle of its own.
    pub fn table_path(&self) -> JointPath {
        let joint = |(k, row)| PathJoint {
            name: self.joint_names.get(k).cloned().unwrap_or_default(),
            kind: JointKind::Turns,
            origin: if k == 0 {
                compose(&self.base, &row_transform(row, 0.0))
            } else {
                row_transform(row, 0.0)
            },
            axis: Vector3::z(),
            terms: vec![(k, 1.0)],
            offset: 0.0,
        };
        let joints: Vec<PathJoint> = self.rows().iter().enumerate().map(joint).collect();
        let name = |(k, joint): (usize, &PathJoint)| match joint.name.as_str() {
            "" => format!("q{}", k + 1),
            name => name.to_owned(),
        };
        JointPath {
            columns: joints.iter().enumerate().map(name).collect(),
            joints,
            end: self.flange,
        }
    }

    /// Refuses a robot that its table does not describe alone: one with joints that slide or follow others, or with a base
    /// that its own joints carry. Everything that commands an arm needs a plain one.
    ///
    /// # Errors
    /// The first such joint, or the base.
    pub fn plain(self) -> Result<Self, RobotFileError> {
        if let Origin::Urdf(source) = &self.origin
            && source.1.up > 0
        {
            return Err(RobotFileError::Value {
                path: source.0.path.clone(),
                field: "base link".to_owned(),
                value: source.1.root.clone(),
                remedy: format!(
                    "joints of the chain carry it: only `identify` and `robot show` take such a chain; name a base on the way \
                     from the root to {}",
                    excerpt(&source.1.tip)
                ),
            });
        }
        let path = self.joint_path()?;
        match (path.odd_joint(), &self.origin) {
            (Some(joint), Origin::Urdf(source)) => Err(RobotFileError::Value {
                path: source.0.path.clone(),
                field: format!("joint \"{}\": type", joint.name),
                value: if joint.kind == JointKind::Slides {
                    "prismatic"
                } else {
                    "mimic"
                }
                .to_owned(),
                remedy: format!(
                    "only `identify` and `robot show` take a chain with such a joint; name another base or tip as \
                     {}#BASE:TIP",
                    source.0.path
                ),
            }),
            _ => Ok(self),
        }
    }
}

#[cfg(test)]
#[path = "path_tests.rs"]
mod tests;
