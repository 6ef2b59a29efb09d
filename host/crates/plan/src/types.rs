//! What a plan is, as plain serialisable data.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::cell::Obstacles;
use super::path::Obstacle;

/// A configuration in free space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// TCP in F0, in m.
    pub position_m: [f64; 3],
    /// Orientation of FT in F0 as a unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
    /// Elbow angle in rad, for arms that have one.
    pub elbow_rad: Option<f64>,
    /// Joint angles base to flange, in rad.
    pub joints: Vec<f64>,
}

impl Default for Waypoint {
    fn default() -> Self {
        Self {
            position_m: [0.0; 3],
            orientation: [1.0, 0.0, 0.0, 0.0],
            elbow_rad: None,
            joints: Vec::new(),
        }
    }
}

/// A pose about a sphere: the TCP at its centre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedPose {
    /// Id of the pose, unique within the plan.
    pub id: u32,
    /// Only passed through, not recorded. Such a pose keeps the motion continuous.
    #[serde(default)]
    pub via: bool,
    /// Orientation of FT in F0 as a unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
    /// Elbow angle in rad, for arms that have one.
    pub elbow_rad: Option<f64>,
    /// Joint angles of the nominal robot, continuous with the previous pose, in rad.
    pub joints: Vec<f64>,
}

/// One visit to a sphere: approach, couple, all its poses, decouple.
///
/// A sphere may be visited more than once, in other placements of the plate or
/// other branches of the inverse kinematics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Visit {
    /// Id of the sphere, as in the plate's certificate.
    pub sphere_id: u32,
    /// Which placement of the plate.
    pub place: u32,
    /// Nominal centre of the sphere in F0, in m.
    pub position_m: [f64; 3],
    /// Whether the path to the approach leads over home instead of straight from the previous
    /// visit.
    #[serde(default = "over_home")]
    pub over_home: bool,
    /// Start of the descent: above the centre, against the approach direction.
    pub approach: Waypoint,
    /// Direction of the descent in F0, a unit vector.
    pub approach_direction: [f64; 3],
    /// Poses in the order of motion.
    pub poses: Vec<PlannedPose>,
}

/// What plans of old did.
fn over_home() -> bool {
    true
}

impl Visit {
    /// Poses that are recorded.
    pub fn recorded(&self) -> usize {
        self.poses.iter().filter(|p| !p.via).count()
    }
}

/// A pose of the grid that is not in the plan, and the reason.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rejection {
    /// Id that the pose would have had.
    pub id: u32,
    /// Its sphere.
    pub sphere_id: u32,
    /// The obstacle.
    pub obstacle: Obstacle,
}

/// Predicted TCP error over the validation volume, base aligned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Poses recorded.
    pub poses: usize,
    /// Mean error, in mm.
    pub mean_mm: f64,
    /// Mean error at the worst configuration, in mm.
    pub worst_mm: f64,
}

/// The whole plan, in the order of execution.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the robot that it was made for.
    pub robot: String,
    /// Safe start and end of all motions (the paper's homeFrame).
    pub home: Waypoint,
    /// Visits to the spheres.
    pub spheres: Vec<Visit>,
    /// Poses that were considered.
    pub planned: usize,
    /// Poses of them that the arm reaches.
    pub reachable: usize,
    /// The others.
    pub rejected: Vec<Rejection>,
    /// Predicted robot time, in s: visits, turning, recording and second visits ([`robot_time`](super::robot_time)).
    pub robot_s: f64,
    /// Predicted accuracy against the number of poses. The last item is that of the whole plan.
    /// Empty if none was predicted.
    #[serde(default)]
    pub promise: Vec<Accuracy>,
    /// What stands in the way of a free arm.
    #[serde(default)]
    pub obstacles: Obstacles,
}

impl Plan {
    /// Whether the plate is moved during the plan.
    pub fn several_places(&self) -> bool {
        self.spheres.iter().any(|visit| visit.place != 0)
    }

    /// Poses that are recorded, over all visits.
    pub fn recorded(&self) -> usize {
        self.spheres.iter().map(Visit::recorded).sum()
    }

    /// Number of rejected poses by reason, in words.
    pub fn rejected_by_reason(&self) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for rejection in &self.rejected {
            *counts.entry(rejection.obstacle.kind().to_owned()).or_insert(0) += 1;
        }
        counts
    }
}
