//! The disturbance estimate: a torque of each joint that no model of the arm explains.
//!
//! A cable, a wrong mass, a bias of a torque sensor or friction that the torque loop leaves holds a joint off its
//! setpoint by torque over stiffness. The estimate is the integral of the torque that the joint's spring has by its
//! error, and the law adds it. So free motions and holds reach their targets. It is bounded, because what is larger is
//! no disturbance, and slow, because it must not press on what the arm meets before the guard sees that.
//!
//! After closed brakes, and after a sphere, it starts from the torque that the sensors show beyond gravity: a light
//! wrist would be thrown by its cable.
//!
//! Until a motion or a release has shown that the nest is free, the estimate of a hold stays as it is: the magnet of a
//! sphere may draw the nest in, and a hold that takes this for a disturbance pulls against the magnet, more and more.

use super::joint::JointSpring;
use nalgebra::SVector;
use spherecal_shared::robot::JointLimits;
use spherecal_shared::scalar::bounded;

/// Rate at which the estimate takes over the torque of the spring, in 1/s: a tenth of what the damping of the joint
/// spring bears (40 1/s at 20 rad/s).
const RATE_PER_S: f64 = 4.0;
/// Joint error that needs no correction, in rad, while the setpoint stands and while it moves. Dry friction would else
/// make a joint hunt, and a motion would leave a part of its own lag in the estimate.
const NEAR_RAD: [f64; 2] = [1e-3, 1e-2];
/// Largest estimate, as a share of the joint's torque limit, and within which bounds, in N m: 1.5 N m of cable at a
/// wrist, and 8 N m of bias at a shoulder, of which a torque loop of gain 6 leaves 6.9.
const MOST_SHARE: f64 = 1.0 / 12.0;
const MOST_NM: [f64; 2] = [2.0, 10.0];

/// Largest estimate at a joint with these limits, in N m.
pub(crate) fn most(limits: &JointLimits) -> f64 {
    (limits.torque_nm * MOST_SHARE).max(MOST_NM[0]).min(MOST_NM[1])
}

/// Time constant with which a hold forgets what a motion has learned, in s: a light wrist that loses the torque of its
/// cable at once jumps by its deflection.
const FORGET_S: f64 = 0.1;

/// What of a torque (N m) that the sensors show is no error of theirs, in N m.
#[inline]
pub fn beyond_sensors<const N: usize>(torque: &SVector<f64, N>, limits: &[JointLimits; N]) -> SVector<f64, N> {
    SVector::from_fn(|i, _| {
        let error = limits[i].sensor_error_nm();
        torque[i] - torque[i].max(-error).min(error)
    })
}

/// The disturbance estimate of `N` joints.
#[derive(Clone, Copy, Debug)]
pub struct Disturbance<const N: usize> {
    /// The estimate, in N m; none before the first state.
    torque: Option<SVector<f64, N>>,
    /// The same when the arm last stood in free space.
    rest: SVector<f64, N>,
    /// What a motion had added and a hold still forgets, in N m.
    fading: SVector<f64, N>,
    /// A joint whose disturbance is beyond its bound.
    excess: Option<Excess>,
    /// Whether it is known that the nest is on no sphere.
    free: bool,
}

/// A joint whose disturbance is larger than the law may compensate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Joint, from 1.
    pub joint: u8,
    /// Torque that the joint needs beyond the model, in N m.
    pub torque: f64,
    /// The largest that the law gives, in N m.
    pub limit: f64,
}

impl<const N: usize> Default for Disturbance<N> {
    fn default() -> Self {
        Self {
            torque: None,
            rest: SVector::zeros(),
            fading: SVector::zeros(),
            excess: None,
            free: false,
        }
    }
}

impl<const N: usize> Disturbance<N> {
    /// Starts anew from the next state: the brakes open, or arm or tool are others.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Whether it starts anew.
    pub fn starts(&self) -> bool {
        self.torque.is_none()
    }

    /// Starts from the torque (N m) that the sensors of an arm with closed brakes show beyond gravity; from zero if that
    /// is no disturbance: some drives show no torque then. Errors of the sensors are left out.
    pub fn start(&mut self, torque: &SVector<f64, N>, limits: &[JointLimits; N]) {
        let sound = (0..N).all(|i| torque[i].abs() <= most(&limits[i]));
        let torque = if sound {
            beyond_sensors(torque, limits)
        } else {
            SVector::zeros()
        };
        self.set(&torque, limits);
    }

    /// Sets the estimate to a torque (N m), within its bounds.
    pub fn set(&mut self, torque: &SVector<f64, N>, limits: &[JointLimits; N]) {
        self.rest = SVector::from_fn(|i, _| bounded(torque[i], most(&limits[i])).unwrap_or(0.0));
        self.torque = Some(self.rest);
        self.fading = SVector::zeros();
    }

