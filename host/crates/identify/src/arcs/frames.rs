//! Base pose and tool from arcs, as Section 4.3 of the paper measures them.
//!
//! Each arc gives one joint axis as a line. The base frame F0 is placed so that the nominal axis 1
//! lies on the measured one, the nominal axis 2 points towards the measured one, and the foot of
//! their common normal on axis 1 (for the iiwa: their intersection) coincides. The flange frame Fn
//! is placed in the same way from the axes of the last joints. The tool is the position of the last
//! arc's points in it, with the phase averaged over the turn.
//!
//! Effects that this method cannot separate stay in the result, as in the paper: deflection under
//! gravity, encoder errors, and geometric errors between the axes used.

use nalgebra::{Matrix3, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::{Robot, Tool};

use super::MeasuredArc;
use super::circle::{Circle, CircleError, fit_circle};
use spherecal_model::{Chain, Pose};

/// Nominal axes closer to each other than this meet in a point, in m.
const CONCURRENT_M: f64 = 1e-6;
/// Axes whose directions differ by less than this (sine) give no frame.
const PARALLEL: f64 = 0.05;

/// Base and tool as measured by arcs. Sigmas are 1 standard deviation of the tracker's noise
/// propagated through the fits; systematic errors of the robot are not included.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredFrames {
    /// Pose of the base frame F0 in the tracker frame (translation in m).
    pub base: Pose,
    /// Standard deviation of the base's position in the tracker frame, in m.
    pub base_sigma_m: [f64; 3],
    /// Standard deviation of the base's rotation about the tracker's axes, in rad.
    pub base_sigma_rad: [f64; 3],
    /// Tool centre point in the flange frame Fn, in m.
    pub tool_m: [f64; 3],
    /// Standard deviation of the tool, in m.
    pub tool_sigma_m: [f64; 3],
    /// Root mean square distance of the points from their circles, in m.
    pub rms_m: f64,
    /// Points that fit no circle and were left out.
    pub outliers: usize,
}

/// Why arcs gave no frames.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LaserError {
    /// An arc is missing.
    #[error("no arc of joint {joint} among the {which} arcs: measure one in which only that joint turns")]
    MissingArc {
        /// The joint, from 1.
        joint: usize,
        /// `base` or `tool`.
        which: &'static str,
    },
    /// An arc could not be fitted.
    #[error("arc of joint {joint}: {source}")]
    Arc {
        /// The joint, from 1.
        joint: usize,
        /// What was wrong with it.
        source: CircleError,
    },
    /// A configuration has the wrong number of joints.
    #[error(
        "arc of joint {joint}: a configuration has {found} angles, the robot {expected} joints: give one per joint"
    )]
    JointCount {
        /// The joint that turned, from 1.
        joint: usize,
        /// Angles found.
        found: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// Two axes are parallel, so that they define no frame.
    #[error(
        "axes {first} and {second} are parallel within 3 degrees: no frame follows from them, state the frame instead"
    )]
    Parallel {
        /// One joint, from 1.
        first: usize,
        /// The other.
        second: usize,
    },
}

/// A joint axis: a line with the sense of positive rotation.
#[derive(Clone, Copy, Debug)]
struct FittedAxis {
    point: Vector3<f64>,
    direction: Vector3<f64>,
}

/// One fitted arc, with the data of its configurations that later steps need.
#[derive(Clone, Debug)]
struct Fitted {
    circle: Circle,
    /// +1 if the circle's normal has the sense of positive rotation, else -1.
    sense: f64,
    /// Angles of the joint that turned, and the points.
    turn: Vec<(f64, Vector3<f64>)>,
    /// Mean of every joint angle over the arc.
    rest: Vec<f64>,
}

impl Fitted {
    fn axis(&self) -> FittedAxis {
        FittedAxis {
            point: self.circle.centre_m,
            direction: self.circle.normal * self.sense,
        }
    }

    /// The arc with its circle displaced by `delta`: centre, tilts, radius.
    fn displaced(&self, delta: &Vector6<f64>) -> Self {
        let mut moved = self.clone();
        let [u, v] = self.circle.plane;
        moved.circle.centre_m += Vector3::new(delta[0], delta[1], delta[2]);
        moved.circle.normal = (self.circle.normal + u * delta[3] + v * delta[4]).normalize();
        moved.circle.radius_m += delta[5];
        moved
    }
}

