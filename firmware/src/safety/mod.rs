//! Safety: checks that hold in every tick, in every phase.
//!
//! The monitor stands at both ends of the control path. Before the law it checks
//! that the drive state is complete, new and within limits
//! ([`SafetyMonitor::admit`]). After the law it checks contact force and torque
//! saturation ([`SafetyMonitor::watch`]). A [`Violation`] becomes a fault.

mod answer;
mod envelope;
mod instability;
mod plausibility;
mod pressing;
#[cfg(test)]
mod tests;
mod violation;

use nalgebra::Vector3;
use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::drive::{DriveState, DriveStatus};
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::{DrivenRobot, JointLimits};

use crate::law::Shaped;
pub(crate) use answer::AnswerWatch;
use envelope::Envelope;
pub(crate) use envelope::workspace_clearance;
pub(crate) use instability::{Instability, energy_share};
use plausibility::{Plausibility, plausible};
pub(crate) use pressing::{Pressing, Touch};
pub(crate) use violation::{JointState, Violation};

/// Time for which the contact force may exceed its limit, in s; impacts are shorter.
const FORCE_DWELL_S: f64 = 0.010;
/// Smallest share of the time by which the clocks of controller and drive may drift
/// apart, 1/1000: more than that of any quartz.
const DRIFT: i64 = 1000;
/// Outward speed above which a joint in the margin counts as leaving its range, in rad/s.
const OUTWARD_RAD_S: f64 = 0.02;
/// How far beyond its range a joint may have been pushed and still come back, in rad. The end stops of arms are
/// nearer; farther off the angle is wrong.
const BEYOND_RAD: f64 = 0.1;
/// Time for which a torque may be saturated, in s.
const SATURATION_DWELL_S: f64 = 0.050;

/// Result of [`SafetyMonitor::admit`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Admission<const N: usize> {
    /// The state is complete and new.
    Fresh(JointState<N>),
    /// The state is unusable or repeated; the last torque is sent again.
    Bridged,
    /// Too many such states in a row, or a state that shows a fault.
    Refused(Violation),
}

/// What the present phase may do where a joint is at the end of its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ends {
    /// It works on a sphere: no joint may be out of its range.
    Keep,
    /// It stands or moves in free space: a joint that was pushed out of its range may come back.
    Return,
    /// The same with half of the margin: an arm that stands at a sphere, at the edge of the margin, must be
    /// able to leave.
    Leave,
}

/// The safety monitor of an arm with `N` joints.
#[derive(Clone, Debug)]
pub(crate) struct SafetyMonitor<const N: usize> {
    limits: [JointLimits; N],
    last_tick: Option<u64>,
    /// Smallest difference between the controller's time and the drive's, in µs.
    offset_us: Option<i64>,
    missed_in_row: u32,
    overrun_in_row: u32,
    missed: u32,
    force_ticks: u32,
    saturated_ticks: u32,
    plausibility: Plausibility<N>,
    envelope: Envelope<N>,
}

impl<const N: usize> Default for SafetyMonitor<N> {
    fn default() -> Self {
        let none = JointLimits {
            min_rad: f64::NEG_INFINITY,
            max_rad: f64::INFINITY,
            velocity_rad_s: f64::INFINITY,
            torque_nm: 0.0,
        };
        Self {
            limits: [none; N],
            last_tick: None,
            offset_us: None,
            missed_in_row: 0,
            overrun_in_row: 0,
            missed: 0,
            force_ticks: 0,
            saturated_ticks: 0,
            plausibility: Plausibility::default(),
            envelope: Envelope::default(),
        }
    }
}

impl<const N: usize> SafetyMonitor<N> {
    /// Takes the limits of a checked robot and, where they are tighter, those of the
    /// `drive`.
    ///
    /// # Errors
    /// A joint would have no range. Nothing is changed then.
    pub(crate) fn configure(&mut self, robot: &DrivenRobot, drive: Option<&[JointLimits; N]>) -> Result<(), ()> {
        let mut limits = self.limits;
        for (slot, joint) in limits.iter_mut().zip(&robot.joints) {
            *slot = joint.limits;
        }
        for (slot, drive) in limits.iter_mut().zip(drive.into_iter().flatten()) {
            slot.min_rad = slot.min_rad.max(drive.min_rad);
            slot.max_rad = slot.max_rad.min(drive.max_rad);
            slot.velocity_rad_s = slot.velocity_rad_s.min(drive.velocity_rad_s);
            slot.torque_nm = slot.torque_nm.min(drive.torque_nm);
            if !(slot.min_rad < slot.max_rad) {
                return Err(());
            }
        }
        self.limits = limits;
        self.plausibility.reset();
        self.envelope = Envelope::default();
        Ok(())
    }

