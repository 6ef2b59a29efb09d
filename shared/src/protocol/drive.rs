//! The drive link: joint state in, joint torque out, once a millisecond.
//!
//! A drive first introduces itself ([`DriveHello`]). Lock-step: it sends
//! [`DriveState`] number `tick`, the controller answers with the
//! [`DriveCommand`] of the same `tick`, and only then does the drive advance. A
//! real drive does not wait; it flags a missing command. Byte by byte:
//! `docs/drive-link.md`.

mod receiver;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::robot::JointLimits;
use crate::{Joints, MAX_JOINTS};

pub use receiver::{DriveMessage, DriveReceiver};

/// What the drive says of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DriveStatus {
    /// Torque commands are carried out.
    #[default]
    Ready,
    /// Brakes closed or drives off; state is valid, torque is not carried out.
    Disabled,
    /// Emergency stop.
    EmergencyStop,
    /// The drive has failed.
    Failed,
}

/// State of the joints at one tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct DriveState {
    /// Number of the control period, growing by one each.
    pub tick: u64,
    /// Joint angles as the encoders give them, in rad.
    pub q: Joints,
    /// Joint velocities, in rad/s.
    pub dq: Joints,
    /// Measured joint torques, in N m, in the sign that [`DriveHello`] states;
    /// by default at rest it equals `gravity(q) − Jᵀ F`, where `F` is the force
    /// of the environment on the arm.
    pub tau: Joints,
    /// Status of the drive.
    pub status: DriveStatus,
}

/// Torque for the period that begins with the state of the same tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct DriveCommand {
    /// Tick of the state that this answers.
    pub tick: u64,
    /// Total joint torque, in N m, gravity included, unless the drive said in
    /// its [`DriveHello`] that it compensates gravity itself.
    pub tau: Joints,
    /// Whether the controller wants the torque carried out; `false` asks the
    /// drive to close its brakes.
    pub enable: bool,
}

/// In which sense a drive states measured torques. Commanded torques are
/// always those of the actuator on its link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum TorqueSign {
    /// The torque that the actuator exerts on its link.
    #[default]
    OfActuator,
    /// The torque that the link exerts on its actuator: the opposite.
    OfLink,
}

/// First message of a drive: what it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DriveHello {
    /// [`PROTOCOL_VERSION`](super::PROTOCOL_VERSION) of the drive.
    pub protocol: u16,
    /// Limits of each joint, base to flange; their number is the number of joints.
    pub limits: heapless::Vec<JointLimits, MAX_JOINTS>,
    /// Control period, in µs.
    pub period_us: u32,
    /// Whether the drive adds the gravity torque itself, so that the commanded
    /// torque is the rest.
    pub compensates_gravity: bool,
    /// Sign of the measured torques.
    pub torque_sign: TorqueSign,
    /// Whether the drive waits for each command (a simulator) or runs in real time.
    pub lock_step: bool,
}
