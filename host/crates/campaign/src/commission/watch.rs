//! What the samples of a step amount to, and how steps are made gentler than a calibration.

use std::collections::VecDeque;

use nalgebra::Vector3;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::Sample;
use spherecal_shared::robot::JointLimits;

use super::Figure;

/// What is accepted while the controller holds and moves the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovingLimits {
    /// Time of each hold, in s.
    pub hold_s: f64,
    /// Largest movement of a joint at zero stiffness, in rad.
    pub sink_rad: f64,
    /// Largest movement of a joint that soft springs hold, in rad.
    pub soft_rad: f64,
    /// Largest speed of a joint that is held, in rad/s.
    pub hold_rad_s: f64,
    /// Largest commanded torque, as a share of a joint's limit.
    pub torque_share: f64,
    /// Largest force of the first contact, a mean over 10 ms, in N. Of 45 sound arms none shows more than 63 N.
    pub peak_n: f64,
    /// Largest share of control periods without a state of the robot.
    pub missed_share: f64,
}

impl Default for MovingLimits {
    fn default() -> Self {
        Self {
            hold_s: 5.0,
            sink_rad: 0.1,
            soft_rad: 0.05,
            hold_rad_s: 0.1,
            torque_share: 0.9,
            peak_n: 80.0,
            missed_share: 0.02,
        }
    }
}

/// Natural frequency of the soft springs, as a share of the usual one.
pub(super) const SOFT: f64 = 0.4;
/// Speed of the free motions of each joint, as a share of the usual one.
pub(super) const SLOW: f64 = 0.1;
/// Speed of the way to sphere 1, as a share of the usual one.
pub(super) const CALM: f64 = 0.25;

/// How far each joint turns, in rad.
const TURN_RAD: f64 = 0.1;
/// Time over which the speed of a free motion is taken, in s. Friction lets a slow joint stick and slip: its speed at one
/// instant says little.
const MEAN_S: f64 = 0.2;

/// The procedure with these shares of speed and of natural frequency.
pub(super) fn gentle(procedure: &Procedure, speed: f64, natural: f64) -> Procedure {
    let mut gentle = *procedure;
    let motion = &mut gentle.motion;
    // The smallest values that a procedure may have.
    motion.speed_rad_s = (motion.speed_rad_s * speed).max(0.01);
    motion.acceleration_rad_s2 = (motion.acceleration_rad_s2 * speed).max(0.01);
    motion.natural_rad_s = (motion.natural_rad_s * natural).max(2.0);
    gentle
}

/// What the samples of a while amount to.
#[derive(Clone, Debug, Default)]
pub(super) struct WatchedSamples {
    tick: u64,
    pub(super) first: Option<Sample>,
    pub(super) last: Sample,
    pub(super) moved_rad: f64,
    pub(super) speed_rad_s: f64,
    /// Largest mean speed of a joint over [`MEAN_S`], in rad/s.
    pub(super) mean_rad_s: f64,
    pub(super) torque_share: f64,
    pub(super) tcp_m: f64,
    pub(super) saturated: u64,
    /// The samples of the last [`MEAN_S`], and one that is older.
    recent: VecDeque<Sample>,
}

impl WatchedSamples {
    /// Adds the samples that were not seen before. `period_s`: of the control loop, in s.
    pub(super) fn add(&mut self, samples: &[Sample], limits: &[JointLimits], period_s: f64) {
        for sample in samples {
            if self.first.is_none() || sample.tick > self.tick {
                self.add_one(sample, limits, period_s);
            }
        }
    }

    fn add_one(&mut self, sample: &Sample, limits: &[JointLimits], period_s: f64) {
        self.tick = sample.tick;
        self.recent.push_back(*sample);
        let age_s = |of: &Sample| sample.tick.saturating_sub(of.tick) as f64 * period_s;
        while self.recent.get(1).is_some_and(|next| age_s(next) >= MEAN_S) {
            self.recent.pop_front();
        }
        let earlier = self.recent.front().filter(|earlier| age_s(earlier) >= MEAN_S).copied();
        self.last = *sample;
        let first = *self.first.get_or_insert(*sample);
        for (j, limit) in limits.iter().enumerate() {
            let value = |of: &[f32]| of.get(j).map_or(0.0, |v| f64::from(*v));
            self.moved_rad = self.moved_rad.max((value(&sample.q) - value(&first.q)).abs());
            self.speed_rad_s = self.speed_rad_s.max(value(&sample.dq).abs());
            self.torque_share = self.torque_share.max(value(&sample.command).abs() / limit.torque_nm);
            if let Some(earlier) = &earlier {
                let mean = (value(&sample.q) - value(&earlier.q)).abs() / age_s(earlier);
                self.mean_rad_s = self.mean_rad_s.max(mean);
            }
        }
        let tcp = |s: &Sample| Vector3::from(s.tcp_m.map(f64::from));
        self.tcp_m = self.tcp_m.max((tcp(sample) - tcp(&first)).norm());
        self.saturated += u64::from(sample.flags & 1);
    }

