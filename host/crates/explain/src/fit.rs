//! The fit behind a score: base, tool and joint offsets, and on demand the joints' origins. Several chains of one tree are
//! fitted together: the joints with which all begin, their *trunk*, are fitted once.
//!
//! Iterated least squares with weights that fall for far rows (Cauchy's, squared), in the scale of the residuals
//! themselves. Priors are in the same scale, so a hypothesis that fits badly cannot buy offsets.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use spherecal_model::chain::rotation_vector;
use spherecal_model::robots::frames::compose;
use spherecal_model::robots::{JointPath, PathFrames, Twist};
use spherecal_model::statistics::median;
use spherecal_model::{Pose, fit_pose};

use crate::rows::Row;

/// Standard deviation of a joint's offset, in rad: that of an arm without a factory calibration.
const OFFSET_RAD: f64 = 0.02;
/// Standard deviations of an origin, in m and rad.
const ORIGIN: (f64, f64) = (2e-3, 5e-3);
/// An error of an orientation by 1 rad counts as this many metres.
const LEVER_M: f64 = 0.2;
/// Smallest scale of the residuals, in m.
const LEAST_M: f64 = 2e-5;
/// Largest turn of one step, in rad.
const STEP_RAD: f64 = 0.5;

/// What is fitted, and how often.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Effort {
    pub(crate) offsets: bool,
    pub(crate) origins: bool,
    /// Standard deviation of the TCP, in m.
    pub(crate) tool_m: f64,
    pub(crate) iterations: usize,
}

#[derive(Clone, Debug)]
pub(crate) struct Fitted {
    /// Median distance of the TCP from its targets (with orientations, of both), in m.
    pub(crate) median_m: f64,
    /// TCP of the first chain in its flange frame, in m.
    pub(crate) tool: Vector3<f64>,
    pub(crate) state: State,
}

/// A chain and its tool as fitted.
#[derive(Clone, Debug)]
pub(crate) struct Limb {
    pub(crate) path: JointPath,
    /// How many joints all chains have in common, from the first.
    trunk: usize,
    /// Number of its first joint behind the trunk, among the joints of all chains.
    first: usize,
    /// TCP in the flange frame, in m.
    pub(crate) tool: Vector3<f64>,
    /// Rotation of the measured body in the flange frame.
    body: Matrix3<f64>,
}

impl Limb {
    /// Number of its joint `k` among the joints of all chains.
    fn number(&self, k: usize) -> usize {
        if k < self.trunk { k } else { self.first + k - self.trunk }
    }
}

/// A robot, its base and its tools as fitted.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) limbs: Vec<Limb>,
    /// Of all joints: those of the trunk, then those of each chain.
    offsets: Vec<f64>,
    pub(crate) bases: Vec<Pose<f64>>,
}

fn turn(vector: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::new(*vector).into_inner()
}

impl State {
    /// Positions (rad, m) of a chain's joints for joint columns.
    pub(crate) fn positions(&self, limb: &Limb, columns: &[f64]) -> Vec<f64> {
        let mut q = limb.path.positions(columns);
        for (k, q) in q.iter_mut().enumerate() {
            *q += self.offset(limb, k);
        }
        q
    }

    /// The offset of a joint of a chain, in rad or m.
    pub(crate) fn offset(&self, limb: &Limb, k: usize) -> f64 {
        self.offsets.get(limb.number(k)).copied().unwrap_or_default()
    }

    fn limb(&self, row: &Row) -> &Limb {
        &self.limbs[row.limb]
    }

    fn frames(&self, row: &Row) -> PathFrames {
        let limb = self.limb(row);
        limb.path.frames(&self.positions(limb, &row.q))
    }

    /// Residuals of a row: of the position in m, and of the orientation in rad.
    fn residual(&self, row: &Row, tip: &Pose<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let (base, limb) = (&self.bases[row.group], self.limb(row));
        let at = base.point(&tip.point(&limb.tool));
        let turned = row.turn.map_or_else(Vector3::zeros, |measured| {
            rotation_vector(&Rotation3::from_matrix_unchecked(
                measured * (base.rotation * tip.rotation * limb.body).transpose(),
            ))
        });
        (row.at - at, turned)
    }

    fn distances(&self, rows: &[Row]) -> Vec<f64> {
        let one = |row: &Row| {
            let (at, turned) = self.residual(row, &self.frames(row).tip);
            at.norm().hypot(LEVER_M * turned.norm())
        };
        rows.iter().map(one).collect()
    }

