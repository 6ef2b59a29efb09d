//! Normal equations, accumulated pose by pose.
//!
//! Each residual `r = P(q) − R₀ᵀ(S + δ − t₀)` (3 numbers, in F0) is whitened by
//! the Cholesky factor of `C = σ_q² J Jᵀ + σ_s² I`: the joint noise as it
//! reaches the TCP, and the seating. With `Ã` and `J̃` the whitened columns,
//!
//! `H = Σ w [Ã | J̃_j φ_j]ᵀ [Ã | J̃_j φ_j]`
//!
//! where `φ_j = (1, −τ_j, cos q_j, sin q_j, …)`: offset, compliance and
//! harmonics of a joint all act along its one Jacobian column. So the large
//! part of `H` needs one number per pair of joints, `s_ij = J̃_iᵀ J̃_j`, not three
//! rows: `H_ij = Σ w s_ij φ_i φ_jᵀ`. Cost and memory are linear in the poses;
//! nothing is poses by poses.

use nalgebra::{DMatrix, DMatrixView, DMatrixViewMut, DVector, Dyn, Matrix3, MatrixView, Vector3};

use super::chain::{N, Prepared, State};
use super::parameters::Layout;

/// Poses that are whitened before they are multiplied: fits the cache.
const CHUNK: usize = 96;

/// Standard deviations that whiten the residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Whitening {
    /// Variance of the joint noise, in rad².
    pub(crate) joint: f64,
    /// Variance of seating on a sphere, in m².
    pub(crate) seating: f64,
    /// Variance of a measured point, in m².
    pub(crate) point: f64,
}

impl Whitening {
    /// `C` at a pose, in m².
    #[inline]
    pub(crate) fn covariance(&self, joints: &[Vector3<f64>], on_sphere: bool) -> Matrix3<f64> {
        let floor = if on_sphere { self.seating } else { self.point };
        let (mut xx, mut yy, mut zz, mut xy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for j in joints {
            xx += j.x * j.x;
            yy += j.y * j.y;
            zz += j.z * j.z;
            xy += j.x * j.y;
            xz += j.x * j.z;
            yz += j.y * j.z;
        }
        let v = self.joint;
        Matrix3::new(
            v * xx + floor,
            v * xy,
            v * xz,
            v * xy,
            v * yy + floor,
            v * yz,
            v * xz,
            v * yz,
            v * zz + floor,
        )
    }
}

/// `L⁻¹` of a 3 x 3 covariance, as its six numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Root([f64; 6]);

impl Root {
    #[inline]
    pub(crate) fn new(c: &Matrix3<f64>) -> Self {
        let a = 1.0 / c[(0, 0)].sqrt();
        let (l10, l20) = (c[(1, 0)] * a, c[(2, 0)] * a);
        let b = 1.0 / (c[(1, 1)] - l10 * l10).max(1e-30).sqrt();
        let l21 = (c[(2, 1)] - l20 * l10) * b;
        let d = 1.0 / (c[(2, 2)] - l20 * l20 - l21 * l21).max(1e-30).sqrt();
        Self([a, b, d, -l10 * a * b, (l10 * b * l21 - l20) * a * d, -l21 * b * d])
    }

    /// `ln |L⁻¹|`.
    pub(crate) fn log_determinant(&self) -> f64 {
        let [a, b, d, ..] = self.0;
        (a * b * d).ln()
    }

    #[inline]
    pub(crate) fn times(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let [a, b, d, ba, da, db] = self.0;
        Vector3::new(a * v.x, ba * v.x + b * v.y, da * v.x + db * v.y + d * v.z)
    }
}

/// Information matrix and gradient over all columns of the layout, data only.
#[derive(Clone, Debug)]
pub(crate) struct Normal {
    pub(crate) matrix: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
}

/// Buffers of one chunk.
struct Chunk {
    /// Whitened own columns, `own` x 3 poses.
    own: Vec<f64>,
    /// Basis of each joint, `basis` x poses.
    phi: Vec<Vec<f64>>,
    /// `w s_ij` by pair, and `Ã ᵀ J̃_j` by joint.
    pairs: Vec<Vec<f64>>,
    cross: Vec<Vec<f64>>,
    /// A basis times `w s_ij`.
    scaled: Vec<f64>,
}

/// Adds `c += a bᵀ`, with `a` m x k and `b` n x k, all column-major.
fn add_product(c: &mut [f64], a: &[f64], b: &[f64], m: usize, n: usize, k: usize) {
    if m == 0 || n == 0 || k == 0 {
        return;
    }
    let a = DMatrixView::from_slice(&a[..m * k], m, k);
    let bt: MatrixView<'_, f64, Dyn, Dyn, Dyn, Dyn> =
        MatrixView::from_slice_with_strides_generic(&b[..n * k], Dyn(k), Dyn(n), Dyn(n), Dyn(1));
    DMatrixViewMut::from_slice(c, m, n).gemm(1.0, &a, &bt, 1.0);
}

/// Group of observations that share a reference frame and a sphere.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Group {
    pub(crate) reference: usize,
    pub(crate) sphere: Option<usize>,
    /// Indices into the prepared observations.
    pub(crate) members: Vec<usize>,
}

