//! Events: what the controller reports to the host.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{CycleCost, LoopTiming};
use crate::MAX_JOINTS;
use crate::protocol::frame::LinkCounters;

/// An event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[allow(clippy::large_enum_variant)]
pub enum Event {
    /// Identity of the controller.
    Banner(Banner),
    /// A command was received and waits for its start: the host need not repeat it.
    Held {
        /// Sequence number of the command.
        sequence: u32,
    },
    /// The answer to a command, sent when it starts or is refused.
    Reply {
        /// Sequence number of the command.
        sequence: u32,
        /// Whether the command was accepted.
        result: Result<(), Refusal>,
    },
    /// The controller has entered a phase.
    Phase(PhaseChange),
    /// Contact was declared.
    Contact(Contact),
    /// The nest is seated: the hold and the test pull are over.
    Coupled(Coupled),
    /// A recording is complete.
    Recording(Recording),
    /// A pose that was not to be recorded has been reached.
    Passed {
        /// Id of the pose.
        pose: u32,
    },
    /// A fault; the arm holds, damped, or the brakes close.
    Fault(FaultReport),
    /// Samples of the control loop.
    Telemetry(heapless::Vec<Sample, MAX_BATCH>),
    /// Statistics of the links and of the tick.
    Statistics(Statistics),
}

/// Most samples in one telemetry frame.
pub const MAX_BATCH: usize = 8;

/// Identity of the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Banner {
    /// [`PROTOCOL_VERSION`](crate::protocol::PROTOCOL_VERSION) of the controller.
    pub protocol: u16,
    /// [`SCHEMA`](crate::protocol::SCHEMA) of the controller.
    pub schema: u64,
    /// Version of the firmware crate.
    pub version: heapless::String<16>,
    /// Hash of the build, if the build recorded it.
    pub build: heapless::String<24>,
    /// Number of joints that the controller was built for.
    pub joints: u8,
    /// Control period, in µs.
    pub period_us: u32,
    /// Number of the oldest event that was not acknowledged. A new host counts
    /// events from here.
    pub first_event: u32,
}

/// The controller's phases.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Damped hold, waiting for a command.
    #[default]
    Idle,
    /// Free-space motion in joint coordinates.
    Moving,
    /// At rest at the approach frame, averaging the wrench for the tare.
    Taring,
    /// Descending towards the sphere.
    Approaching,
    /// After contact: soft hold while the magnet seats the nest.
    Coupling,
    /// Test pull: checks whether the nest is seated.
    Verifying,
    /// Seated, waiting for the next pose.
    Coupled,
    /// Turning to a pose.
    Turning,
    /// Averaging joint angles and torques.
    Recording,
    /// Leaving the sphere.
    Decoupling,
    /// Hand-guiding.
    HandGuiding,
    /// After a fault: damped hold with gravity compensation.
    Fault,
    /// Held by a Cartesian spring that the host sets.
    Impedance,
}

/// A change of phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct PhaseChange {
    /// The new phase.
    pub phase: Phase,
    /// The previous phase.
    pub from: Phase,
    /// Device time, in µs.
    pub time_us: u64,
    /// Tick of the drive state at which the phase changed.
    pub tick: u64,
}

/// A contact: the force condition has held for its dwell time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Contact {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time, in µs.
    pub time_us: u64,
    /// Tared force against the approach at the declaration, in N: the steady estimate, a low-pass of
    /// [`Law::observer_rad_s`](crate::procedure::Law::observer_rad_s).
    pub force_n: f64,
    /// Largest force against the approach since the descent began, in N: the largest mean over 10 ms of what sphere and
    /// plate do to the tool. What the magnet pulls between nest and sphere is within the tool's own balance: the pads
    /// press by as much more, 26.5 N with the usual nest.
    pub peak_n: f64,
    /// The tare: the force that is subtracted, F0, in N.
    pub tare_n: [f64; 3],
    /// Computed TCP in F0, in m.
    pub tcp_m: [f64; 3],
    /// Distance descended, in m.
    pub travel_m: f64,
    /// Ticks from the threshold's last crossing to the declaration.
    pub latency_ticks: u32,
    /// Number of times that the force crossed the threshold but did not last.
    pub early_crossings: u32,
}

/// The nest is seated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Coupled {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time, in µs.
    pub time_us: u64,
    /// Computed TCP of the seated nest in F0, in m.
    pub centre_m: [f64; 3],
    /// Distance that the TCP moved from contact to seat, in m.
    pub shift_m: f64,
    /// Distance that it moved under the test pull, in m.
    pub test_m: f64,
}

/// Statistics of one signal, computed in one pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct SignalStatistics {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation (n − 1).
    pub std: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

/// The averages of one pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Recording {
    /// Id of the sphere.
    pub sphere: u32,
    /// Id of the pose.
    pub pose: u32,
    /// Device time of the first sample, in µs.
    pub start_us: u64,
    /// Device time of the last sample, in µs.
    pub end_us: u64,
    /// Number of samples averaged.
    pub count: u32,
    /// Ticks missing between the first and the last sample.
    pub gaps: u32,
    /// Joint angles, in rad.
    pub q: heapless::Vec<SignalStatistics, MAX_JOINTS>,
    /// Measured joint torques, in N m.
    pub tau: heapless::Vec<SignalStatistics, MAX_JOINTS>,
    /// Spread of the computed TCP: the root mean square of its distance from its
    /// mean, in m.
    pub tcp_spread_m: f64,
    /// Mean estimated contact force, tared, F0, in N.
    pub force_n: [f64; 3],
}

/// Kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// A joint has reached the limit of its range.
    JointPosition,
    /// A joint is too fast.
    JointVelocity,
    /// A commanded torque was saturated for too long.
    JointTorque,
    /// The steady estimate of the contact force is too large.
    Force,
    /// The arm does not follow its setpoint.
    PathDeviation,
    /// A motion did not settle in time.
    MotionTimeout,
    /// The tare is too large: the tool or the sensors are not as declared.
    Tare,
    /// There was no contact within the allowed travel.
    NoContact,
    /// The test pull moved the nest: it is not seated.
    NotSeated,
    /// The nest has left the sphere.
    ContactLost,
    /// The nest did not leave the sphere.
    StillCoupled,
    /// Drive states are missing, repeated, frozen or out of order.
    StaleState,
    /// A drive state has a NaN, an infinity, a value that no arm can have, or a wrong
    /// number of joints.
    NotFinite,
    /// The drive is not ready.
    Drive,
    /// Control periods were missed.
    Overrun,
    /// Nothing came from the host for too long.
    HostSilence,
    /// An internal computation failed.
    Internal,
    /// A joint angle has jumped: its encoder lost its reference.
    PositionJump,
    /// A measured torque differs from the commanded one: a sensor or a motor fails.
    TorqueSensor,
    /// The TCP is too fast.
    TcpSpeed,
    /// The TCP leaves the workspace or is too close to the plate.
    Workspace,
    /// A joint swings to and fro, faster and faster: control drives it.
    Unstable,
    /// The arm has more kinetic energy than its motion explains.
    KineticEnergy,
    /// The arm presses on something for too long.
    Pressing,
    /// A joint needs more torque to reach its target than the law may give against a disturbance.
    Disturbance,
}

/// A fault with its time, phase and cause.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultReport {
    /// The fault.
    pub fault: Fault,
    /// The phase in which it happened.
    pub phase: Phase,
    /// Device time, in µs.
    pub time_us: u64,
    /// Tick of the drive state.
    pub tick: u64,
    /// Joint concerned, from 1; 0 for none.
    pub joint: u8,
    /// The value that violated the limit, in the limit's unit.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// The present phase does not allow the command.
    #[error("the controller is in a phase that does not allow this: wait, or send Stop")]
    Phase,
    /// A fault is pending.
    #[error("a fault is pending: clear it first")]
    FaultPending,
    /// The robot or the tool is not valid.
    #[error("the robot or tool description is not valid, or has another number of joints than this controller")]
    Robot,
    /// A value of the procedure is not valid.
    #[error("the procedure has a value out of range")]
    Procedure,
    /// A target is not finite, not normalised or out of limits.
    #[error("the target is not finite, not normalised or outside the joint limits")]
    Target,
    /// The controller has no robot or no procedure yet.
    #[error("the controller has no robot or procedure yet: send Robot and Configure first")]
    NotConfigured,
    /// The drive is not ready.
    #[error("the drive is not ready: enable it and try again")]
    Drive,
    /// A queue is full.
    #[error("the controller is busy: its queue is full, try again")]
    Busy,
    /// The command's start is too far ahead.
    #[error("the command is to start more than 5 s from now: send it later")]
    Start,
    /// The drive answers later than any safe spring bears that holds the arm, by its handshake or by what it has shown.
    #[error(
        "the drive answers {latency_us} µs after a state; springs that are safe then and hold this arm against friction exist up to \
         {most_us} µs. Run the controller nearer to the drive, or declare motor_kg_m2 in the drive's handshake if the motors \
         show (for franka: and fri: in [cell.drive])"
    )]
    TooLate {
        /// How late it answers, in µs.
        latency_us: u32,
        /// How late it may answer, in µs.
        most_us: u32,
    },
}

/// One sample of the control loop, in single precision. Arrays have one value per
/// joint; those beyond the robot's last joint are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Sample {
    /// Tick of the drive state.
    pub tick: u64,
    /// The phase.
    pub phase: Phase,
    /// Joint angles, in rad.
    pub q: [f32; MAX_JOINTS],
    /// Joint velocities, in rad/s.
    pub dq: [f32; MAX_JOINTS],
    /// Measured torques, in N m.
    pub tau: [f32; MAX_JOINTS],
    /// Commanded torques, in N m.
    pub command: [f32; MAX_JOINTS],
    /// Steady estimate of the force of the environment on the arm at the TCP, tared, F0, in N.
    pub force_n: [f32; 3],
    /// Estimated torque about the TCP, F0, in N m.
    pub torque_nm: [f32; 3],
    /// Computed TCP in F0, in m.
    pub tcp_m: [f32; 3],
    /// Setpoint of the TCP in F0, in m.
    pub setpoint_m: [f32; 3],
    /// Bits: 0 torque saturated, 1 torque rate limited, 2 near a singularity.
    pub flags: u8,
}

/// Counters of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Statistics {
    /// Control ticks run.
    pub ticks: u64,
    /// Control periods without a new and usable drive state, overruns included.
    pub missed: u32,
    /// Commands that came after their start.
    pub late: u32,
    /// Counters of the controller's end of the host link.
    pub link: LinkCounters,
    /// Counters of the controller's end of the drive link; zero where a process gives the
    /// states directly.
    pub drive: LinkCounters,
    /// Cost of the control cycles.
    pub cost: CycleCost,
    /// How punctual the control loop is.
    pub timing: LoopTiming,
    /// Whether the drive of the present session moves a simulated arm.
    pub simulated: bool,
}
