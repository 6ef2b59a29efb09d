//! The data that a picture of the cell needs.

use serde::{Deserialize, Serialize};
use spherecal_shared::robot::{Robot, Tool};

use spherecal_plan::Plan;

/// What does not change during a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveScene {
    /// Kind of robot.
    pub robot: String,
    /// Which one; empty where it is not named.
    pub arm: String,
    /// The link to it.
    pub link: String,
    /// When the run was begun, UTC.
    pub begun_utc: String,
    /// Joints base to flange, nominal.
    pub joints: Vec<SceneJoint>,
    /// TCP in the last frame of the table, in m.
    pub tcp_m: [f64; 3],
    /// Planned positions of the spheres, each placement once.
    pub sites: Vec<SceneSphere>,
    /// Home, in rad: shown before the first telemetry.
    pub home_rad: Vec<f64>,
    /// Force at which contact is declared, in N.
    pub trigger_n: f64,
}

/// One joint: its row of the modified Denavit-Hartenberg table, and its range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneJoint {
    /// Twist about x of the frame before, in rad.
    pub alpha: f64,
    /// Length along x of the frame before, in m.
    pub a: f64,
    /// Hayati's rotation about y after the twist, in rad.
    pub beta: f64,
    /// Offset of the joint angle, in rad.
    pub theta: f64,
    /// Offset along z, in m.
    pub d: f64,
    /// Smallest joint angle, in rad.
    pub min_rad: f64,
    /// Largest, in rad.
    pub max_rad: f64,
}

/// One sphere in one placement of the plate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneSphere {
    /// Id of the sphere.
    pub sphere: u32,
    /// Placement of the plate.
    pub place: u32,
    /// Nominal centre in F0, in m.
    pub at_m: [f64; 3],
    /// Direction of the approach in F0, a unit vector.
    pub direction: [f64; 3],
}

impl LiveScene {
    /// The scene of a plan. The caller fills in arm and time.
    pub fn new(robot: &Robot, tool: &Tool, plan: &Plan, trigger_n: f64) -> Self {
        let mut sites: Vec<SceneSphere> = Vec::new();
        for visit in &plan.spheres {
            if !sites
                .iter()
                .any(|s| (s.sphere, s.place) == (visit.sphere_id, visit.place))
            {
                sites.push(SceneSphere {
                    sphere: visit.sphere_id,
                    place: visit.place,
                    at_m: visit.position_m,
                    direction: visit.approach_direction,
                });
            }
        }
        Self {
            robot: robot.name.to_string(),
            arm: String::new(),
            link: String::new(),
            begun_utc: String::new(),
            joints: robot
                .joints
                .iter()
                .map(|j| SceneJoint {
                    alpha: j.mdh.alpha,
                    a: j.mdh.a,
                    beta: j.mdh.beta,
                    theta: j.mdh.theta,
                    d: j.mdh.d,
                    min_rad: j.limits.min_rad,
                    max_rad: j.limits.max_rad,
                })
                .collect(),
            tcp_m: tool.tcp().into(),
            sites,
            home_rad: plan.home.joints.clone(),
            trigger_n,
        }
    }
}