/// Groups in order of first appearance.
pub(crate) fn groups(prepared: &[Prepared]) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let mut at = std::collections::HashMap::new();
    for (i, observation) in prepared.iter().enumerate() {
        let key = (observation.reference, observation.sphere);
        let slot = *at.entry(key).or_insert_with(|| {
            groups.push(Group {
                reference: key.0,
                sphere: key.1,
                members: Vec::new(),
            });
            groups.len() - 1
        });
        groups[slot].members.push(i);
    }
    groups
}

/// Sum over all poses; `weights` by prepared observation.
pub(crate) fn accumulate(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    groups: &[Group],
    whitening: &Whitening,
    weights: &[f64],
) -> Normal {
    let size = layout.len();
    let mut normal = Normal {
        matrix: DMatrix::zeros(size, size),
        gradient: DVector::zeros(size),
    };
    let n = layout.n;
    let basis = layout.basis();
    let widest = layout.general() + 9;
    let mut chunk = Chunk {
        own: vec![0.0; widest * 3 * CHUNK],
        phi: vec![vec![0.0; basis * CHUNK]; n],
        pairs: vec![vec![0.0; CHUNK]; n * n],
        cross: vec![vec![0.0; widest * CHUNK]; n],
        scaled: vec![0.0; basis * CHUNK],
    };
    let mut pairs = vec![vec![0.0; basis * basis]; n * n];
    for group in groups {
        let own = layout.general() + 6 + if group.sphere.is_some() { 3 } else { 0 };
        let mut block = vec![0.0; own * own];
        let mut cross = vec![vec![0.0; own * basis]; n];
        let mut gradient = vec![0.0; own];
        for members in group.members.chunks(CHUNK) {
            let count = members.len();
            for (b, &index) in members.iter().enumerate() {
                pose(
                    state,
                    layout,
                    &prepared[index],
                    whitening,
                    weights[index],
                    own,
                    b,
                    &mut chunk,
                    &mut gradient,
                    &mut normal.gradient,
                );
            }
            add_product(&mut block, &chunk.own, &chunk.own, own, own, 3 * count);
            for i in 0..n {
                add_product(&mut cross[i], &chunk.cross[i], &chunk.phi[i], own, basis, count);
                for j in i..n {
                    let s = &chunk.pairs[i * n + j];
                    for b in 0..count {
                        for k in 0..basis {
                            chunk.scaled[b * basis + k] = s[b] * chunk.phi[i][b * basis + k];
                        }
                    }
                    add_product(&mut pairs[i * n + j], &chunk.scaled, &chunk.phi[j], basis, basis, count);
                }
            }
        }
        let place = |local: usize| {
            let general = layout.general();
            if local < general {
                local
            } else if local < general + 6 {
                layout.base(group.reference) + local - general
            } else {
                layout.sphere(group.sphere.unwrap_or_default()) + local - general - 6
            }
        };
        for c in 0..own {
            normal.gradient[place(c)] += gradient[c];
            for r in 0..own {
                normal.matrix[(place(r), place(c))] += block[c * own + r];
            }
        }
        for (j, cross) in cross.iter().enumerate() {
            for k in 0..basis {
                let at = layout.joint(j) + k;
                for r in 0..own {
                    normal.matrix[(place(r), at)] += cross[k * own + r];
                    normal.matrix[(at, place(r))] += cross[k * own + r];
                }
            }
        }
    }
    for i in 0..n {
        for j in i..n {
            let block = &pairs[i * n + j];
            for c in 0..basis {
                for r in 0..basis {
                    let (row, column) = (layout.joint(i) + r, layout.joint(j) + c);
                    normal.matrix[(row, column)] = block[c * basis + r];
                    normal.matrix[(column, row)] = block[c * basis + r];
                }
            }
        }
    }
    normal
}

