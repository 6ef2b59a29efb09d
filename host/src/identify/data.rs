//! What identification works on: an experiment as plain data, SI units.

use serde::{Deserialize, Serialize};
use spherecal_shared::robot::{Robot, Tool};

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
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// At a measured point, in m, in the frame of the measuring device (absolute data).
    Point([f64; 3]),
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

/// A sphere of the plate as its certificate states it, in the plate's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Id that observations refer to.
    pub id: u32,
    /// Centre, in m.
    pub position_m: [f64; 3],
    /// Standard uncertainty of each coordinate (1 sigma), in m.
    pub sigma_m: f64,
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

/// Table 1 of the paper: three 50.8 mm spheres, ±2.7 µm at 95 %.
pub fn paper_plate() -> Vec<Sphere> {
    let sigma_m = 2.7e-6 / 1.96;
    [[0.0, 0.0, 0.0], [0.300_009, 0.0, 0.0], [0.150_049, 0.260_051, 0.0]]
        .into_iter()
        .zip(1..)
        .map(|(position_m, id)| Sphere {
            id,
            position_m,
            sigma_m,
        })
        .collect()
}
