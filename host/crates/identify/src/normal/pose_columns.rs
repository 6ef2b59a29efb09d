//! The whitened columns of one pose, and the gradient that they add up to.

use nalgebra::{Matrix3, Vector3};

use super::groups::add_all;
use super::whitening::{Root, Whitening};
use crate::chain::{N, Prepared, State};
use crate::parameters::Layout;

/// One pose's whitened columns and residual.
pub(super) struct PoseColumns {
    pub(super) own: [Vector3<f64>; 5 * N + 16],
    pub(super) joints: [Vector3<f64>; N],
    pub(super) trig: [(f64, f64); N],
    pub(super) residual: Vector3<f64>,
}

impl PoseColumns {
    #[inline]
    pub(super) fn new(
        state: &State,
        layout: &Layout,
        observation: &Prepared,
        whitening: &Whitening,
        weight: f64,
    ) -> Self {
        let n = layout.n;
        let general = layout.general();
        let mut own = [Vector3::zeros(); 5 * N + 16];
        let mut joints = [Vector3::zeros(); N];
        let kinematics = state.at(observation);
        state.columns(layout, &kinematics, &observation.load, &mut own, &mut joints);
        let rotation = state
            .bases
            .get(observation.reference)
            .map_or_else(Matrix3::identity, |base| base.rotation);
        let arm = kinematics.tcp - state.pivot(observation.reference);
        for axis in 0..3 {
            // Row `axis` of R₀ is R₀ᵀ e_axis: the reference frame's axis in F0.
            let e = rotation.row(axis).transpose();
            own[general + axis] = e;
            own[general + 3 + axis] = e.cross(&arm);
        }
        let covariance = whitening.covariance(&joints[..n], observation.sphere.is_some());
        let root = Root::new(&covariance).scaled(weight.sqrt());
        for column in &mut own[..general + 6] {
            *column = root.times(column);
        }
        for column in &mut joints[..n] {
            *column = root.times(column);
        }
        Self {
            own,
            joints,
            trig: kinematics.trig,
            residual: root.times(&state.residual(observation, &kinematics.tcp)),
        }
    }

    /// `φ_j` of joint j.
    #[inline]
    pub(super) fn basis(&self, layout: &Layout, j: usize, observation: &Prepared, phi: &mut [f64]) {
        phi[0] = 1.0;
        let mut first = 1;
        if layout.stiffness {
            phi[1] = -observation.load.joint[j][2];
            first = 2;
        }
        let (c, s) = self.trig[j];
        let (mut ck, mut sk) = (c, s);
        for pair in phi[first..].chunks_exact_mut(2) {
            pair[0] = ck;
            pair[1] = sk;
            (ck, sk) = (ck * c - sk * s, sk * c + ck * s);
        }
    }

    #[inline]
    pub(super) fn add_gradient(&self, layout: &Layout, observation: &Prepared, sum: &mut Gradient) {
        for (to, column) in sum.own.iter_mut().zip(&self.own) {
            *to += column.dot(&self.residual);
        }
        let basis = layout.basis();
        for (j, to) in sum.joints.chunks_exact_mut(basis).enumerate() {
            let along = self.joints[j].dot(&self.residual);
            to[0] += along;
            let mut first = 1;
            if layout.stiffness {
                to[1] -= along * observation.load.joint[j][2];
                first = 2;
            }
            let (c, s) = self.trig[j];
            let (mut ck, mut sk) = (along * c, along * s);
            for pair in to[first..].chunks_exact_mut(2) {
                pair[0] += ck;
                pair[1] += sk;
                (ck, sk) = (ck * c - sk * s, sk * c + ck * s);
            }
        }
    }
}

/// Gradient of one group: own columns, then the joints' blocks.
pub(super) struct Gradient {
    pub(super) own: Vec<f64>,
    pub(super) joints: Vec<f64>,
}

impl Gradient {
    pub(super) fn new(layout: &Layout) -> Self {
        Self {
            own: vec![0.0; layout.general() + 6],
            joints: vec![0.0; layout.n * layout.basis()],
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        add_all(&mut self.own, &other.own);
        add_all(&mut self.joints, &other.joints);
    }
}
