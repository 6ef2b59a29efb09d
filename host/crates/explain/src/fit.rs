//! The fit behind a score: base, tool and joint offsets, and on demand the joints' origins.
//!
//! Iterated least squares with weights that fall for far rows (Cauchy's, squared), in the scale of the residuals
//! themselves. Priors are in the same scale, so a hypothesis that fits badly cannot buy offsets.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use spherecal_model::chain::rotation_vector;
use spherecal_model::robots::frames::compose;
use spherecal_model::robots::{JointKind, JointPath, Twist};
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
    /// Joint offsets.
    pub(crate) offsets: bool,
    /// Origins of the joints.
    pub(crate) origins: bool,
    /// Standard deviation of the TCP, in m.
    pub(crate) tool_m: f64,
    /// Most iterations.
    pub(crate) iterations: usize,
}

/// A robot with what was fitted.
#[derive(Clone, Debug)]
pub(crate) struct Fitted {
    /// Median distance of the TCP from its targets (with orientations, of both), in m.
    pub(crate) median_m: f64,
    /// TCP in the flange frame, in m.
    pub(crate) tool: Vector3<f64>,
    pub(crate) state: State,
}

/// A robot, its base and its tool as fitted.
#[derive(Clone, Debug)]
pub(crate) struct State {
    path: JointPath,
    offsets: Vec<f64>,
    tool: Vector3<f64>,
    /// Rotation of the measured body in the flange frame.
    body: Matrix3<f64>,
    bases: Vec<Pose<f64>>,
}

/// A rotation vector as a rotation.
fn turn(vector: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::new(*vector).into_inner()
}

impl State {
    fn frames(&self, row: &Row) -> spherecal_model::robots::PathFrames {
        let mut q = self.path.positions(&row.q);
        for (q, offset) in q.iter_mut().zip(&self.offsets) {
            *q += offset;
        }
        self.path.frames(&q)
    }

    /// Where the TCP is for joint columns, in the frame of group 0 (m); with `slides` at zero if they are not wanted.
    pub(crate) fn tcp(&self, columns: &[f64], slides: bool) -> Vector3<f64> {
        let mut q = self.path.positions(columns);
        for ((q, offset), joint) in q.iter_mut().zip(&self.offsets).zip(&self.path.joints) {
            let zero = joint.kind == JointKind::Slides && !slides;
            *q = if zero { 0.0 } else { *q + offset };
        }
        let at = self.path.frames(&q).tip.point(&self.tool);
        self.bases.first().map_or(at, |base| base.point(&at))
    }

    /// Directions of the sliding joints with all columns at zero, base to tip, in the frame of group 0.
    pub(crate) fn slides(&self) -> Vec<Vector3<f64>> {
        let mut q = self.path.positions(&[]);
        for (q, offset) in q.iter_mut().zip(&self.offsets) {
            *q += offset;
        }
        let frames = self.path.frames(&q);
        let joints = self.path.joints.iter().zip(&frames.before);
        let slides = joints.filter(|(joint, _)| joint.kind == JointKind::Slides);
        let base = self.bases.first().map_or_else(Matrix3::identity, |base| base.rotation);
        slides
            .map(|(joint, frame)| base * (frame.rotation * joint.axis))
            .collect()
    }

    /// Residuals of a row: of the position in m, and of the orientation in rad.
    fn residual(&self, row: &Row, tip: &Pose<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let base = &self.bases[row.group];
        let at = base.point(&tip.point(&self.tool));
        let turned = row.turn.map_or_else(Vector3::zeros, |measured| {
            rotation_vector(&Rotation3::from_matrix_unchecked(
                measured * (base.rotation * tip.rotation * self.body).transpose(),
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

    /// Places every group by its points, and the body by its orientations.
    fn place(&mut self, rows: &[Row]) {
        for group in 0..self.bases.len() {
            let of = || rows.iter().filter(|r| r.group == group);
            let from: Vec<_> = of().map(|r| self.frames(r).tip.point(&self.tool)).collect();
            let onto: Vec<_> = of().map(|r| r.at).collect();
            if let Some(pose) = fit_pose(&from, &onto) {
                self.bases[group] = pose;
            }
        }
        let mut sum = Matrix3::zeros();
        for row in rows {
            if let Some(measured) = row.turn {
                sum += (self.bases[row.group].rotation * self.frames(row).tip.rotation).transpose() * measured;
            }
        }
        let svd = sum.svd(true, true);
        if let (Some(u), Some(vt)) = (svd.u, svd.v_t) {
            let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * vt).determinant().signum()));
            self.body = u * flip * vt;
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
        self.tool += three(k);
        self.body *= turn(&three(k + 3));
        k += 6;
        if effort.offsets {
            for offset in &mut self.offsets {
                *offset += step[k];
                k += 1;
            }
        }
        if effort.origins {
            for joint in &mut self.path.joints {
                let own = Pose {
                    rotation: turn(&three(k + 3)),
                    position: three(k),
                };
                joint.origin = compose(&joint.origin, &own);
                k += 6;
            }
        }
    }
}

/// Fits a path with its TCP to rows.
pub(crate) fn fit(path: &JointPath, tool: &Vector3<f64>, rows: &[Row], effort: Effort) -> Fitted {
    let n = path.joints.len();
    let groups = rows.iter().map(|r| r.group + 1).max().unwrap_or(0);
    let mut state = State {
        path: path.clone(),
        offsets: vec![0.0; n],
        tool: *tool,
        body: Matrix3::identity(),
        bases: vec![Pose::identity(); groups],
    };
    state.place(rows);
    let size = 6 * groups + 6 + if effort.offsets { n } else { 0 } + if effort.origins { 6 * n } else { 0 };
    // What was added to each parameter that has a prior, and the prior's standard deviation.
    let mut sigma = DVector::from_element(size, f64::INFINITY);
    let at = 6 * groups;
    sigma.rows_mut(at, 3).fill(effort.tool_m);
    if effort.offsets {
        sigma.rows_mut(at + 6, n).fill(OFFSET_RAD);
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
        tool: best.1.tool,
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
    let n = state.path.joints.len();
    let shared = 6 * state.bases.len();
    let mut normal = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    let mut columns: Vec<(usize, Twist)> = Vec::with_capacity(size);
    for (row, distance) in rows.iter().zip(distances) {
        let frames = state.frames(row);
        let base = &state.bases[row.group];
        let inner = frames.tip.point(&state.tool);
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
                shared + k,
                out(Twist {
                    linear: axis,
                    angular: Vector3::zeros(),
                }),
            ));
            if row.turn.is_some() {
                let body: Vector3<f64> = (frames.tip.rotation * state.body).column(k).into();
                columns.push((
                    shared + 3 + k,
                    out(Twist {
                        linear: Vector3::zeros(),
                        angular: body,
                    }),
                ));
            }
        }
        let mut next = shared + 6;
        if effort.offsets {
            for k in 0..n {
                columns.push((next + k, out(state.path.joint_column(&frames, k, &inner))));
            }
            next += n;
        }
        if effort.origins {
            for k in 0..n {
                let six = state.path.origin_columns(&frames, k, &inner);
                columns.extend(six.into_iter().enumerate().map(|(m, t)| (next + 6 * k + m, out(t))));
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
