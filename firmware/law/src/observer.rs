//! Momentum observer and the wrench at the TCP.
//!
//! From `ṗ = tau + tau_ext + Cᵀ q̇ − g` with `p = M q̇` the residual
//!
//! `r = k (p − ∫ (tau + Cᵀ q̇ − g + r) dt)`
//!
//! follows the external joint torque `tau_ext = Jᵀ F` with a first-order lag of
//! `1/k` and differentiates no velocity (De Luca and Mattone, 2003). The wrench is
//! the damped, inertia-weighted least-squares solution. Light wrist joints have
//! more weight than heavy joints, whose gravity torque is known less exactly.

use nalgebra::{SVector, Vector3};

use spherecal_shared::robot::JointLimits;
use spherecal_shared::scalar::bounded;

use super::disturbance::most;
use super::snapshot::Snapshot;

/// A wrench at the TCP in F0, of the environment on the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force, in N.
    pub force: Vector3<f64>,
    /// Torque about the TCP, in N m.
    pub torque: Vector3<f64>,
}

/// The momentum observer of an arm with `N` joints.
#[derive(Clone, Debug)]
pub struct Observer<const N: usize> {
    integral: SVector<f64, N>,
    residual: SVector<f64, N>,
    /// The part of the external torque that is known to be no contact, in N m.
    known: SVector<f64, N>,
    /// The same as the last turn began.
    kept: SVector<f64, N>,
    started: bool,
}

impl<const N: usize> Default for Observer<N> {
    fn default() -> Self {
        Self {
            integral: SVector::zeros(),
            residual: SVector::zeros(),
            known: SVector::zeros(),
            kept: SVector::zeros(),
            started: false,
        }
    }
}

impl<const N: usize> Observer<N> {
    /// Starts anew: the next update sets the integral so that the residual is zero.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Advances by one tick of `period_s` (s). Takes the measured torque (N m, sign
    /// as in [`DriveState`](spherecal_shared::protocol::drive::DriveState)) and the
    /// pole (1/s). Returns the wrench at the TCP, not tared.
    #[inline]
    pub fn update(&mut self, snapshot: &Snapshot<N>, measured: &[f64; N], pole: f64, period_s: f64) -> Wrench {
        if !self.started {
            self.started = true;
            self.integral = snapshot.momentum;
        }
        for i in 0..N {
            let rate =
                measured[i] + self.known[i] + snapshot.transposed_coriolis[i] - snapshot.gravity[i] + self.residual[i];
            self.integral[i] += rate * period_s;
            self.residual[i] = pole * (snapshot.momentum[i] - self.integral[i]);
        }
        let f = snapshot.task_force(&snapshot.mass.solve_lower(&self.residual));
        Wrench {
            force: Vector3::new(f[0], f[1], f[2]),
            torque: Vector3::new(f[3], f[4], f[5]),
        }
    }

    /// Takes `torque` (N m) out of the residual, without delay: it is no contact. The law has to compensate what is
    /// [`known`](Self::known). Each joint's part keeps within `most` of its limits.
    #[inline]
    pub fn explain(&mut self, torque: &SVector<f64, N>, limits: &[JointLimits; N], pole: f64) {
        for i in 0..N {
            let known = bounded(self.known[i] + torque[i], most(&limits[i])).unwrap_or(0.0);
            let moved = known - self.known[i];
            self.known[i] = known;
            self.residual[i] -= moved;
            self.integral[i] += moved / pole;
        }
    }

    /// The part of the external joint torque that is known to be no contact, in N m.
    pub fn known(&self) -> &SVector<f64, N> {
        &self.known
    }

    /// Keeps what is known, for [`forget_turn`](Self::forget_turn): a turn begins.
    pub fn keep(&mut self) {
        self.kept = self.known;
    }

    /// Forgets what a turn has made known since it began: it may have met something.
    pub fn forget_turn(&mut self, limits: &[JointLimits; N], pole: f64) {
        let change = self.kept - self.known;
        self.explain(&change, limits, pole);
    }

    /// The residual: external joint torque beyond what is known, in N m.
    pub fn residual(&self) -> &SVector<f64, N> {
        &self.residual
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    const POLE: f64 = 25.0;
    const PERIOD_S: f64 = 1e-4;

    /// The residual while the arm moves freely from `dq` (rad/s), its gravity carried,
    /// under an external torque (N m): at each of the `times` (s).
    fn residuals(dq: f64, external: SVector<f64, 7>, times: &[f64]) -> std::vec::Vec<SVector<f64, 7>> {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let mut q = SVector::from([0.0, 0.7, 0.0, -1.2, 0.0, 1.24, 0.0]);
        let mut dq = SVector::from([dq, -dq, dq, dq, -dq, dq, dq]);
        let mut observer = Observer::default();
        let (mut now, mut found) = (0.0, std::vec::Vec::new());
        for time in times {
            while now < *time {
                let snapshot = Snapshot::new(&arm, &q.into(), &dq.into()).expect("a mass matrix");
                observer.update(&snapshot, &snapshot.gravity.into(), POLE, PERIOD_S);
                dq += snapshot.mass.solve(&(external - snapshot.coriolis)) * PERIOD_S;
                q += dq * PERIOD_S;
                now += PERIOD_S;
            }
            found.push(*observer.residual());
        }
        found
    }

    // Fails if the observer takes the arm's own motion for a force: without `Cᵀ q̇`
    // its residual is several N m here.
    #[test]
    fn a_motion_is_no_force() {
        for residual in residuals(1.0, SVector::zeros(), &[0.05, 0.1, 0.2]) {
            assert!(residual.norm() < 0.05, "{residual}");
        }
    }

    // Fails if the residual does not follow a step with the lag of its pole.
    #[test]
    fn the_residual_follows_with_the_lag_of_the_pole() {
        let external = SVector::from([0.5, -0.4, 0.3, 0.2, -0.1, 0.1, 0.05]);
        let times = [0.5 / POLE, 1.0 / POLE, 3.0 / POLE];
        for (residual, time) in residuals(0.0, external, &times).iter().zip(times) {
            let expected = external * (1.0 - libm::exp(-POLE * time));
            let off = (residual - expected).norm() / external.norm();
            assert!(off < 0.01, "{off} after {time} s");
        }
    }
}
