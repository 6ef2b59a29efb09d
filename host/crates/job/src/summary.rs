//! `summary.json`, the document for other programs, and the verdict.
//!
//! For one seed it is the same in every run, except the wall-clock times and the date on the certificate.

use std::collections::BTreeMap;

use serde::Serialize;
use sha2::{Digest, Sha256};
use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_shared::protocol::host::{FaultReport, Recording};

use super::certificate::run_certificate;
use super::{EarlyEnding, Evaluation, JobError, LinkRecord, Measurements};
use spherecal_identify::validate::{Alignment, ErrorStatistics};
use spherecal_identify::{ParameterEstimate, Verdict};
use spherecal_link::Injected;
use spherecal_link::native::DriveRecord;
use spherecal_report::Certificate;
use spherecal_results::{files_json, hexadecimal};

/// Poses, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PoseCounts {
    /// Considered by the planner.
    pub planned: usize,
    /// Of them, within reach.
    pub reachable: usize,
    /// Chosen to be recorded.
    pub chosen: usize,
    /// Recorded.
    pub recorded: usize,
    /// Given up.
    pub rejected: usize,
}

/// Both directions of the host link together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LinkSummary {
    /// Frames accepted.
    pub frames: u64,
    /// Frames whose checksum or shape was wrong.
    pub crc_errors: u64,
    /// Missing numbers of frames; damaged frames are included.
    pub lost: u64,
    /// Messages sent again.
    pub resent: u64,
    /// Messages that came again.
    pub duplicates: u64,
    /// Commands that arrived after their start time. Zero means that the link changed no tick of
    /// the arm.
    pub late: u64,
    /// What was done to frames on purpose.
    pub injected: Injected,
}

impl LinkSummary {
    /// From what the two ends counted.
    pub fn of(record: &LinkRecord) -> Self {
        let sum = |f: fn(&LinkCounters) -> u32| record.ends.iter().map(|c| u64::from(f(c))).sum();
        Self {
            frames: sum(|c| c.frames),
            crc_errors: sum(|c| c.crc_errors),
            lost: sum(|c| c.lost),
            resent: sum(|c| c.resent),
            duplicates: sum(|c| c.duplicates),
            late: record.late.into(),
            injected: record.injected,
        }
    }
}

/// What the data can determine.
#[derive(Clone, Debug, Serialize)]
pub struct IdentifiabilitySummary {
    /// Columns analysed.
    pub columns: usize,
    /// Their rank.
    pub rank: usize,
    /// Condition number of what is left.
    pub condition: Option<f64>,
    /// Parameters whose effect others have too.
    pub redundant: Vec<String>,
    /// Why, in words.
    pub dependencies: Vec<String>,
}

/// How well the recordings agree with the model.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ResidualSummary {
    /// Root mean square distance, in mm.
    pub rms_mm: f64,
    /// Mean distance, in mm.
    pub mean_mm: f64,
    /// Largest distance, in mm.
    pub max_mm: f64,
    /// Recordings that the model does not believe.
    pub outliers: usize,
}

/// One model's errors under the paper's alignment, and under the two others.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ModelSummary {
    /// Base measured by arcs, as in the paper.
    #[serde(flatten)]
    pub arcs: ErrorStatistics,
    /// Base fitted to the points: the arm's shape alone.
    pub best_fit: ErrorStatistics,
    /// The model's own base.
    pub own: ErrorStatistics,
}

/// Table 5.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ValidationSummary {
    /// Measurements.
    pub n: usize,
    /// Errors by model.
    pub models: BTreeMap<String, ModelSummary>,
}

/// One contact.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ContactSummary {
    /// Sphere.
    pub sphere: u32,
    /// Steady estimate of the force when declared, in N.
    pub force_n: f64,
    /// Largest force since the descent began, a mean over 10 ms, in N.
    pub peak_n: f64,
    /// Distance descended, in mm.
    pub travel_mm: f64,
    /// Ticks from the first crossing to the declaration.
    pub latency_ticks: u32,
    /// Crossings that were not held.
    pub early_crossings: u32,
}

