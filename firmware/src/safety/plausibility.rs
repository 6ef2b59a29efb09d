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
    /// The good state before `last`, where none has been forgotten: `last` may be false and have passed as motion. It can
    /// where the arm was not seen before it, by a false speed, and at the very limit of what is motion.
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
            // The one state in between was false: the arm stands where it stood before.
            self.last = Some(*state);
            self.before = None;
            self.unseen = 0;
            self.same = 0;
            return None;
        }
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
        self.before = self.last.replace(*state);
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
#[path = "plausibility_tests.rs"]
mod tests;
