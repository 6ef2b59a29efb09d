//! Long holds at some of the plan's poses, as a separate stage.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use nalgebra::Vector3;
use serde::Serialize;
use spherecal_campaign::{self as campaign, Assignment, CampaignObserver, NoJournal, Outcome, RunOptions};

use super::{Hold, SampleKeeper};
use crate::connect::reliable;
use crate::{ConfigError, JobError, Link, PreparedRun};

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

/// How many times the noise of a window's mean a step must be.
const NOISES: f64 = 10.0;
/// The smallest step that counts, in µm: a tenth of the accuracy that a calibration reaches.
const LEAST_UM: f64 = 20.0;

/// A step of the TCP.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Jump {
    /// Distance between the means of two windows that follow each other, in µm.
    pub size_um: f64,
    /// When it was, in s after the start of the hold: between the middles of the two windows.
    pub at_s: f64,
}

/// The largest step between the TCPs of windows that follow each other (µm; their middles in s), if `noise` (µm) of a
/// window does not explain it.
pub(super) fn jump(points: &[Vector3<f64>], time_s: &[f64], noise: f64) -> Option<Jump> {
    let steps = points.windows(2).zip(time_s.windows(2)).map(|(p, t)| Jump {
        size_um: (p[1] - p[0]).norm(),
        at_s: 0.5 * (t[0] + t[1]),
    });
    steps
        .max_by(|a, b| a.size_um.total_cmp(&b.size_um))
        .filter(|largest| largest.size_um > LEAST_UM.max(NOISES * noise))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a step of 100 µm is not found at its time, or if a drift of the same size, or noise, counts as one.
    #[test]
    fn a_step_is_no_drift() {
        let time_s: Vec<f64> = (0..20).map(|k| f64::from(k) + 0.5).collect();
        let along = |of: &dyn Fn(f64) -> f64| -> Vec<Vector3<f64>> {
            time_s.iter().map(|t| Vector3::new(0.0, of(*t), 0.0)).collect()
        };
        let step = along(&|t| if t > 7.0 { 100.0 } else { 0.0 });
        let found = jump(&step, &time_s, 4.0).expect("a step");
        assert_eq!(
            found,
            Jump {
                size_um: 100.0,
                at_s: 7.0
            }
        );
        assert_eq!(jump(&step, &time_s, 11.0), None);
        assert_eq!(jump(&along(&|t| 5.0 * t), &time_s, 0.1), None);
        assert_eq!(jump(&[], &[], 1.0), None);
    }
}
