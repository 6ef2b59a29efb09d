//! Plausibility: checks whether the arm can be in a drive state, given the states
//! before.
//!
//! A drive that hangs may count ticks and repeat its last values. An encoder that
//! loses its reference jumps from one state to the next. An encoder that sticks
//! shows the same angle although its joint is driven. A single state shows none of
//! these.
//!
//! [`plausible`] stands before: it refuses a state that has a value which no arm can
//! have, so that no filter ever sees one.

use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::drive::DriveState;
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::JointLimits;

use super::violation::{JointState, Violation};

/// Factor on the joint's speed limit, or on its last speed, that bounds the motion
/// between two states.
const SPEED_FACTOR: f64 = 1.5;
/// A last speed counts up to this multiple of the joint's speed limit. A single
/// absurd speed must not make room for an absurd angle.
const FASTEST_FACTOR: f64 = 20.0;
/// Longest time of identical states that counts as "not seen", in s: the drive may
/// have been frozen while the arm moved.
const MOST_UNSEEN_S: f64 = 0.5;
/// Joint speed above which a state says that the arm moves, in rad/s.
const MOVES_RAD_S: f64 = 1e-3;
/// Change of the sent torques (sum over the joints, in N m) that must change at
/// least one value of the state. A drive without noise that stands still under the
/// same torque is not frozen.
const TORQUE_CHANGE_NM: f64 = 0.05;
/// The same for one joint whose angle alone stays the same: at least this many
/// N m, and this share of its torque limit. It exceeds the range of its stiction.
const STUCK_NM: f64 = 10.0;
const STUCK_SHARE: f64 = 0.05;

/// Largest angle, speed and torque that a state may have, in rad, rad/s and N m.
/// A robot description may state no larger limits, so no arm has larger values.
const MOST_RAD: f64 = 1e4;
const MOST_RAD_S: f64 = 1e3;
const MOST_NM: f64 = 1e5;

/// The values of a drive state, if an arm with `N` joints can have them: one per
/// joint, and each a number within the range of all robots. NaN is in no range.
pub(crate) fn plausible<const N: usize>(state: &DriveState) -> Option<JointState<N>> {
    let within = |values: &[f64], most: f64| -> Option<[f64; N]> {
        let values: [f64; N] = values.try_into().ok()?;
        values.iter().all(|x| x.abs() <= most).then_some(values)
    };
    Some(JointState {
        q: within(&state.q, MOST_RAD)?,
        dq: within(&state.dq, MOST_RAD_S)?,
        tau: within(&state.tau, MOST_NM)?,
    })
}

/// State of the plausibility checks.
#[derive(Clone, Debug)]
pub(crate) struct Plausibility<const N: usize> {
    last: Option<JointState<N>>,
    /// The good state before `last`, if the arm was not seen between them and no later
    /// state has confirmed `last`. A false angle may have passed as motion.
    before: Option<JointState<N>>,
    /// Tick of the last state that was checked, good or not.
    tick: u64,
    /// Ticks since the last good state in which the arm was not seen. It may have
    /// moved during them.
    unseen: u64,
    same: u32,
    /// Torques that were sent when the state first repeated, in N m.
    sent: [f64; N],
    /// For each joint: ticks for which the angle has been the same, and the torque
    /// sent at the first of them, in N m.
    stuck: [(u32, f64); N],
}

impl<const N: usize> Default for Plausibility<N> {
    fn default() -> Self {
        Self {
            last: None,
            before: None,
            tick: 0,
            unseen: 0,
            same: 0,
            sent: [0.0; N],
            stuck: [(0, 0.0); N],
        }
    }
}

