//! The last frame of a robot's table.

use spherecal_shared::MAX_CHAIN;
use spherecal_shared::robot::kinematics::frames_into;
use spherecal_shared::robot::{LinkTransform, Robot};

use crate::Pose;

/// The frame Fn of a robot's table.
pub(crate) struct Flange(Vec<LinkTransform<f64>>);

impl Flange {
    pub(crate) fn new(robot: &Robot) -> Self {
        Self(robot.joints.iter().map(|j| LinkTransform::from(&j.mdh)).collect())
    }

    /// At joint angles `q` (rad).
    pub(crate) fn at(&self, q: &[f64]) -> Pose<f64> {
        let mut frames = [Pose::identity(); MAX_CHAIN];
        let count = self.0.len().min(q.len()).min(MAX_CHAIN);
        frames_into(&self.0, q, &mut frames[..count]);
        count.checked_sub(1).map_or_else(Pose::identity, |last| frames[last])
    }
}