    /// Places every group by its points, and the bodies by their orientations.
    fn place(&mut self, rows: &[Row]) {
        for group in 0..self.bases.len() {
            let of = || rows.iter().filter(|r| r.group == group);
            let from: Vec<_> = of().map(|r| self.frames(r).tip.point(&self.limb(r).tool)).collect();
            let onto: Vec<_> = of().map(|r| r.at).collect();
            if let Some(pose) = fit_pose(&from, &onto) {
                self.bases[group] = pose;
            }
        }
        for number in 0..self.limbs.len() {
            let mut sum = Matrix3::zeros();
            for row in rows.iter().filter(|row| row.limb == number) {
                if let Some(measured) = row.turn {
                    sum += (self.bases[row.group].rotation * self.frames(row).tip.rotation).transpose() * measured;
                }
            }
            let svd = sum.svd(true, true);
            if let (Some(u), Some(vt)) = (svd.u, svd.v_t) {
                let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * vt).determinant().signum()));
                self.limbs[number].body = u * flip * vt;
            }
        }
    }

    /// Takes a step of all parameters, in the order of `columns`.
    fn step(&mut self, step: &DVector<f64>, effort: Effort) {
        let three = |k: usize| Vector3::new(step[k], step[k + 1], step[k + 2]);
        let mut k = 0;
        for base in &mut self.bases {
            base.position += three(k);
            base.rotation = turn(&three(k + 3)) * base.rotation;
            k += 6;
        }
        for limb in &mut self.limbs {
            limb.tool += three(k);
            limb.body *= turn(&three(k + 3));
            k += 6;
        }
        if effort.offsets {
            for offset in &mut self.offsets {
                *offset += step[k];
                k += 1;
            }
        }
        if effort.origins {
            for limb in &mut self.limbs {
                for j in 0..limb.path.joints.len() {
                    let at = k + 6 * limb.number(j);
                    let own = Pose {
                        rotation: turn(&three(at + 3)),
                        position: three(at),
                    };
                    let joint = &mut limb.path.joints[j];
                    joint.origin = compose(&joint.origin, &own);
                }
            }
        }
    }
}

pub(crate) fn fit(path: &JointPath, tool: &Vector3<f64>, rows: &[Row], effort: Effort) -> Fitted {
    fit_limbs(&[(path, *tool)], 0, rows, effort)
}

/// Fits chains with their TCPs to rows of each; all begin with the same `trunk` joints.
pub(crate) fn fit_limbs(chains: &[(&JointPath, Vector3<f64>)], trunk: usize, rows: &[Row], effort: Effort) -> Fitted {
    let groups = rows.iter().map(|r| r.group + 1).max().unwrap_or(0);
    let mut n = trunk;
    let limb = |(path, tool): &(&JointPath, Vector3<f64>)| {
        let first = n;
        n += path.joints.len().saturating_sub(trunk);
        Limb {
            path: JointPath::clone(path),
            trunk,
            first,
            tool: *tool,
            body: Matrix3::identity(),
        }
    };
    let limbs: Vec<Limb> = chains.iter().map(limb).collect();
    let tools = 6 * limbs.len();
    let mut state = State {
        limbs,
        offsets: vec![0.0; n],
        bases: vec![Pose::identity(); groups],
    };
    state.place(rows);
    let size = 6 * groups + tools + if effort.offsets { n } else { 0 } + if effort.origins { 6 * n } else { 0 };
    // What was added to each parameter that has a prior, and the prior's standard deviation.
    let mut sigma = DVector::from_element(size, f64::INFINITY);
    let at = 6 * groups;
    for k in 0..chains.len() {
        sigma.rows_mut(at + 6 * k, 3).fill(effort.tool_m);
    }
    if effort.offsets {
        sigma.rows_mut(at + tools, n).fill(OFFSET_RAD);
    }
    if effort.origins {
        let first = size - 6 * n;
        for k in 0..6 * n {
            sigma[first + k] = if k % 6 < 3 { ORIGIN.0 } else { ORIGIN.1 };
        }
    }
    let mut added = DVector::<f64>::zeros(size);
    let mut distances = state.distances(rows);
    let mut best = (median(distances.clone()), state.clone());
    for _ in 0..effort.iterations {
        let scale = median(distances.clone()).max(LEAST_M);
        let (mut normal, mut right) = equations(&state, rows, &distances, scale, effort, size);
        for k in 0..size {
            let weight = sigma[k].powi(-2);
            // What nothing determines stays where it is.
            normal[(k, k)] += weight + 1e-6 / (1.0 + scale * scale);
            right[k] -= weight * added[k];
        }
        let Some(mut step) = normal.cholesky().map(|c| c.solve(&right)) else {
            break;
        };
        let largest = step.amax();
        if !largest.is_finite() {
            break;
        }
        if largest > STEP_RAD {
            step *= STEP_RAD / largest;
        }
        state.step(&step, effort);
        added += &step;
        distances = state.distances(rows);
        let score = median(distances.clone());
        let before = best.0;
        if score < before {
            best = (score, state.clone());
        }
        if step.amax() < 1e-7 || (score - before).abs() < 1e-3 * before && largest < 1e-3 {
            break;
        }
    }
    Fitted {
        median_m: best.0,
        tool: best.1.limbs.first().map_or_else(Vector3::zeros, |limb| limb.tool),
        state: best.1,
    }
}

