//! How late a drive answers, from what it measures and what it was sent.
//!
//! A drive that hides its motors measures the torque that it was sent, as late as it answers. From tick to tick both change by
//! noise, at rest too: the noise of the speeds passes through the law into the torque. So the rough parts of both are
//! correlated at the delay, and at no other.

use spherecal_shared::scalar::sqrt;

/// Most periods of delay that it looks for: 4 ms each way at 1 kHz.
const MOST: usize = 8;
/// Time over which it remembers, in s: 250 ticks of seven joints find a delay with 20 standard errors where the sensors' noise
/// is as large as the torque's.
const MEMORY_S: f64 = 0.25;
/// Standard errors that tell something: five of what chance makes, because the sums at a delay that is not there vary by 1.4 of
/// them (rough parts are correlated with themselves two ticks later). 49 ticks that are all alike have as many.
const SURE: f64 = 7.0;
/// Least correlation at a longer delay, beyond that at the delay that is known. Without noise it is 1, 0.7 at each of two delays
/// between which the real one is, and 0 elsewhere. In the simulation an iiwa 7 at rest that answers 3 ms late, between two ticks,
/// has 0.25 at both and 0.10 at none. What a contact or a motor's own loop adds to the measured torque is not correlated.
const BEYOND: f64 = 0.08;
/// How negative the correlation must be two periods beside a delay, in the mean of both sides, as a share of that at the delay.
/// That of noise has -2/3 there, because of the two middle parts of a rough part. A ripple of several periods, as of joints that
/// stick and slip or of a contact that chatters, is alike at many delays, or at those where it repeats. (Asked of
/// each side alone, 0.5 found steps of the delay too late, and 0.3 took the stick and slip of an arm on another physics engine for a
/// delay.)
const DIP: f64 = 0.4;
/// Least change of a torque that has a direction, in N m: a hundredth of what torque sensors resolve. An arm that friction holds
/// without any noise, in a simulator, changes by rounding errors of 1e-9 N m, which may be alike at any delay.
const LEAST_NM: f64 = 1e-4;
/// Time for which it must show, in s: as of a torque beyond its limit.
const DWELL_S: f64 = 0.020;

/// The direction, in the space of the joints, of the part of a torque that changes within a few ticks, `x_k - 2 x_k-2 + x_k-4`:
/// a motion has none. White noise is not correlated with itself a tick later there. That it has no size makes every tick count
/// alike: one jump of both torques, which is alike at one delay by chance, tells nothing.
#[derive(Clone, Debug)]
struct Rough<const N: usize> {
    /// The last four torques, newest first, in N m.
    before: [[f64; N]; 4],
}

impl<const N: usize> Rough<N> {
    #[inline]
    fn push(&mut self, torque: &[f64; N]) -> [f64; N] {
        let [one, two, three, four] = self.before;
        self.before = [*torque, one, two, three];
        let change: [f64; N] = core::array::from_fn(|i| torque[i] - 2.0 * two[i] + four[i]);
        let square = dot(&change, &change);
        if !(square > LEAST_NM * LEAST_NM && square.is_finite()) {
            return [0.0; N];
        }
        let scale = 1.0 / sqrt(square);
        change.map(|part| scale * part)
    }
}

#[inline]
fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = 0.0;
    for i in 0..N {
        sum += a[i] * b[i];
    }
    sum
}

/// The watch over a drive with `N` joints.
#[derive(Clone, Debug)]
pub(crate) struct AnswerWatch<const N: usize> {
    sent: Rough<N>,
    measured: Rough<N>,
    /// Directions of the sent torque, a ring; where the next one goes, and how many torques have come.
    changes: [[f64; N]; MOST + 1],
    next: usize,
    filled: usize,
    /// Fading sums of the cosines between the measured direction and the sent one at each delay, and of their squares.
    common: [f64; MOST + 1],
    variance: [f64; MOST + 1],
    /// How many ticks they count for.
    weight: f64,
    shows: u32,
}

impl<const N: usize> Default for AnswerWatch<N> {
    fn default() -> Self {
        let rough = Rough { before: [[0.0; N]; 4] };
        Self {
            sent: rough.clone(),
            measured: rough,
            changes: [[0.0; N]; MOST + 1],
            next: 0,
            filled: 0,
            common: [0.0; MOST + 1],
            variance: [0.0; MOST + 1],
            weight: 0.0,
            shows: 0,
        }
    }
}