/// Fills slot `b` of the chunk with one pose and adds its gradient.
#[inline]
fn pose(
    state: &State,
    layout: &Layout,
    observation: &Prepared,
    whitening: &Whitening,
    weight: f64,
    own: usize,
    b: usize,
    chunk: &mut Chunk,
    gradient: &mut [f64],
    joint_gradient: &mut DVector<f64>,
) {
    let n = layout.n;
    let general = layout.general();
    let basis = layout.basis();
    let mut columns = [Vector3::zeros(); 5 * N + 16];
    let mut joints = [Vector3::zeros(); N];
    let kinematics = state.evaluate(&observation.q, &observation.load);
    state.columns(layout, &kinematics, &observation.load, &mut columns, &mut joints);
    let rotation = state
        .bases
        .get(observation.reference)
        .map_or_else(Matrix3::identity, |base| base.rotation);
    let pivot = state.pivot(observation.reference);
    for axis in 0..3 {
        // Row `axis` of R₀ is R₀ᵀ e_axis: the reference frame's axis in F0.
        let e = rotation.row(axis).transpose();
        columns[general + axis] = e;
        columns[general + 3 + axis] = e.cross(&(kinematics.tcp - pivot));
        columns[general + 6 + axis] = -e;
    }
    let covariance = whitening.covariance(&joints[..n], observation.sphere.is_some());
    let root = Root::new(&covariance);
    let amplitude = weight.sqrt();
    let r = root.times(&state.residual(observation, &kinematics.tcp)) * amplitude;
    let slot = &mut chunk.own[3 * own * b..3 * own * (b + 1)];
    for (c, column) in columns.iter().enumerate().take(own) {
        let v = root.times(column) * amplitude;
        slot[c] = v.x;
        slot[own + c] = v.y;
        slot[2 * own + c] = v.z;
        gradient[c] += v.dot(&r);
    }
    let mut white = [Vector3::zeros(); N];
    for j in 0..n {
        white[j] = root.times(&joints[j]) * amplitude;
        let phi = &mut chunk.phi[j][b * basis..(b + 1) * basis];
        phi[0] = 1.0;
        let mut k = 1;
        if layout.stiffness {
            phi[1] = -observation.load.joint[j][2];
            k = 2;
        }
        let (c, s) = kinematics.trig[j];
        let (mut ck, mut sk) = (c, s);
        for _ in 0..layout.orders {
            phi[k] = ck;
            phi[k + 1] = sk;
            (ck, sk) = (ck * c - sk * s, sk * c + ck * s);
            k += 2;
        }
        let along = white[j].dot(&r);
        let at = layout.joint(j);
        for (k, value) in phi.iter().enumerate() {
            joint_gradient[at + k] += along * value;
        }
        let cross = &mut chunk.cross[j][b * own..(b + 1) * own];
        let w = white[j];
        let (x, rest) = slot.split_at(own);
        let (y, z) = rest.split_at(own);
        for c in 0..own {
            cross[c] = x[c] * w.x + y[c] * w.y + z[c] * w.z;
        }
    }
    for i in 0..n {
        for j in i..n {
            chunk.pairs[i * n + j][b] = white[i].dot(&white[j]);
        }
    }
}

/// Squared whitened residual of every prepared observation.
pub(crate) fn distances(state: &State, layout: &Layout, prepared: &[Prepared], whitening: &Whitening) -> Vec<f64> {
    let mut columns = [Vector3::zeros(); N];
    prepared
        .iter()
        .map(|observation| {
            let k = state.evaluate(&observation.q, &observation.load);
            for j in 0..layout.n {
                columns[j] = k.frames[j].z().cross(&(k.tcp - k.frames[j].origin));
            }
            let c = whitening.covariance(&columns[..layout.n], observation.sphere.is_some());
            Root::new(&c).times(&state.residual(observation, &k.tcp)).norm_squared()
        })
        .collect()
}

/// Log likelihood of the residuals under each candidate whitening, its scale at
/// its own best; `nu` as in the estimator.
pub(crate) fn likelihoods(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    candidates: &[Whitening],
    nu: f64,
) -> Vec<f64> {
    let mut columns = [Vector3::zeros(); N];
    let mut distances = vec![Vec::with_capacity(prepared.len()); candidates.len()];
    let mut logs = vec![0.0; candidates.len()];
    for observation in prepared {
        let k = state.evaluate(&observation.q, &observation.load);
        for j in 0..layout.n {
            columns[j] = k.frames[j].z().cross(&(k.tcp - k.frames[j].origin));
        }
        let residual = state.residual(observation, &k.tcp);
        for (c, candidate) in candidates.iter().enumerate() {
            let covariance = candidate.covariance(&columns[..layout.n], observation.sphere.is_some());
            let root = Root::new(&covariance);
            distances[c].push(root.times(&residual).norm_squared());
            logs[c] += root.log_determinant();
        }
    }
    let shape = |d: f64, s2: f64| {
        if nu > 0.0 {
            -0.5 * (nu + 3.0) * (d / (s2 * nu)).ln_1p()
        } else {
            -0.5 * d / s2
        }
    };
    logs.iter()
        .zip(&distances)
        .map(|(log, d2)| {
            let s2 = super::map::scale(d2, 0.0, nu, 1.0);
            log + d2.iter().map(|d| shape(*d, s2)).sum::<f64>() - 1.5 * d2.len() as f64 * s2.ln()
        })
        .collect()
}
