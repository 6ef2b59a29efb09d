//! Telemetry samples of the control loop.

use spherecal_shared::protocol::host::{Phase, Sample};

use super::Controller;
use crate::law::{Shaped, Snapshot};
use crate::safety::JointState;

impl<const N: usize> Controller<N> {
    /// Queues a telemetry sample if one is due.
    pub(super) fn publish(&mut self, state: &JointState<N>, snapshot: &Snapshot<N>, tau: &[f64; N], shaped: Shaped) {
        let near_contact = matches!(
            self.activity.phase(),
            Phase::Taring | Phase::Approaching | Phase::Coupling | Phase::Verifying | Phase::Decoupling
        );
        let telemetry = &self.procedure.telemetry;
        let every = if near_contact {
            telemetry.contact_ticks
        } else {
            telemetry.other_ticks
        };
        self.since_sample = self.since_sample.saturating_add(1);
        if every == 0 || self.since_sample < every {
            return;
        }
        self.since_sample = 0;
        let force = self.contact_force();
        let torque = self.wrench.torque;
        let mut sample = Sample {
            tick: self.tick,
            phase: self.activity.phase(),
            force_n: [force.x as f32, force.y as f32, force.z as f32],
            torque_nm: [torque.x as f32, torque.y as f32, torque.z as f32],
            flags: u8::from(shaped.saturated > 0)
                | u8::from(shaped.rate_limited) << 1
                | u8::from(snapshot.near_singular) << 2,
            ..Sample::default()
        };
        let setpoint = if self.activity.is_cartesian() {
            self.cartesian.setpoint.position
        } else {
            snapshot.tcp.position
        };
        for k in 0..3 {
            sample.tcp_m[k] = snapshot.tcp.position[k] as f32;
            sample.setpoint_m[k] = setpoint[k] as f32;
        }
        for (i, slot) in sample.q.iter_mut().enumerate().take(N) {
            *slot = state.q[i] as f32;
        }
        for (i, slot) in sample.dq.iter_mut().enumerate().take(N) {
            *slot = state.dq[i] as f32;
        }
        for (i, slot) in sample.tau.iter_mut().enumerate().take(N) {
            *slot = state.tau[i] as f32;
        }
        for (i, slot) in sample.command.iter_mut().enumerate().take(N) {
            *slot = tau[i] as f32;
        }
        if self.samples.is_full() {
            self.samples.pop_front();
            self.overflow = self.overflow.saturating_add(1);
        }
        let _ = self.samples.push_back(sample);
    }
}
