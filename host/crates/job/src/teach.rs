//! Teaching as a stage of the job: an operator guides the arm, and the waypoints are kept.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use super::connect::{controller, distant};
use super::waypoints::{TaughtWaypoint, TaughtWaypoints};
use super::{JobError, Link, PreparedRun};
use spherecal_campaign::{self as campaign, Assignment, CampaignObserver, Operator};
use spherecal_link::{Device, LocalDevice};
use spherecal_sim::{OperatorCall, hand_guided_arm};

/// The operator beside the simulated arm.
struct SimulatedOperator(OperatorCall);

impl Operator for SimulatedOperator {
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
    prepared: &PreparedRun,
    link: &Link,
    folder: &Path,
    person: &mut dyn Operator,
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
) -> Result<TaughtWaypoints, JobError> {
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
    let (mut device, operator): (Box<dyn Device>, &mut dyn Operator) =
        if let Some(device) = distant(&prepared.model, &prepared.config, link)? {
            (device, person)
        } else {
            let controller = controller(prepared, link, folder)?;
            let height_m = prepared.config.plan.approach_height_m;
            let (robot, tool) = (&prepared.robot, &prepared.tool);
            let (drive, call) = hand_guided_arm(robot, tool, &prepared.plant, &plan.home.joints, height_m)?;
            simulated = SimulatedOperator(call);
            (
                Box::new(LocalDevice::new(controller, drive, robot.dof())?),
                &mut simulated,
            )
        };
    let taught = campaign::teach(&assignment, device.as_mut(), operator, observer, interrupt)?;
    Ok(TaughtWaypoints {
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
