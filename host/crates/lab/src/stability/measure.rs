//! Long holds at some of the plan's poses, as a separate stage.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use super::{Hold, Listener};
use spherecal_campaign::{self as campaign, Assignment, Nowhere, Observer, Outcome};
use spherecal_job::link::{controller, distant};
use spherecal_job::{ConfigError, JobError, Link, Prepared, tour};
use spherecal_link::{Cell, Device};
use spherecal_sim::simulated_arm;

/// Holds for `hold_ticks` control periods at `places` poses, spread evenly over the plan; passes
/// through the others. Stores nothing.
///
/// # Errors
/// Any error that stops the campaign, and numbers that the procedure refuses.
pub fn hold(
    prepared: &Prepared,
    link: &Link,
    folder: &Path,
    (places, hold_ticks): (usize, u32),
    observer: &mut dyn Observer,
    interrupt: &AtomicBool,
) -> Result<(Vec<Hold>, Outcome), JobError> {
    let mut tour = tour(&prepared.plan);
    // The plate is not moved for it.
    tour.stops.retain(|stop| stop.place == 0);
    let recorded = tour.poses();
    let chosen: BTreeSet<usize> = (0..places)
        .map(|k| (2 * k + 1) * recorded / (2 * places).max(1))
        .collect();
    let poses = tour.stops.iter_mut().flat_map(|s| &mut s.poses);
    for (number, pose) in poses.filter(|p| p.record).enumerate() {
        pose.record = chosen.contains(&number);
    }
    let mut procedure = prepared.config.procedure;
    procedure.record.samples = hold_ticks;
    procedure.telemetry.other_ticks = 1;
    procedure.check().map_err(ConfigError::from)?;
    let done = BTreeSet::new();
    let assignment = Assignment {
        robot: &prepared.robot,
        tool: &prepared.tool,
        procedure: &procedure,
        tour: &tour,
        done: &done,
        seated: &[],
        options: prepared.config.campaign.options(),
    };
    let joints = prepared.robot.dof();
    let mut device: Box<dyn Device> = if let Some(device) = distant(prepared, link)? {
        device
    } else {
        let controller = controller(prepared, link, folder)?;
        let drive = simulated_arm(&prepared.robot, &prepared.tool, &prepared.plant, &tour.home)?;
        Box::new(Cell::new(controller, drive, joints)?)
    };
    let mut listener = Listener::new(observer, joints);
    let (outcome, result) = campaign::run(&assignment, device.as_mut(), &mut Nowhere, &mut listener, interrupt);
    let holds = listener.finish();
    result?;
    Ok((holds, outcome))
}
