//! Dry friction of the joints: each joint sticks or slips, decided at the end of the sub-step.
//!
//! A sticking joint has a very steep viscous law, a slipping one a constant torque. A small active-set iteration
//! finds which joint does which ([`super::integrate`] has the equation).

use nalgebra::{SMatrix, SVector};
use spherecal_shared::linalg::Cholesky;

/// Speed of creep of a sticking joint at its full dry friction, in rad/s.
const STICK_RAD_S: f64 = 1e-6;

/// How each joint slips: its direction, or 0 where it sticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slip<const N: usize>(pub(super) [f64; N]);

impl<const N: usize> Slip<N> {
    /// Dry friction of joint `i` at speed `v`, in N m, against the motion.
    pub(super) fn dry(&self, coulomb: f64, i: usize, v: f64) -> f64 {
        if self.0[i] == 0.0 {
            coulomb * (v / STICK_RAD_S).clamp(-1.0, 1.0)
        } else {
            coulomb * self.0[i]
        }
    }

    /// `Δv` of `system Δv = impulse − h dry(v + Δv)` by active sets.
    pub(super) fn solve(
        &mut self,
        coulomb: &[f64; N],
        system: &SMatrix<f64, N, N>,
        impulse: &SVector<f64, N>,
        v: &SVector<f64, N>,
        h: f64,
    ) -> Option<SVector<f64, N>> {
        if coulomb.iter().all(|c| *c == 0.0) {
            return Some(Cholesky::new(system)?.solve(impulse));
        }
        let mut modes = self.0;
        let mut change = SVector::zeros();
        for _ in 0..6 {
            let mut matrix = *system;
            let mut right = *impulse;
            for i in 0..N {
                let (stick, drag) = friction_terms(coulomb[i], modes[i], v[i]);
                matrix[(i, i)] += h * stick;
                right[i] -= h * drag;
            }
            change = Cholesky::new(&matrix)?.solve(&right);
            if settle_modes(coulomb, &mut modes, &(v + change)) {
                break;
            }
        }
        self.0 = modes;
        Some(change)
    }
}

/// Slope (N m s/rad) and torque at the present speed `v` of dry friction in a mode.
#[inline]
pub(super) fn friction_terms(coulomb: f64, mode: f64, v: f64) -> (f64, f64) {
    if coulomb == 0.0 {
        (0.0, 0.0)
    } else if mode == 0.0 {
        let slope = coulomb / STICK_RAD_S;
        (slope, slope * v)
    } else {
        (0.0, coulomb * mode)
    }
}

/// Corrects the modes by the velocities at the end of the step; true where
/// nothing had to be corrected.
#[inline]
pub(super) fn settle_modes<const N: usize>(coulomb: &[f64; N], modes: &mut [f64; N], v: &SVector<f64, N>) -> bool {
    let mut settled = true;
    for i in 0..N {
        if coulomb[i] == 0.0 {
            continue;
        }
        let mode = if modes[i] == 0.0 {
            if v[i].abs() > STICK_RAD_S { v[i].signum() } else { 0.0 }
        } else if modes[i] * v[i] < 0.0 {
            0.0
        } else {
            modes[i]
        };
        settled &= mode == modes[i];
        modes[i] = mode;
    }
    settled
}
