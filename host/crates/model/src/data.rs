//! What identification works on: an experiment as plain data, SI units; and what was measured beside it.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use spherecal_shared::MAX_CHAIN;
use spherecal_shared::robot::{Pose, Robot, RobotError, Tool};

use crate::input::MOST_TARGETS;
use crate::{CalibrationPlate, Sphere};

/// What an observation may be used for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Set {
    /// To fit the model.
    #[default]
    Calibrate,
    /// To judge it.
    Validate,
}

/// Where the TCP was, as far as is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// At a measured point, in m, in the frame of the measuring device (absolute data).
    Point([f64; 3]),
    /// Several targets on the tool at measured points, in m, in the frame of the
    /// measuring device: one entry per target, always in the same order; `None`
    /// where the device did not see it.
    Points(Box<[Option<[f64; 3]>]>),
    /// The whole tool frame as measured: its pose in the frame of the measuring device.
    Frame(Box<Pose>),
    /// At the centre of a sphere of the plate (closed-loop data).
    Sphere {
        /// Id of the sphere, as in [`Sphere::id`].
        sphere: u32,
        /// Which placement of the plate; each has a pose of its own.
        place: u32,
    },
}

/// One configuration of the robot and where its TCP was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Joint angles as the encoders gave them, base to flange, in rad.
    pub q: Vec<f64>,
    /// Measured joint torques, in N m, where the data has them.
    pub tau: Option<Vec<f64>>,
    /// Where the TCP was.
    pub target: Target,
    /// What the observation may be used for.
    pub set: Set,
    /// Rows with the same number share a seat of their own: the sphere sat elsewhere in the nest than usual. None
    /// for the usual seat, the TCP.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seat: Option<u32>,
}

/// Everything that an identification is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool.
    pub tool: Tool,
    /// The plate's certificate (empty for purely absolute data).
    pub spheres: Vec<Sphere>,
    /// Observations, in the order in which they were made.
    pub observations: Vec<Observation>,
}

impl Experiment {
    /// Checks every number that an identification will read.
    ///
    /// # Errors
    /// The first row or field that cannot be used, with its value and the remedy.
    pub fn check(&self) -> Result<(), DataError> {
        self.robot.check()?;
        self.tool.check()?;
        let n = self.robot.dof().min(MAX_CHAIN);
        for sphere in &self.spheres {
            check_sphere(sphere)?;
        }
        for (index, observation) in self.observations.iter().enumerate() {
            self.check_row(index + 1, observation, n)?;
        }
        self.check_kinds()
    }

    /// Rows with several targets or poses do not stand beside contacts with spheres.
    fn check_kinds(&self) -> Result<(), DataError> {
        let several = |o: &Observation| matches!(o.target, Target::Points(_) | Target::Frame(_));
        let contact = |o: &Observation| matches!(o.target, Target::Sphere { .. });
        match self.observations.iter().position(several) {
            Some(row) if self.observations.iter().any(contact) => Err(DataError::TargetKind {
                row: row + 1,
                kind: "several targets or a pose, and other rows give contacts with spheres",
                remedy: "give each kind in an experiment of its own",
            }),
            _ => Ok(()),
        }
    }

    fn check_row(&self, row: usize, observation: &Observation, n: usize) -> Result<(), DataError> {
        let count = |found: usize| {
            if found == n {
                Ok(())
            } else {
                Err(DataError::JointCount {
                    row,
                    found,
                    expected: n,
                })
            }
        };
        count(observation.q.len())?;
        for (i, &value) in observation.q.iter().enumerate() {
            let field = || format!("q{}", i + 1);
            within(
                row,
                field,
                value,
                50.0,
                "joint angles are in rad (use q1_deg.. for degrees)",
            )?;
        }
        if let Some(tau) = &observation.tau {
            count(tau.len())?;
            for (i, &value) in tau.iter().enumerate() {
                within(row, || format!("tau{}", i + 1), value, 1e5, "torques are in N m")?;
            }
        }
        match &observation.target {
            Target::Point(p) => check_point(row, "", p)?,
            Target::Points(points) => {
                if points.len() > MOST_TARGETS {
                    return Err(DataError::TargetKind {
                        row,
                        kind: "more targets than are identified together",
                        remedy: "give at most six per row",
                    });
                }
                if points.iter().all(Option::is_none) {
                    return Err(DataError::TargetKind {
                        row,
                        kind: "no target that was seen",
                        remedy: "leave the row out",
                    });
                }
                for (k, point) in points.iter().enumerate() {
                    if let Some(point) = point {
                        check_point(row, &(k + 1).to_string(), point)?;
                    }
                }
            }
            Target::Frame(pose) => {
                check_point(row, "", &pose.position.into())?;
                let off = (pose.rotation * pose.rotation.transpose() - Matrix3::identity()).amax();
                let right_handed = pose.rotation.determinant() > 0.0;
                if !(off < MOST_SKEW && right_handed) {
                    return Err(DataError::TargetKind {
                        row,
                        kind: "an orientation that is no rotation",
                        remedy: "give a rotation matrix: orthogonal, of determinant 1",
                    });
                }
            }
            &Target::Sphere { sphere, .. } => {
                if !self.spheres.iter().any(|s| s.id == sphere) {
                    let ids: Vec<_> = self.spheres.iter().map(|s| s.id.to_string()).collect();
                    let known = if ids.is_empty() {
                        "no spheres".to_owned()
                    } else {
                        ids.join(", ")
                    };
                    return Err(DataError::UnknownSphere { row, sphere, known });
                }
            }
        }
        Ok(())
    }
}

