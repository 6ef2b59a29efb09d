//! The signals of a telemetry file. The writer and the reader use these types, and no other
//! description of a message exists. [`scene`](super::scene) has the frames of the arm,
//! [`log`](super::log) what happened.
//!
//! | topic | type | message |
//! |---|---|---|
//! | `/joint_states` | [`JointStates`] | names, position (rad), velocity (rad/s), effort (measured, N m), command (N m) |
//! | `/wrench` | [`StampedWrench`] | estimated force (N) and torque (N m) of the environment at the TCP, axes of F0 |
//! | `/tcp` | [`Tcp`] | computed TCP with its orientation, and commanded position, in F0 (m) |
//! | `/phase` | [`PhaseState`] | phase of the procedure, by name and number, flags, and device time |
//!
//! Times are UTC; the module `utc` ties them to device time.
//!
//! The fields follow `sensor_msgs/JointState`, `geometry_msgs/WrenchStamped` and
//! `foxglove.PoseInFrame`, so that panels made for those find them. JSON has no
//! NaN: a number that is not finite is written as `null` and read as NaN.

use std::borrow::Cow;

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Value, json};
use spherecal_shared::protocol::host::{Phase, Sample};

use super::quaternion::Quaternion;
use crate::force::WrenchError;

/// A message type of the telemetry file.
pub(super) trait TelemetryMessage: Serialize {
    /// Topic of its channel.
    const TOPIC: &'static str;
    /// Name of its schema.
    const SCHEMA: &'static str;
    /// The properties of its JSON Schema.
    fn properties() -> Value;

    /// Its JSON Schema.
    fn schema() -> Value {
        json!({ "$schema": "https://json-schema.org/draft/2020-12/schema", "title": Self::SCHEMA, "type": "object",
                "properties": Self::properties() })
    }
}

/// A time, since 1970 (UTC) or since the controller's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Whole seconds.
    pub sec: u64,
    /// The rest, in ns.
    pub nsec: u32,
}

impl Stamp {
    /// From a time in ns.
    pub const fn from_ns(time_ns: u64) -> Self {
        Self {
            sec: time_ns / 1_000_000_000,
            nsec: (time_ns % 1_000_000_000) as u32,
        }
    }

    /// The time, in ns.
    pub const fn time_ns(&self) -> u64 {
        self.sec.saturating_mul(1_000_000_000).saturating_add(self.nsec as u64)
    }

    pub(super) fn schema() -> Value {
        json!({ "type": "object", "title": "time",
                "properties": { "sec": { "type": "integer" }, "nsec": { "type": "integer" } } })
    }
}

/// A vector along the axes of F0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Xyz {
    /// Along x.
    #[serde(deserialize_with = "number")]
    pub x: f32,
    /// Along y.
    #[serde(deserialize_with = "number")]
    pub y: f32,
    /// Along z.
    #[serde(deserialize_with = "number")]
    pub z: f32,
}

impl From<[f32; 3]> for Xyz {
    fn from([x, y, z]: [f32; 3]) -> Self {
        Self { x, y, z }
    }
}

impl Xyz {
    fn schema() -> Value {
        json!({ "type": "object", "properties": {
                "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" } } })
    }
}

/// The state of all joints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointStates<'a> {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// Names of the joints, base to flange.
    pub name: Cow<'a, [String]>,
    /// Joint angles, in rad.
    #[serde(deserialize_with = "numbers")]
    pub position: Cow<'a, [f32]>,
    /// Joint velocities, in rad/s.
    #[serde(deserialize_with = "numbers")]
    pub velocity: Cow<'a, [f32]>,
    /// Measured torques, in N m.
    #[serde(deserialize_with = "numbers")]
    pub effort: Cow<'a, [f32]>,
    /// Commanded torques, in N m.
    #[serde(deserialize_with = "numbers")]
    pub command: Cow<'a, [f32]>,
}

impl<'a> JointStates<'a> {
    /// From a sample of an arm with the named joints.
    pub(super) fn new(timestamp: Stamp, names: &'a [String], sample: &'a Sample) -> Self {
        let n = names.len().min(sample.q.len());
        Self {
            timestamp,
            name: names.into(),
            position: sample.q[..n].into(),
            velocity: sample.dq[..n].into(),
            effort: sample.tau[..n].into(),
            command: sample.command[..n].into(),
        }
    }
}

impl TelemetryMessage for JointStates<'_> {
    const TOPIC: &'static str = "/joint_states";
    const SCHEMA: &'static str = "sensor_msgs/JointState";
    fn properties() -> Value {
        let numbers = json!({ "type": "array", "items": { "type": "number" } });
        json!({ "timestamp": Stamp::schema(), "name": { "type": "array", "items": { "type": "string" } },
                "position": numbers, "velocity": numbers, "effort": numbers, "command": numbers })
    }
}

/// Estimated force and torque of the environment on the arm at the TCP.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StampedWrench<'a> {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// Name of the frame whose axes are used.
    pub frame_id: Cow<'a, str>,
    /// Magnitude of the force, in N.
    #[serde(deserialize_with = "number")]
    pub magnitude: f32,
    /// Force and torque.
    pub wrench: ForceTorque,
    /// Their standard uncertainties, from the errors of the torque sensors; older files have none.
    #[serde(default)]
    pub uncertainty: Option<ForceTorque>,
}

