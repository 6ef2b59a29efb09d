//! Taught waypoints: where the descent to each sphere begins, and the file that holds it.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use spherecal_model::chain::{Chain, TcpPose, quaternion, rotation_of};
use spherecal_model::write_file;
use spherecal_plan::Plan;
use spherecal_shared::robot::{Robot, Tool};

use super::JobError;

/// Largest distance of a waypoint from its planned position, in m. A waypoint farther away belongs
/// to another plate.
const FAR_M: f64 = 0.10;

/// Largest joint difference, in rad, between a visit and its taught waypoint. Beyond it the visit
/// uses another branch of the inverse kinematics than the one that was taught.
const ELSEWHERE_RAD: f64 = 0.5;

/// The starts of the descents to the spheres, taught by hand or written by a person.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaughtWaypoints {
    /// Name of the robot.
    pub robot: String,
    /// One for each sphere.
    pub waypoint: Vec<TaughtWaypoint>,
}

/// Where the descent to one sphere begins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaughtWaypoint {
    /// Id of the sphere.
    pub sphere: u32,
    /// Placement of the plate, from 0.
    #[serde(default, skip_serializing_if = "is_first")]
    pub place: u32,
    /// Joint angles base to flange, in rad.
    pub joints_rad: Vec<f64>,
}

fn is_first(place: &u32) -> bool {
    *place == 0
}

/// Largest file of waypoints, in bytes.
const MOST_BYTES: u64 = 1 << 20;

fn refused(what: String, remedy: &'static str) -> JobError {
    JobError::Waypoints { what, remedy }
}

impl TaughtWaypoints {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read or is not a file of waypoints.
    pub fn read(path: &Path) -> Result<Self, JobError> {
        let name = path.display();
        let text = spherecal_model::read_text(path, MOST_BYTES, "waypoints have some kilobytes")
            .map_err(|e| refused(e.to_string(), "give a file of `spherecal teach`"))?;
        spherecal_model::read_toml(&text).map_err(|e| {
            refused(
                format!("{name}: {e}"),
                "a file of waypoints has `robot`, and `sphere` and `joints_rad` in each [[waypoint]]",
            )
        })
    }

    /// Writes a file.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), JobError> {
        let text = toml::to_string(self).map_err(|e| JobError::Encode {
            what: "the waypoints",
            message: e.to_string(),
        })?;
        write_file(path, text).map_err(|source| JobError::Write {
            path: path.display().to_string(),
            source,
        })
    }

    /// Replaces the waypoints of a plan for this robot and tool by these.
    ///
    /// # Errors
    /// Another robot, a sphere without a waypoint, angles out of range, or a waypoint far from its
    /// sphere.
    pub fn apply(&self, robot: &Robot, tool: &Tool, plan: &mut Plan) -> Result<(), JobError> {
        if self.robot != robot.name.as_str() {
            return Err(refused(
                format!(
                    "the waypoints were taught with \"{}\", but the robot is \"{}\"",
                    self.robot, robot.name
                ),
                "teach them with this robot",
            ));
        }
        let chain = Chain::new(robot, tool)?;
        for visit in &mut plan.spheres {
            let sphere = visit.sphere_id;
            let of = |w: &&TaughtWaypoint| (w.sphere, w.place) == (sphere, visit.place);
            let Some(waypoint) = self.waypoint.iter().find(of) else {
                return Err(refused(
                    format!(
                        "sphere {sphere} has no waypoint in placement {} of the plate",
                        visit.place + 1
                    ),
                    "teach every sphere of the plan",
                ));
            };
            let joints = &waypoint.joints_rad;
            let margin = if joints.len() == chain.dof() && joints.iter().all(|q| q.is_finite()) {
                chain.limit_margin(joints)
            } else {
                f64::NEG_INFINITY
            };
            if !(margin >= 0.0) {
                return Err(refused(
                    format!("the waypoint of sphere {sphere} is {joints:?} rad"),
                    "give one angle in rad for each joint, within the joint limits",
                ));
            }
            let pose = chain.pose(joints);
            let planned = nalgebra::Vector3::from(visit.approach.position_m);
            let away = (pose.position - planned).norm();
            if !(away <= FAR_M) {
                return Err(refused(
                    format!(
                        "the waypoint of sphere {sphere} is {:.0} mm from its planned position",
                        away * 1e3
                    ),
                    "teach it above its own sphere, or correct the position of the plate in [[cell.placements]] of the configuration",
                ));
            }
            visit.approach.position_m = pose.position.into();
            let apart = joints.iter().zip(&visit.approach.joints).map(|(a, b)| (a - b).abs());
            if apart.fold(0.0, f64::max) <= ELSEWHERE_RAD {
                visit.approach.orientation = quaternion(&pose.rotation);
                visit.approach.elbow_rad = pose.elbow;
                visit.approach.joints.clone_from(joints);
                continue;
            }
            // The visit uses another branch of the inverse kinematics: it takes over the position
            // alone.
            let there = TcpPose {
                position: pose.position,
                rotation: rotation_of(&visit.approach.orientation),
                elbow: visit.approach.elbow_rad,
            };
            let reached = chain.follow(&there, &visit.approach.joints);
            visit.approach.joints = reached.filter(|q| chain.limit_margin(q) >= 0.0).ok_or_else(|| {
                refused(
                    format!("the arm cannot reach the waypoint of sphere {sphere} in another branch of the inverse kinematics"),
                    "teach it closer to the vertical above the sphere, or set plan.range.branches = false",
                )
            })?;
        }
        Ok(())
    }
}
