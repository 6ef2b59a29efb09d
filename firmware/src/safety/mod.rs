//! Safety: what must hold at every tick, whatever the phase.
//!
//! Stands at both doors of the control path. Before the law: is the drive
//! state whole, fresh and within limits ([`SafetyMonitor::admit`])? After it: does the
//! arm follow, is the force bounded, is the torque not saturated for long
//! ([`SafetyMonitor::watch`])? A violation is a [`Violation`], which becomes a fault.

mod envelope;
mod plausibility;
mod violation;

use nalgebra::Vector3;
use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::drive::{DriveState, DriveStatus};
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::{JointLimits, Robot};

use crate::law::Shaped;
use envelope::Envelope;
pub(crate) use envelope::workspace_clearance;
use plausibility::Plausibility;
pub(crate) use violation::{JointState, Violation};

/// How long the contact force may exceed its limit, in s: impacts are shorter.
const FORCE_DWELL_S: f64 = 0.010;
/// By how much the clocks of controller and drive may drift apart in a period,
/// in µs: 0.1 % at 1 kHz, more than any quartz does.
const DRIFT_US: i64 = 1;
/// Speed out of its range above which a joint in the margin counts as leaving, in rad/s.
const OUTWARD_RAD_S: f64 = 0.02;
/// How long a torque may stay saturated, in s.
const SATURATION_DWELL_S: f64 = 0.050;

/// What [`SafetyMonitor::admit`] says of a drive state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Admission<const N: usize> {
    /// Whole and fresh.
    Fresh(JointState<N>),
    /// Not usable, or repeated; the last torque is kept for now.
    Bridged,
    /// Too many in a row.
    Refused(Violation),
}

/// The guard of an arm with `N` joints.
#[derive(Clone, Debug)]
pub(crate) struct SafetyMonitor<const N: usize> {
    limits: [JointLimits; N],
    last_tick: Option<u64>,
    /// Least difference between the controller's time and the drive's, in µs.
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

fn joints<const N: usize>(values: &[f64]) -> Option<[f64; N]> {
    let values: [f64; N] = values.try_into().ok()?;
    values.iter().all(|x| x.is_finite()).then_some(values)
}

impl<const N: usize> SafetyMonitor<N> {
    /// Takes the limits of a checked robot.
    pub(crate) fn configure(&mut self, robot: &Robot) {
        for (slot, joint) in self.limits.iter_mut().zip(&robot.joints) {
            *slot = joint.limits;
        }
        self.plausibility.reset();
        self.envelope = Envelope::default();
    }

    /// Limits of the joints.
    pub(crate) fn limits(&self) -> &[JointLimits; N] {
        &self.limits
    }

    /// The limits, and the envelope that is watched with them.
    pub(crate) fn parts(&mut self) -> (&[JointLimits; N], &mut Envelope<N>) {
        (&self.limits, &mut self.envelope)
    }

    /// Drive states that were missed or unusable so far.
    pub(crate) fn missed(&self) -> u32 {
        self.missed
    }

    /// Whether all joint angles lie within the limits less the margin.
    pub(crate) fn reachable(&self, q: &[f64; N], margin: f64) -> bool {
        self.limits
            .iter()
            .zip(q)
            .all(|(l, q)| *q >= l.min_rad + margin && *q <= l.max_rad - margin)
    }

    /// Counts `ticks` control periods that were missed by whoever runs the
    /// controller, 0 for a tick that came in time; a violation once there are
    /// too many without such a tick between them.
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

    /// Looks at a drive state before anything is computed from it; `sent` are
    /// the torques of the last command, in N m, none while the brakes are closed,
    /// and `now_us` is the controller's own time, by which late states are told.
    #[inline]
    pub(crate) fn admit(
        &mut self,
        now_us: u64,
        state: &DriveState,
        sent: &[f64],
        limits: &Limits,
        period_s: f64,
    ) -> Admission<N> {
        let whole = match (joints(&state.q), joints(&state.dq), joints(&state.tau)) {
            (Some(q), Some(dq), Some(tau)) => Some(JointState { q, dq, tau }),
            _ => None,
        };
        let skipped = match self.last_tick {
            None => 0,
            Some(last) if state.tick > last => u32::try_from(state.tick - last - 1).unwrap_or(u32::MAX),
            // The same tick again, or an older one: stale.
            Some(_) => return self.bridge(1, Fault::StaleState, limits),
        };
        self.last_tick = Some(state.tick);
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

    /// Whether a state is older than states used to be when they came: a law
    /// that answers the arm of a while ago makes it swing.
    fn late(&mut self, now_us: u64, tick: u64, limits: &Limits, period_s: f64) -> bool {
        let period_us = (period_s * 1e6 + 0.5) as i64;
        let offset = (now_us as i64).wrapping_sub((tick as i64).wrapping_mul(period_us));
        let least = match self.offset_us {
            // The clocks may drift apart.
            Some(least) => least.saturating_add(DRIFT_US).min(offset),
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

    /// So many states that cannot be used; a violation once there are too many in a row.
    fn bridged(&mut self, ticks: u32, violation: Violation, limits: &Limits) -> Admission<N> {
        self.missed = self.missed.saturating_add(ticks);
        self.missed_in_row = self.missed_in_row.saturating_add(ticks);
        if self.missed_in_row > limits.missed_ticks {
            return Admission::Refused(violation);
        }
        Admission::Bridged
    }

    /// Looks at a fresh joint state: positions and velocities within limits. An
    /// arm that `leaves` a sphere may use half the margin: it may have to leave
    /// since it stands at the margin's end, and must not be held there by it.
    #[inline]
    pub(crate) fn joint_state(&self, state: &JointState<N>, limits: &Limits, leaves: bool) -> Option<Violation> {
        let margin = limits.position_margin_rad * if leaves { 0.5 } else { 1.0 };
        for (i, limit) in self.limits.iter().enumerate() {
            let joint = i as u8 + 1;
            let q = state.q[i];
            let (min, max) = (limit.min_rad + margin, limit.max_rad - margin);
            // Between margin and limit an arm may stand, and go back.
            let out = q < limit.min_rad || q > limit.max_rad;
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

    /// Looks at what came of the tick: contact force and torque saturation.
    #[inline]
    pub(crate) fn watch(
        &mut self,
        force: &Vector3<f64>,
        shaped: &Shaped,
        limits: &Limits,
        period_s: f64,
    ) -> Option<Violation> {
        let magnitude = force.norm();
        self.force_ticks = if magnitude > limits.force_n {
            self.force_ticks.saturating_add(1)
        } else {
            0
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