impl<const N: usize> AnswerWatch<N> {
    /// Takes one tick of `period_s` (s): the torque that was sent a tick ago and what is measured now (N m), and the delay
    /// that is known, in periods. Returns a longer one, in periods, once it shows.
    #[inline]
    pub(crate) fn push(&mut self, sent: &[f64], measured: &[f64; N], known: usize, period_s: f64) -> Option<usize> {
        let Ok(sent) = <[f64; N]>::try_from(sent) else {
            // The brakes were closed.
            self.filled = 0;
            return None;
        };
        let (change, by) = (self.sent.push(&sent), self.measured.push(measured));
        if let Some(place) = self.changes.get_mut(self.next) {
            *place = change;
        }
        let newest = self.next;
        self.next = (self.next + 1) % (MOST + 1);
        // The oldest part is made of four more torques.
        if self.filled < MOST + 4 {
            self.filled += 1;
            return None;
        }
        let keep = 1.0 - period_s / MEMORY_S;
        self.weight = keep * self.weight + 1.0;
        let mut at = newest;
        for (common, variance) in self.common.iter_mut().zip(&mut self.variance) {
            let cosine = self.changes.get(at).map_or(0.0, |change| dot(&by, change));
            *common = keep * *common + cosine;
            *variance = keep * keep * *variance + cosine * cosine;
            at = if at == 0 { MOST } else { at - 1 };
        }
        let expected = self.common.get(known).map_or(f64::INFINITY, |common| common.max(0.0));
        let mut most = 0.0f64;
        for (common, variance) in self.common.iter().zip(&self.variance).skip(known + 1) {
            if *common > 0.0 && common * common > SURE * SURE * variance {
                most = most.max(common - expected);
            }
        }
        let shows = most > BEYOND * self.weight;
        self.shows = if shows { self.shows.saturating_add(1) } else { 0 };
        if f64::from(self.shows) * period_s <= DWELL_S {
            return None;
        }
        // Of two neighbours with a part each, the longer one counts unless it has less. A ripple that repeats within a few ticks is
        // alike at other delays, too, and tells none.
        let (mut shortest, mut longest) = (MOST, 0);
        for (delay, common) in self.common.iter().enumerate() {
            if 2.0 * (common - expected) > most {
                shortest = shortest.min(delay);
                longest = delay;
            }
        }
        (longest > known && longest <= shortest + 1 && self.dips(longest, shortest, known)).then_some(longest)
    }

