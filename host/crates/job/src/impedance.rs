//! A hold by a Cartesian spring as a stage of the job.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use super::connect::reliable;
use super::{JobError, Link, PreparedRun};
use spherecal_campaign::{CampaignError, CampaignObserver, ManualControl, operate};

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
