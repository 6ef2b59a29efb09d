//! How late a drive answers, from what it measures and what it was sent.
//!
//! A drive that hides its motors measures the torque that it was sent, as late as it answers. From tick to tick both change by
//! noise, at rest too: the noise of the speeds passes through the law into the torque. So the changes are correlated at
//! the delay, and at no other.

/// Most periods of delay that it looks for: one more than a handshake may declare at 1 kHz.
const MOST: usize = 6;
/// Time over which it remembers, in s: 250 ticks of seven joints tell a share within 0.024 where the sensors' noise is as
/// large as the changes.
const MEMORY_S: f64 = 0.25;
/// Largest standard error of a share that tells something: a sixth of the smaller share below.
const SURE: f64 = 0.05;
/// Least share of the sent change that comes back at the delay. Without a delay it is 1, and what a contact or a motor's own
/// loop adds to the measured torque is not correlated.
const SHARE: f64 = 0.5;
/// Least share by which it exceeds that at the delay that is known: a smooth motion has the same share at all delays.
const BEYOND: f64 = 0.3;
/// Time for which it must show, in s: as of a torque beyond its limit.
const DWELL_S: f64 = 0.020;

/// The watch over a drive with `N` joints.
#[derive(Clone, Debug)]
pub(crate) struct AnswerWatch<const N: usize> {
    /// Torques sent and measured one tick ago, in N m.
    last: Option<([f64; N], [f64; N])>,
    /// Changes of the sent torque, a ring; where the next one goes, and how many there are.
    changes: [[f64; N]; MOST + 1],
    next: usize,
    filled: usize,
    /// Fading sums of the measured change times the sent one at each delay, and of the squares of both.
    common: [f64; MOST + 1],
    sent: f64,
    measured: f64,
    shows: u32,
}

impl<const N: usize> Default for AnswerWatch<N> {
    fn default() -> Self {
        Self {
            last: None,
            changes: [[0.0; N]; MOST + 1],
            next: 0,
            filled: 0,
            common: [0.0; MOST + 1],
            sent: 0.0,
            measured: 0.0,
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
            self.last = None;
            self.filled = 0;
            return None;
        };
        let (last_sent, last_measured) = self.last.replace((sent, *measured))?;
        let fade = period_s / MEMORY_S;
        let keep = 1.0 - fade;
        let (mut of_sent, mut of_measured, mut by) = (0.0, 0.0, [0.0; N]);
        if let Some(change) = self.changes.get_mut(self.next) {
            for i in 0..N {
                change[i] = sent[i] - last_sent[i];
                by[i] = measured[i] - last_measured[i];
                of_sent += change[i] * change[i];
                of_measured += by[i] * by[i];
            }
        }
        if self.filled <= MOST {
            self.filled += 1;
            self.next = (self.next + 1) % (MOST + 1);
            return None;
        }
        self.sent = keep * self.sent + of_sent;
        self.measured = keep * self.measured + of_measured;
        let (mut at, mut best, mut most, mut expected) = (self.next, 0, 0.0, 0.0);
        for (delay, common) in self.common.iter_mut().enumerate() {
            let mut sum = 0.0;
            if let Some(change) = self.changes.get(at) {
                for i in 0..N {
                    sum += by[i] * change[i];
                }
            }
            *common = keep * *common + sum;
            if *common > most {
                (best, most) = (delay, *common);
            }
            if delay == known {
                expected = *common;
            }
            at = if at == 0 { MOST } else { at - 1 };
        }
        self.next = (self.next + 1) % (MOST + 1);
        // The variance of a share is that of the measured change over twice the sum of squares.
        let sure = self.measured * fade <= 2.0 * N as f64 * SURE * SURE * self.sent;
        let shows = sure && best > known && most > SHARE * self.sent && most - expected > BEYOND * self.sent;
        self.shows = if shows { self.shows.saturating_add(1) } else { 0 };
        (f64::from(self.shows) * period_s > DWELL_S).then_some(best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random;

    /// What the watch finds within 2 s of 1 ms on a drive that answers `delay` periods late, with so much noise (N m) of its
    /// sensors about torques that change by 0.05 N m, and a motion of 100 N m/s on top; and after how many ticks.
    fn found(delay: usize, known: usize, noise_nm: f64, motion: bool) -> Option<(usize, u32)> {
        let mut watch = AnswerWatch::<3>::default();
        let mut seed = 1000 * delay as u64;
        let mut random = || {
            seed += 1;
            1.7 * random(seed)
        };
        let mut sent = std::vec![[0.0; 3]; 10];
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

    // Fails if closed brakes, whose torques were not sent, count.
    #[test]
    fn closed_brakes_tell_nothing() {
        let mut watch = AnswerWatch::<3>::default();
        assert!((0..1000).all(|_| watch.push(&[], &[0.0; 3], 0, 1e-3).is_none()));
    }
}
