//! Measured points of an arm with sliding joints, as those of the same arm with its slides at zero.
//!
//! A joint that slides moves the TCP by `R u s`: the direction of its axis in the instrument's frame times its position. A
//! fit of the whole path (base, tool, offsets and origins of all joints, the sliding ones too) gives that motion for each
//! row. Without it the points are those of an arm of hinges, which the identification knows. What remains of an error of
//! the slide is that of the fit: in first order its least-squares error.

use nalgebra::Vector3;
use spherecal_model::input::Table;
use spherecal_model::robots::{JointKind, JointPath};
use spherecal_model::{Observation, Target};

use crate::fit::{Effort, State, fit};
use crate::rows::rows;

/// Fewest rows for the fit of a path.
const FEWEST: usize = 10;
/// Standard deviation of the TCP, in m: also that of a tool that nobody gave.
const TOOL_M: f64 = 0.3;

/// Why the motion of the slides cannot be taken out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlidesError {
    /// Too few rows.
    TooFew,
    /// Contacts with spheres: their places are known, and cannot be moved.
    Contacts,
}

impl std::fmt::Display for SlidesError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::TooFew => "an arm with sliding joints needs at least ten rows with a measured point",
            Self::Contacts => "contacts with spheres cannot be used with sliding joints: give measured points",
        })
    }
}

impl std::error::Error for SlidesError {}

/// The fitted motion of the slides.
#[derive(Clone, Debug)]
pub struct Slides {
    state: State,
    /// Median distance of the TCP from its targets in the fit of the whole path, in m.
    pub left_m: f64,
}

impl Slides {
    /// Fits a path with its tool (TCP in the flange frame, m) to rows of joint columns.
    ///
    /// # Errors
    /// Too few rows, or contacts with spheres.
    pub fn fit(path: &JointPath, tool: &Vector3<f64>, observations: &[Observation]) -> Result<Self, SlidesError> {
        if observations.iter().any(|o| matches!(o.target, Target::Sphere { .. })) {
            return Err(SlidesError::Contacts);
        }
        let rows = rows(observations, &[]);
        if rows.len() < FEWEST {
            return Err(SlidesError::TooFew);
        }
        let effort = Effort {
            offsets: true,
            origins: true,
            tool_m: TOOL_M,
            iterations: 50,
        };
        let fitted = fit(path, tool, &rows, effort);
        Ok(Self {
            state: fitted.state,
            left_m: fitted.median_m,
        })
    }

    /// Directions of the sliding joints with all joints at zero, base to tip, in the instrument's frame.
    pub fn directions(&self) -> Vec<Vector3<f64>> {
        self.state.slides()
    }

    /// What to add to a measured point (m, instrument's frame) of a row with these joint columns.
    pub fn shift(&self, columns: &[f64]) -> Vector3<f64> {
        self.state.tcp(columns, false) - self.state.tcp(columns, true)
    }
}