    /// Forgets the ticks, the clock and the states of the last drive session. Counters
    /// and limits stay.
    pub(crate) fn restart(&mut self) {
        self.last_tick = None;
        self.offset_us = None;
        self.missed_in_row = 0;
        self.overrun_in_row = 0;
        self.force_ticks = 0;
        self.saturated_ticks = 0;
        self.plausibility.reset();
        self.envelope = Envelope::default();
    }

    /// The limits of the joints.
    pub(crate) fn limits(&self) -> &[JointLimits; N] {
        &self.limits
    }

    /// The limits of the joints and the envelope, borrowed together.
    pub(crate) fn parts(&mut self) -> (&[JointLimits; N], &mut Envelope<N>) {
        (&self.limits, &mut self.envelope)
    }

    /// Number of missed periods and unusable drive states so far.
    pub(crate) fn missed(&self) -> u32 {
        self.missed
    }

    /// Whether all joint angles are inside their limits by `margin` (rad).
    pub(crate) fn reachable(&self, q: &[f64; N], margin: f64) -> bool {
        self.limits
            .iter()
            .zip(q)
            .all(|(l, q)| *q >= l.min_rad + margin && *q <= l.max_rad - margin)
    }

    /// Counts `ticks` missed control periods, 0 for a tick in time. Returns a
    /// violation once there are too many without a tick in time between them.
    pub(crate) fn overrun(&mut self, ticks: u32, limits: &Limits) -> Option<Violation> {
        if ticks == 0 {
            self.overrun_in_row = 0;
            return None;
        }
        self.missed = self.missed.saturating_add(ticks);
        self.overrun_in_row = self.overrun_in_row.saturating_add(ticks);
        let (row, allowed) = (self.overrun_in_row, limits.missed_ticks);
        (row > allowed).then(|| Violation::new(Fault::Overrun, f64::from(row), f64::from(allowed)))
    }

    /// Checks a drive state before anything is computed from it. `sent` are the
    /// torques of the last command in N m (empty while the brakes are closed).
    /// `now_us` is the controller's time; it serves to detect late states.
    #[inline]
    pub(crate) fn admit(
        &mut self,
        now_us: u64,
        state: &DriveState,
        sent: &[f64],
        limits: &Limits,
        period_s: f64,
    ) -> Admission<N> {
        let whole = plausible(state);
        let skipped = match self.last_tick {
            None => 0,
            Some(last) if state.tick > last => u32::try_from(state.tick - last - 1).unwrap_or(u32::MAX),
            // A repeated or an older tick.
            Some(_) => return self.bridge(1, Fault::StaleState, limits),
        };
        if skipped < u32::MAX {
            // No drive runs for so long unseen: such a tick number is not kept, or all
            // later ones would count as old.
            self.last_tick = Some(state.tick);
        }
        if skipped > 0 {
            self.missed = self.missed.saturating_add(skipped);
            if skipped > limits.missed_ticks {
                let allowed = f64::from(limits.missed_ticks);
                return Admission::Refused(Violation::new(Fault::StaleState, f64::from(skipped), allowed));
            }
        }
        let Some(admitted) = whole else {
            return self.bridge(1, Fault::NotFinite, limits);
        };
        if self.late(now_us, state.tick, limits, period_s) {
            return self.bridge(1, Fault::StaleState, limits);
        }
        if let Some(violation) = self
            .plausibility
            .check(state.tick, &admitted, sent, &self.limits, limits, period_s)
        {
            if violation.fault == Fault::PositionJump {
                return self.bridged(1, violation, limits);
            }
            self.missed = self.missed.saturating_add(1);
            return Admission::Refused(violation);
        }
        self.missed_in_row = 0;
        if state.status != DriveStatus::Ready {
            return Admission::Refused(Violation::new(Fault::Drive, f64::from(state.status as u8), 0.0));
        }
        Admission::Fresh(admitted)
    }