/// Base pose and tool of `robot` from measured arcs: of joints 1 and 2 for the base, of the last
/// two or three joints for the tool (with the same rest configuration).
///
/// # Errors
/// Missing, short or inconsistent arcs, and parallel axes.
pub fn frames_from_arcs(
    robot: &Robot,
    base_arcs: &[MeasuredArc],
    tool_arcs: &[MeasuredArc],
) -> Result<MeasuredFrames, LaserError> {
    let n = robot.dof();
    let chain = Chain::unchecked(robot, &Tool::default());
    let first = fitted(base_arcs, 1, "base", n)?;
    let second = fitted(base_arcs, 2, "base", n)?;
    let before = fitted(tool_arcs, n.saturating_sub(1), "tool", n)?;
    let last = fitted(tool_arcs, n, "tool", n)?;
    // The third axis from the flange improves the result, but is not required.
    let third = if tool_arcs.iter().any(|a| a.joint + 2 == n) {
        Some(fitted(tool_arcs, n - 2, "tool", n)?)
    } else {
        None
    };
    let base = base_from(&chain, &first, &second)?;
    let tool = tool_from(&chain, third.as_ref(), &before, &last)?;

    let mut base_variance = [0.0; 6];
    let mut tool_variance = [0.0; 3];
    let mut add_base = |moved: &Pose| {
        let shift = moved.position - base.position;
        let turn = small_turn(&(moved.rotation * base.rotation.transpose()));
        for k in 0..3 {
            base_variance[k] += shift[k] * shift[k];
            base_variance[k + 3] += turn[k] * turn[k];
        }
    };
    for delta in deviations(&first) {
        add_base(&base_from(&chain, &first.displaced(&delta), &second)?);
    }
    for delta in deviations(&second) {
        add_base(&base_from(&chain, &first, &second.displaced(&delta))?);
    }
    let mut add_tool = |moved: &Vector3<f64>| {
        for k in 0..3 {
            tool_variance[k] += (moved[k] - tool[k]).powi(2);
        }
    };
    for delta in third.iter().flat_map(deviations) {
        let moved = third.as_ref().map(|t| t.displaced(&delta));
        add_tool(&tool_from(&chain, moved.as_ref(), &before, &last)?);
    }
    for delta in deviations(&before) {
        add_tool(&tool_from(&chain, third.as_ref(), &before.displaced(&delta), &last)?);
    }
    for delta in deviations(&last) {
        add_tool(&tool_from(&chain, third.as_ref(), &before, &last.displaced(&delta))?);
    }

    // Noise along the circle affects only the phase, not the fit.
    let tangent = Vector3::new(-tool.y, tool.x, 0.0) / tool.xy().norm().max(1e-9);
    let along = last.circle.sigma_m.powi(2) / last.turn.len() as f64;
    for k in 0..3 {
        tool_variance[k] += tangent[k] * tangent[k] * along;
    }

    let all = [&first, &second, &before, &last];
    let all = all.into_iter().chain(third.as_ref());
    let (mut sum, mut count, mut outliers) = (0.0, 0usize, 0);
    for fit in all {
        outliers += fit.circle.outliers;
        for (_, p) in &fit.turn {
            let w = p - fit.circle.centre_m;
            let axial = w.dot(&fit.circle.normal);
            let radial = (w - fit.circle.normal * axial).norm() - fit.circle.radius_m;
            sum += axial * axial + radial * radial;
            count += 1;
        }
    }
    let [x, y, z, rx, ry, rz] = base_variance.map(f64::sqrt);
    Ok(MeasuredFrames {
        base,
        base_sigma_m: [x, y, z],
        base_sigma_rad: [rx, ry, rz],
        tool_m: tool.into(),
        tool_sigma_m: tool_variance.map(f64::sqrt),
        rms_m: (sum / count.max(1) as f64).sqrt(),
        outliers,
    })
}

/// Rotation vector of a rotation by a small angle, exact where the angle vanishes.
fn small_turn(r: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]) * 0.5
}

/// Columns of the Cholesky factor of the arc's covariance: independent
/// one-sigma displacements of its circle.
fn deviations(fit: &Fitted) -> Vec<Vector6<f64>> {
    fit.circle
        .covariance
        .cholesky()
        .map(|factor| factor.l().column_iter().map(nalgebra::Matrix::into_owned).collect())
        .unwrap_or_default()
}

/// The arc of `joint` (from 1), fitted.
fn fitted(arcs: &[MeasuredArc], joint: usize, which: &'static str, dof: usize) -> Result<Fitted, LaserError> {
    let arc = arcs
        .iter()
        .find(|a| a.joint == joint && joint >= 1 && joint <= dof)
        .ok_or(LaserError::MissingArc { joint, which })?;
    let mut turn = Vec::with_capacity(arc.measured.len());
    let mut rest = vec![0.0; dof];
    for m in &arc.measured {
        if m.q.len() != dof {
            return Err(LaserError::JointCount {
                joint,
                found: m.q.len(),
                expected: dof,
            });
        }
        for (sum, q) in rest.iter_mut().zip(&m.q) {
            *sum += q / arc.measured.len() as f64;
        }
        turn.push((m.q[joint - 1], Vector3::from(m.point_m)));
    }
    let points: Vec<_> = turn.iter().map(|(_, p)| *p).collect();
    let circle = fit_circle(&points).map_err(|source| LaserError::Arc { joint, source })?;
    // Sum of the signed areas swept about the normal, with the joint's sense.
    let swept: f64 = turn
        .windows(2)
        .map(|pair| {
            let ((qa, a), (qb, b)) = (pair[0], pair[1]);
            let area = (a - circle.centre_m).cross(&(b - circle.centre_m)).dot(&circle.normal);
            area * (qb - qa).signum()
        })
        .sum();
    Ok(Fitted {
        sense: if swept < 0.0 { -1.0 } else { 1.0 },
        circle,
        turn,
        rest,
    })
}