impl<const N: usize> Plausibility<N> {
    /// Forgets earlier states: for another robot.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Checks the state of `tick`. `sent` are the torques (N m) sent before it
    /// (empty while the brakes are closed). An implausible state is not kept: the
    /// next one is compared with the last good one.
    #[inline]
    pub(crate) fn check(
        &mut self,
        tick: u64,
        state: &JointState<N>,
        sent: &[f64],
        joints: &[JointLimits; N],
        limits: &Limits,
        period_s: f64,
    ) -> Option<Violation> {
        let gap = tick.saturating_sub(self.tick);
        self.tick = tick;
        let Some(last) = &self.last else {
            self.last = Some(*state);
            return None;
        };
        self.unseen = self.unseen.saturating_add(gap.saturating_sub(1));
        let elapsed_s = self.unseen.saturating_add(1) as f64 * period_s;
        if let Some(violation) = jump(last, state, elapsed_s, joints, limits) {
            let stands = |before| jump(before, state, 0.0, joints, limits).is_none();
            if !self.before.as_ref().is_some_and(stands) {
                return Some(violation);
            }
            // The one state after the gap was false: the arm stands where it stood before.
            self.last = Some(*state);
            self.before = None;
            self.unseen = 0;
            self.same = 0;
            return None;
        }
        self.before = self.last.filter(|_| self.unseen > 0);
        let mut change = 0.0;
        let mut fastest = 0.0f64;
        let (mut stuck_joint, mut others) = (None, false);
        for i in 0..N {
            let moved = (state.q[i] - last.q[i]).abs();
            others |= moved > 0.0;
            stuck_joint = stuck_joint.or(stuck_encoder(&mut self.stuck[i], i, moved, sent, &joints[i], limits));
            change += moved + (state.dq[i] - last.dq[i]).abs() + (state.tau[i] - last.tau[i]).abs();
            fastest = fastest.max(state.dq[i].abs());
        }
        self.last = Some(*state);
        if change > 0.0 {
            self.same = 0;
            self.unseen = 0;
            // All joints of a blocked arm stand still.
            return stuck_joint.filter(|_| others);
        }
        if self.same == 0 {
            for (kept, sent) in self.sent.iter_mut().zip(sent) {
                *kept = *sent;
            }
        }
        self.same = self.same.saturating_add(1);
        let allowed = limits.frozen_ticks;
        let mut torque_change = 0.0;
        for (kept, sent) in self.sent.iter().zip(sent) {
            torque_change += (sent - kept).abs();
        }
        let alive = torque_change > TORQUE_CHANGE_NM || fastest > MOVES_RAD_S;
        // The drive may be frozen while the arm moves.
        self.unseen = if alive {
            u64::from(self.same).min((MOST_UNSEEN_S / period_s + 0.5) as u64)
        } else {
            0
        };
        (allowed > 0 && self.same > allowed && alive)
            .then(|| Violation::new(Fault::StaleState, f64::from(self.same), f64::from(allowed)))
    }
}

/// The first joint that cannot have moved from the state `from` to `state` in
/// `elapsed_s` seconds.
#[inline]
fn jump<const N: usize>(
    from: &JointState<N>,
    state: &JointState<N>,
    elapsed_s: f64,
    joints: &[JointLimits; N],
    limits: &Limits,
) -> Option<Violation> {
    for (i, joint) in joints.iter().enumerate() {
        let moved = (state.q[i] - from.q[i]).abs();
        // By the earlier speed: the later one may be computed from the jump.
        let limit = joint.velocity_rad_s;
        let speed = limit.max(from.dq[i].abs().min(FASTEST_FACTOR * limit));
        let most = speed * SPEED_FACTOR * elapsed_s + limits.jump_rad;
        if moved > most {
            return Some(Violation {
                fault: Fault::PositionJump,
                joint: i as u8 + 1,
                value: moved,
                limit: most,
            });
        }
    }
    None
}

