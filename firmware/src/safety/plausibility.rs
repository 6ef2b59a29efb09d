//! Plausibility: is a drive state one that this arm can be in, after the last?
//!
//! A drive that hangs may go on counting ticks and send what it sent before; an
//! encoder that loses its place reads another angle from one state to the next;
//! one that sticks reads the same however its joint is driven. None of it shows
//! in a single state.

use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::JointLimits;

use super::violation::{JointState, Violation};

/// By how much an arm may run faster than its limit, or than it did, between two states.
const SPEED_FACTOR: f64 = 1.5;
/// Ticks for which a drive that shows the same state again is taken to have
/// shown nothing, at most.
const MOST_UNSEEN: u64 = 500;
/// Joint speed above which a state says that the arm moves, in rad/s.
const MOVES_RAD_S: f64 = 1e-3;
/// Change of the torques sent, in N m and summed, that a drive cannot have
/// taken without any of its numbers changing: one without noise that stands
/// still under the same torque is not frozen.
const TAKEN_NM: f64 = 0.05;
/// The same for one joint whose angle alone stays the same, in N m at least and
/// as a share of its limit: more than from one end of its stiction to the other.
const STICKS_NM: f64 = 10.0;
const STICKS_SHARE: f64 = 0.05;

/// What is kept of the states before.
#[derive(Clone, Debug)]
pub(crate) struct Plausibility<const N: usize> {
    last: Option<JointState<N>>,
    /// Tick of the last state that was looked at, good or not.
    tick: u64,
    /// Ticks since the last good state of which nothing was seen: the arm may
    /// have moved then, and not while it was seen.
    unseen: u64,
    same: u32,
    /// What was being sent when the state was first the same.
    sent: [f64; N],
    /// Ticks for which each angle has been the same, and what was being sent at
    /// the first of them.
    stuck: [(u32, f64); N],
}

impl<const N: usize> Default for Plausibility<N> {
    fn default() -> Self {
        Self {
            last: None,
            tick: 0,
            unseen: 0,
            same: 0,
            sent: [0.0; N],
            stuck: [(0, 0.0); N],
        }
    }
}

impl<const N: usize> Plausibility<N> {
    /// Forgets the states before: for another robot, or a drive that was referenced anew.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Looks at the state of `tick`, and at the torques (N m) that were `sent`
    /// before it (none while the brakes are closed). A state that cannot be is not kept, so
    /// that the next one is held against the last good one.
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
        let mut change = 0.0;
        let mut fastest = 0.0f64;
        let (mut sticks, mut others) = (None, false);
        for i in 0..N {
            let moved = (state.q[i] - last.q[i]).abs();
            // By the speed of before: that of after may be made from the jump.
            let speed = joints[i].velocity_rad_s.max(last.dq[i].abs());
            let most = speed * SPEED_FACTOR * elapsed_s + limits.jump_rad;
            if moved > most {
                return Some(Violation {
                    fault: Fault::PositionJump,
                    joint: i as u8 + 1,
                    value: moved,
                    limit: most,
                });
            }
            others |= moved > 0.0;
            sticks = sticks.or(sticking(&mut self.stuck[i], i, moved, sent, &joints[i], limits));
            change += moved + (state.dq[i] - last.dq[i]).abs() + (state.tau[i] - last.tau[i]).abs();
            fastest = fastest.max(state.dq[i].abs());
        }
        self.last = Some(*state);
        if change > 0.0 {
            self.same = 0;
            self.unseen = 0;
            // An arm that is blocked stands with all its joints.
            return sticks.filter(|_| others);
        }
        if self.same == 0 {
            for (kept, sent) in self.sent.iter_mut().zip(sent) {
                *kept = *sent;
            }
        }
        self.same = self.same.saturating_add(1);
        let allowed = limits.frozen_ticks;
        let mut taken = 0.0;
        for (kept, sent) in self.sent.iter().zip(sent) {
            taken += (sent - kept).abs();
        }
        let alive = taken > TAKEN_NM || fastest > MOVES_RAD_S;
        // A drive that shows the same again may have frozen while the arm moved.
        self.unseen = if alive {
            u64::from(self.same).min(MOST_UNSEEN)
        } else {
            0
        };
        (allowed > 0 && self.same > allowed && alive)
            .then(|| Violation::new(Fault::StaleState, f64::from(self.same), f64::from(allowed)))
    }
}

/// Whether joint `i` stays where it was though the torque that is sent to it
/// changes: its encoder does not follow. `stuck`: ticks for which the angle has
/// been the same, and what was being sent at the first of them, in N m.
#[inline]
fn sticking(
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
    let most = STICKS_NM.max(STICKS_SHARE * joint.torque_nm);
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

    // Fails if a jump is taken for motion or motion for a jump, or if the last
    // good state is forgotten because of one that cannot be.
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
        // But it cannot be while it is seen.
        assert!((105..1000).all(|tick| look(tick, 0.2, 1.0).is_some()));
    }

    // Fails if a frozen drive is not noticed in its time, or if a simulator
    // without noise that stands under the same torque is taken for one.
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

    // Fails if an encoder that sticks while its joint is driven is not noticed,
    // if one whose joint stands under friction's torque is taken for it, or if
    // the ticks of an earlier stand count.
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
        let most = STICKS_NM.max(STICKS_SHARE * iiwa7().joints[3].limits.torque_nm);
        let ramp = |tick: u64| 0.5 * tick as f64;
        let noticed = run(&ramp, &|tick| tick >= 100).expect("noticed");
        assert_eq!(noticed, 100 + (most / 0.5).floor() as u64 + 1);
        assert_eq!(run(&|tick| 0.9 * most * (tick % 2) as f64, &|tick| tick >= 100), None);
        assert_eq!(run(&ramp, &|tick| tick % 20 > 0), None, "it moves now and then");
    }
}
