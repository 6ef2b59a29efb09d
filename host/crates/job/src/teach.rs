//! A person at the arm: teaching as a stage of the job (an operator guides the arm, and the waypoints are kept), and the arm on
//! a spring.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use spherecal_campaign::{
    self as campaign, Assignment, CampaignError, CampaignObserver, ManualControl, Operator, operate,
};
use spherecal_link::{Device, LocalDevice};

use super::connect::{controller, distant, reliable};
use super::waypoints::{TaughtWaypoint, TaughtWaypoints};
use super::{JobError, Link, PreparedRun};

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
            let (drive, hand) = prepared.simulator.guided_arm(prepared)?;
            simulated = hand;
            let device = LocalDevice::new(controller, drive, prepared.robot.dof())?;
            (Box::new(device), simulated.as_mut())
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

/// Control periods between two samples. Eight come together: more than ten times a second.
const SAMPLE_TICKS: u32 = 10;

/// Connects to the arm, configures the controller, and lets `work` hold the arm. In every case the arm is told to stop
/// at the end; then it holds where it is.
///
/// # Errors
/// Any error of the link or of `work`.
pub fn impedance(
    prepared: &PreparedRun,
    link: &Link,
    folder: &Path,
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
    work: impl FnOnce(&mut ManualControl<'_>) -> Result<(), CampaignError>,
) -> Result<(), JobError> {
    let mut device = reliable(prepared, link, folder)?;
    let mut procedure = prepared.config.procedure;
    procedure.telemetry.other_ticks = SAMPLE_TICKS;
    Ok(operate(
        device.as_mut(),
        &prepared.robot,
        &prepared.tool,
        &procedure,
        observer,
        interrupt,
        work,
    )?)
}