    /// Whether the correlation is as negative beside a delay, found as `shortest` to `longest`, as that of noise: in the mean of
    /// both sides, where both are looked at.
    fn dips(&self, longest: usize, shortest: usize, known: usize) -> bool {
        let peak = self.common.get(longest).copied().unwrap_or_default();
        // At the delay that is known the torques were alike until now.
        let before = shortest.checked_sub(2).filter(|before| *before != known);
        let (mut sum, mut count) = (0.0, 0.0);
        for beside in before.into_iter().chain([longest + 2]) {
            if let Some(common) = self.common.get(beside) {
                sum += common;
                count += 1.0;
            }
        }
        sum <= -DIP * peak * count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random;

    /// What the watch finds within 2 s of 1 ms on a drive that answers `delay` periods late, with so much noise (N m) of its
    /// sensors about torques that change by 0.05 N m, and a motion of 100 N m/s on top; and after how many ticks.
    fn found(delay: usize, known: usize, noise_nm: f64, motion: bool) -> Option<(usize, u32)> {
        let mut watch = AnswerWatch::<7>::default();
        let mut seed = 1000 * delay as u64;
        let mut random = || {
            seed += 1;
            1.7 * random(seed)
        };
        let mut sent = std::vec![[0.0; 7]; 10];
        (0..2000).find_map(|tick| {
            let swing = if motion {
                10.0 * libm::sin(0.01 * f64::from(tick))
            } else {
                0.0
            };
            sent.push(core::array::from_fn(|_| swing + 0.05 * random()));
            let arrived = sent[sent.len() - 1 - delay];
            let measured = arrived.map(|torque| torque + noise_nm * random());
            watch
                .push(&sent[sent.len() - 1], &measured, known, 1e-3)
                .map(|delay| (delay, tick))
        })
    }

    // Fails if a delay is not found, is found as another one, or takes longer than a second to show, at rest or in a motion.
    #[test]
    fn a_delay_shows() {
        for delay in 1..=MOST {
            for motion in [false, true] {
                let (found, tick) = found(delay, 0, 0.05, motion).expect("it shows");
                assert_eq!(found, delay);
                assert!(tick < 1000, "{tick}");
            }
        }
    }

    // Fails if a delay of some periods and a half is not found, though two delays have a half each, or counts as the shorter one.
    #[test]
    fn a_delay_of_a_part_of_a_period_shows() {
        let mut watch = AnswerWatch::<3>::default();
        let sent = |tick: u64| [0, 1, 2].map(|joint| 0.05 * random(3 * tick + joint));
        let found = (10..2000u64).find_map(|tick| {
            let (one, two) = (sent(tick - 3), sent(tick - 4));
            let measured =
                core::array::from_fn(|i| 0.45 * one[i] + 0.55 * two[i] + 0.02 * random(90_000 + 3 * tick + i as u64));
            watch.push(&sent(tick), &measured, 0, 1e-3)
        });
        assert_eq!(found, Some(4));
    }

    // Fails if a torque that changes its sign with each tick, which is the same at every second delay, shows one.
    #[test]
    fn a_ripple_shows_no_delay() {
        let mut watch = AnswerWatch::<3>::default();
        let found = (0..2000u64).find_map(|tick| {
            let ripple = if tick % 2 == 0 { 0.05 } else { -0.05 };
            watch.push(&[ripple; 3], &[-ripple; 3], 0, 1e-3)
        });
        assert_eq!(found, None);
    }

    // Fails if a ripple of several periods shows a delay: one of three that a joint without noise has which sticks and slips, a
    // tick apart in both torques, or one that slowly changes its frequency.
    #[test]
    fn a_ripple_of_some_periods_shows_no_delay() {
        let three = |tick: u64| [0.05, -0.03, -0.02].map(|size| size * [1.0, -0.4, -0.6][(tick % 3) as usize]);
        let slow =
            |tick: u64| [0.05, 0.02, -0.04].map(|size| size * libm::sin(tick as f64 * (0.7 + 1e-5 * tick as f64)));
        let ripples: [&dyn Fn(u64) -> [f64; 3]; 2] = [&three, &slow];
        for ripple in ripples {
            for lag in 1..=6 {
                let mut watch = AnswerWatch::<3>::default();
                let mut noise = 0;
                let found = (10..3000u64).find_map(|tick| {
                    let measured = ripple(tick - lag).map(|torque| {
                        noise += 1;
                        torque + 0.01 * random(noise)
                    });
                    watch.push(&ripple(tick), &measured, 0, 1e-3)
                });
                assert_eq!(found, None, "{lag}");
            }
        }
    }

    // Fails if a delay is found in some tens of ticks with jumps of both torques that have nothing in common.
    #[test]
    fn jumps_show_no_delay() {
        for begin in 0..1_000 {
            let mut watch = AnswerWatch::<3>::default();
            let jump = |joint: u64, at: u64| {
                let size = random(1_000_000 * joint + 40 * begin + at);
                if at < 40 && size.abs() > 0.8 { size } else { 0.0 }
            };
            let found = (0..1000u64).find_map(|at| {
                let sent = [jump(0, at), jump(1, at), jump(2, at)];
                watch.push(&sent, &[jump(3, at), jump(4, at), jump(5, at)], 0, 1e-3)
            });
            assert_eq!(found, None, "{begin}");
        }
    }

    // Fails if a delay that is known is reported, or one that is not there: of a prompt drive, of noise alone, or of a
    // smooth motion alone, which is the same at all delays.
    #[test]
    fn a_delay_that_is_not_there_does_not_show() {
        for delay in 0..=MOST {
            assert_eq!(found(delay, delay, 0.05, true), None);
        }
        assert_eq!(found(3, 0, 5.0, false), None);
        let mut watch = AnswerWatch::<3>::default();
        let torque = |tick: u32| [libm::sin(0.01 * f64::from(tick)); 3];
        assert!((10..2000).all(|tick| watch.push(&torque(tick), &torque(tick - 5), 0, 1e-3).is_none()));
    }

    // Fails if what is rounded in an arm at rest shows a delay.
    #[test]
    fn rounding_shows_no_delay() {
        let mut watch = AnswerWatch::<3>::default();
        let sent = |tick: u64| [0, 1, 2].map(|joint| 1e-8 * random(3 * tick + joint));
        assert!((10..2000).all(|tick| watch.push(&sent(tick), &sent(tick - 6), 0, 1e-3).is_none()));
    }

    // Fails if closed brakes, whose torques were not sent, count.
    #[test]
    fn closed_brakes_tell_nothing() {
        let mut watch = AnswerWatch::<3>::default();
        assert!((0..1000).all(|_| watch.push(&[], &[0.0; 3], 0, 1e-3).is_none()));
    }
}