/// A force and a torque.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForceTorque {
    /// Force, in N.
    pub force: Xyz,
    /// Torque about the TCP, in N m.
    pub torque: Xyz,
}

impl<'a> StampedWrench<'a> {
    /// From a sample and how well its torques tell the wrench; `f0` is the name of F0.
    pub(super) fn new(timestamp: Stamp, f0: &'a str, sample: &Sample, error: &WrenchError) -> Self {
        Self {
            timestamp,
            frame_id: f0.into(),
            magnitude: length(sample.force_n),
            wrench: ForceTorque {
                force: sample.force_n.into(),
                torque: sample.torque_nm.into(),
            },
            uncertainty: Some(ForceTorque {
                force: error.force_n.into(),
                torque: error.torque_nm.into(),
            }),
        }
    }
}

impl TelemetryMessage for StampedWrench<'_> {
    const TOPIC: &'static str = "/wrench";
    const SCHEMA: &'static str = "geometry_msgs/WrenchStamped";
    fn properties() -> Value {
        let wrench = json!({ "type": "object", "properties": { "force": Xyz::schema(), "torque": Xyz::schema() } });
        json!({ "timestamp": Stamp::schema(), "frame_id": { "type": "string" }, "magnitude": { "type": "number" },
                "wrench": wrench, "uncertainty": wrench })
    }
}

/// Computed and commanded TCP.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tcp<'a> {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// Name of the frame that positions are in.
    pub frame_id: Cow<'a, str>,
    /// Computed position, from the controller, and orientation, from the joint angles and the
    /// nominal robot.
    pub pose: PositionAndOrientation,
    /// Commanded position, in m.
    pub setpoint: Xyz,
    /// Distance of the computed position from the commanded one, in mm.
    #[serde(deserialize_with = "number")]
    pub deviation_mm: f32,
}

/// The shape of `foxglove.Pose`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PositionAndOrientation {
    /// Position, in m.
    pub position: Xyz,
    /// Orientation.
    pub orientation: Quaternion,
}

impl<'a> Tcp<'a> {
    /// From a sample; `f0` is the name of F0.
    pub(super) fn new(timestamp: Stamp, f0: &'a str, sample: &Sample, orientation: Quaternion) -> Self {
        let deviation_m: [f32; 3] = core::array::from_fn(|k| sample.tcp_m[k] - sample.setpoint_m[k]);
        Self {
            timestamp,
            frame_id: f0.into(),
            pose: PositionAndOrientation {
                position: sample.tcp_m.into(),
                orientation,
            },
            setpoint: sample.setpoint_m.into(),
            deviation_mm: 1e3 * length(deviation_m),
        }
    }
}

impl TelemetryMessage for Tcp<'_> {
    const TOPIC: &'static str = "/tcp";
    const SCHEMA: &'static str = "foxglove.PoseInFrame";
    fn properties() -> Value {
        let number = json!({ "type": "number" });
        let orientation = json!({ "type": "object",
                                  "properties": { "x": number, "y": number, "z": number, "w": number } });
        let pose = json!({ "type": "object", "title": "foxglove.Pose",
                           "properties": { "position": Xyz::schema(), "orientation": orientation } });
        json!({ "timestamp": Stamp::schema(), "frame_id": { "type": "string" }, "pose": pose,
                "setpoint": Xyz::schema(), "deviation_mm": number })
    }
}

/// The phase of the procedure, and the flags of the control loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PhaseState {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// The phase.
    pub phase: Phase,
    /// Device time since the controller's start; older files have none.
    #[serde(default)]
    pub device_time: Option<Stamp>,
    /// Number of the phase, for plots.
    pub number: u8,
    /// Whether a torque is saturated.
    pub saturated: bool,
    /// Whether a torque's rate is limited.
    pub rate_limited: bool,
    /// Whether the arm is near a singular pose.
    pub near_singular: bool,
}

impl PhaseState {
    /// From a sample that was taken at the given device time.
    pub(super) fn new(timestamp: Stamp, device_time: Stamp, sample: &Sample) -> Self {
        Self {
            timestamp,
            phase: sample.phase,
            device_time: Some(device_time),
            number: sample.phase as u8,
            saturated: sample.flags & 1 != 0,
            rate_limited: sample.flags & 2 != 0,
            near_singular: sample.flags & 4 != 0,
        }
    }
}

impl TelemetryMessage for PhaseState {
    const TOPIC: &'static str = "/phase";
    const SCHEMA: &'static str = "spherecal.Phase";
    fn properties() -> Value {
        let flag = json!({ "type": "boolean" });
        json!({ "timestamp": Stamp::schema(), "phase": { "type": "string" }, "device_time": Stamp::schema(),
                "number": { "type": "integer" }, "saturated": flag, "rate_limited": flag, "near_singular": flag })
    }
}

fn length(v: [f32; 3]) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}

/// Reads `null` as NaN.
fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f32::NAN))
}

/// Reads each `null` as NaN.
fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Cow<'static, [f32]>, D::Error> {
    let values = Vec::<Option<f32>>::deserialize(deserializer)?;
    Ok(values.into_iter().map(|x| x.unwrap_or(f32::NAN)).collect())
}