/// The whole document.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Always `run`.
    pub command: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Seed.
    pub seed: u64,
    /// Robot.
    pub robot: String,
    /// Name of the arm; empty where it has none.
    pub arm: String,
    /// Link, as on the command line.
    pub link_name: String,
    /// Whether the arm was a simulation in this program.
    pub simulated: bool,
    /// Poses.
    pub poses: PoseCounts,
    /// Why the run ended before its last chosen pose, if the accuracy that was asked for was reached there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ended_early: Option<EarlyEnding>,
    /// Device time, in s.
    pub simulated_s: f64,
    /// Time on the wall, in s.
    pub wall_s: f64,
    /// Device time per time on the wall.
    pub real_time_factor: f64,
    /// What the data can determine.
    pub identifiability: IdentifiabilitySummary,
    /// Every parameter of the sphere-calibrated model.
    pub parameters: Vec<ParameterEstimate>,
    /// Residuals of the recordings.
    pub residual: ResidualSummary,
    /// Table 5.
    pub validation: ValidationSummary,
    /// Hash over the recordings' bits, in order.
    pub recordings_sha256: String,
    /// Contacts, in order.
    pub contacts: Vec<ContactSummary>,
    /// Faults, in order.
    pub faults: Vec<FaultReport>,
    /// Host link.
    pub link: LinkSummary,
    /// Real-time loop of a robot's own interface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drive: Option<DriveRecord>,
    /// Verdict.
    pub verdict: Verdict,
    /// The files of the result with the error that each has over the work region.
    pub files: serde_json::Value,
    /// The figures of the report's certificate.
    pub certificate: Certificate,
    /// Remarks.
    pub remarks: Vec<String>,
}

/// Summarises a run; `created` says when it was measured.
///
/// # Errors
/// When a recording cannot be encoded for the hash.
pub fn summarise(m: &Measurements, e: &Evaluation, created: &str) -> Result<Summary, JobError> {
    let finite = |value: f64| value.is_finite().then_some(value);
    let i = &e.calibration.identifiability;
    let r = &e.calibration.residual;
    let validation = e
        .table()
        .map_or_else(ValidationSummary::default, |table| ValidationSummary {
            n: table.n,
            models: table
                .models
                .iter()
                .map(|model| {
                    let summary = ModelSummary {
                        arcs: *model.statistics(Alignment::Arcs),
                        best_fit: *model.statistics(Alignment::BestFit),
                        own: *model.statistics(Alignment::Own),
                    };
                    (model.name.clone(), summary)
                })
                .collect(),
        });
    let recordings_sha256 = hash(&m.recordings)?;
    Ok(Summary {
        certificate: run_certificate(m, e, created, &recordings_sha256)?,
        files: files_json(e),
        command: "run",
        version: env!("CARGO_PKG_VERSION"),
        seed: m.seed,
        robot: m.robot.name.to_string(),
        arm: m.config.arm.clone(),
        link_name: m.link_name.clone(),
        simulated: m.simulated(),
        poses: PoseCounts {
            planned: m.plan.planned,
            reachable: m.plan.reachable,
            chosen: m.plan.recorded(),
            recorded: m.recordings.len(),
            rejected: m.rejected.len(),
        },
        ended_early: m.ended_early,
        simulated_s: m.simulated_s,
        wall_s: m.wall_s,
        real_time_factor: if m.wall_s > 0.0 { m.simulated_s / m.wall_s } else { 0.0 },
        identifiability: IdentifiabilitySummary {
            columns: i.columns,
            rank: i.rank,
            condition: finite(i.condition),
            redundant: i.redundant.clone(),
            dependencies: i.dependencies.clone(),
        },
        parameters: e.calibration.parameters.clone(),
        residual: ResidualSummary {
            rms_mm: r.rms_mm,
            mean_mm: r.mean_mm,
            max_mm: r.max_mm,
            outliers: r.outliers.len(),
        },
        recordings_sha256,
        contacts: m
            .contacts
            .iter()
            .map(|c| ContactSummary {
                sphere: c.sphere,
                force_n: c.force_n,
                peak_n: c.peak_n,
                travel_mm: c.travel_m * 1e3,
                latency_ticks: c.latency_ticks,
                early_crossings: c.early_crossings,
            })
            .collect(),
        faults: m.faults.clone(),
        link: LinkSummary::of(&m.link),
        drive: m.link.drive,
        verdict: e.verdict.clone(),
        validation,
        remarks: e.notes.clone(),
    })
}

/// SHA-256 over the recordings as they travel on the wire, in order. Every bit of every statistic
/// counts.
fn hash(recordings: &[Recording]) -> Result<String, JobError> {
    let mut hash = Sha256::new();
    for recording in recordings {
        let bytes = postcard::to_allocvec(recording).map_err(|e| JobError::Encode {
            what: "a recording",
            message: e.to_string(),
        })?;
        hash.update(&bytes);
    }
    Ok(hexadecimal(&hash.finalize()))
}
