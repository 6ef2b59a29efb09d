//! Forward kinematics of a robot whose number of joints is known at run time.

use nalgebra::Vector3;
use spherecal_shared::robot::kinematics::frames_into;
use spherecal_shared::robot::{LinkTransform, Pose, Robot, Tool};

/// A robot with its tool, ready for forward kinematics on slices.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    links: Vec<LinkTransform<f64>>,
    tcp: Vector3<f64>,
}

impl Chain {
    /// Compiles a description (which its owner has checked).
    pub(crate) fn new(robot: &Robot, tool: &Tool) -> Self {
        Self {
            links: robot.joints.iter().map(|j| LinkTransform::from(&j.mdh)).collect(),
            tcp: tool.tcp(),
        }
    }

    /// Number of joints.
    pub(crate) fn dof(&self) -> usize {
        self.links.len()
    }

    /// Frames F1..Fn in F0 at `q` (rad).
    pub(crate) fn frames(&self, q: &[f64]) -> Vec<Pose<f64>> {
        let mut frames = vec![Pose::identity(); self.links.len()];
        frames_into(&self.links, q, &mut frames);
        frames
    }

    /// The TCP in F0 for frames of this chain, in m.
    pub(crate) fn tcp_of(&self, frames: &[Pose<f64>]) -> Vector3<f64> {
        frames.last().map_or(self.tcp, |flange| flange.point(&self.tcp))
    }
}
