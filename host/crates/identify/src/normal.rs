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
//!
//! The parts of one row (several targets, or position and orientation) share the joint noise, and several targets shifts and turns
//! of the tool. They
//! are whitened one after the other, each given those before it, and then count as residuals of
//! their own with the same `φ_j`.

use nalgebra::{DMatrix, DMatrixView, DMatrixViewMut, DVector, Dyn, MatrixView, Vector3};

mod groups;
mod likelihood;
#[cfg(test)]
mod parts_tests;
mod pose_columns;
mod whitening;

use self::groups::{add_all, by_group, places};
use self::pose_columns::{Gradient, PoseColumns};
use super::chain::{N, Prepared, State};
use super::parameters::Layout;

pub(crate) use self::groups::{Group, groups};
pub(crate) use self::likelihood::{WhitenedTarget, distances, log_determinant, plain_columns, whitened_rows};
pub(crate) use self::whitening::{Own, Root, Whitening};

/// Parts of poses that are whitened before they are multiplied: fits the cache.
const CHUNK: usize = 96;

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

impl Chunk {
    /// Writes one part of a pose to slot `b`.
    fn put(&mut self, b: usize, pose: &PoseColumns, layout: &Layout, observation: &Prepared, widths: Widths) {
        let Widths {
            basis,
            own,
            wide,
            apart,
            ..
        } = widths;
        let slot = &mut self.own[3 * wide * b..3 * wide * (b + 1)];
        for (c, v) in pose.own[..own].iter().chain(&pose.joints[..wide - own]).enumerate() {
            slot[c] = v.x;
            slot[wide + c] = v.y;
            slot[2 * wide + c] = v.z;
        }
        let phi = self.phi.iter_mut().take(apart);
        let slots = phi.map(|phi| &mut phi[b * basis..(b + 1) * basis]);
        pose.bases(layout, observation, slots);
        self.white[b] = pose.joints;
    }

    /// Adds the products of the first `count` slots.
    fn add_to(&mut self, out: &mut Sums, count: usize, widths: Widths) {
        let Widths {
            basis,
            own,
            wide,
            apart,
            n,
        } = widths;
        add_product(&mut out.block, &self.own, &self.own, wide, wide, 3 * count);
        for i in 0..apart {
            let wide = widths.joint(i);
            for b in 0..count {
                let slot = &mut self.stack[b * wide..(b + 1) * wide];
                let (cross, rest) = slot.split_at_mut(own);
                let columns = &self.own[3 * own * b..3 * own * (b + 1)];
                let (x, yz) = columns.split_at(own);
                let (y, z) = yz.split_at(own);
                let w = &self.white[b][i];
                for (((c, x), y), z) in cross.iter_mut().zip(x).zip(y).zip(z) {
                    *c = x * w.x + y * w.y + z * w.z;
                }
                for (j, scaled) in (i..n).zip(rest.chunks_exact_mut(basis)) {
                    let s = w.dot(&self.white[b][j]);
                    let phi = &self.phi[j][b * basis..(b + 1) * basis];
                    for (to, from) in scaled.iter_mut().zip(phi) {
                        *to = s * from;
                    }
                }
            }
            add_product(&mut out.joints[i], &self.stack, &self.phi[i], wide, basis, count);
        }
    }
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
        basis, wide, apart, n, ..
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
    let mut filled = 0;
    for &index in members {
        let observation = &prepared[index];
        PoseColumns::each(state, layout, observation, whitening, weights[index], |pose| {
            pose.add_gradient(layout, observation, &mut out.gradient);
            chunk.put(filled, pose, layout, observation, widths);
            filled += 1;
            if filled == CHUNK {
                chunk.add_to(&mut out, filled, widths);
                filled = 0;
            }
        });
    }
    chunk.add_to(&mut out, filled, widths);
    out
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

#[cfg(test)]
#[path = "normal_tests.rs"]
mod tests;
