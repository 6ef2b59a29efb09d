//! The operating envelope: limits on the position and speed of the TCP, and on the
//! difference between commanded and measured torque.
//!
//! These are hard limits: each is a fault after a short dwell time. Speed scaling
//! slows motions down before they reach them.

use nalgebra::{Vector3, Vector6};
use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::JointLimits;

use super::violation::Violation;

/// Time for which a speed or position may violate its limit, in s; noise is shorter.
const DWELL_S: f64 = 0.005;
/// Largest outward speed outside the workspace, in m/s. There the arm may stand
/// still and move back in.
const OUTWARD_M_S: f64 = 0.005;
/// Time for which a measured torque may differ from the commanded one, in s. The
/// snap of the magnet and the acceleration of rotors are shorter.
const TORQUE_DWELL_S: f64 = 0.020;
/// Torque difference that is accepted on any joint, in N m: Coulomb and viscous
/// friction of a wrist (2 and 2 N m) and its rotor (0.3 kg m² at 20 rad/s²), which
/// a sensor behind the gear does not measure.
const TORQUE_ERROR_NM: f64 = 10.0;

/// Number of ticks for which each limit has been violated.
#[derive(Clone, Debug)]
pub(crate) struct Envelope<const N: usize> {
    fast: u32,
    outside: u32,
    /// Negative if the measured torque is below the commanded one.
    torque_error_ticks: [i32; N],
}

impl<const N: usize> Default for Envelope<N> {
    fn default() -> Self {
        Self {
            fast: 0,
            outside: 0,
            torque_error_ticks: [0; N],
        }
    }
}

/// Distance (m) of a point from the nearest bound of the workspace or the plate,
/// positive inside, and the outward normal of that bound.
#[inline]
pub(crate) fn workspace_clearance(tcp: &Vector3<f64>, limits: &Limits) -> (f64, Vector3<f64>) {
    let plate = Vector3::from(limits.plate_normal);
    let mut least = plate.dot(tcp) - limits.plate_offset_m;
    let mut outward = -plate;
    for axis in 0..3 {
        let below = tcp[axis] - limits.workspace_min_m[axis];
        let above = limits.workspace_max_m[axis] - tcp[axis];
        if below < least {
            least = below;
            outward = Vector3::zeros();
            outward[axis] = -1.0;
        }
        if above < least {
            least = above;
            outward = Vector3::zeros();
            outward[axis] = 1.0;
        }
    }
    (least, outward)
}

impl<const N: usize> Envelope<N> {
    /// Checks the TCP (m) and its velocity (m/s, linear part first), F0.
    #[inline]
    pub(crate) fn tcp(
        &mut self,
        tcp: &Vector3<f64>,
        velocity: &Vector6<f64>,
        limits: &Limits,
        period_s: f64,
    ) -> Option<Violation> {
        let v = Vector3::new(velocity[0], velocity[1], velocity[2]);
        let speed = v.norm();
        let fast = speed > limits.speed_m_s;
        self.fast = if fast { self.fast.saturating_add(1) } else { 0 };
        if f64::from(self.fast) * period_s > DWELL_S {
            return Some(Violation::new(Fault::TcpSpeed, speed, limits.speed_m_s));
        }
        let (clearance, outward) = workspace_clearance(tcp, limits);
        let leaves = clearance < 0.0 && v.dot(&outward) > OUTWARD_M_S;
        self.outside = if leaves { self.outside.saturating_add(1) } else { 0 };
        (f64::from(self.outside) * period_s > DWELL_S).then(|| Violation::new(Fault::Workspace, -clearance, 0.0))
    }

