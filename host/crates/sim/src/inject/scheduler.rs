//! Turns a plan into starts and ends of faults, tick by tick.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use spherecal_link::Drive;
use spherecal_shared::protocol::host::Phase;

use super::fault::InjectedFault;
use super::plan::{FaultPlan, PlannedFault, When};
use crate::plant::Disturbance;
use crate::simulated::Disturb;

/// What the scheduler keeps of one entry.
#[derive(Clone, Copy, Debug)]
struct ScheduledFault {
    entry: PlannedFault,
    /// Tick at which it begins, once that is known.
    due: Option<u64>,
    /// Tick at which it ends, while it lasts.
    until: Option<u64>,
    /// How often it has begun.
    count: u32,
}

/// Beginnings and ends, in order.
pub(super) struct Scheduler {
    rows: Vec<ScheduledFault>,
    rng: ChaCha8Rng,
    period_s: f64,
}

fn ticks(seconds: f64, period_s: f64) -> u64 {
    // A duration without end has more ticks than there will ever be.
    (seconds / period_s).round() as u64
}

impl Scheduler {
    pub(super) fn new(plan: &FaultPlan, period_s: f64) -> Self {
        let rows = plan.faults.iter().map(|entry| ScheduledFault {
            entry: *entry,
            due: if let When::Tick(tick) = entry.when {
                Some(tick)
            } else {
                None
            },
            until: None,
            count: 0,
        });
        Self {
            rows: rows.collect(),
            rng: ChaCha8Rng::seed_from_u64(plan.seed),
            period_s,
        }
    }

    /// The controller has entered a phase for the `count`-th time, at `tick`.
    pub(super) fn entered(&mut self, phase: Phase, count: u32, tick: u64) {
        for row in &mut self.rows {
            match row.entry.when {
                When::Phase { name, entry, after_s } if name == phase && entry == count => {
                    row.due = Some(tick + ticks(after_s, self.period_s));
                }
                When::Entering {
                    name,
                    probability,
                    after_s,
                    most,
                } if name == phase && row.count < most && self.rng.random_range(0.0..1.0) < probability => {
                    row.due = Some(tick + ticks(after_s, self.period_s));
                }
                _ => {}
            }
        }
    }

    /// The faults that start (`true`) and end (`false`) at `tick`; ends come first.
    pub(super) fn at(&mut self, tick: u64, mut change: impl FnMut(InjectedFault, bool)) {
        for row in &mut self.rows {
            if row.until.is_some_and(|until| tick >= until) {
                row.until = None;
                change(row.entry.what, false);
            }
        }
        for row in &mut self.rows {
            if let When::Rate { per_s, most } = row.entry.when
                && row.count < most
                && row.until.is_none()
                && self.rng.random_range(0.0..1.0) < per_s * self.period_s
            {
                row.due = Some(tick);
            }
            if row.until.is_none() && row.due.is_some_and(|due| tick >= due) {
                row.due = None;
                row.count += 1;
                row.until = Some(tick.saturating_add(ticks(row.entry.duration_s(), self.period_s).max(1)));
                change(row.entry.what, true);
            }
        }
    }
}

/// The drive of a [`FaultyCell`](super::FaultyCell).
pub enum FaultyDrive {
    /// The simulated arm, which can suffer every fault.
    Simulated(Box<dyn Disturb>),
    /// Any other drive: faults can only be injected between it and the controller.
    Other(Box<dyn Drive>),
}

impl FaultyDrive {
    pub(super) fn drive(&self) -> &dyn Drive {
        match self {
            Self::Simulated(arm) => arm.as_ref(),
            Self::Other(drive) => drive.as_ref(),
        }
    }

    pub(super) fn drive_mut(&mut self) -> &mut dyn Drive {
        match self {
            Self::Simulated(arm) => arm.as_mut(),
            Self::Other(drive) => drive.as_mut(),
        }
    }

    pub(super) fn disturb(&mut self, what: &Disturbance) {
        // A plan with faults of the arm itself is refused if the arm is not simulated.
        if let Self::Simulated(arm) = self {
            arm.disturb(what);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(plan: &FaultPlan, ticks: u64, phases: &[(u64, Phase, u32)]) -> Vec<(u64, bool)> {
        let mut scheduler = Scheduler::new(plan, 1e-3);
        let mut seen = Vec::new();
        for tick in 1..=ticks {
            scheduler.at(tick, |_, begins| seen.push((tick, begins)));
            for (_, phase, count) in phases.iter().filter(|p| p.0 == tick) {
                scheduler.entered(*phase, *count, tick);
            }
        }
        seen
    }

    // Fails if a fault starts at another tick than its file says, or has another duration.
    #[test]
    fn beginnings_and_ends_are_where_the_file_puts_them() {
        let at = |when, for_s| FaultPlan {
            seed: 3,
            host_link: None,
            faults: vec![PlannedFault {
                what: InjectedFault::StateFrozen,
                when,
                for_s: Some(for_s),
            }],
        };
        assert_eq!(run(&at(When::Tick(10), 0.005), 30, &[]), [(10, true), (15, false)]);
        let second = When::Phase {
            name: Phase::Recording,
            entry: 2,
            after_s: 0.004,
        };
        let phases = [(3, Phase::Recording, 1), (10, Phase::Recording, 2)];
        assert_eq!(run(&at(second, 0.002), 30, &phases), [(14, true), (16, false)]);
        assert_eq!(run(&at(second, f64::INFINITY), 30, &phases), [(14, true)]);
        let rate = When::Rate { per_s: 20.0, most: 5 };
        let seen = run(&at(rate, 0.001), 10_000, &[]);
        assert_eq!(seen.len(), 10, "five beginnings and five ends");
        assert!(seen[8].0 < 1000, "five at 20 a second: {seen:?}");
        let chance = When::Entering {
            name: Phase::Turning,
            probability: 0.5,
            after_s: 0.0,
            most: 100,
        };
        let phases: Vec<_> = (1..=40).map(|k| (10 * k, Phase::Turning, k as u32)).collect();
        let begun = run(&at(chance, 0.001), 500, &phases).len() / 2;
        assert!((10..=30).contains(&begun), "{begun} of 40 at one half");
    }
}
