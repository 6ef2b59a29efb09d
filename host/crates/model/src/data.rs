//! What identification works on: an experiment as plain data, SI units.

use serde::{Deserialize, Serialize};
use spherecal_shared::MAX_JOINTS;
use spherecal_shared::robot::{Pose, Robot, Tool};

use crate::{CalibrationPlate, DataError, Sphere};

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
        let n = self.robot.dof().min(MAX_JOINTS);
        for sphere in &self.spheres {
            check_sphere(sphere)?;
        }
        for (index, observation) in self.observations.iter().enumerate() {
            self.check_row(index + 1, observation, n)?;
        }
        Ok(())
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
            Target::Point(p) => {
                for (axis, value) in ["x", "y", "z"].into_iter().zip(*p) {
                    within(
                        row,
                        || axis.to_owned(),
                        value,
                        100.0,
                        "points lie within 100 m (use x_mm.. for mm)",
                    )?;
                }
            }
            Target::Points(_) => {
                return Err(DataError::TargetKind {
                    row,
                    kind: "several measured points",
                    remedy: "give one point per row (x_mm, y_mm, z_mm), each target in a table of its own",
                });
            }
            Target::Frame(_) => {
                return Err(DataError::TargetKind {
                    row,
                    kind: "a measured frame",
                    remedy: "give its position (x_mm, y_mm, z_mm), and leave the orientation out with --ignore-columns",
                });
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
