//! A fit as a linear model: whitened rows, residuals and priors in one place,
//! from which every test and every prediction about it is computed.
//!
//! ```text
//! Fit ─ Linear ─ tests of named causes (alternatives)
//! ```
//!
//! At the estimate, `y = X x + e` with `x ~ N(0, I)` (columns are scaled by the
//! sigma of their prior) and `e ~ N(0, I)` (rows are whitened by the noise and
//! by the robust weight), so that `y ~ N(0, I + X Xᵀ)`.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::chain::{Kinematics, Prepared};
use crate::dense::transposed_product;
use crate::hierarchy::Fit;
use crate::normal::{Root, WhitenedTarget, accumulate, groups, whitened_rows};
use crate::parameters::Layout;
use crate::seen::{RowPart, Seen};

/// Most observations that a statement about a fit is computed from; of more,
/// these many evenly spread ones.
const MOST: usize = 1500;

/// The arm at one configuration, as columns of causes need it.
#[derive(Clone, Debug)]
pub(crate) struct Posture {
    /// Encoder angles, in rad.
    pub(crate) q: Vec<f64>,
    /// Rotation of the flange in F0.
    pub(crate) flange: Matrix3<f64>,
    /// Columns of the joint angles in F0, in m/rad.
    pub(crate) joints: Vec<Vector3<f64>>,
    /// Columns of the lengths a and d of each row in F0.
    pub(crate) lengths: Vec<Vector3<f64>>,
}

impl Posture {
    pub(crate) fn new(layout: &Layout, k: &Kinematics, q: &[f64]) -> Self {
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
            flange: k.frames[n - 1].rotation,
            joints: k.frames[..n]
                .iter()
                .map(|f| f.z().cross(&(k.tcp - f.position)))
                .collect(),
            lengths,
        }
    }
}

/// What one target of an observation contributes besides its rows of the model.
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
    /// Factors on what the earlier targets of the same observation have after whitening; none for the first. The targets
    /// share the joint noise, so each is whitened given those before it.
    factors: Vec<Matrix3<f64>>,
    /// Robust weight.
    pub(crate) weight: f64,
}

impl LinearRow {
    /// Whether it is the first target of its observation.
    pub(crate) fn leads(&self) -> bool {
        self.factors.is_empty()
    }

    /// The whitened `value` (m, F0) of row `k`; `whitened` gives axis and number of an earlier row after whitening.
    pub(crate) fn whiten(
        &self,
        k: usize,
        value: &Vector3<f64>,
        whitened: impl Fn(usize) -> Vector3<f64>,
    ) -> Vector3<f64> {
        if self.factors.is_empty() {
            return self.root.times(value);
        }
        let first = k - self.factors.len();
        let pairs = self.factors.iter().zip(first..);
        let known: Vector3<f64> = pairs.map(|(factor, row)| factor * whitened(row)).sum();
        self.root.times(&(value - known))
    }
}

/// The linear model of a fit.
#[derive(Clone)]
pub(crate) struct Linear {
    /// `X`, 3n x m; n counts the targets of all observations.
    pub(crate) x: DMatrix<f64>,
    /// `y`, 3n: target minus model at the prior's mean.
    pub(crate) y: DVector<f64>,
    /// Targets of observations, in the order of the rows.
    pub(crate) rows: Vec<LinearRow>,
    /// Sigma that scales each column, in SI units.
    pub(crate) scale: Vec<f64>,
    /// The estimate that the fit gave, in units of [`Self::scale`].
    pub(crate) estimate: DVector<f64>,
    /// Information of what is no row here (orientations), m x m.
    pub(crate) rest: DMatrix<f64>,
    /// Its right side.
    pub(crate) rest_y: DVector<f64>,
}

