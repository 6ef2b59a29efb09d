//! Changes of phase, and faults.

use nalgebra::{SVector, Vector6};
use spherecal_shared::protocol::host::{Fault, FaultReport, PhaseChange};

use super::Controller;
use crate::Report;
use crate::law::{Giving, JointSetpoint};
use crate::phases::Activity;
use crate::safety::Violation;

impl<const N: usize> Controller<N> {
    pub(super) fn queue_event(&mut self, event: Report) {
        if self.outbox.push_back(event).is_err() {
            self.overflow = self.overflow.saturating_add(1);
        }
    }

    /// Enters a phase and reports it to the host.
    pub(super) fn enter(&mut self, activity: Activity<N>) {
        let from = self.activity.phase();
        let leaves_cartesian = self.activity.is_cartesian() && !activity.is_cartesian();
        self.activity = activity;
        self.phase_ticks = 0;
        if leaves_cartesian {
            self.latch();
            self.hand_over();
        }
        let phase = self.activity.phase();
        self.queue_event(Report::Phase(PhaseChange {
            phase,
            from,
            time_us: self.now_us,
            tick: self.tick,
        }));
    }

    /// Passes what is known to be no contact from the Cartesian spring to the joint spring.
    fn hand_over(&mut self) {
        let known = *self.observer.known();
        let tare = &self.cartesian.tare.force;
        let force = Vector6::new(tare.x, tare.y, tare.z, 0.0, 0.0, 0.0);
        let by_tare = self.snapshot.as_ref().map(|snapshot| snapshot.joint_torque(&force));
        let torque = -known - by_tare.unwrap_or_else(SVector::zeros);
        self.disturbance.set(&torque, self.safety.limits());
        let pole = self.procedure.law.observer_rad_s;
        self.observer.explain(&-known, self.safety.limits(), pole);
    }

    /// Sets the joint setpoint to the present joint angles.
    pub(super) fn latch(&mut self) {
        self.hold = JointSetpoint {
            q: self.latest_q,
            dq: [0.0; N],
        };
    }

    /// Enters the fault phase once. A later violation changes nothing, but it may
    /// still close the brakes.
    pub(super) fn fail(&mut self, violation: Violation) {
        // Control cannot hold an arm whose motors do not deliver the torque, whose
        // position is unknown, or that control itself sets in motion.
        self.keep_brakes |= matches!(
            violation.fault,
            Fault::TorqueSensor | Fault::Unstable | Fault::KineticEnergy
        ) || violation.is_stuck_encoder();
        if matches!(self.activity, Activity::Fault) {
            return;
        }
        let report = FaultReport {
            fault: violation.fault,
            phase: self.activity.phase(),
            time_us: self.now_us,
            tick: self.tick,
            joint: violation.joint,
            value: violation.value,
            limit: violation.limit,
        };
        if let (Fault::Pressing, Some(snapshot)) = (violation.fault, &self.snapshot) {
            let model_n = if self.activity.is_cartesian() {
                self.cartesian.tare.force.norm()
            } else {
                self.pressing.rest_n()
            };
            self.giving = Some(Giving::new(snapshot.tcp.position, model_n));
        }
        match self.activity {
            Activity::Moving(_) => self.disturbance.forget_motion(),
            // A nest that has left its sphere has met nothing: what the turn has learned is of cables, and a hold without it
            // throws a light wrist.
            Activity::Turning(_) if violation.fault != Fault::ContactLost => {
                let pole = self.procedure.law.observer_rad_s;
                self.observer.forget_turn(self.safety.limits(), pole);
            }
            _ => {}
        }
        self.latch();
        self.queue_event(Report::Fault(report));
        self.enter(Activity::Fault);
    }

    /// Faults if nothing has come from the host for too long while the arm needs it.
    pub(super) fn watch_host(&mut self) {
        self.silent_ticks = self.silent_ticks.saturating_add(1);
        let limit = self.procedure.limits.host_silence_s;
        let silent_s = f64::from(self.silent_ticks) * self.period_s;
        let waiting = !matches!(self.activity, Activity::Idle | Activity::Fault);
        if waiting && silent_s > limit {
            self.fail(Violation::new(Fault::HostSilence, silent_s, limit));
        }
    }
}
