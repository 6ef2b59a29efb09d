//! What a viewer needs to draw the arm without any set-up: the robot's description, and its frames
//! over time.
//!
//! | topic | type | message |
//! |---|---|---|
//! | `/tf` | [`FrameTransforms`] | every frame in its parent frame, 20 times a second |
//! | `/robot_description` | [`RobotDescription`] | the URDF of the nominal robot, once |

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use spherecal_model::chain::Chain;
use spherecal_model::robots::{FrameTree, RobotModel, write_urdf};
use spherecal_shared::protocol::host::Sample;
use spherecal_shared::robot::Tool;

use super::messages::{Stamp, TelemetryMessage};
use super::quaternion::{Quaternion, rounded};
use crate::force::{ForceSense, WrenchError};

/// The nominal robot with its tool, as telemetry describes it.
#[derive(Clone, Debug)]
pub struct DrawnArm {
    /// Its frames.
    pub(super) frames: FrameTree,
    /// Its description.
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

    /// Rotation of the TCP's frame in F0 at joint angles `q` (rad).
    pub(super) fn tcp_orientation(&self, q: &[f64]) -> Quaternion {
        Quaternion::from(self.chain.pose(q).rotation.matrix())
    }

    /// All transforms at joint angles `q` (rad).
    pub(super) fn transforms<'a>(&'a self, timestamp: Stamp, q: &'a [f64]) -> FrameTransforms<'a> {
        let one = |frame: spherecal_model::robots::FrameInParent<'a>| FrameTransform {
            timestamp,
            parent_frame_id: frame.parent.into(),
            child_frame_id: frame.child.into(),
            translation: Translation::from(frame.pose.position),
            rotation: Quaternion::from(&frame.pose.rotation),
        };
        FrameTransforms {
            transforms: self.frames.transforms(q).map(one).collect(),
        }
    }
}

/// The shape of `foxglove.FrameTransforms`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameTransforms<'a> {
    /// One for each frame but the root.
    pub transforms: Vec<FrameTransform<'a>>,
}

/// One frame in its parent frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameTransform<'a> {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// Name of the parent frame.
    pub parent_frame_id: Cow<'a, str>,
    /// Name of the frame.
    pub child_frame_id: Cow<'a, str>,
    /// Origin of the frame, in m.
    pub translation: Translation,
    /// Its axes.
    pub rotation: Quaternion,
}

/// A position, in m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Translation {
    /// Along the parent's x.
    pub x: f64,
    /// Along the parent's y.
    pub y: f64,
    /// Along the parent's z.
    pub z: f64,
}

impl From<nalgebra::Vector3<f64>> for Translation {
    fn from(v: nalgebra::Vector3<f64>) -> Self {
        let [x, y, z] = [v.x, v.y, v.z].map(rounded);
        Self { x, y, z }
    }
}

impl TelemetryMessage for FrameTransforms<'_> {
    const TOPIC: &'static str = "/tf";
    const SCHEMA: &'static str = "foxglove.FrameTransforms";
    fn properties() -> Value {
        let number = json!({ "type": "number" });
        let transform = json!({ "type": "object", "title": "foxglove.FrameTransform", "properties": {
            "timestamp": Stamp::schema(),
            "parent_frame_id": { "type": "string" }, "child_frame_id": { "type": "string" },
            "translation": { "type": "object", "title": "foxglove.Vector3",
                             "properties": { "x": number, "y": number, "z": number } },
            "rotation": { "type": "object", "title": "foxglove.Quaternion",
                          "properties": { "x": number, "y": number, "z": number, "w": number } } } });
        json!({ "transforms": { "type": "array", "items": transform } })
    }
}

/// The description of the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotDescription<'a> {
    /// A URDF.
    pub data: Cow<'a, str>,
}

impl TelemetryMessage for RobotDescription<'_> {
    const TOPIC: &'static str = "/robot_description";
    const SCHEMA: &'static str = "std_msgs/String";
    fn properties() -> Value {
        json!({ "data": { "type": "string" } })
    }
}
