//! The drive link: joint state in, joint torque out, once per control period.
//!
//! A drive first sends its handshake ([`DriveHello`]), and again when a command has
//! the session number [`NO_SESSION`]. A drive in lock-step (a
//! simulator) sends the [`DriveState`] of a tick, waits for the [`DriveCommand`]
//! of the same tick and only then goes on. A real drive does not wait; it reports
//! a missing command. `docs/drive-link.md` describes every byte.

mod receiver;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::robot::JointLimits;
use crate::{Joints, MAX_JOINTS};

pub use receiver::{DriveMessage, DriveReceiver};

super::frame::message!(DriveHello, "drive/hello");
super::frame::message!(DriveState, "drive/state");
super::frame::message!(DriveCommand, "drive/command");

/// Session number of a command outside of a session: it asks the drive for its
/// handshake. No drive may have it.
pub const NO_SESSION: u32 = 0;

/// Largest delay of a drive, in µs, beyond one control period. With more, the springs
/// that seat the nest would have to be too soft.
pub const MOST_LATENCY_US: u32 = 5000;
/// Largest inertia of a motor that a drive may declare, seen at its joint, in kg m²: ten times the largest of the
/// iiwa 7.
pub const MOST_MOTOR_KG_M2: f64 = 50.0;

/// Control periods that the controller supports, in µs.
pub const PERIODS_US: core::ops::RangeInclusive<u32> = 1000..=4000;

/// Status of the drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DriveStatus {
    /// The drive carries out torque commands.
    #[default]
    Ready,
    /// Brakes closed or drives off. The state is valid; torque has no effect.
    Disabled,
    /// Emergency stop.
    EmergencyStop,
    /// The drive has failed.
    Failed,
}

/// State of the joints at one tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct DriveState {
    /// Number of the session, as in the drive's [`DriveHello`].
    pub session: u32,
    /// Number of the control period; grows by one each.
    pub tick: u64,
    /// Joint angles from the encoders, in rad.
    pub q: Joints,
    /// Joint velocities, in rad/s.
    pub dq: Joints,
    /// Measured joint torques, in N m. [`DriveHello`] states their sign. With the
    /// default sign they equal `gravity(q) − Jᵀ F` at rest, where `F` is the force
    /// of the environment on the arm.
    pub tau: Joints,
    /// Status of the drive.
    pub status: DriveStatus,
}

/// Torque for the control period that starts with the state of the same tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct DriveCommand {
    /// Number of the session of the state that this command answers. [`NO_SESSION`]
    /// from a controller that has not taken the handshake of that session: the drive
    /// then sends its [`DriveHello`] again.
    pub session: u32,
    /// Tick of the state that this command answers.
    pub tick: u64,
    /// Total joint torque, in N m. It includes gravity unless the drive's
    /// [`DriveHello`] says that the drive compensates gravity.
    pub tau: Joints,
    /// Joint angles, in rad, that a drive which follows angles moves to in place of the torques: those of a motion
    /// through free space. Empty otherwise, and for every other drive.
    pub follow: Joints,
    /// Whether the drive is to carry out the torque; `false` asks it to close
    /// its brakes.
    pub enable: bool,
}

/// Sign of the torques that a drive measures. A commanded torque is always the
/// torque of the actuator on its link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum TorqueSign {
    /// The torque that the actuator exerts on its link.
    #[default]
    OfActuator,
    /// The torque that the link exerts on its actuator: the opposite sign.
    OfLink,
}

/// The drive's handshake: its first message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DriveHello {
    /// [`PROTOCOL_VERSION`](super::PROTOCOL_VERSION) of the drive.
    pub protocol: u16,
    /// Number of the session: another one after each start of the drive, never
    /// [`NO_SESSION`]. Nothing of this message changes within one session.
    pub session: u32,
    /// Limits of each joint, base to flange. Their number is the number of joints.
    pub limits: heapless::Vec<JointLimits, MAX_JOINTS>,
    /// Control period, in µs, within [`PERIODS_US`].
    pub period_us: u32,
    /// Whether the drive adds the gravity torque itself. The controller then sends
    /// the torque without gravity.
    pub compensates_gravity: bool,
    /// Sign of the measured torques.
    pub torque_sign: TorqueSign,
    /// Whether the drive waits for each command (a simulator) or runs in real time.
    pub lock_step: bool,
    /// Inertia of each motor, seen at its joint, that lies between the commanded and
    /// the measured torque, in kg m². Empty: none, because the drive's own torque
    /// loop hides it. The controller derives damping and torque loop from it.
    pub motor_kg_m2: Joints,
    /// Delay of the drive, in µs: age of a state when it is sent, and time until the
    /// answering command acts, together. One period is not counted.
    pub latency_us: u32,
    /// Whether the drive follows joint angles by a position control of its own. The controller then moves the arm
    /// through free space by [`DriveCommand::follow`].
    pub follows: bool,
    /// Whether the drive moves a simulated arm. Everything that a run over it writes is
    /// then marked as simulated.
    pub simulated: bool,
}

impl DriveHello {
    /// A real drive at 1 kHz that hides its motors and its delay: no gravity of its own,
    /// torques of the actuators, not in lock-step. `session` is never [`NO_SESSION`];
    /// `limits` are those of each joint, base to flange.
    pub fn new(session: u32, limits: impl IntoIterator<Item = JointLimits>) -> Self {
        Self {
            protocol: super::PROTOCOL_VERSION,
            session,
            limits: limits.into_iter().take(MAX_JOINTS).collect(),
            period_us: 1000,
            compensates_gravity: false,
            torque_sign: TorqueSign::OfActuator,
            lock_step: false,
            motor_kg_m2: Joints::new(),
            latency_us: 0,
            follows: false,
            simulated: false,
        }
    }
}
