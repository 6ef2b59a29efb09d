//! The signals of a telemetry file: messages of ROS 2. The writer and the reader use these types.
//! [`scene`](super::scene) has the frames of the arm, [`log`](super::log) what happened.
//!
//! | topic | type | message |
//! |---|---|---|
//! | `/joint_states` | [`JointState`] | names, position (rad), velocity (rad/s), effort (measured, N m) |
//! | `/wrench` | [`WrenchStamped`] | estimated force (N) and torque (N m) of the environment at the TCP, axes of F0 |
//! | `/control` | [`Control`] | commanded torques (N m), computed and commanded TCP in F0 (m) |
//! | `/wrench_uncertainty` | [`Uncertainty`] | standard uncertainty of `/wrench`, which depends on the posture alone |
//! | `/phase` | [`PhaseState`] | phase of the procedure, flags, and device time |
//!
//! The first three have one message for each sample. `/joint_states` is the last of them, so a sample that has it is
//! complete. Times are UTC; the module `utc` ties them to device time.
//!
//! Numbers are rounded to multiples of powers of two, so that their low bytes are zero and compress. Each step is less than
//! half of what good sensors tell: encoders 1.5e-6 rad, torque sensors 5e-3 N m.

use std::borrow::Cow;

use nalgebra::{Matrix3, Rotation3};
use serde::{Deserialize, Serialize};
use spherecal_model::chain::quaternion;
use spherecal_model::name_of;
use spherecal_shared::protocol::host::Sample;

use super::ros::{Header, RosMessage, Time};
use crate::force::{WrenchError, magnitude};

/// 2 to the power `-bits`.
const fn step(bits: u32) -> f64 {
    1.0 / (1_u64 << bits) as f64
}
/// Step of joint angles, 0.5e-6 rad.
const ANGLE_RAD: f64 = step(21);
/// Step of joint velocities, 8e-6 rad/s: the encoders' resolution over a filter of 0.1 s or less.
const VELOCITY_RAD_S: f64 = step(17);
/// Step of torques, 2e-3 N m, of joints and of wrenches.
const TORQUE_NM: f64 = step(9);
/// Step of forces, 8e-3 N: the torques' step on a lever of 0.25 m.
const FORCE_N: f64 = step(7);
/// Step of positions, 0.5e-6 m, and, in 1, of the numbers of a quaternion.
const POSITION_M: f64 = step(21);
/// Step of the distance between computed and commanded TCP, 4e-3 mm, which plots show.
const DISTANCE_MM: f64 = step(8);

/// A number rounded to a multiple of `step`, a power of two.
fn rounded(x: impl Into<f64>, step: f64) -> f64 {
    (x.into() / step).round() * step
}

/// A vector or a point: `geometry_msgs/msg/Vector3`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Xyz {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
}

impl Xyz {
    fn new<T: Into<f64> + Copy>([x, y, z]: [T; 3], step: f64) -> Self {
        let [x, y, z] = [x, y, z].map(|v| rounded(v, step));
        Self { x, y, z }
    }

    /// A position, in m.
    pub(super) fn position(v: nalgebra::Vector3<f64>) -> Self {
        Self::new([v.x, v.y, v.z], POSITION_M)
    }
}

/// A point in single precision, in m: `geometry_msgs/msg/Point32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point32 {
    /// Along x.
    pub x: f32,
    /// Along y.
    pub y: f32,
    /// Along z.
    pub z: f32,
}

impl From<[f32; 3]> for Point32 {
    fn from(v: [f32; 3]) -> Self {
        let [x, y, z] = v.map(|v| rounded(v, POSITION_M) as f32);
        Self { x, y, z }
    }
}

/// A unit quaternion: `geometry_msgs/msg/Quaternion`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Its x part.
    pub x: f64,
    /// Its y part.
    pub y: f64,
    /// Its z part.
    pub z: f64,
    /// Its real part; not negative.
    pub w: f64,
}

impl From<&Matrix3<f64>> for Quaternion {
    fn from(rotation: &Matrix3<f64>) -> Self {
        let parts = quaternion(&Rotation3::from_matrix_unchecked(*rotation));
        let [w, x, y, z] = parts.map(|part| rounded(part, POSITION_M));
        Self { x, y, z, w }
    }
}

/// The state of all joints: `sensor_msgs/msg/JointState`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState<'a> {
    /// Time; joints have no frame.
    pub header: Header<'a>,
    /// Names of the joints, base to flange.
    pub name: Cow<'a, [String]>,
    /// Joint angles, in rad.
    pub position: Vec<f64>,
    /// Joint velocities, in rad/s.
    pub velocity: Vec<f64>,
    /// Measured torques, in N m.
    pub effort: Vec<f64>,
}

impl<'a> JointState<'a> {
    /// From a sample of an arm with the named joints.
    pub(super) fn new(utc_ns: u64, names: &'a [String], sample: &Sample) -> Self {
        let of = |values: &[f32], step| values.iter().take(names.len()).map(|x| rounded(*x, step)).collect();
        Self {
            header: Header::new(utc_ns, ""),
            name: names.into(),
            position: of(&sample.q, ANGLE_RAD),
            velocity: of(&sample.dq, VELOCITY_RAD_S),
            effort: of(&sample.tau, TORQUE_NM),
        }
    }
}