    /// Whether a state is older than the freshest states were. Control on old
    /// states makes the arm oscillate.
    fn late(&mut self, now_us: u64, tick: u64, limits: &Limits, period_s: f64) -> bool {
        let period_us = (period_s * 1e6 + 0.5) as i64;
        let offset = (now_us as i64).wrapping_sub((tick as i64).wrapping_mul(period_us));
        let least = match self.offset_us {
            // The clocks may drift apart.
            Some(least) => least.saturating_add(period_us / DRIFT).min(offset),
            None => offset,
        };
        self.offset_us = Some(least);
        let allowed = i64::from(limits.missed_ticks) * period_us + period_us / 2;
        offset.saturating_sub(least) > allowed
    }

    fn bridge(&mut self, ticks: u32, fault: Fault, limits: &Limits) -> Admission<N> {
        let row = self.missed_in_row.saturating_add(ticks);
        let violation = Violation::new(fault, f64::from(row), f64::from(limits.missed_ticks));
        self.bridged(ticks, violation, limits)
    }

    /// Counts `ticks` unusable states; refuses once there are too many in a row.
    fn bridged(&mut self, ticks: u32, violation: Violation, limits: &Limits) -> Admission<N> {
        self.missed = self.missed.saturating_add(ticks);
        self.missed_in_row = self.missed_in_row.saturating_add(ticks);
        if self.missed_in_row > limits.missed_ticks {
            return Admission::Refused(violation);
        }
        Admission::Bridged
    }

    /// Checks positions and velocities of a new joint state.
    #[inline]
    pub(crate) fn joint_state(&self, state: &JointState<N>, limits: &Limits, ends: Ends) -> Option<Violation> {
        let margin = limits.position_margin_rad * if ends == Ends::Leave { 0.5 } else { 1.0 };
        let beyond = if ends == Ends::Keep { 0.0 } else { BEYOND_RAD };
        for (i, limit) in self.limits.iter().enumerate() {
            let joint = i as u8 + 1;
            let q = state.q[i];
            let (min, max) = (limit.min_rad + margin, limit.max_rad - margin);
            // Between margin and limit the arm may stand still and move back.
            let out = q < limit.min_rad - beyond || q > limit.max_rad + beyond;
            let outwards = (q < min && state.dq[i] < -OUTWARD_RAD_S) || (q > max && state.dq[i] > OUTWARD_RAD_S);
            if out || outwards {
                let limit = if q < min { min } else { max };
                return Some(Violation {
                    fault: Fault::JointPosition,
                    joint,
                    value: q,
                    limit,
                });
            }
            let fastest = limit.velocity_rad_s * limits.velocity_share;
            if state.dq[i].abs() > fastest {
                return Some(Violation {
                    fault: Fault::JointVelocity,
                    joint,
                    value: state.dq[i],
                    limit: fastest,
                });
            }
        }
        None
    }

    /// Checks the result of the tick: contact force and torque saturation.
    #[inline]
    pub(crate) fn watch(
        &mut self,
        force: &Vector3<f64>,
        shaped: &Shaped,
        limits: &Limits,
        period_s: f64,
    ) -> Option<Violation> {
        let magnitude = force.norm();
        // A force that is not a number counts as too large.
        self.force_ticks = if magnitude <= limits.force_n {
            0
        } else {
            self.force_ticks.saturating_add(1)
        };
        if f64::from(self.force_ticks) * period_s > FORCE_DWELL_S {
            return Some(Violation::new(Fault::Force, magnitude, limits.force_n));
        }
        self.saturated_ticks = if shaped.saturated > 0 {
            self.saturated_ticks.saturating_add(1)
        } else {
            0
        };
        if f64::from(self.saturated_ticks) * period_s > SATURATION_DWELL_S {
            let limit = self
                .limits
                .get(usize::from(shaped.saturated) - 1)
                .map_or(0.0, |l| l.torque_nm);
            return Some(Violation {
                fault: Fault::JointTorque,
                joint: shaped.saturated,
                value: limit,
                limit,
            });
        }
        None
    }
}
