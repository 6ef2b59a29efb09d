//! Why a robot cannot be compiled into a chain.

use spherecal_shared::robot::RobotError;

/// A robot or tool that kinematics cannot be computed with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ChainError {
    /// The robot's or the tool's description was refused.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// An arm that cannot take up any orientation at a point.
    #[error("the robot has {found} joints: turning about a sphere takes at least 6")]
    TooFewJoints {
        /// Joints of the description.
        found: usize,
    },
}
