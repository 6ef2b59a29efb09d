//! Teaching as a stage of the job, and the file of waypoints that it writes.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::link::{controller, distant};
use super::{JobError, Link, Prepared};
use spherecal_campaign::{self as campaign, Assignment, Observer, Operator};
use spherecal_link::{Device, LocalDevice};
use spherecal_model::chain::{Chain, TcpPose, quaternion, rotation_of};
use spherecal_sim::{OperatorCall, hand_guided_arm};

/// Largest distance of a waypoint from its planned position, in m. A waypoint farther away belongs
/// to another plate.
const FAR_M: f64 = 0.10;

/// Largest joint difference, in rad, between a visit and its taught waypoint. Beyond it the visit
/// uses another branch of the inverse kinematics than the one that was taught.
const ELSEWHERE_RAD: f64 = 0.5;

/// The starts of the descents to the spheres, taught by hand or written by a person.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoints {
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

impl Waypoints {
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
        std::fs::write(path, text).map_err(|source| JobError::Write {
            path: path.display().to_string(),
            source,
        })
    }

    /// Replaces the planned waypoints by these.
    ///
    /// # Errors
    /// Another robot, a sphere without a waypoint, angles out of range, or a waypoint far from its
    /// sphere.
    pub fn apply(&self, prepared: &mut Prepared) -> Result<(), JobError> {
        let robot = &prepared.robot;
        if self.robot != robot.name.as_str() {
            return Err(refused(
                format!(
                    "the waypoints were taught with \"{}\", but the robot is \"{}\"",
                    self.robot, robot.name
                ),
                "teach them with this robot",
            ));
        }
        let chain = Chain::new(robot, &prepared.tool)?;
        for visit in &mut prepared.plan.spheres {
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

/// The operator beside the simulated arm.
struct Simulated(OperatorCall);

impl Operator for Simulated {
    fn lead(&mut self, sphere: u32) {
        // Ids count from 1, the plate's spheres from 0.
        self.0.lead_to(sphere.saturating_sub(1) as usize);
    }

    fn is_there(&mut self) -> bool {
        self.0.is_there()
    }

    fn let_go(&mut self) {
        self.0.let_go();
    }
}

/// Has the arm led over every sphere: by a simulated hand if the arm is simulated in this process,
/// else by `person`.
///
/// # Errors
/// Any error that stops teaching.
pub fn teach(
    prepared: &Prepared,
    link: &Link,
    folder: &Path,
    person: &mut dyn Operator,
    observer: &mut dyn Observer,
    interrupt: &AtomicBool,
) -> Result<Waypoints, JobError> {
    let plan = &prepared.plan;
    let done = std::collections::BTreeSet::new();
    let assignment = Assignment {
        robot: &prepared.robot,
        tool: &prepared.tool,
        procedure: &prepared.config.procedure,
        plan,
        done: &done,
        seated: &[],
        options: prepared.config.campaign.options(),
    };
    let mut simulated;
    let (mut device, operator): (Box<dyn Device>, &mut dyn Operator) = if let Some(device) = distant(prepared, link)? {
        (device, person)
    } else {
        let controller = controller(prepared, link, folder)?;
        let height_m = prepared.config.plan.approach_height_m;
        let (robot, tool) = (&prepared.robot, &prepared.tool);
        let (drive, call) = hand_guided_arm(robot, tool, &prepared.plant, &plan.home.joints, height_m)?;
        simulated = Simulated(call);
        (
            Box::new(LocalDevice::new(controller, drive, robot.dof())?),
            &mut simulated,
        )
    };
    let taught = campaign::teach(&assignment, device.as_mut(), operator, observer, interrupt)?;
    Ok(Waypoints {
        robot: prepared.robot.name.to_string(),
        waypoint: taught
            .into_iter()
            .map(|t| TaughtWaypoint {
                sphere: t.sphere,
                place: t.place,
                joints_rad: t.joints,
            })
            .collect(),
    })
}
