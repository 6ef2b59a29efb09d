//! Long holds at some of the plan's poses, as a separate stage.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use super::{Hold, SampleKeeper};
use crate::connect::reliable;
use crate::{ConfigError, JobError, Link, PreparedRun};
use spherecal_campaign::{self as campaign, Assignment, CampaignObserver, NoJournal, Outcome, RunOptions};

/// Holds for `hold_ticks` control periods at `places` poses, spread evenly over the plan; passes
/// through the others. Stores nothing.
///
/// # Errors
/// Any error that stops the campaign, and numbers that the procedure refuses.
pub fn hold(
    prepared: &PreparedRun,
    link: &Link,
    folder: &Path,
    (places, hold_ticks): (usize, u32),
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
) -> Result<(Vec<Hold>, Outcome), JobError> {
    let mut plan = prepared.plan.clone();
    // Nobody moves the plate for it.
    plan.spheres.retain(|visit| visit.place == 0);
    let recorded = plan.recorded();
    let chosen: BTreeSet<usize> = (0..places)
        .map(|k| (2 * k + 1) * recorded / (2 * places).max(1))
        .collect();
    let poses = plan.spheres.iter_mut().flat_map(|s| &mut s.poses);
    for (number, pose) in poses.filter(|p| !p.via).enumerate() {
        pose.via = !chosen.contains(&number);
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
        plan: &plan,
        done: &done,
        seated: &[],
        // The places say nothing of stability.
        options: RunOptions {
            confirm_seats: false,
            second_visits: false,
            ..prepared.config.campaign.options()
        },
    };
    let joints = prepared.robot.dof();
    let mut device = reliable(prepared, link, folder)?;
    let mut listener = SampleKeeper::new(observer, joints);
    let (outcome, result) = campaign::run(&assignment, device.as_mut(), &mut NoJournal, &mut listener, interrupt);
    let holds = listener.finish();
    result?;
    Ok((holds, outcome))
}