/// Whether the encoder of joint `i` sticks: its angle stays the same although the
/// torque sent to it changes. `stuck` holds the ticks for which the angle has been
/// the same and the torque sent at the first of them, in N m.
#[inline]
fn stuck_encoder(
    stuck: &mut (u32, f64),
    i: usize,
    moved: f64,
    sent: &[f64],
    joint: &JointLimits,
    limits: &Limits,
) -> Option<Violation> {
    let (count, first) = stuck;
    let Some(sent) = sent.get(i).filter(|_| moved == 0.0) else {
        *count = 0;
        return None;
    };
    if *count == 0 {
        *first = *sent;
    }
    *count = count.saturating_add(1);
    let change = (sent - *first).abs();
    let most = STUCK_NM.max(STUCK_SHARE * joint.torque_nm);
    let long = limits.frozen_ticks > 0 && *count > limits.frozen_ticks;
    (long && change > most).then_some(Violation {
        fault: Fault::StaleState,
        joint: i as u8 + 1,
        value: change,
        limit: most,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_shared::robot::iiwa7;

    fn joints() -> [JointLimits; 7] {
        core::array::from_fn(|i| iiwa7().joints[i].limits)
    }

    fn at(q: f64, tau: f64) -> JointState<7> {
        JointState {
            q: [q; 7],
            dq: [0.0; 7],
            tau: [tau; 7],
        }
    }

    // Fails if a motion counts as a jump or a jump as motion, or if an implausible
    // state replaces the last good one.
    #[test]
    fn an_angle_cannot_jump() {
        let limits = Limits::default();
        let mut watch = Plausibility::default();
        let mut look = |tick, q, tau| watch.check(tick, &at(q, tau), &[0.0; 7], &joints(), &limits, 1e-3);
        assert_eq!(look(1, 0.0, 1.0), None);
        assert_eq!(look(2, 0.003, 1.1), None);
        let jump = look(3, 0.1, 1.0).expect("a jump");
        assert_eq!((jump.fault, jump.joint), (Fault::PositionJump, 1));
        assert!((jump.value - 0.097).abs() < 1e-12);
        assert_eq!(look(4, 0.006, 1.0), None, "back where it was");
        // After 100 ms without a state the arm may be elsewhere.
        assert_eq!(look(104, 0.1, 1.0), None);
        // While it is seen it cannot be.
        assert!((105..1000).all(|tick| look(tick, 0.2, 1.0).is_some()));
    }

    // Fails if the way that an arm can go in a time has another size than its speed allows,
    // by the joint's limit or by its own higher speed before.
    #[test]
    fn an_angle_may_change_by_speed_times_time() {
        let (limits, joints) = (Limits::default(), joints());
        let moved = |from: &JointState<7>, by: f64| jump(from, &at(by, 0.0), 0.1, &joints, &limits);
        let most = joints[0].velocity_rad_s * SPEED_FACTOR * 0.1 + limits.jump_rad;
        let found = moved(&at(0.0, 0.0), 1.001 * most).expect("a jump");
        assert_eq!((found.joint, found.limit), (1, most));
        assert!(moved(&at(0.0, 0.0), 0.999 * most).is_none_or(|found| found.joint > 1));
        let mut fast = at(0.0, 0.0);
        fast.dq = joints.map(|joint| 3.0 * joint.velocity_rad_s);
        let most = 3.0 * joints[0].velocity_rad_s * SPEED_FACTOR * 0.1 + limits.jump_rad;
        assert_eq!(moved(&fast, 1.001 * most).map(|found| found.limit), Some(most));
    }

    // Fails if one false angle after a gap becomes the place from which all true angles
    // are jumps, or if an arm that stays away after the gap may come back at once.
    #[test]
    fn one_false_angle_after_a_gap_is_forgotten() {
        let limits = Limits::default();
        let run = |away: u64| {
            let mut watch = Plausibility::default();
            let mut look = |tick, q| watch.check(tick, &at(q, tick as f64), &[0.0; 7], &joints(), &limits, 1e-3);
            assert_eq!(look(1, 0.0), None);
            assert!((5..5 + away).all(|tick| look(tick, 0.012).is_none()));
            look(5 + away, 0.0)
        };
        assert_eq!(run(1), None);
        assert_eq!(run(2).map(|found| found.fault), Some(Fault::PositionJump));
    }

    // Fails if a frozen drive is not found in time, or if a simulator without
    // noise that stands under the same torque is taken for one.
    #[test]
    fn a_frozen_drive_is_noticed_and_a_still_one_is_not() {
        let limits = Limits::default();
        let run = |torque: &dyn Fn(u64) -> f64, dq: f64| {
            let mut watch = Plausibility::default();
            (1..1000).find(|tick| {
                let mut state = at(1e-5 * (*tick).min(10) as f64, 1.0);
                state.dq = [dq; 7];
                watch
                    .check(*tick, &state, &[torque(*tick); 7], &joints(), &limits, 1e-3)
                    .is_some()
            })
        };
        let noticed = Some(11 + u64::from(limits.frozen_ticks));
        assert_eq!(run(&|tick| 0.001 * tick as f64, 0.0), noticed, "the torque changes");
        assert_eq!(run(&|_| 3.0, 0.1), noticed, "it says that it moves");
        assert_eq!(run(&|_| 3.0, 0.0), None, "it stands");
    }

    // Fails if an encoder that sticks while its joint is driven is not found, if a
    // joint that stands under friction is taken for one, or if the ticks of an
    // earlier standstill count.
    #[test]
    fn an_encoder_that_sticks_is_noticed() {
        let limits = Limits::default();
        let run = |torque: &dyn Fn(u64) -> f64, stands: &dyn Fn(u64) -> bool| {
            let mut watch = Plausibility::default();
            let mut q4 = 0.0;
            (1..1000).find_map(|tick| {
                let mut state = at(1e-5 * tick as f64, 1.0);
                q4 = if stands(tick) { q4 } else { state.q[3] };
                state.q[3] = q4;
                let mut sent = [0.0; 7];
                sent[3] = torque(tick);
                let found = watch.check(tick, &state, &sent, &joints(), &limits, 1e-3)?;
                assert_eq!((found.fault, found.joint), (Fault::StaleState, 4));
                Some(tick)
            })
        };
        let most = STUCK_NM.max(STUCK_SHARE * iiwa7().joints[3].limits.torque_nm);
        let ramp = |tick: u64| 0.5 * tick as f64;
        let noticed = run(&ramp, &|tick| tick >= 100).expect("noticed");
        assert_eq!(noticed, 100 + (most / 0.5).floor() as u64 + 1);
        assert_eq!(run(&|tick| 0.9 * most * (tick % 2) as f64, &|tick| tick >= 100), None);
        assert_eq!(run(&ramp, &|tick| tick % 20 > 0), None, "it moves now and then");
    }

    // Fails if an arm whose drive was frozen may reappear farther away than its speed and the frozen
    // time allow, or nearer; the time counts up to 0.5 s. A drive that stood was not frozen.
    #[test]
    fn a_frozen_drive_may_have_moved_for_half_a_second() {
        let limits = Limits {
            frozen_ticks: 0,
            ..Limits::default()
        };
        let joints = [joints()[0]; 7];
        let speed = joints[0].velocity_rad_s;
        let reappears = |ticks: u64, moving: f64, period_s: f64, by: f64| {
            let mut watch = Plausibility::default();
            let mut state = at(0.0, 1.0);
            state.dq = [moving; 7];
            for tick in 1..=1 + ticks {
                assert_eq!(watch.check(tick, &state, &[0.0; 7], &joints, &limits, period_s), None);
            }
            let found = watch.check(2 + ticks, &at(by, 1.1), &[0.0; 7], &joints, &limits, period_s);
            found.map(|found| found.limit)
        };
        for (ticks, moving, period_s, counted) in [
            (0, 0.1, 1e-3, 0.001),
            (1, 0.1, 1e-3, 0.002),
            (100, 0.1, 1e-3, 0.101),
            (100, 0.0, 1e-3, 0.001),
            (499, 0.1, 1e-3, 0.500),
            (900, 0.1, 1e-3, 0.501),
            (900, 0.1, 2e-3, 0.502),
        ] {
            let most = speed * 1.5 * counted + limits.jump_rad;
            assert_eq!(reappears(ticks, moving, period_s, most - 1e-9), None, "{ticks} ticks");
            let limit = reappears(ticks, moving, period_s, most + 1e-9).expect("a jump");
            assert!((limit - most).abs() < 1e-12, "{ticks} ticks: {limit} is not {most}");
        }
    }
}
