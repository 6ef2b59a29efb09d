//! A fit as a linear model: whitened rows, residuals and priors in one place,
//! from which every test and every prediction about it is computed.
//!
//! ```text
//! Fit ─ Linear ─┬─ sizes of what the model leaves out   (discrepancy)
//!               ├─ tests of named causes                (alternatives)
//!               └─ expected error over the workspace    (expected)
//! ```
//!
//! At the estimate, `y = X x + e` with `x ~ N(0, I)` (columns are scaled by the
//! sigma of their prior) and `e ~ N(0, s² I)` (rows are whitened by the noise and
//! by the robust weight), so that `y ~ N(0, s² I + X Xᵀ)`.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::chain::{Kinematics, Load};
use crate::map::Fit;
use crate::normal::{Root, whitened_row};
use crate::parameters::Layout;

/// Most observations that a statement about a fit is computed from; of more,
/// these many evenly spread ones.
const MOST: usize = 4000;

/// The arm at one configuration, as columns of causes need it.
#[derive(Clone, Debug)]
pub(crate) struct Posture {
    /// Encoder angles, in rad.
    pub(crate) q: Vec<f64>,
    /// Joint torques that hold the arm, in N m.
    pub(crate) torque: Vec<f64>,
    /// TCP in F0, in m.
    pub(crate) tcp: Vector3<f64>,
    /// Rotation of the flange in F0.
    pub(crate) flange: Matrix3<f64>,
    /// Columns of the joint angles in F0, in m/rad.
    pub(crate) joints: Vec<Vector3<f64>>,
    /// Columns of the lengths a and d of each row in F0.
    pub(crate) lengths: Vec<Vector3<f64>>,
}

impl Posture {
    pub(crate) fn new(layout: &Layout, k: &Kinematics, q: &[f64], load: &Load) -> Self {
        let n = layout.n;
        let mut lengths = Vec::with_capacity(2 * n);
        let mut x = Vector3::x();
        for frame in &k.frames[..n] {
            lengths.push(x);
            lengths.push(frame.z());
            x = frame.rotation.column(0).into();
        }
        Self {
            q: q[..n].to_vec(),
            torque: load.joint[..n].iter().map(|m| m[2]).collect(),
            tcp: k.tcp,
            flange: k.frames[n - 1].rotation,
            joints: k.frames[..n]
                .iter()
                .map(|f| f.z().cross(&(k.tcp - f.position)))
                .collect(),
            lengths,
        }
    }
}

/// What one observation contributes besides its row of the model.
#[derive(Clone, Debug)]
pub(crate) struct LinearRow {
    /// Index of the observation in the experiment.
    pub(crate) index: usize,
    /// Reference frame in the layout.
    pub(crate) reference: usize,
    /// Sphere in the layout.
    pub(crate) sphere: Option<usize>,
    /// Where the arm stood.
    pub(crate) posture: Posture,
    /// Rotation from F0 into the reference frame.
    pub(crate) rotation: Matrix3<f64>,
    /// Certified or measured target in the reference frame, in m.
    pub(crate) target: Vector3<f64>,
    /// Whitener of a vector in F0, robust weight included.
    pub(crate) root: Root,
    /// Robust weight.
    pub(crate) weight: f64,
}

/// The linear model of a fit.
pub(crate) struct Linear {
    /// `X`, 3n x m.
    pub(crate) x: DMatrix<f64>,
    /// `y`, 3n: target minus model at the prior's mean.
    pub(crate) y: DVector<f64>,
    /// Observations, in the order of the rows.
    pub(crate) rows: Vec<LinearRow>,
    /// Sigma that scales each column, in SI units.
    pub(crate) scale: Vec<f64>,
    /// The estimate that the fit gave, in units of [`Self::scale`].
    pub(crate) estimate: DVector<f64>,
    /// Variance of the noise in units of the whitening, as the fit estimated it.
    pub(crate) s2: f64,
    /// Variance of one joint's white error, in rad² per unit of `s2`.
    pub(crate) joint_variance: f64,
}

impl Linear {
    /// The linear model of a fit; `scale` gives the sigma of each free parameter.
    pub(crate) fn new(fit: &Fit, scale: Vec<f64>) -> Self {
        let unknowns = &fit.unknowns;
        let m = unknowns.len();
        let step = fit.prepared.len().div_ceil(MOST).max(1);
        let chosen: Vec<usize> = (0..fit.prepared.len()).step_by(step).collect();
        let mut x = DMatrix::zeros(3 * chosen.len(), m);
        let mut y = DVector::zeros(3 * chosen.len());
        let mut rows = Vec::with_capacity(chosen.len());
        let mut all = vec![Vector3::zeros(); fit.layout.len()];
        for (k, &of) in chosen.iter().enumerate() {
            let observation = &fit.prepared[of];
            let weight = fit.weights[of];
            let row = whitened_row(&fit.state, &fit.layout, observation, &fit.whitening, weight, &mut all);
            for (c, (&column, sigma)) in unknowns.columns.iter().zip(&scale).enumerate() {
                for axis in 0..3 {
                    x[(3 * k + axis, c)] = all[column][axis] * sigma;
                }
            }
            for axis in 0..3 {
                y[3 * k + axis] = -row.residual[axis];
            }
            let kinematics = fit.state.at(observation);
            let base = fit.state.bases.get(observation.reference);
            rows.push(LinearRow {
                index: observation.index,
                reference: observation.reference,
                sphere: observation.sphere,
                posture: Posture::new(&fit.layout, &kinematics, &observation.q, &observation.load),
                rotation: base.map_or_else(Matrix3::identity, |b| b.rotation),
                target: observation.target,
                root: row.root,
                weight,
            });
        }
        let estimate = DVector::from_fn(m, |i, _| unknowns.deviation[i] / scale[i]);
        y.gemv(1.0, &x, &estimate, 1.0);
        Self {
            x,
            y,
            rows,
            scale,
            estimate,
            s2: fit.scale.powi(2),
            joint_variance: fit.whitening.joint,
        }
    }

    /// Whitened column of `value` (m, F0) by observation, 3n.
    pub(crate) fn column(&self, mut value: impl FnMut(&LinearRow) -> Vector3<f64>) -> DVector<f64> {
        let mut out = DVector::zeros(3 * self.rows.len());
        for (k, row) in self.rows.iter().enumerate() {
            let v = row.root.times(&value(row));
            for axis in 0..3 {
                out[3 * k + axis] = v[axis];
            }
        }
        out
    }
}