    /// The figures of a hold: no joint may have moved by more than `moved_rad`.
    pub(super) fn held(&self, limits: &MovingLimits, moved_rad: f64) -> Vec<Figure> {
        vec![
            Figure::judged(
                "largest movement of a joint",
                self.moved_rad.to_degrees(),
                "deg",
                moved_rad.to_degrees(),
            ),
            Figure::shown("movement of the TCP", self.tcp_m * 1e3, "mm"),
            Figure::judged(
                "largest joint speed",
                self.speed_rad_s.to_degrees(),
                "deg/s",
                limits.hold_rad_s.to_degrees(),
            ),
            Figure::judged(
                "largest commanded torque, of the joint's limit",
                self.torque_share * 100.0,
                "%",
                limits.torque_share * 100.0,
            ),
        ]
    }
}

/// `start` (rad) with joint `j` turned a little, to the side with more room if the way is `clear` there. `None` if it can
/// turn to neither side without coming within `margin` (rad) of its limits.
pub(super) fn aside(
    start: &[f64],
    j: usize,
    limit: &JointLimits,
    margin: f64,
    clear: impl Fn(&[f64]) -> bool,
) -> Option<Vec<f64>> {
    let at = *start.get(j)?;
    let mut sides = [(limit.max_rad - margin - at, 1.0), (at - limit.min_rad - margin, -1.0)];
    if sides[1].0 > sides[0].0 {
        sides.swap(0, 1);
    }
    let turned = |(room, side): (f64, f64)| {
        let mut away = start.to_vec();
        away[j] += side * TURN_RAD.min(0.5 * room);
        away
    };
    // A turn that is too small to be seen shows nothing.
    let possible = sides.into_iter().filter(|(room, _)| *room >= TURN_RAD);
    possible.map(turned).find(|away| clear(away))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limit() -> JointLimits {
        JointLimits {
            min_rad: -1.0,
            max_rad: 1.0,
            velocity_rad_s: 1.0,
            torque_nm: 10.0,
        }
    }

    // Fails if a slip of an instant counts as the speed of a joint, if a joint that is fast for longer does not, or if a
    // sample counts twice. Samples come each 20 ms, in batches that overlap.
    #[test]
    fn a_slip_is_no_speed() {
        for (fast_ticks, least, most) in [(20, 0.09, 0.2), (400, 0.95, 1.01)] {
            let (mut watch, mut at) = (WatchedSamples::default(), 0.0f64);
            let samples: Vec<Sample> = (0..100u64)
                .map(|k| {
                    let speed = if (1000..1000 + fast_ticks).contains(&(k * 20)) {
                        1.0
                    } else {
                        0.05
                    };
                    let mut sample = Sample {
                        tick: k * 20,
                        ..Sample::default()
                    };
                    sample.q[1] = at as f32;
                    sample.dq[1] = speed as f32;
                    at += speed * 0.02;
                    sample
                })
                .collect();
            for batch in samples.windows(8) {
                watch.add(batch, &[limit(), limit()], 1e-3);
            }
            assert!(
                watch.mean_rad_s > least && watch.mean_rad_s < most,
                "{}",
                watch.mean_rad_s
            );
            assert!((watch.speed_rad_s - 1.0).abs() < 1e-6, "{}", watch.speed_rad_s);
            assert!(watch.recent.len() < 13, "{} samples are kept", watch.recent.len());
        }
    }

    // Fails if a joint turns towards its nearer limit, over a limit, into an obstacle, or not at all where it can.
    #[test]
    fn a_joint_turns_where_there_is_room() {
        let (margin, anywhere) = (0.1, |_: &[f64]| true);
        for at in [-0.85, -0.5, -0.1, 0.0, 0.3, 0.85] {
            let away = aside(&[5.0, at], 1, &limit(), margin, anywhere).expect("room to one side");
            assert_eq!(away[0], 5.0);
            assert!(
                away[1].abs() <= 0.9 && (away[1] - at).abs() >= 0.5 * TURN_RAD,
                "{at} {away:?}"
            );
            assert!(at == 0.0 || (away[1] - at) * at < 0.0, "{at} {away:?}");
            // Something stands on that side.
            let other = aside(&[5.0, at], 1, &limit(), margin, |q| (q[1] - at) * at >= 0.0);
            assert_eq!(other.is_some(), at.abs() < 0.8, "{at} {other:?}");
            assert_eq!(aside(&[5.0, at], 1, &limit(), margin, |_| false), None);
        }
        let narrow = JointLimits {
            min_rad: -0.15,
            max_rad: 0.15,
            ..limit()
        };
        assert_eq!(aside(&[0.0], 0, &narrow, margin, anywhere), None);
    }
}