    /// Says that the nest is on no sphere: a motion or a release has ended well.
    pub fn free(&mut self) {
        self.free = true;
    }

    /// Whether it is known that the nest is on no sphere.
    pub fn is_free(&self) -> bool {
        self.free
    }

    /// The torque that the law adds, in N m.
    pub fn torque(&self) -> SVector<f64, N> {
        self.learned() + self.fading
    }

    fn learned(&self) -> SVector<f64, N> {
        self.torque.unwrap_or(self.rest)
    }

    /// Forgets for one tick of `period_s` (s), in whatever phase.
    #[inline]
    pub fn fade(&mut self, period_s: f64) {
        self.fading *= 1.0 - (period_s / FORGET_S).min(1.0);
    }

    /// Takes one tick of `period_s` (s) in free space: the joint spring, the speeds of its setpoint (rad/s), and the
    /// joints' limits. `stands` says that the arm is not in a motion: then it does nothing until the nest is known to be
    /// [free](Self::free).
    #[inline]
    pub fn push(
        &mut self,
        spring: &JointSpring<N>,
        speeds: &[f64; N],
        limits: &[JointLimits; N],
        stands: bool,
        period_s: f64,
    ) {
        self.excess = None;
        if stands && !self.free {
            return;
        }
        let mut torque = self.learned();
        for i in 0..N {
            let near = NEAR_RAD[usize::from(speeds[i] != 0.0)];
            let beyond = spring.error[i] - spring.error[i].max(-near).min(near);
            let moved = torque[i] + RATE_PER_S * period_s * spring.stiffness[i] * beyond;
            let limit = most(&limits[i]);
            torque[i] = bounded(moved, limit).unwrap_or(0.0);
            if moved.abs() > limit && self.excess.is_none() {
                let needed = (torque[i] + spring.stiffness[i] * spring.error[i]).abs();
                self.excess = Some(Excess {
                    joint: i as u8 + 1,
                    torque: needed,
                    limit,
                });
            }
        }
        self.torque = Some(torque);
        if stands {
            self.rest = torque;
        }
    }

    /// The first joint whose disturbance is beyond its bound at the last tick.
    pub fn excess(&self) -> Option<Excess> {
        self.excess
    }

