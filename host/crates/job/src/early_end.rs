//! Ends a run as soon as its evaluation would accept the result at the accuracy that was asked for.
//!
//! ```text
//!   journal ── what was stored ──▶ EarlyEnd ── a copy, every LOOK poses ──▶ evaluation, on a thread of its own
//!   campaign ── enough? ─────────▶    └─◀── may be used? ─────────────────────┘
//! ```
//!
//! The evaluation is the one that ends every run, so there is no second estimator and no second limit. The arm takes one
//! more pose while it lasts. A yes is asked again with that pose, and the arm waits for the answer: so the result is that of an
//! evaluation that accepted it, and which pose is the last depends on no clock.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;

use serde::{Deserialize, Serialize};
use spherecal_shared::protocol::host::Event;

use super::evaluate::{Measurements, evaluate};
use super::prepared::Simulator;
use super::{Evaluation, JobError};
use spherecal_campaign::telemetry::RunKey;
use spherecal_campaign::{CampaignObserver, Moved, Progress};
use spherecal_link::Arrival;
use spherecal_store::{CalibrationStore, RunInfo};

/// Recordings between two evaluations. Ten poses take an arm some 20 s, which is what a run can last too long; an evaluation
/// takes 0.1 to 0.9 s of a processor.
const LOOK: usize = 10;
/// Name of the stored result.
const ACCURACY: &str = "accuracy";

/// What the evaluation said that ended a run before its last planned pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EarlyEnding {
    /// Mean error (mm) that was asked for.
    pub accuracy_mm: f64,
    /// Recordings that it evaluated.
    pub poses: usize,
    /// Mean error (mm) to expect over the work region.
    pub expected_mm: f64,
    /// Probability that the mean error is below the one that was asked for.
    pub probability: f64,
}

impl EarlyEnding {
    /// In words, with the figures.
    pub fn words(&self) -> String {
        format!(
            "the mean error over the work region is below {:.3} mm with a probability of {:.3} ({:.3} mm expected) after {} \
             poses: the others are not needed",
            self.accuracy_mm, self.probability, self.expected_mm, self.poses
        )
    }

    /// `None` if the measurements are not enough.
    fn of(m: &Measurements, evaluation: &Evaluation) -> Option<Self> {
        let verdict = &evaluation.verdict;
        verdict.may_be_used.then_some(Self {
            accuracy_mm: m.config.plan.accuracy_mm?,
            poses: m.recordings.len(),
            expected_mm: verdict.expected_error_mm?.work.mean,
            probability: verdict.probability?,
        })
    }
}

/// What a run keeps of an accuracy that was asked for while or after it was measured.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct StoredAccuracy {
    /// Mean error (mm) that was asked for last, if it is another than that of the run's configuration.
    asked_mm: Option<f64>,
    /// Why the run ended before its last planned pose.
    pub(super) ended: Option<EarlyEnding>,
}

impl StoredAccuracy {
    /// Of a stored run.
    pub(super) fn read(store: &mut dyn CalibrationStore, run: i64) -> Result<Self, JobError> {
        let json = store.result(run, ACCURACY)?;
        let decoded = json.map(|json| serde_json::from_str(&json)).transpose();
        decoded.map(Option::unwrap_or_default).map_err(|e| JobError::Encode {
            what: "the stored accuracy",
            message: e.to_string(),
        })
    }

    fn write(&self, store: &mut dyn CalibrationStore, run: i64) -> Result<(), JobError> {
        let json = serde_json::to_string(self).map_err(|e| JobError::Encode {
            what: "the accuracy",
            message: e.to_string(),
        })?;
        Ok(store.put_result(run, ACCURACY, &json)?)
    }

    /// The mean error (mm) that counts; `configured` is that of the run's configuration.
    pub(super) fn asked_mm(&self, configured: Option<f64>) -> Option<f64> {
        self.asked_mm.or(configured)
    }

    /// Stores why a run ended, or that it did not end early.
    pub(super) fn end(store: &mut dyn CalibrationStore, run: i64, ended: Option<EarlyEnding>) -> Result<(), JobError> {
        let before = Self::read(store, run)?;
        if before.ended == ended {
            return Ok(());
        }
        Self { ended, ..before }.write(store, run)
    }
}