    /// Checks the torque that was delivered (N m) against the one that was sent.
    #[inline]
    pub(crate) fn torque(
        &mut self,
        sent: &[f64],
        delivered: &[f64; N],
        joints: &[JointLimits; N],
        limits: &Limits,
        period_s: f64,
    ) -> Option<Violation> {
        for (i, (sent, is)) in sent.iter().zip(delivered).enumerate() {
            let limit = (joints[i].torque_nm * limits.torque_error_share).max(TORQUE_ERROR_NM);
            let error = is - sent;
            // Counts one sign only: rotors that chatter on a contact alternate.
            self.torque_error_ticks[i] = if error > limit {
                self.torque_error_ticks[i].max(0).saturating_add(1)
            } else if error < -limit {
                self.torque_error_ticks[i].min(0).saturating_sub(1)
            } else {
                0
            };
            if f64::from(self.torque_error_ticks[i]).abs() * period_s > TORQUE_DWELL_S {
                return Some(Violation {
                    fault: Fault::TorqueSensor,
                    joint: i as u8 + 1,
                    value: error.abs(),
                    limit,
                });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits {
            workspace_min_m: [-1.0, -1.0, -0.5],
            workspace_max_m: [1.0, 1.0, 2.0],
            plate_normal: [0.0, 0.0, 1.0],
            plate_offset_m: 0.1,
            ..Limits::default()
        }
    }

    // Fails if the nearest bound is wrong, or its distance or side.
    #[test]
    fn the_room_is_the_distance_to_the_nearest_bound() {
        let (least, outward) = workspace_clearance(&Vector3::new(0.0, 0.0, 0.3), &limits());
        assert!((least - 0.2).abs() < 1e-12);
        assert_eq!(outward, -Vector3::z(), "the plate");
        let (least, outward) = workspace_clearance(&Vector3::new(0.95, 0.0, 0.5), &limits());
        assert!((least - 0.05).abs() < 1e-12);
        assert_eq!(outward, Vector3::x());
        assert!(workspace_clearance(&Vector3::new(0.0, -1.1, 0.5), &limits()).0 < 0.0);
    }

    // Fails if the arm may move out of the workspace, or may not move back in.
    #[test]
    fn outside_one_may_only_come_back() {
        let outside = Vector3::new(0.0, 0.0, 0.09);
        let moving = |v: f64| Vector6::new(0.0, 0.0, v, 0.0, 0.0, 0.0);
        let run = |v: f64| {
            let mut envelope = Envelope::<7>::default();
            (0..100).find_map(|_| envelope.tcp(&outside, &moving(v), &limits(), 1e-3))
        };
        assert_eq!(run(-0.02).map(|v| v.fault), Some(Fault::Workspace));
        assert_eq!(run(0.02), None);
        assert_eq!(run(0.001), None);
        assert_eq!(run(2.0).map(|v| v.fault), Some(Fault::TcpSpeed));
    }

    // Fails if a dead sensor is not found after its dwell time, or if friction or
    // a chattering contact is taken for one.
    #[test]
    fn a_torque_that_does_not_arrive_is_noticed() {
        let joints = core::array::from_fn(|i| spherecal_shared::robot::iiwa7().joints[i].limits);
        let mut envelope = Envelope::<7>::default();
        let sent = [0.0, 60.0, 0.0, 20.0, 0.0, 0.0, 0.0];
        let mut delivered = sent;
        delivered[3] = 12.0;
        let mut look = |delivered: &[f64; 7]| envelope.torque(&sent, delivered, &joints, &Limits::default(), 1e-3);
        assert!((0..1000).all(|_| look(&delivered).is_none()), "8 N m of friction");
        delivered[1] = 0.0;
        let noticed = (1..100).find_map(|k| look(&delivered).map(|v| (k, v.fault, v.joint)));
        assert_eq!(noticed, Some((21, Fault::TorqueSensor, 2)));
        let mut envelope = Envelope::<7>::default();
        let chatters = (0..1000).any(|k| {
            let mut delivered = sent;
            delivered[5] += if k % 8 < 4 { 28.0 } else { -28.0 };
            envelope
                .torque(&sent, &delivered, &joints, &Limits::default(), 1e-3)
                .is_some()
        });
        assert!(!chatters, "rotors on a contact");
    }
}