/// Normal equations at a state, in units of `scale`.
fn equations(
    state: &State,
    rows: &[Row],
    distances: &[f64],
    scale: f64,
    effort: Effort,
    size: usize,
) -> (DMatrix<f64>, DVector<f64>) {
    let tools = 6 * state.bases.len();
    let mut normal = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    let mut columns: Vec<(usize, Twist)> = Vec::with_capacity(size);
    for (row, distance) in rows.iter().zip(distances) {
        let frames = state.frames(row);
        let (base, limb) = (&state.bases[row.group], state.limb(row));
        let inner = frames.tip.point(&limb.tool);
        let (at, turned) = state.residual(row, &frames.tip);
        columns.clear();
        // A twist of the arm, seen from the row's frame.
        let out = |t: Twist| Twist {
            linear: base.rotation * t.linear,
            angular: base.rotation * t.angular,
        };
        let unit = |k: usize| Vector3::from_fn(|r, _| f64::from(r == k));
        let lever = base.rotation * inner;
        for k in 0..3 {
            let first = 6 * row.group + k;
            columns.push((
                first,
                Twist {
                    linear: unit(k),
                    angular: Vector3::zeros(),
                },
            ));
            columns.push((
                first + 3,
                Twist {
                    linear: unit(k).cross(&lever),
                    angular: unit(k),
                },
            ));
            let axis: Vector3<f64> = frames.tip.rotation.column(k).into();
            columns.push((
                tools + 6 * row.limb + k,
                out(Twist {
                    linear: axis,
                    angular: Vector3::zeros(),
                }),
            ));
            if row.turn.is_some() {
                let body: Vector3<f64> = (frames.tip.rotation * limb.body).column(k).into();
                columns.push((
                    tools + 6 * row.limb + 3 + k,
                    out(Twist {
                        linear: Vector3::zeros(),
                        angular: body,
                    }),
                ));
            }
        }
        let mut next = tools + 6 * state.limbs.len();
        let joints = || (0..limb.path.joints.len()).map(|k| (k, limb.number(k)));
        if effort.offsets {
            for (k, number) in joints() {
                columns.push((next + number, out(limb.path.joint_column(&frames, k, &inner))));
            }
            next += state.offsets.len();
        }
        if effort.origins {
            for (k, number) in joints() {
                let six = limb.path.origin_columns(&frames, k, &inner);
                columns.extend(
                    six.into_iter()
                        .enumerate()
                        .map(|(m, t)| (next + 6 * number + m, out(t))),
                );
            }
        }
        let weight = (1.0 + (distance / (3.0 * scale)).powi(2)).powi(-2) / (scale * scale);
        let turn_weight = if row.turn.is_some() {
            weight * LEVER_M * LEVER_M
        } else {
            0.0
        };
        for (i, (a, left)) in columns.iter().enumerate() {
            right[*a] += weight * left.linear.dot(&at) + turn_weight * left.angular.dot(&turned);
            for (b, other) in &columns[i..] {
                let value = weight * left.linear.dot(&other.linear) + turn_weight * left.angular.dot(&other.angular);
                normal[(*a, *b)] += value;
                if a != b {
                    normal[(*b, *a)] += value;
                }
            }
        }
    }
    (normal, right)
}