/// Right-handed triad with `z` first and the second axis normal to `z` and `other`.
fn triad(z: &Vector3<f64>, other: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let across = z.cross(other);
    if across.norm() < PARALLEL {
        return None;
    }
    let y = across.normalize();
    Some(Matrix3::from_columns(&[y.cross(z), y, *z]))
}

/// The point of `on` nearest to `to`.
fn foot(on: &FittedAxis, to: &FittedAxis) -> Vector3<f64> {
    let w = to.point - on.point;
    let c = on.direction.dot(&to.direction);
    let along = (w.dot(&on.direction) - c * w.dot(&to.direction)) / (1.0 - c * c);
    on.point + on.direction * along
}

/// The point nearest to several lines, in least squares.
fn meeting(axes: &[FittedAxis]) -> Option<Vector3<f64>> {
    let mut matrix = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for axis in axes {
        let across = Matrix3::identity() - axis.direction * axis.direction.transpose();
        matrix += across;
        right += across * axis.point;
    }
    matrix.try_inverse().map(|inverse| inverse * right)
}

/// F0 in the tracker frame from the axes of joints 1 and 2.
fn base_from(chain: &Chain, first: &Fitted, second: &Fitted) -> Result<Pose, LaserError> {
    let parallel = LaserError::Parallel { first: 1, second: 2 };
    let frames = chain.frames(&second.rest);
    let nominal = |i: usize| FittedAxis {
        point: frames[i].position,
        direction: frames[i].z(),
    };
    let (a, b) = (nominal(0), nominal(1));
    let (ma, mb) = (first.axis(), second.axis());
    let planned = triad(&a.direction, &b.direction).ok_or(parallel.clone())?;
    let seen = triad(&ma.direction, &mb.direction).ok_or(parallel)?;
    let rotation = seen * planned.transpose();
    Ok(Pose {
        rotation,
        position: foot(&ma, &mb) - rotation * foot(&a, &b),
    })
}

/// The tool in Fn from the axes of the last joints.
fn tool_from(
    chain: &Chain,
    third: Option<&Fitted>,
    before: &Fitted,
    last: &Fitted,
) -> Result<Vector3<f64>, LaserError> {
    let n = chain.dof();
    let frames = chain.frames(&before.rest);
    // Nominal axes in Fn at the angle of joint n that the arc of joint n-1 had.
    let flange = frames[n - 1];
    let nominal = |i: usize| FittedAxis {
        point: flange.rotation.transpose() * (frames[i].position - flange.position),
        direction: flange.rotation.transpose() * frames[i].z(),
    };
    let (a, b) = (nominal(n - 1), nominal(n - 2));
    let (ma, mb) = (last.axis(), before.axis());
    let parallel = LaserError::Parallel {
        first: n - 1,
        second: n,
    };
    let planned = triad(&a.direction, &b.direction).ok_or(parallel.clone())?;
    let seen = triad(&ma.direction, &mb.direction).ok_or(parallel)?;
    let rotation = seen * planned.transpose();
    let planned_foot = foot(&a, &b);
    let mut seen_foot = foot(&ma, &mb);
    if let Some(third) = third {
        let c = nominal(n - 3);
        let w = planned_foot - c.point;
        let concurrent = (w - c.direction * w.dot(&c.direction)).norm() < CONCURRENT_M;
        if let Some(point) = meeting(&[ma, mb, third.axis()]).filter(|_| concurrent) {
            seen_foot = ma.point + ma.direction * (point - ma.point).dot(&ma.direction);
        }
    }
    let q_reference = before.rest[n - 1];
    let (x, y) = (rotation.column(0).into_owned(), rotation.column(1).into_owned());
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (q, p) in &last.turn {
        let w = p - last.circle.centre_m;
        let phase = w.dot(&y).atan2(w.dot(&x)) - (q - q_reference);
        cosine += phase.cos();
        sine += phase.sin();
    }
    let phase = sine.atan2(cosine);
    let along = (last.circle.centre_m - seen_foot).dot(&ma.direction);
    Ok(Vector3::new(
        last.circle.radius_m * phase.cos(),
        last.circle.radius_m * phase.sin(),
        planned_foot.z + along,
    ))
}
