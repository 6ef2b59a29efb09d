//! Static studies on the plant's world, without moving it: what an estimator
//! would be given by an ideal campaign.
//!
//! Recordings of a run never come from here; they come from the controller's
//! samples while the nest is seated. This serves comparisons of estimators over
//! many robots (`identification.md`, worlds W0 to W4), where an hour of
//! simulated motion a robot is too dear.

use nalgebra::{SMatrix, SVector, Vector3};
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::Dynamics;

use super::config::PlantConfig;
use super::simulation::Plant;
use super::world::{World, normal, normal3};

impl<const N: usize> World<N> {
    /// Encoder angles (rad) nearest to `guess` at which the arm, at rest under
    /// gravity alone, has its TCP at `point` (m, F0).
    ///
    /// `None` where Newton's method does not get there within 0.1 µm: out of
    /// reach or singular.
    pub fn encoder_angles_at(&self, guess: &[f64; N], point: &Vector3<f64>) -> Option<[f64; N]> {
        let mut q = *guess;
        for _ in 0..20 {
            let link = self.link_angles_at_rest(&q);
            let tcp = self.tcp(&link).origin;
            let wrong = point - tcp;
            if wrong.norm() < 1e-9 {
                break;
            }
            let full = self.arm.jacobian(&self.arm.frames(&link), &tcp);
            let j: SMatrix<f64, 3, N> = full.fixed_rows::<3>(0).into();
            let square = j * j.transpose() + SMatrix::<f64, 3, 3>::identity() * 1e-9;
            let step: SVector<f64, N> = j.transpose() * Cholesky::new(&square)?.solve(&wrong);
            for i in 0..N {
                q[i] += step[i].clamp(-0.1, 0.1);
            }
        }
        let reached = self.tcp(&self.link_angles_at_rest(&q)).origin;
        ((reached - point).norm() < 1e-7).then_some(q)
    }
}

impl<const N: usize> Plant<N> {
    /// A coupling as a study sees it: mean encoder angles and torques with the
    /// nest on sphere `index` (from 0) near the joint angles `guess` (rad),
    /// with seating and averaged encoder noise. `None` where it cannot be reached.
    pub fn coupled_shot(&mut self, guess: &[f64; N], index: usize) -> Option<([f64; N], [f64; N])> {
        let centre = self.world.spheres.get(index).copied().flatten()?;
        let PlantConfig { nest, tracker, .. } = &self.config;
        let seat = if nest.seating_error {
            normal3(&mut self.tracker_rng) * nest.seating_sigma_m.hypot(nest.form_sigma_m)
        } else {
            Vector3::zeros()
        };
        let sigma = if tracker.noise { tracker.encoder_rad } else { 0.0 };
        let mut q = self.world.encoder_angles_at(guess, &(centre - seat))?;
        let link = self.world.link_angles_at_rest(&q);
        let gravity = self.world.arm.bodies(&self.world.arm.frames(&link)).gravity();
        for angle in &mut q {
            *angle += sigma * normal(&mut self.tracker_rng);
        }
        Some((q, core::array::from_fn(|i| gravity[i] + self.world.torque_bias[i])))
    }
}