/// Asks another accuracy of a stored run. A run that ended early at a worse one is to be measured on.
///
/// # Errors
/// When the store fails.
pub fn ask_accuracy(store: &mut dyn CalibrationStore, info: &mut RunInfo, accuracy_mm: f64) -> Result<(), JobError> {
    let before = StoredAccuracy::read(store, info.run)?;
    let enough = before.ended.is_none_or(|ended| ended.accuracy_mm <= accuracy_mm);
    let after = StoredAccuracy {
        asked_mm: Some(accuracy_mm),
        ended: before.ended.filter(|_| enough),
    };
    // A program that is killed in between leaves a run that is measured on.
    if !enough {
        "running".clone_into(&mut info.state);
        store.set_state(info.run, &info.state)?;
    }
    after.write(store, info.run)
}

/// The observer of a run, which also answers whether its recordings are enough.
pub(super) struct EarlyEnd<'a> {
    observer: &'a mut dyn CampaignObserver,
    simulator: Arc<dyn Simulator>,
    /// What the journal stored since.
    stored: Receiver<Event>,
    /// Everything that the run measured so far.
    so_far: Measurements,
    known: BTreeSet<(u32, u32)>,
    /// Recordings that were there before this session and were not evaluated yet: their answer comes before any motion.
    recalled: bool,
    /// Recordings at the last evaluation.
    seen: usize,
    evaluation: Option<JoinHandle<Option<EarlyEnding>>>,
    ended: Option<EarlyEnding>,
}

impl<'a> EarlyEnd<'a> {
    /// `so_far` is what earlier sessions measured, `stored` tells what this one stores.
    pub(super) fn new(
        observer: &'a mut dyn CampaignObserver,
        simulator: Arc<dyn Simulator>,
        stored: Receiver<Event>,
        so_far: Measurements,
    ) -> Self {
        Self {
            observer,
            simulator,
            stored,
            known: so_far.recordings.iter().map(|r| (r.sphere, r.pose)).collect(),
            recalled: !so_far.recordings.is_empty(),
            so_far,
            seen: 0,
            evaluation: None,
            ended: None,
        }
    }

    /// Why the run ended before its last planned pose; `None` if it did not.
    pub(super) fn ended(&self) -> Option<EarlyEnding> {
        self.ended
    }

    /// Takes what was stored.
    fn take(&mut self) {
        for event in self.stored.try_iter() {
            match event {
                Event::Recording(recording) if self.known.insert((recording.sphere, recording.pose)) => {
                    self.so_far.recordings.push(recording);
                }
                Event::Coupled(coupled) => self.so_far.couplings.push(coupled),
                Event::Fault(report) => self.so_far.faults.push(report),
                _ => {}
            }
        }
    }

    /// Evaluates a copy of what was measured, on a thread of its own. A computer without a thread to spare measures on.
    fn begin(&mut self) {
        self.seen = self.so_far.recordings.len();
        let (m, simulator) = (self.so_far.clone(), Arc::clone(&self.simulator));
        let work = move || {
            let evaluation = evaluate(&m, simulator.as_ref(), &mut |_| ()).ok()?;
            EarlyEnding::of(&m, &evaluation)
        };
        let named = std::thread::Builder::new().name("evaluation".to_owned());
        self.evaluation = named.spawn(work).ok();
    }
}

impl CampaignObserver for EarlyEnd<'_> {
    fn run(&mut self, run: &RunKey) {
        self.observer.run(run);
    }

    fn event(&mut self, now_us: u64, arrival: &Arrival) {
        self.observer.event(now_us, arrival);
    }

    fn progress(&mut self, progress: &Progress) {
        self.observer.progress(progress);
    }

    fn note(&mut self, text: &str) {
        self.observer.note(text);
    }

    fn plate(&mut self, place: u32) -> Moved {
        self.observer.plate(place)
    }

    fn enough(&mut self, waits: bool) -> Option<bool> {
        if self.so_far.config.plan.accuracy_mm.is_none() {
            return Some(false);
        }
        if let Some(evaluation) = self.evaluation.take_if(|thread| waits || thread.is_finished()) {
            // An evaluation that fails says of no recording that it is enough.
            let ended = evaluation.join().ok().flatten();
            self.take();
            if ended.is_some() && self.so_far.recordings.len() > self.seen {
                self.begin();
                return None;
            }
            self.ended = ended;
            if let Some(ended) = &self.ended {
                self.observer.note(&ended.words());
            }
            return Some(self.ended.is_some());
        }
        if self.evaluation.is_some() {
            return None;
        }
        self.take();
        let recalled = std::mem::take(&mut self.recalled);
        if !recalled && self.so_far.recordings.len() < self.seen + LOOK {
            return Some(false);
        }
        self.begin();
        if recalled { None } else { Some(false) }
    }
}
