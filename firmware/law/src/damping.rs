//! Damping of the Cartesian spring by double diagonalisation.
//!
//! With the task-space inertia `Λ = (J M⁻¹ Jᵀ)⁻¹` and the stiffness `K`, the
//! damping that gives *every* mode Lehr's ratio `zeta` is
//!
//! `D = 2 zeta L⁻ᵀ A^{1/2} L⁻¹`, with `Λ⁻¹ = L Lᵀ` and `A = Lᵀ K L`.
//!
//! In the coordinates `x = L y` the inertia is the identity, the stiffness is `A`,
//! and the damping must be `2 zeta A^{1/2}` (Albu-Schäffer et al., IROS 2003).
//! `A^{1/2}` comes from the eigenvectors of `A`. They change little from tick to
//! tick: one Jacobi sweep from the last ones keeps their error far below the
//! required 1 %, in a fixed number of instructions.

use nalgebra::{Matrix6, Vector6};
use spherecal_shared::linalg::jacobi_sweep;
use spherecal_shared::scalar::sqrt;

use super::snapshot::Snapshot;
use super::stiffness::{Rotational, Stiffness};

/// Smallest modal frequency, in rad/s. It gives damping to axes without
/// stiffness. The softest spring of the procedure (5 N/m on 20 kg: 0.5 rad/s) is
/// above it.
const FREQUENCY_FLOOR: f64 = 0.25;

/// The eigenvectors of the mass-normalised stiffness, kept from tick to tick.
#[derive(Clone, Debug)]
pub(super) struct Damping {
    basis: Matrix6<f64>,
}

impl Default for Damping {
    fn default() -> Self {
        Self {
            basis: Matrix6::identity(),
        }
    }
}

impl Damping {
    /// Damping force for the velocity error `v_d − v` at the TCP (F0, linear part
    /// first), in N and N m. `ratio` is Lehr's damping ratio.
    ///
    /// A mode that is faster than the drive allows is slowed down to that frequency:
    /// the part of its spring force beyond is taken off, by the position error `error`
    /// (m and rad).
    #[inline]
    pub(super) fn force<R: Rotational, const N: usize>(
        &mut self,
        snapshot: &Snapshot<N>,
        stiffness: &Stiffness<R>,
        ratio: f64,
        error: &Vector6<f64>,
        velocity_error: &Vector6<f64>,
    ) -> Vector6<f64> {
        let frequency = self.update(snapshot, stiffness);
        self.of_modes(snapshot, &frequency, ratio, error, velocity_error)
    }

    /// As [`force`](Self::force), with the modes of the last [`update`](Self::update) and their
    /// frequencies, in rad/s.
    #[inline]
    pub(super) fn of_modes<const N: usize>(
        &self,
        snapshot: &Snapshot<N>,
        frequency: &Vector6<f64>,
        ratio: f64,
        error: &Vector6<f64>,
        velocity_error: &Vector6<f64>,
    ) -> Vector6<f64> {
        let fastest = snapshot.fastest_rad_s;
        let y = snapshot.mobility.solve_lower(velocity_error);
        let mut modal = Vector6::zeros();
        for i in 0..6 {
            modal[i] = 2.0 * ratio * frequency[i].min(fastest) * self.share(i, &y);
        }
        if frequency.iter().any(|f| *f > fastest) {
            let y = snapshot.mobility.solve_lower(error);
            for i in 0..6 {
                let excess = (frequency[i] * frequency[i] - fastest * fastest).max(0.0);
                modal[i] -= excess * self.share(i, &y);
            }
        }
        let mut back = Vector6::zeros();
        for k in 0..6 {
            let mut sum = 0.0;
            for i in 0..6 {
                sum += self.basis[(k, i)] * modal[i];
            }
            back[k] = sum;
        }
        snapshot.mobility.solve_upper(&back)
    }

    /// Share of mode `i` in `y`.
    #[inline]
    fn share(&self, i: usize, y: &Vector6<f64>) -> f64 {
        (0..6).map(|k| self.basis[(k, i)] * y[k]).sum()
    }

    /// One sweep towards the eigenvectors of `A`. Returns the modal frequencies in
    /// rad/s, bounded below.
    #[inline]
    pub(super) fn update<R: Rotational, const N: usize>(
        &mut self,
        snapshot: &Snapshot<N>,
        stiffness: &Stiffness<R>,
    ) -> Vector6<f64> {
        // C = L V are the modes in task coordinates; then V^T A V = C^T K C.
        let lower = snapshot.mobility.lower();
        let mut modes = Matrix6::zeros();
        for i in 0..6 {
            for j in 0..6 {
                let mut sum = 0.0;
                for k in 0..=i {
                    sum += lower[(i, k)] * self.basis[(k, j)];
                }
                modes[(i, j)] = sum;
            }
        }
        let mut a = Matrix6::zeros();
        for j in 0..6 {
            let column = Vector6::from_fn(|i, _| modes[(i, j)]);
            let force = stiffness.times(&column);
            for i in 0..=j {
                let mut sum = 0.0;
                for k in 0..6 {
                    sum += modes[(k, i)] * force[k];
                }
                a[(i, j)] = sum;
                a[(j, i)] = sum;
            }
        }
        jacobi_sweep(&mut a, &mut self.basis);
        Vector6::from_fn(|i, _| sqrt(a[(i, i)].max(FREQUENCY_FLOOR * FREQUENCY_FLOOR)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Actuation;
    use crate::testing::HOME;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    // Fails if a spring is faster in any direction than the drive's delay allows, or if a
    // drive without delay gets a softer spring than the one that is asked for.
    #[test]
    fn no_mode_is_faster_than_the_drive_allows() {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let stiffness = Stiffness::isotropic(100.0, 200.0);
        let mut seed = 1u64;
        let mut draw = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        let mut softened = 0;
        // With the last one all modes are too fast.
        for latency_s in [0.0, 4e-3, 0.2] {
            let drive = Actuation::<7>::new([0.0; 7], 1e-3, latency_s);
            let snapshot = Snapshot::on(&drive, &arm, &HOME, &[0.0; 7]).expect("a mass matrix");
            let mut damping = Damping::default();
            let still = Vector6::zeros();
            for _ in 0..20 {
                damping.force(&snapshot, &stiffness, 0.7, &still, &still);
            }
            for _ in 0..200 {
                let x = Vector6::from_fn(|_, _| draw());
                let taken = damping.force(&snapshot, &stiffness, 0.7, &x, &still);
                let asked = stiffness.times(&x).dot(&x);
                let left = asked + taken.dot(&x);
                // x' Λ x, where the mobility L L' is the inverse of Λ.
                let inertia = snapshot.mobility.solve_lower(&x).norm_squared();
                assert!(left <= 1.001 * inertia * drive.fastest_rad_s * drive.fastest_rad_s);
                if latency_s == 0.0 {
                    assert!((left - asked).abs() < 1e-9 * asked);
                }
                softened += usize::from(left < 0.99 * asked);
            }
        }
        assert!(softened > 100, "late drives get a softer spring: {softened} of 400");
    }
}
