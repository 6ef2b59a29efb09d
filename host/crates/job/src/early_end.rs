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
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;

use spherecal_shared::protocol::host::Event;

use super::Evaluation;
use super::accuracy::EarlyEnding;
use super::evaluate::{Measurements, evaluate_alone};
use spherecal_campaign::telemetry::RunKey;
use spherecal_campaign::{CampaignObserver, Moved, Progress};
use spherecal_link::Arrival;

/// Recordings between two evaluations. Ten poses take an arm some 20 s, which is what a run can last too long; an evaluation
/// takes 0.1 to 0.9 s of a processor.
const LOOK: usize = 10;

/// Why a run may end with these measurements; `None` if they are not enough.
fn ending(m: &Measurements, evaluation: &Evaluation) -> Option<EarlyEnding> {
    let verdict = &evaluation.verdict;
    verdict.may_be_used.then_some(EarlyEnding {
        accuracy_mm: m.config.plan.accuracy_mm?,
        poses: m.recordings.len(),
        expected_mm: verdict.expected_error_mm?.work.mean,
        probability: verdict.probability?,
    })
}

/// The observer of a run, which also answers whether its recordings are enough.
pub(super) struct EarlyEnd<'a> {
    observer: &'a mut dyn CampaignObserver,
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
    pub(super) fn new(observer: &'a mut dyn CampaignObserver, stored: Receiver<Event>, so_far: Measurements) -> Self {
        Self {
            observer,
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
        let m = self.so_far.clone();
        let work = move || ending(&m, &evaluate_alone(&m).ok()?);
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
