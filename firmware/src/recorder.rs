//! The recorder: mean, standard deviation, minimum and maximum of every joint
//! angle and torque at one pose, in one pass.
//!
//! Welford's update keeps the mean and the sum of squared deviations without
//! cancellation. Noise of 1e-5 rad on an angle of 2 rad is measured to many digits.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Recording, SignalStatistics};
use spherecal_shared::scalar::sqrt;

/// The statistics of one signal.
#[derive(Clone, Copy, Debug)]
struct Signal {
    mean: f64,
    squares: f64,
    min: f64,
    max: f64,
}

impl Signal {
    const EMPTY: Self = Self {
        mean: 0.0,
        squares: 0.0,
        min: f64::INFINITY,
        max: f64::NEG_INFINITY,
    };

    #[inline]
    fn push(&mut self, value: f64, reciprocal_count: f64) {
        let deviation = value - self.mean;
        self.mean += deviation * reciprocal_count;
        self.squares += deviation * (value - self.mean);
        self.min = self.min.min(value);
        self.max = self.max.max(value);
    }

    fn finish(&self, count: u32) -> SignalStatistics {
        let std = if count > 1 {
            sqrt(self.squares / f64::from(count - 1))
        } else {
            0.0
        };
        SignalStatistics {
            mean: self.mean,
            std,
            min: self.min,
            max: self.max,
        }
    }
}

/// Averages one recording of `N` joints.
#[derive(Clone, Debug)]
pub(crate) struct Recorder<const N: usize> {
    q: [Signal; N],
    tau: [Signal; N],
    force: Vector3<f64>,
    /// Mean of the computed TCP, in m, and the sum of squared distances from it.
    tcp: Vector3<f64>,
    tcp_squares: f64,
    count: u32,
    gaps: u32,
    last_tick: u64,
    start_us: u64,
    end_us: u64,
}

/// The values of one tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RecorderSample<'a, const N: usize> {
    /// Tick of the drive state.
    pub(crate) tick: u64,
    /// Device time, in µs.
    pub(crate) time_us: u64,
    /// Joint angles, in rad.
    pub(crate) q: &'a [f64; N],
    /// Measured torques, in N m.
    pub(crate) tau: &'a [f64; N],
    /// Computed TCP in F0, in m.
    pub(crate) tcp: &'a Vector3<f64>,
    /// Estimated contact force, tared, F0, in N.
    pub(crate) force: &'a Vector3<f64>,
}

impl<const N: usize> Default for Recorder<N> {
    fn default() -> Self {
        Self {
            q: [Signal::EMPTY; N],
            tau: [Signal::EMPTY; N],
            force: Vector3::zeros(),
            tcp: Vector3::zeros(),
            tcp_squares: 0.0,
            count: 0,
            gaps: 0,
            last_tick: 0,
            start_us: 0,
            end_us: 0,
        }
    }
}

impl<const N: usize> Recorder<N> {
    /// Adds one tick; ticks missing since the last one count as gaps.
    #[inline]
    pub(crate) fn push(&mut self, sample: &RecorderSample<'_, N>) {
        if self.count == 0 {
            self.start_us = sample.time_us;
        } else {
            let missing = sample.tick.saturating_sub(self.last_tick).saturating_sub(1);
            self.gaps = self.gaps.saturating_add(u32::try_from(missing).unwrap_or(u32::MAX));
        }
        self.last_tick = sample.tick;
        self.end_us = sample.time_us;
        self.count = self.count.saturating_add(1);
        let reciprocal = 1.0 / f64::from(self.count);
        for i in 0..N {
            self.q[i].push(sample.q[i], reciprocal);
            self.tau[i].push(sample.tau[i], reciprocal);
        }
        self.force += (sample.force - self.force) * reciprocal;
        let deviation = sample.tcp - self.tcp;
        self.tcp += deviation * reciprocal;
        self.tcp_squares += deviation.dot(&(sample.tcp - self.tcp));
    }

    /// Number of samples so far.
    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    /// The recording, with the given ids.
    pub(crate) fn finish(&self, sphere: u32, pose: u32) -> Recording {
        let collect = |signals: &[Signal; N]| signals.iter().map(|s| s.finish(self.count)).collect();
        Recording {
            sphere,
            pose,
            start_us: self.start_us,
            end_us: self.end_us,
            count: self.count,
            gaps: self.gaps,
            q: collect(&self.q),
            tau: collect(&self.tau),
            tcp_spread_m: sqrt(self.tcp_squares / f64::from(self.count.max(1))),
            force_n: self.force.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn record(values: &[[f64; 2]], ticks: impl Iterator<Item = u64>) -> Recording {
        let mut recorder = Recorder::<2>::default();
        for (tick, value) in ticks.zip(values) {
            let zero = Vector3::zeros();
            recorder.push(&RecorderSample {
                tick,
                time_us: tick * 1000,
                q: value,
                tau: value,
                tcp: &zero,
                force: &zero,
            });
        }
        recorder.finish(1, 2)
    }

    proptest! {
        // Against a two-pass reference. Fails if the one-pass formula loses digits on a large offset.
        #[test]
        fn statistics_equal_two_passes(values in prop::collection::vec(prop::array::uniform2(-1e-5f64..1e-5), 2..400), offset in -3.0f64..3.0) {
            let values: Vec<[f64; 2]> = values.iter().map(|v| [v[0] + offset, v[1] - offset]).collect();
            let recording = record(&values, 10..);
            let n = values.len() as f64;
            for j in 0..2 {
                let mean = values.iter().map(|v| v[j]).sum::<f64>() / n;
                let variance = values.iter().map(|v| (v[j] - mean).powi(2)).sum::<f64>() / (n - 1.0);
                let ours = recording.q[j];
                prop_assert!((ours.mean - mean).abs() < 1e-14);
                prop_assert!((ours.std - variance.sqrt()).abs() < 1e-9 * variance.sqrt() + 1e-15);
                prop_assert_eq!(ours.min, values.iter().map(|v| v[j]).fold(f64::INFINITY, f64::min));
                prop_assert_eq!(ours.max, values.iter().map(|v| v[j]).fold(f64::NEG_INFINITY, f64::max));
            }
        }
    }

    // Fails if the spread of the TCP depends on which sample is the first.
    #[test]
    fn the_spread_is_about_the_mean() {
        let spread = |along: &[f64]| {
            let mut recorder = Recorder::<1>::default();
            for (tick, x) in (1..).zip(along) {
                recorder.push(&RecorderSample {
                    tick,
                    time_us: 0,
                    q: &[0.0],
                    tau: &[0.0],
                    tcp: &Vector3::new(0.5, *x, 0.2),
                    force: &Vector3::zeros(),
                });
            }
            recorder.finish(1, 2).tcp_spread_m
        };
        let expected = sqrt(0.75) * 2e-3;
        assert!((spread(&[0.004, 0.0, 0.0, 0.0]) - expected).abs() < 1e-12);
        assert!((spread(&[0.0, 0.0, 0.004, 0.0]) - expected).abs() < 1e-12);
        assert_eq!(spread(&[0.004]), 0.0);
    }

    #[test]
    fn gaps_are_counted() {
        let values = [[0.0; 2]; 4];
        let recording = record(&values, [5, 6, 9, 10].into_iter());
        assert_eq!((recording.count, recording.gaps), (4, 2));
        assert_eq!((recording.start_us, recording.end_us), (5000, 10_000));
    }
}