impl Linear {
    /// The linear model of a fit, its columns scaled by the sizes that the fit found.
    pub(crate) fn new(fit: &Fit) -> Self {
        let unknowns = &fit.unknowns;
        let scale: Vec<f64> = unknowns.precision.iter().map(|p| p.powf(-0.5)).collect();
        let m = unknowns.len();
        let targets = |of: usize| {
            let parts = fit.prepared[of].parts();
            parts.filter(|part| *part != RowPart::Body).count()
        };
        let step = (0..fit.prepared.len())
            .map(targets)
            .sum::<usize>()
            .div_ceil(MOST)
            .max(1);
        let chosen: Vec<usize> = (0..fit.prepared.len()).step_by(step).collect();
        let count: usize = chosen.iter().map(|of| targets(*of)).sum();
        let mut x = DMatrix::zeros(3 * count, m);
        let mut y = DVector::zeros(3 * count);
        let mut rows: Vec<LinearRow> = Vec::with_capacity(count);
        for &of in &chosen {
            let observation = &fit.prepared[of];
            let weight = fit.weights[of];
            let leading = fit.state.at(observation);
            let rotation = fit.state.bases.get(observation.reference).map(|b| b.rotation);
            let mut further = observation.further.iter();
            let put = |row: WhitenedTarget, all: &[Vector3<f64>]| {
                let k = rows.len();
                for (c, (&column, sigma)) in unknowns.columns.iter().zip(&scale).enumerate() {
                    for axis in 0..3 {
                        x[(3 * k + axis, c)] = all[column][axis] * sigma;
                    }
                }
                for axis in 0..3 {
                    y[3 * k + axis] = -row.residual[axis];
                }
                let (kinematics, target) = match (row.factors.is_empty(), further.as_slice().first()) {
                    (false, Some(&Seen::Target { number, at })) => {
                        further.next();
                        (fit.state.moved(&leading, &observation.load, number), at)
                    }
                    _ => (leading, observation.target),
                };
                rows.push(LinearRow {
                    index: observation.index,
                    reference: observation.reference,
                    sphere: observation.sphere,
                    posture: Posture::new(&fit.layout, &kinematics, &observation.q),
                    rotation: rotation.unwrap_or_else(Matrix3::identity),
                    target,
                    root: row.root,
                    factors: row.factors,
                    weight,
                });
            };
            whitened_rows(&fit.state, &fit.layout, observation, &fit.whitening, weight, put);
        }
        let estimate = DVector::from_fn(m, |i, _| unknowns.deviation[i] / scale[i]);
        y.gemv(1.0, &x, &estimate, 1.0);
        let own = transposed_product(&x, &x);
        let (all, gradient) = information(fit, &chosen, &scale);
        let rest = all - &own;
        let own_gradient = own * &estimate - x.tr_mul(&y);
        let rest_y = &rest * &estimate - (gradient - own_gradient);
        Self {
            x,
            y,
            rows,
            scale,
            estimate,
            rest,
            rest_y,
        }
    }

    /// The same model with another white noise of the targets, by a factor.
    pub(crate) fn with_noise(mut self, factor: f64) -> Self {
        let by = 1.0 / factor;
        self.x *= by;
        self.y *= by;
        for row in &mut self.rows {
            row.root = row.root.scaled(by);
        }
        self
    }

    /// The scales of the columns.
    pub(crate) fn sigmas(&self) -> DVector<f64> {
        DVector::from_column_slice(&self.scale)
    }

    /// Whitened column of `value` (m, F0) by target, 3n.
    pub(crate) fn column(&self, mut value: impl FnMut(&LinearRow) -> Vector3<f64>) -> DVector<f64> {
        let mut out = DVector::zeros(3 * self.rows.len());
        for (k, row) in self.rows.iter().enumerate() {
            let v = row.whiten(k, &value(row), |row| out.fixed_rows::<3>(3 * row).into());
            for axis in 0..3 {
                out[3 * k + axis] = v[axis];
            }
        }
        out
    }
}

/// Information of the chosen observations about the unknowns, all their parts, and its gradient, in units of `scale`.
fn information(fit: &Fit, chosen: &[usize], scale: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
    let prepared: Vec<Prepared> = chosen.iter().map(|&of| fit.prepared[of].clone()).collect();
    let weights: Vec<f64> = chosen.iter().map(|&of| fit.weights[of]).collect();
    let of = groups(&prepared);
    let all = accumulate(&fit.state, &fit.layout, &prepared, &of, &fit.whitening, &weights);
    let columns = &fit.unknowns.columns;
    let matrix = DMatrix::from_fn(columns.len(), columns.len(), |r, c| {
        let (row, column) = (columns[r].max(columns[c]), columns[r].min(columns[c]));
        all.matrix[(row, column)] * scale[r] * scale[c]
    });
    let gradient = DVector::from_fn(columns.len(), |i, _| all.gradient[columns[i]] * scale[i]);
    (matrix, gradient)
}
