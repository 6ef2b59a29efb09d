//! The workspace of a robot, and displacements over it.

use nalgebra::{DMatrix, Vector3};
use spherecal_model::halton::halton;
use spherecal_shared::robot::kinematics::frames_into;
use spherecal_shared::robot::{LinkTransform, Pose as Frame, Robot, Tool};

use crate::dense::transposed_product;

/// Configurations of a workspace.
pub const WORKSPACE: usize = 200;

/// The workspace of a robot with its tool: joint angles (rad) of 200 configurations.
///
/// They are spread evenly over 95 % of each joint's range (at most half a turn
/// either way), and kept where the TCP is in front of the arm: x from -0.05 to
/// 1.0 m, y within 0.6 m, z from 0.13 to 1.15 m, scaled by the arm's reach over
/// 1.4 m. That is the box of the paper's Table 4 for any arm.
pub fn workspace(robot: &Robot, tool: &Tool) -> Vec<Vec<f64>> {
    let links: Vec<LinkTransform<f64>> = robot.joints.iter().map(|j| LinkTransform::from(&j.mdh)).collect();
    let mut frames = vec![Frame::identity(); links.len()];
    let mut tcp = |q: &[f64]| -> Vector3<f64> { frames_into(&links, q, &mut frames).point(&tool.tcp()) };
    let configuration = |k: usize| -> Vec<f64> {
        let joint = |(j, of): (usize, &spherecal_shared::robot::Joint)| {
            let l = &of.limits;
            let middle = 0.5 * (l.min_rad + l.max_rad);
            let half = (0.5 * (l.max_rad - l.min_rad)).min(core::f64::consts::PI);
            middle + 0.95 * half * (2.0 * halton(k, j) - 1.0)
        };
        robot.joints.iter().enumerate().map(joint).collect()
    };
    let reach = (1..=500).map(|k| tcp(&configuration(k)).norm()).fold(0.1, f64::max);
    let scale = reach / 1.4;
    let inside = |p: &Vector3<f64>| {
        (-0.05..=1.0).contains(&(p.x / scale)) && (p.y / scale).abs() <= 0.6 && (0.13..=1.15).contains(&(p.z / scale))
    };
    let found: Vec<Vec<f64>> = (1..20_000)
        .map(configuration)
        .filter(|q| inside(&tcp(q)))
        .take(WORKSPACE)
        .collect();
    if found.len() == WORKSPACE {
        return found;
    }
    // An arm that hardly comes before its base: anywhere in its joint ranges.
    (1..=WORKSPACE).map(configuration).collect()
}

/// Takes the best-fitting rigid motion of all points out of displacements.
#[derive(Clone, Debug)]
pub(crate) struct Rigid {
    basis: DMatrix<f64>,
}

impl Rigid {
    pub(crate) fn new(points: &[Vector3<f64>]) -> Self {
        let mut b = DMatrix::zeros(3 * points.len(), 6);
        let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        for (k, p) in points.iter().enumerate() {
            for axis in 0..3 {
                let e: Vector3<f64> = Vector3::ith(axis, 1.0);
                b[(3 * k + axis, axis)] = 1.0;
                let turn = e.cross(&(p - middle));
                for i in 0..3 {
                    b[(3 * k + i, 3 + axis)] = turn[i];
                }
            }
        }
        Self { basis: b.qr().q() }
    }

    /// Mean length of displacements (m) without the motion.
    pub(crate) fn mean_without(&self, moved: &[Vector3<f64>]) -> f64 {
        let mut columns = stacked(moved);
        self.remove(&mut columns);
        let lengths = columns
            .as_slice()
            .chunks_exact(3)
            .map(|v| Vector3::from_column_slice(v).norm());
        lengths.sum::<f64>() / moved.len().max(1) as f64
    }

    /// Removes the motion from each column.
    pub(crate) fn remove(&self, columns: &mut DMatrix<f64>) {
        let share = transposed_product(&self.basis, columns);
        columns.gemm(-1.0, &self.basis, &share, 1.0);
    }
}

/// Displacements as one column, 3n.
pub(crate) fn stacked(moved: &[Vector3<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(3 * moved.len(), 1, |r, _| moved[r / 3][r % 3])
}
