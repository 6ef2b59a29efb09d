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
use rayon::prelude::*;

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

    /// The same times a factor.
    #[inline]
    fn scaled(self, factor: f64) -> Self {
        Self(self.0.map(|x| x * factor))
    }

    /// `L`, 3 x 3 lower triangular.
    pub(crate) fn inverse(&self) -> Matrix3<f64> {
        let [a, b, d, ba, da, db] = self.0;
        let (x, y, z) = (1.0 / a, 1.0 / b, 1.0 / d);
        let yx = -ba * x * y;
        let zy = -db * y * z;
        let zx = -(da * x + db * yx) * z;
        Matrix3::new(x, 0.0, 0.0, yx, y, 0.0, zx, zy, z)
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
    /// Whitened joint columns by pose.
    white: Vec<[Vector3<f64>; N]>,
    /// Of one joint, by pose: `Ãᵀ J̃_i`, then `s_ij φ_j` for every later joint j.
    stack: Vec<f64>,
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

/// Poses that one task sums. Sums of as many or fewer are those of a plain loop,
/// to the last bit; those of more do not depend on the number of threads.
const BLOCK: usize = 16_384;
/// Tasks whose sums are in memory together.
const BATCH: usize = 16;

/// The poses of all groups in blocks: number of the group, and its poses.
fn blocks(groups: &[Group]) -> Vec<(usize, &[usize])> {
    let of = |(g, group)| -> Vec<(usize, &[usize])> {
        let group: &Group = group;
        group.members.chunks(BLOCK).map(|members| (g, members)).collect()
    };
    groups.iter().enumerate().flat_map(of).collect()
}

/// Sums each group's blocks with `sum`, on all cores where there are many poses,
/// and hands each group's total to `done`, in order. `add` adds the second sum to
/// the first.
fn by_group<'g, S: Send>(
    groups: &'g [Group],
    sum: impl Fn(&'g [usize]) -> S + Sync,
    add: impl Fn(&mut S, &S),
    mut done: impl FnMut(&'g Group, &S),
) {
    let blocks = blocks(groups);
    let many = groups.iter().map(|g| g.members.len()).sum::<usize>() > BLOCK;
    let mut open: Option<(usize, S)> = None;
    for batch in blocks.chunks(BATCH) {
        let sums: Vec<S> = if many {
            batch.par_iter().map(|(_, members)| sum(members)).collect()
        } else {
            batch.iter().map(|(_, members)| sum(members)).collect()
        };
        for ((group, _), next) in batch.iter().zip(sums) {
            match &mut open {
                Some((last, total)) if last == group => add(total, &next),
                _ => {
                    if let Some((last, total)) = open.replace((*group, next)) {
                        done(&groups[last], &total);
                    }
                }
            }
        }
    }
    if let Some((last, total)) = open {
        done(&groups[last], &total);
    }
}

fn add_all(to: &mut [f64], from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from;
    }
}

/// Sums over some poses of one group.
struct Sums {
    /// Own columns by own columns.
    block: Vec<f64>,
    /// Of each joint: own columns and later joints' basis by its own basis.
    joints: Vec<Vec<f64>>,
    gradient: Gradient,
}

/// How wide the parts of the equations are.
#[derive(Clone, Copy)]
struct Widths {
    basis: usize,
    /// Columns of the group: the general ones and the base's six.
    own: usize,
    /// The same with the joints, where a joint has one column only and is a column
    /// like any other.
    wide: usize,
    /// Joints whose columns are kept apart.
    apart: usize,
    n: usize,
}

impl Widths {
    fn new(layout: &Layout) -> Self {
        let (n, basis) = (layout.n, layout.basis());
        let plain = basis == 1;
        let own = layout.general() + 6;
        Self {
            basis,
            own,
            wide: own + if plain { n } else { 0 },
            apart: if plain { 0 } else { n },
            n,
        }
    }

    fn joint(&self, joint: usize) -> usize {
        self.own + (self.n - joint) * self.basis
    }
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
    let widths = Widths::new(layout);
    let Widths { own, wide, .. } = widths;
    let sum = |members: &[usize]| sums(state, layout, prepared, members, whitening, weights, widths);
    let add = |total: &mut Sums, next: &Sums| {
        add_all(&mut total.block, &next.block);
        for (total, next) in total.joints.iter_mut().zip(&next.joints) {
            add_all(total, next);
        }
        total.gradient.add(&next.gradient);
    };
    by_group(groups, sum, add, |group, total| {
        let mut at = places(layout, group);
        for &(c, column, sign) in &at {
            normal.gradient[column] += sign * total.gradient.own[c];
        }
        for (at, value) in (layout.joint(0)..).zip(&total.gradient.joints) {
            normal.gradient[at] += value;
        }
        for (i, sum) in total.joints.iter().enumerate() {
            scatter(layout, i, &at, sum, &mut normal);
        }
        at.extend((own..wide).map(|c| (c, layout.joint(c - own), 1.0)));
        for &(c, column, sign) in &at {
            for &(r, row, other) in &at {
                normal.matrix[(row, column)] += sign * other * total.block[c * wide + r];
            }
        }
    });
    normal
}

/// Sums over some poses of one group.
fn sums(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    members: &[usize],
    whitening: &Whitening,
    weights: &[f64],
    widths: Widths,
) -> Sums {
    let Widths {
        basis,
        own,
        wide,
        apart,
        n,
    } = widths;
    let mut chunk = Chunk {
        own: vec![0.0; wide * 3 * CHUNK],
        phi: vec![vec![0.0; basis * CHUNK]; n],
        white: vec![[Vector3::zeros(); N]; CHUNK],
        stack: vec![0.0; if apart == 0 { 0 } else { widths.joint(0) * CHUNK }],
    };
    let mut out = Sums {
        block: vec![0.0; wide * wide],
        joints: (0..apart).map(|i| vec![0.0; widths.joint(i) * basis]).collect(),
        gradient: Gradient::new(layout),
    };
    for members in members.chunks(CHUNK) {
        let count = members.len();
        for (b, &index) in members.iter().enumerate() {
            let pose = PoseColumns::new(state, layout, &prepared[index], whitening, weights[index]);
            pose.add_gradient(layout, &prepared[index], &mut out.gradient);
            let slot = &mut chunk.own[3 * wide * b..3 * wide * (b + 1)];
            for (c, v) in pose.own[..own].iter().chain(&pose.joints[..wide - own]).enumerate() {
                slot[c] = v.x;
                slot[wide + c] = v.y;
                slot[2 * wide + c] = v.z;
            }
            for (j, phi) in chunk.phi.iter_mut().enumerate().take(apart) {
                let phi = &mut phi[b * basis..(b + 1) * basis];
                pose.basis(layout, j, &prepared[index], phi);
            }
            chunk.white[b] = pose.joints;
        }
        add_product(&mut out.block, &chunk.own, &chunk.own, wide, wide, 3 * count);
        for i in 0..apart {
            let wide = widths.joint(i);
            for b in 0..count {
                let slot = &mut chunk.stack[b * wide..(b + 1) * wide];
                let (cross, rest) = slot.split_at_mut(own);
                let columns = &chunk.own[3 * own * b..3 * own * (b + 1)];
                let (x, yz) = columns.split_at(own);
                let (y, z) = yz.split_at(own);
                let w = &chunk.white[b][i];
                for (((c, x), y), z) in cross.iter_mut().zip(x).zip(y).zip(z) {
                    *c = x * w.x + y * w.y + z * w.z;
                }
                for (j, scaled) in (i..n).zip(rest.chunks_exact_mut(basis)) {
                    let s = w.dot(&chunk.white[b][j]);
                    let phi = &chunk.phi[j][b * basis..(b + 1) * basis];
                    for (to, from) in scaled.iter_mut().zip(phi) {
                        *to = s * from;
                    }
                }
            }
            add_product(&mut out.joints[i], &chunk.stack, &chunk.phi[i], wide, basis, count);
        }
    }
    out
}

/// Where a group's own column lies in the layout; sphere columns follow after
/// the base's: they are the base's shifts with the sign turned.
fn places(layout: &Layout, group: &Group) -> Vec<(usize, usize, f64)> {
    let general = layout.general();
    let mut places: Vec<_> = (0..general).map(|c| (c, c, 1.0)).collect();
    places.extend((0..6).map(|k| (general + k, layout.base(group.reference) + k, 1.0)));
    if let Some(sphere) = group.sphere {
        places.extend((0..3).map(|k| (general + k, layout.sphere(sphere) + k, -1.0)));
    }
    places
}

/// Adds a group's sums for one joint to the whole.
fn scatter(layout: &Layout, joint: usize, places: &[(usize, usize, f64)], sum: &[f64], normal: &mut Normal) {
    let own = layout.general() + 6;
    let basis = layout.basis();
    let wide = own + (layout.n - joint) * basis;
    for k in 0..basis {
        let column = layout.joint(joint) + k;
        let from = &sum[k * wide..(k + 1) * wide];
        for &(r, row, sign) in places {
            normal.matrix[(row, column)] += sign * from[r];
            normal.matrix[(column, row)] += sign * from[r];
        }
        for (row, value) in (layout.joint(joint)..).zip(&from[own..]) {
            normal.matrix[(row, column)] += value;
            if row >= layout.joint(joint) + basis {
                normal.matrix[(column, row)] += value;
            }
        }
    }
}

/// Gradient of one group: own columns, then the joints' blocks.
struct Gradient {
    own: Vec<f64>,
    joints: Vec<f64>,
}

impl Gradient {
    fn new(layout: &Layout) -> Self {
        Self {
            own: vec![0.0; layout.general() + 6],
            joints: vec![0.0; layout.n * layout.basis()],
        }
    }

    fn add(&mut self, other: &Self) {
        add_all(&mut self.own, &other.own);
        add_all(&mut self.joints, &other.joints);
    }
}

/// Gradient alone, where the matrix of an earlier state still serves.
pub(crate) fn gradient(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    groups: &[Group],
    whitening: &Whitening,
    weights: &[f64],
) -> DVector<f64> {
    let mut total = DVector::zeros(layout.len());
    let sum = |members: &[usize]| {
        let mut sum = Gradient::new(layout);
        for &index in members {
            let pose = PoseColumns::new(state, layout, &prepared[index], whitening, weights[index]);
            pose.add_gradient(layout, &prepared[index], &mut sum);
        }
        sum
    };
    by_group(groups, sum, Gradient::add, |group, sum| {
        for (c, column, sign) in places(layout, group) {
            total[column] += sign * sum.own[c];
        }
        for (at, value) in (layout.joint(0)..).zip(&sum.joints) {
            total[at] += value;
        }
    });
    total
}

/// One pose's whitened columns and residual.
struct PoseColumns {
    own: [Vector3<f64>; 5 * N + 16],
    joints: [Vector3<f64>; N],
    trig: [(f64, f64); N],
    residual: Vector3<f64>,
}

impl PoseColumns {
    #[inline]
    fn new(state: &State, layout: &Layout, observation: &Prepared, whitening: &Whitening, weight: f64) -> Self {
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
    fn basis(&self, layout: &Layout, j: usize, observation: &Prepared, phi: &mut [f64]) {
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
    fn add_gradient(&self, layout: &Layout, observation: &Prepared, sum: &mut Gradient) {
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

/// One observation's whitened residual and what whitened it.
pub(crate) struct Row {
    /// Whitener of a vector in F0, robust weight included.
    pub(crate) root: Root,
    /// Whitened residual.
    pub(crate) residual: Vector3<f64>,
}

/// The whitened columns of one observation over the whole layout, into `all`,
/// and its residual.
pub(crate) fn whitened_row(
    state: &State,
    layout: &Layout,
    observation: &Prepared,
    whitening: &Whitening,
    weight: f64,
    all: &mut [Vector3<f64>],
) -> Row {
    let pose = PoseColumns::new(state, layout, observation, whitening, weight);
    all.fill(Vector3::zeros());
    let group = Group {
        reference: observation.reference,
        sphere: observation.sphere,
        members: Vec::new(),
    };
    for (c, column, sign) in places(layout, &group) {
        all[column] = pose.own[c] * sign;
    }
    let mut phi = vec![0.0; layout.basis()];
    for j in 0..layout.n {
        pose.basis(layout, j, observation, &mut phi);
        for (k, value) in phi.iter().enumerate() {
            all[layout.joint(j) + k] = pose.joints[j] * *value;
        }
    }
    let k = state.at(observation);
    let joints: Vec<_> = (0..layout.n)
        .map(|j| k.frames[j].z().cross(&(k.tcp - k.frames[j].position)))
        .collect();
    let covariance = whitening.covariance(&joints, observation.sphere.is_some());
    Row {
        root: Root::new(&covariance).scaled(weight.sqrt()),
        residual: pose.residual,
    }
}

/// Squared whitened residual of every prepared observation.
pub(crate) fn distances(state: &State, layout: &Layout, prepared: &[Prepared], whitening: &Whitening) -> Vec<f64> {
    let [found] = whitened(state, layout, prepared, &[*whitening]).map(|found| found.0);
    found
}

/// Squared whitened residuals under each whitening, and the sum of `ln |L⁻¹|`.
fn whitened<const K: usize>(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    candidates: &[Whitening; K],
) -> [(Vec<f64>, f64); K] {
    let block = |prepared: &[Prepared]| {
        let mut columns = [Vector3::zeros(); N];
        let mut found: [(Vec<f64>, f64); K] = core::array::from_fn(|_| (Vec::with_capacity(prepared.len()), 0.0));
        for observation in prepared {
            let k = state.at(observation);
            for j in 0..layout.n {
                columns[j] = k.frames[j].z().cross(&(k.tcp - k.frames[j].position));
            }
            let residual = state.residual(observation, &k.tcp);
            for (candidate, (d2, log)) in candidates.iter().zip(&mut found) {
                let root = Root::new(&candidate.covariance(&columns[..layout.n], observation.sphere.is_some()));
                d2.push(root.times(&residual).norm_squared());
                *log += root.log_determinant();
            }
        }
        found
    };
    let add = |mut total: [(Vec<f64>, f64); K], next: [(Vec<f64>, f64); K]| {
        for (total, next) in total.iter_mut().zip(next) {
            total.0.extend(next.0);
            total.1 += next.1;
        }
        total
    };
    let blocks: Vec<_> = prepared.par_chunks(BLOCK).map(block).collect();
    blocks.into_iter().reduce(add).unwrap_or_else(|| block(&[]))
}

/// Log likelihood of the residuals under each candidate whitening, its scale at
/// its own best; `nu` as in the estimator.
pub(crate) fn likelihoods<const K: usize>(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    candidates: &[Whitening; K],
    nu: f64,
) -> [f64; K] {
    let shape = |d: f64, s2: f64| {
        if nu > 0.0 {
            -0.5 * (nu + 3.0) * (d / (s2 * nu)).ln_1p()
        } else {
            -0.5 * d / s2
        }
    };
    whitened(state, layout, prepared, candidates).map(|(d2, log)| {
        let s2 = super::noise_scale::scale(&d2, 0.0, nu, 1.0);
        log + d2.iter().map(|d| shape(*d, s2)).sum::<f64>() - 1.5 * d2.len() as f64 * s2.ln()
    })
}

#[cfg(test)]
#[path = "normal_tests.rs"]
mod tests;
