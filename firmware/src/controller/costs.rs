//! What a control cycle costs, by stage, in counts of the board's stopwatch.
//!
//! On a microcontroller the stopwatch is the cycle counter of the core. A process on a
//! PC has none, and nothing is measured there.

use spherecal_shared::protocol::host::{Cost, CycleCost, STAGES, Stage};

/// Cycles whose costs are summed before they are stated.
const WINDOW: u32 = 1000;

/// A counter of the board that runs at a fixed rate.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch {
    /// Reads the counter, which counts up.
    pub read: fn() -> u32,
    /// Counts per second.
    pub hz: u32,
    /// Largest value of the counter, one less than a power of two: 0 follows it.
    pub last: u32,
}

/// Sum and largest value.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    sum: u64,
    worst: u32,
}

impl Sum {
    fn add(&mut self, counts: u32) {
        self.sum += u64::from(counts);
        self.worst = self.worst.max(counts);
    }

    fn over(self, cycles: u32) -> Cost {
        let mean = self.sum / u64::from(cycles.max(1));
        Cost {
            mean: u32::try_from(mean).unwrap_or(u32::MAX),
            worst: self.worst,
        }
    }
}

/// The costs of the present window, and those of the last one.
#[derive(Clone, Debug, Default)]
pub(super) struct Costs {
    stopwatch: Option<Stopwatch>,
    /// The counter at the last border of two stages.
    from: u32,
    /// Cost of the present cycle so far.
    cycle: u32,
    cycles: u32,
    whole: Sum,
    stages: [Sum; STAGES],
    stated: CycleCost,
}

impl Costs {
    pub(super) fn set_stopwatch(&mut self, stopwatch: Stopwatch) {
        *self = Self {
            stopwatch: Some(stopwatch),
            ..Self::default()
        };
    }

    /// A cycle begins.
    #[inline]
    pub(super) fn begin(&mut self) {
        if let Some(stopwatch) = self.stopwatch {
            self.from = (stopwatch.read)();
            self.cycle = 0;
        }
    }

    /// A stage ends, and the next one begins.
    #[inline]
    pub(super) fn end_of(&mut self, stage: Stage) {
        if let Some(stopwatch) = self.stopwatch {
            let now = (stopwatch.read)();
            let counts = now.wrapping_sub(self.from) & stopwatch.last;
            self.from = now;
            self.cycle = self.cycle.saturating_add(counts);
            if let Some(sum) = self.stages.get_mut(stage as usize) {
                sum.add(counts);
            }
        }
    }

    /// A cycle ends, after its last stage.
    #[inline]
    pub(super) fn end(&mut self) {
        let Some(stopwatch) = self.stopwatch else { return };
        self.whole.add(self.cycle);
        self.cycles += 1;
        if self.cycles >= WINDOW {
            self.stated = CycleCost {
                hz: stopwatch.hz,
                cycles: self.cycles,
                whole: self.whole.over(self.cycles),
                stages: self.stages.map(|sum| sum.over(self.cycles)),
            };
            self.cycles = 0;
            self.whole = Sum::default();
            self.stages = [Sum::default(); STAGES];
        }
    }

    /// The costs of the last complete window.
    pub(super) fn stated(&self) -> CycleCost {
        self.stated
    }
}

#[cfg(test)]
mod tests {
    use core::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    static COUNTER: AtomicU32 = AtomicU32::new(0);

    fn read() -> u32 {
        COUNTER.load(Ordering::Relaxed) & 0xff
    }

    fn pass(counts: u32) {
        COUNTER.fetch_add(counts, Ordering::Relaxed);
    }

    // Fails if a stage gets the counts of another, if the wrap of the counter is taken for
    // a cost, if the worst cycle is the sum of the worst stages, or if a window is stated
    // before it is complete.
    #[test]
    fn each_stage_has_its_own_counts() {
        let mut costs = Costs::default();
        costs.begin();
        costs.end_of(Stage::Law);
        costs.end();
        assert_eq!(costs.stated(), CycleCost::default(), "no stopwatch, no cost");
        costs.set_stopwatch(Stopwatch {
            read,
            hz: 1000,
            last: 0xff,
        });
        for cycle in 0..WINDOW {
            assert_eq!(costs.stated(), CycleCost::default());
            costs.begin();
            pass(if cycle == 5 { 60 } else { 20 });
            costs.end_of(Stage::Model);
            pass(if cycle == 7 { 200 } else { 100 });
            costs.end_of(Stage::Law);
            costs.end();
            pass(33);
        }
        let stated = costs.stated();
        assert_eq!((stated.hz, stated.cycles), (1000, WINDOW));
        assert_eq!(stated.of(Stage::Model), Cost { mean: 20, worst: 60 });
        assert_eq!(stated.of(Stage::Law), Cost { mean: 100, worst: 200 });
        assert_eq!(stated.whole, Cost { mean: 120, worst: 220 });
        assert_eq!(stated.of(Stage::Report), Cost::default());
    }
}
