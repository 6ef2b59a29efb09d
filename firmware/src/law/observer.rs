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
    started: bool,
}

impl<const N: usize> Default for Observer<N> {
    fn default() -> Self {
        Self {
            integral: SVector::zeros(),
            residual: SVector::zeros(),
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
            let rate = measured[i] + snapshot.transposed_coriolis[i] - snapshot.gravity[i] + self.residual[i];
            self.integral[i] += rate * period_s;
            self.residual[i] = pole * (snapshot.momentum[i] - self.integral[i]);
        }
        let f = snapshot.task_force(&snapshot.mass.solve_lower(&self.residual));
        Wrench {
            force: Vector3::new(f[0], f[1], f[2]),
            torque: Vector3::new(f[3], f[4], f[5]),
        }
    }

    /// The residual: external joint torque, in N m.
    pub fn residual(&self) -> &SVector<f64, N> {
        &self.residual
    }
}