    /// Begins to forget what a motion has added since the arm last stood: it may have met something.
    pub fn forget_motion(&mut self) {
        if let Some(torque) = self.torque {
            self.fading += torque - self.rest;
            self.torque = Some(self.rest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::HOME;
    use crate::{JointSetpoint, Observer, Snapshot, joint_spring};
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    fn limits() -> [JointLimits; 7] {
        core::array::from_fn(|i| iiwa7().joints[i].limits)
    }

    fn snapshot() -> Snapshot<7> {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        Snapshot::new(&arm, &HOME, &[0.0; 7]).expect("a mass matrix")
    }

    /// The estimate after a second at rest, or in a motion with the speed `dq` (rad/s), with joint 7 off by `error` (rad).
    fn after(error: f64, dq: f64) -> Disturbance<7> {
        let mut setpoint = JointSetpoint { q: HOME, dq: [dq; 7] };
        setpoint.q[6] += error;
        let spring = joint_spring(&snapshot(), &setpoint, 20.0, 1.0);
        let mut estimate = Disturbance::default();
        estimate.free();
        for _ in 0..1_000 {
            estimate.push(&spring, &setpoint.dq, &limits(), true, 1e-3);
        }
        estimate
    }

    // Fails if the estimate is not the integral of the spring's torque beyond the error that needs none: 1 mrad at rest,
    // 10 mrad in a motion; or if it moves other joints.
    #[test]
    fn the_estimate_is_an_integral() {
        let stiffness = joint_spring(&snapshot(), &JointSetpoint { q: HOME, dq: [0.0; 7] }, 20.0, 1.0).stiffness[6];
        for (error, dq, beyond) in [(0.006, 0.0, 0.005), (-0.006, 0.0, -0.005), (0.015, 0.1, 0.005)] {
            let torque = after(error, dq).torque();
            assert!((torque[6] - 4.0 * stiffness * beyond).abs() < 1e-9, "{torque}");
            assert_eq!(torque.rows(0, 6).amax(), 0.0);
        }
        assert_eq!(
            (after(0.0009, 0.0).torque()[6], after(0.009, 0.1).torque()[6]),
            (0.0, 0.0)
        );
    }

    // Fails if the estimate exceeds its bound, a twelfth of the torque limit and 2 to 10 N m; or if the joint and the torque
    // that it needs are not told then.
    #[test]
    fn the_estimate_is_bounded() {
        let estimate = after(0.1, 0.0);
        let limit = most(&limits()[6]);
        assert!((limit - 40.0 / 12.0).abs() < 1e-12);
        assert_eq!(estimate.torque()[6], limit);
        let excess = estimate.excess().expect("an excess");
        assert_eq!((excess.joint, excess.limit), (7, limit));
        assert!(excess.torque > limit + 4.0, "{excess:?}");
        assert_eq!(after(0.006, 0.0).excess(), None);
        let wide = limits();
        assert_eq!(
            (
                most(&wide[0]),
                most(&JointLimits {
                    torque_nm: 12.0,
                    ..wide[0]
                })
            ),
            (10.0, 2.0)
        );
    }

    // Fails if what a motion has added outlives a fault by more than some tenths of a second or ends at once, or if what the
    // arm needed at rest does not stay.
    #[test]
    fn a_fault_forgets_what_the_motion_has_added() {
        let mut estimate = after(0.006, 0.0);
        let rest = estimate.torque();
        let mut setpoint = JointSetpoint { q: HOME, dq: [0.0; 7] };
        setpoint.q[5] += 0.05;
        let spring = joint_spring(&snapshot(), &setpoint, 20.0, 1.0);
        for _ in 0..100 {
            estimate.push(&spring, &setpoint.dq, &limits(), false, 1e-3);
        }
        assert!(estimate.torque()[5] > 0.5);
        let moved = estimate.torque();
        estimate.forget_motion();
        assert_eq!(estimate.torque(), moved);
        for _ in 0..100 {
            estimate.fade(1e-3);
        }
        let left = (estimate.torque() - rest)[5] / (moved - rest)[5];
        assert!((left - 0.366).abs() < 1e-3, "{left}");
        for _ in 0..900 {
            estimate.fade(1e-3);
        }
        assert!((estimate.torque() - rest).amax() < 1e-4);
    }

    // Fails if a hold takes the pull of a magnet for a disturbance before the nest is known to be free, or again after the
    // brakes were closed; or if a motion, which the guard watches, is held off its target then.
    #[test]
    fn a_hold_learns_nothing_until_the_nest_is_free() {
        let mut setpoint = JointSetpoint { q: HOME, dq: [0.0; 7] };
        setpoint.q[1] += 0.01;
        let spring = joint_spring(&snapshot(), &setpoint, 20.0, 1.0);
        let hold = |estimate: &mut Disturbance<7>, stands: bool| {
            let before = estimate.torque()[1];
            estimate.push(&spring, &setpoint.dq, &limits(), stands, 1e-3);
            estimate.torque()[1] > before
        };
        let mut estimate = Disturbance::default();
        assert_eq!((hold(&mut estimate, true), hold(&mut estimate, false)), (false, true));
        assert!(!hold(&mut estimate, true));
        estimate.free();
        assert!(hold(&mut estimate, true));
        estimate.reset();
        assert!(!hold(&mut estimate, true));
    }

    // Fails if an estimate starts from the bias of a sensor, or from a drive that shows no torque while its brakes are
    // closed; or does not start from the torque of a cable.
    #[test]
    fn an_estimate_starts_from_a_cable_alone() {
        let started = |at: usize, torque: f64| {
            let mut estimate = Disturbance::<7>::default();
            let mut all = SVector::zeros();
            all[at] = torque;
            estimate.start(&all, &limits());
            estimate.torque()[at]
        };
        assert!((started(6, 1.5) - 0.9).abs() < 1e-12, "1.5 N m less 1.5 % of 40");
        assert_eq!((started(6, 0.5), started(1, -60.0)), (0.0, 0.0));
    }

    // Fails if what is explained stays in the residual, comes back, or jumps.
    #[test]
    fn what_is_explained_is_no_residual() {
        let (snapshot, limits) = (snapshot(), limits());
        let mut observer = Observer::default();
        let mut measured: [f64; 7] = snapshot.gravity.into();
        measured[6] -= 1.0;
        let run = |observer: &mut Observer<7>| {
            for _ in 0..500 {
                observer.update(&snapshot, &measured, 60.0, 1e-3);
            }
            observer.residual()[6]
        };
        let felt = run(&mut observer);
        assert!((felt - 1.0).abs() < 1e-6, "{felt}");
        let external = *observer.residual();
        observer.explain(&external, &limits, 60.0);
        assert!(observer.residual().amax() < 1e-12);
        assert!(run(&mut observer).abs() < 1e-6);
        assert!((observer.known()[6] - 1.0).abs() < 1e-6);
    }

    // Fails if what a turn has made known outlives its fault, or what was known before does not; or if the residual, of
    // which it was taken out, does not get it back.
    #[test]
    fn a_fault_forgets_what_a_turn_has_made_known() {
        let (limits, pole) = (limits(), 60.0);
        let mut observer = Observer::<7>::default();
        let (before, added) = (SVector::from([0.5; 7]), SVector::from([0.25; 7]));
        observer.explain(&before, &limits, pole);
        observer.keep();
        let residual = *observer.residual();
        observer.explain(&added, &limits, pole);
        observer.forget_turn(&limits, pole);
        assert_eq!((*observer.known(), *observer.residual()), (before, residual));
    }
}
