//! What a viewer needs to draw the arm without any set-up: the robot's description, and its frames
//! over time.
//!
//! | topic | type | message |
//! |---|---|---|
//! | `/tf` | [`FrameTransforms`] | every frame in its parent frame, 10 times a second |
//! | `/robot_description` | [`RobotDescription`] | the URDF of the nominal robot, once |

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use spherecal_model::chain::Chain;
use spherecal_model::robots::{FrameTree, RobotModel, write_urdf};
use spherecal_shared::protocol::host::Sample;
use spherecal_shared::robot::Tool;

use super::messages::{Quaternion, Xyz};
use super::ros::{Header, RosMessage};
use crate::force::{ForceSense, WrenchError};

/// The nominal robot with its tool, as telemetry describes it.
#[derive(Clone, Debug)]
pub struct DrawnArm {
    pub(super) frames: FrameTree,
    pub(super) urdf: String,
    chain: Chain,
    sense: ForceSense,
}

impl DrawnArm {
    /// The robot with `tool`, which is given in the last frame of the robot's table.
    pub fn new(model: &RobotModel, tool: &Tool) -> Self {
        Self {
            frames: model.frame_tree(tool),
            urdf: write_urdf(model, &model.rows(), &[]),
            chain: Chain::unchecked(&model.robot, tool),
            sense: ForceSense::new(&model.robot, tool),
        }
    }

    /// Joint angles (rad) of a sample.
    pub(super) fn angles(&self, sample: &Sample) -> Vec<f64> {
        sample.q.iter().take(self.chain.dof()).map(|q| f64::from(*q)).collect()
    }

    /// How well the torques of a sample tell its wrench.
    pub(super) fn wrench_error(&self, sample: &Sample) -> WrenchError {
        self.sense.error(sample)
    }

    /// All transforms at joint angles `q` (rad).
    pub(super) fn transforms<'a>(&'a self, utc_ns: u64, q: &'a [f64]) -> FrameTransforms<'a> {
        let one = |frame: spherecal_model::robots::FrameInParent<'a>| TransformStamped {
            header: Header::new(utc_ns, frame.parent),
            child_frame_id: frame.child.into(),
            translation: Xyz::position(frame.pose.position),
            rotation: Quaternion::from(&frame.pose.rotation),
        };
        FrameTransforms {
            transforms: self.frames.transforms(q).map(one).collect(),
        }
    }
}

/// The frames of the arm: `tf2_msgs/msg/TFMessage`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameTransforms<'a> {
    /// One for each frame but the root.
    pub transforms: Vec<TransformStamped<'a>>,
}

/// One frame in its parent frame: `geometry_msgs/msg/TransformStamped`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped<'a> {
    /// Time, and name of the parent frame.
    pub header: Header<'a>,
    /// Name of the frame.
    pub child_frame_id: Cow<'a, str>,
    /// Origin of the frame, in m.
    pub translation: Xyz,
    /// Its axes.
    pub rotation: Quaternion,
}

impl RosMessage for FrameTransforms<'_> {
    const TOPIC: &'static str = "/tf";
    const TYPE: &'static str = "tf2_msgs/msg/TFMessage";
    const FIELDS: &'static str = "geometry_msgs/TransformStamped[] transforms\n";
}

/// The description of the robot: `std_msgs/msg/String`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotDescription<'a> {
    /// A URDF.
    pub data: Cow<'a, str>,
}

impl RosMessage for RobotDescription<'_> {
    const TOPIC: &'static str = "/robot_description";
    const TYPE: &'static str = "std_msgs/msg/String";
    const FIELDS: &'static str = "string data\n";
}