/// Turns a table of the columns of a path into one of the hinges of its table, with the slides at zero. `tool` is the TCP in
/// the flange frame, in m. The first table gives the motion of the slides, also for a later one. Returns what was done.
///
/// # Errors
/// As [`Slides::fit`].
pub fn hinges(
    path: &JointPath,
    tool: &Vector3<f64>,
    table: &mut Table,
    motion: &mut Option<Slides>,
) -> Result<Vec<String>, SlidesError> {
    let mut notes = Vec::new();
    let slides = path.joints.iter().filter(|joint| joint.kind == JointKind::Slides);
    let names: Vec<&str> = slides.map(|joint| joint.name.as_str()).collect();
    if !names.is_empty() && motion.is_none() {
        let observations: Vec<Observation> = table
            .rows()
            .map(|row| Observation {
                q: row.q.to_vec(),
                tau: None,
                target: row.target(),
                set: row.set.unwrap_or_default(),
                seat: None,
            })
            .collect();
        let found = Slides::fit(path, tool, &observations)?;
        notes.push(format!(
            "the motion of the sliding joints ({}) was fitted with the whole chain (to {:.3} mm) and taken out of the points: \
             the turning joints are calibrated, and calibrated.urdf has the directions of the slides",
            names.join(", "),
            found.left_m * 1e3
        ));
        *motion = Some(found);
    }
    if table.rows().any(|row| row.tau.is_some()) {
        notes.push("torques are of the table's columns and not of the hinges: they are not used".to_owned());
    }
    table.with_joints(|columns| {
        let shift = motion.as_ref().map_or([0.0; 3], |m| m.shift(columns).into());
        (path.table_angles(&path.positions(columns)), shift)
    });
    Ok(notes)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;
    use spherecal_model::robots::frames::{compose, from_rpy};
    use spherecal_model::robots::{RobotModel, load_path};
    use spherecal_model::{Pose, Set};

    use super::*;

    /// Joints `name type axis` in a row, as a file.
    fn arm(folder: &std::path::Path, joints: &[(&str, &str, &str)]) -> RobotModel {
        let mut out = "<robot name=\"small\"><link name=\"l0\"/>".to_owned();
        for (k, (name, kind, axis)) in joints.iter().enumerate() {
            let mimic = name.split_once('=').map_or(String::new(), |(_, leader)| {
                format!("<mimic joint=\"{leader}\" multiplier=\"-1\"/>")
            });
            let name = name.split('=').next().unwrap();
            out += &format!(
                "<link name=\"l{}\"/><joint name=\"{name}\" type=\"{kind}\"><origin xyz=\"0.05 0.02 0.3\"/><parent \
                 link=\"l{k}\"/><child link=\"l{}\"/><axis xyz=\"{axis}\"/>{mimic}<limit lower=\"-2\" upper=\"2\"/></joint>",
                k + 1,
                k + 1
            );
        }
        let n = joints.len();
        out += &format!(
            "<link name=\"tool0\"/><joint name=\"t\" type=\"fixed\"><parent link=\"l{n}\"/><child link=\"tool0\"/></joint></robot>"
        );
        let file = folder.join("arm.urdf");
        std::fs::write(&file, out).unwrap();
        load_path(&file.display().to_string()).unwrap()
    }

    const TORSO: [(&str, &str, &str); 8] = [
        ("lift", "prismatic", "0 0 1"),
        ("j1", "revolute", "0 0 1"),
        ("j2", "revolute", "0 1 0"),
        ("j3", "revolute", "0 0 1"),
        ("j4", "revolute", "0 1 0"),
        ("j5", "revolute", "0 0 1"),
        ("j6", "revolute", "0 1 0"),
        ("j7", "revolute", "0 0 1"),
    ];
    const SCARA: [(&str, &str, &str); 4] = [
        ("j1", "revolute", "0 0 1"),
        ("j2", "revolute", "0 0 1"),
        ("j3", "prismatic", "0 0 -1"),
        ("j4", "revolute", "0 0 1"),
    ];
    const RAIL: [(&str, &str, &str); 7] = [
        ("rail", "prismatic", "1 0 0"),
        ("j1", "revolute", "0 0 1"),
        ("j2", "revolute", "0 1 0"),
        ("j3", "revolute", "0 1 0"),
        ("j4", "revolute", "1 0 0"),
        ("j5", "revolute", "0 1 0"),
        ("j6", "revolute", "1 0 0"),
    ];
    const PARALLELOGRAM: [(&str, &str, &str); 6] = [
        ("j1", "revolute", "0 0 1"),
        ("j2", "revolute", "0 1 0"),
        ("rod=j2", "revolute", "0 1 0"),
        ("j3", "revolute", "0 1 0"),
        ("slide", "prismatic", "1 0 0"),
        ("j4", "revolute", "0 0 1"),
    ];

    // Fails if the arm of hinges alone, fitted to the points without the slides, is further from them than 1.1 times the
    // noise that a least-squares fit of the whole path leaves; for a torso, a SCARA, a rail, and a parallelogram.
    #[test]
    fn an_arm_of_hinges_is_left() {
        let folder = tempfile::tempdir().unwrap();
        for (name, joints) in [
            ("torso", &TORSO[..]),
            ("SCARA", &SCARA),
            ("rail", &RAIL),
            ("parallelogram", &PARALLELOGRAM),
        ] {
            let model = arm(folder.path(), joints);
            assert!(model.clone().plain().is_err());
            let path = model.joint_path().unwrap();
            let mut rng = ChaCha8Rng::seed_from_u64(7);
            let mut normal = move || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            let mut truth = path.clone();
            for joint in &mut truth.joints {
                let own = Pose {
                    rotation: from_rpy([normal() * 2e-3, normal() * 2e-3, normal() * 2e-3]),
                    position: Vector3::new(normal(), normal(), normal()) * 1e-3,
                };
                joint.origin = compose(&joint.origin, &own);
            }
            let base = Pose {
                rotation: from_rpy([0.4, -0.3, 2.0]),
                position: Vector3::new(2.0, 1.0, 0.3),
            };
            let tool = Vector3::new(0.05, 0.02, 0.1);
            let rows: Vec<Observation> = (0..200)
                .map(|_| {
                    let q: Vec<f64> = path.columns.iter().map(|_| normal().clamp(-2.0, 2.0) * 0.6).collect();
                    let tip = compose(&base, &truth.frames(&truth.positions(&q)).tip);
                    let noise = Vector3::new(normal(), normal(), normal()) * 1e-4;
                    Observation {
                        q,
                        tau: None,
                        target: Target::Point((tip.point(&tool) + noise).into()),
                        set: Set::Calibrate,
                        seat: None,
                    }
                })
                .collect();
            let slides = Slides::fit(&path, &tool, &rows).unwrap();
            let hinges = model.table_path();
            let moved: Vec<Observation> = rows
                .iter()
                .map(|row| {
                    let Target::Point(at) = row.target else { panic!() };
                    Observation {
                        q: path.table_angles(&path.positions(&row.q)),
                        target: Target::Point((Vector3::from(at) + slides.shift(&row.q)).into()),
                        ..row.clone()
                    }
                })
                .collect();
            let left = Slides::fit(&hinges, &tool, &moved).unwrap().left_m;
            println!("{name}: {:.4} mm, whole path {:.4} mm", left * 1e3, slides.left_m * 1e3);
            assert!(slides.left_m < 2e-4, "{name}: {}", slides.left_m);
            assert!(left < 1.1 * slides.left_m, "{name}: {left} after {}", slides.left_m);
        }
    }
}