impl RosMessage for JointState<'_> {
    const TOPIC: &'static str = "/joint_states";
    const TYPE: &'static str = "sensor_msgs/msg/JointState";
    const FIELDS: &'static str =
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n";
}

/// A force and a torque: `geometry_msgs/msg/Wrench`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// Force, in N.
    pub force: Xyz,
    /// Torque about the TCP, in N m.
    pub torque: Xyz,
}

impl Wrench {
    fn new(force_n: [f32; 3], torque_nm: [f32; 3]) -> Self {
        Self {
            force: Xyz::new(force_n, FORCE_N),
            torque: Xyz::new(torque_nm, TORQUE_NM),
        }
    }
}

/// Estimated force and torque of the environment on the arm at the TCP: `geometry_msgs/msg/WrenchStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WrenchStamped<'a> {
    /// Time, and the frame F0.
    pub header: Header<'a>,
    /// Force and torque.
    pub wrench: Wrench,
}

impl<'a> WrenchStamped<'a> {
    /// From a sample; `f0` is the name of F0.
    pub(super) fn new(utc_ns: u64, f0: &'a str, sample: &Sample) -> Self {
        Self {
            header: Header::new(utc_ns, f0),
            wrench: Wrench::new(sample.force_n, sample.torque_nm),
        }
    }
}

impl RosMessage for WrenchStamped<'_> {
    const TOPIC: &'static str = "/wrench";
    const TYPE: &'static str = "geometry_msgs/msg/WrenchStamped";
    const FIELDS: &'static str = "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n";
}

/// How well the torque sensors tell the wrench, as standard uncertainties: `geometry_msgs/msg/WrenchStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty<'a>(pub WrenchStamped<'a>);

impl<'a> Uncertainty<'a> {
    pub(super) fn new(utc_ns: u64, f0: &'a str, error: &WrenchError) -> Self {
        Self(WrenchStamped {
            header: Header::new(utc_ns, f0),
            wrench: Wrench::new(error.force_n, error.torque_nm),
        })
    }
}

impl RosMessage for Uncertainty<'_> {
    const TOPIC: &'static str = "/wrench_uncertainty";
    const TYPE: &'static str = WrenchStamped::TYPE;
    const FIELDS: &'static str = WrenchStamped::FIELDS;
}

/// What the control loop commands, and where the TCP is: `spherecal_msgs/msg/Control`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Control<'a> {
    /// Time, and the frame F0.
    pub header: Header<'a>,
    /// Commanded torques, base to flange, in N m.
    pub command: Vec<f32>,
    /// Computed position of the TCP, in m.
    pub tcp: Point32,
    /// Commanded position of the TCP, in m.
    pub setpoint: Point32,
    /// Distance of the computed position from the commanded one, in mm.
    pub deviation_mm: f32,
    /// Magnitude of the estimated force, in N.
    pub force_n: f32,
}

impl<'a> Control<'a> {
    /// From a sample of an arm with `joints` joints; `f0` is the name of F0.
    pub(super) fn new(utc_ns: u64, f0: &'a str, joints: usize, sample: &Sample) -> Self {
        let command = sample.command.iter().take(joints);
        let deviation_m: [f32; 3] = core::array::from_fn(|k| sample.tcp_m[k] - sample.setpoint_m[k]);
        let deviation_mm = 1e3 * deviation_m.iter().map(|x| x * x).sum::<f32>().sqrt();
        Self {
            header: Header::new(utc_ns, f0),
            command: command.map(|x| rounded(*x, TORQUE_NM) as f32).collect(),
            tcp: sample.tcp_m.into(),
            setpoint: sample.setpoint_m.into(),
            deviation_mm: rounded(deviation_mm, DISTANCE_MM) as f32,
            force_n: rounded(magnitude(sample), FORCE_N) as f32,
        }
    }
}

impl RosMessage for Control<'_> {
    const TOPIC: &'static str = "/control";
    const TYPE: &'static str = "spherecal_msgs/msg/Control";
    const FIELDS: &'static str = "std_msgs/Header header\nfloat32[] command\ngeometry_msgs/Point32 tcp\n\
                                  geometry_msgs/Point32 setpoint\nfloat32 deviation_mm\nfloat32 force_n\n";
}

/// The phase of the procedure, and the flags of the control loop: `spherecal_msgs/msg/Phase`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PhaseState {
    /// Time, UTC.
    pub stamp: Time,
    /// Device time since the controller's start, in µs.
    pub device_us: u64,
    /// Name of the phase.
    pub phase: String,
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
    /// From a sample that was taken at the given times.
    pub(super) fn new(utc_ns: u64, device_us: u64, sample: &Sample) -> Self {
        Self {
            stamp: Time::from_ns(utc_ns),
            device_us,
            phase: name_of(sample.phase),
            number: sample.phase as u8,
            saturated: sample.flags & 1 != 0,
            rate_limited: sample.flags & 2 != 0,
            near_singular: sample.flags & 4 != 0,
        }
    }
}

impl RosMessage for PhaseState {
    const TOPIC: &'static str = "/phase";
    const TYPE: &'static str = "spherecal_msgs/msg/Phase";
    const FIELDS: &'static str = "builtin_interfaces/Time stamp\nuint64 device_us\nstring phase\nuint8 number\n\
                                  bool saturated\nbool rate_limited\nbool near_singular\n";
}