/// Most by which `R Rᵀ` of a measured orientation may differ from the identity.
const MOST_SKEW: f64 = 1e-6;

/// Refuses a point (m) that cannot be where a target is; `number` is that of its columns.
fn check_point(row: usize, number: &str, point: &[f64; 3]) -> Result<(), DataError> {
    for (axis, value) in ["x", "y", "z"].into_iter().zip(*point) {
        within(
            row,
            || format!("{axis}{number}"),
            value,
            100.0,
            "points lie within 100 m (use x_mm.. for mm)",
        )?;
    }
    Ok(())
}

/// Refuses what is not finite, or larger than `largest` either way.
fn within(
    row: usize,
    field: impl Fn() -> String,
    value: f64,
    largest: f64,
    remedy: &'static str,
) -> Result<(), DataError> {
    if !value.is_finite() {
        return Err(DataError::NotFinite {
            row,
            field: field(),
            value,
        });
    }
    if value.abs() > largest {
        return Err(DataError::OutOfRange {
            row,
            field: field(),
            value,
            remedy,
        });
    }
    Ok(())
}

fn check_sphere(sphere: &Sphere) -> Result<(), DataError> {
    let refuse = |field, value, remedy| {
        Err(DataError::Plate {
            sphere: sphere.id,
            field,
            value,
            remedy,
        })
    };
    for (field, value) in ["x", "y", "z"].into_iter().zip(sphere.position_m) {
        if value.is_nan() || value.abs() > 100.0 {
            return refuse(field, value, "give a finite coordinate within 100 m (mm need x_mm)");
        }
    }
    if sphere.sigma_m.is_finite() && sphere.sigma_m >= 0.0 {
        Ok(())
    } else {
        refuse(
            "sigma",
            sphere.sigma_m,
            "give the standard uncertainty, zero or positive",
        )
    }
}

/// Table 1 of the paper: three 50.8 mm spheres, ±2.7 µm at 95 %.
pub fn paper_plate() -> Vec<Sphere> {
    CalibrationPlate::default().certificate()
}

/// A laser tracker shot.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserShot {
    /// What it was made for: `calibrate`, `validate`, or an arc (`base_1`,
    /// `base_2`, `tool_5`, …).
    pub purpose: String,
    /// Joint angles as the encoders gave them, in rad.
    pub q: Vec<f64>,
    /// Measured point in the tracker's frame, in m.
    pub point_m: [f64; 3],
}

impl LaserShot {
    /// Purpose of the points that a model is calibrated from.
    pub const CALIBRATE: &'static str = "calibrate";
    /// Purpose of the points that models are judged by.
    pub const VALIDATE: &'static str = "validate";
    /// Purpose of an arc for the base, before the joint's number.
    pub const BASE: &'static str = "base_";
    /// Purpose of an arc for the tool, before the joint's number.
    pub const TOOL: &'static str = "tool_";
}

/// Which of the paper's laser sessions a shot belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrackerSession {
    /// Arcs of joints 1 and 2, which give the base.
    BaseArcs,
    /// Arcs of joints 5 to 7, which give the tool.
    ToolArcs,
    /// Calibration and validation measurements.
    #[default]
    Measurement,
}

/// The force against the approach around one contact.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContactTrace {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time of the trigger, in s.
    pub trigger_s: f64,
    /// Device time, in s, and force against the approach, in N, to a thousandth: the store keeps all digits as text.
    pub samples: Vec<(f64, f64)>,
}

/// What is wrong with an experiment: where, with its value, and the remedy.
///
/// Rows count the observations from 1, as the lines of a CSV under its header.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DataError {
    /// The nominal robot or tool is not usable.
    #[error("the nominal robot: {0}")]
    Robot(#[from] RobotError),
    /// A row has another number of joints than the robot.
    #[error("row {row}: {found} joint values, the robot has {expected} joints: give q1..q{expected}")]
    JointCount {
        /// Row, from 1.
        row: usize,
        /// Values found (angles or torques).
        found: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// A number is NaN or infinite.
    #[error("row {row}: {field} is {value}: give a finite number or leave the row out")]
    NotFinite {
        /// Row, from 1.
        row: usize,
        /// Column of the data.
        field: String,
        /// Its value.
        value: f64,
    },
    /// A number is far outside what the field can hold: almost surely a wrong unit.
    #[error("row {row}: {field} is {value}: {remedy}")]
    OutOfRange {
        /// Row, from 1.
        row: usize,
        /// Column of the data.
        field: String,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
    /// A row names a sphere that the plate does not have.
    #[error("row {row}: sphere {sphere} is not on the plate, which has {known}: correct the id or the plate file")]
    UnknownSphere {
        /// Row, from 1.
        row: usize,
        /// The id.
        sphere: u32,
        /// Ids of the plate.
        known: String,
    },
    /// A row says where the tool was in a way that the estimators do not take.
    #[error("row {row}: gives {kind}: {remedy}")]
    TargetKind {
        /// Row, from 1.
        row: usize,
        /// What it gives.
        kind: &'static str,
        /// What to give instead.
        remedy: &'static str,
    },
    /// The plate's certificate is not usable.
    #[error("sphere {sphere}: {field} is {value}: {remedy}")]
    Plate {
        /// Id of the sphere.
        sphere: u32,
        /// Field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
}
