//! What the controller tells the host: phases, contacts, recordings, faults,
//! samples, statistics.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::MAX_JOINTS;
use crate::protocol::frame::LinkCounters;

/// What the controller tells the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[allow(clippy::large_enum_variant)]
pub enum Event {
    /// Who the controller is.
    Banner(Banner),
    /// A command has come and waits for its time: no need to repeat it.
    Held {
        /// Sequence number of the command.
        sequence: u32,
    },
    /// The answer to a command, once it is carried out.
    Reply {
        /// Sequence number of the command.
        sequence: u32,
        /// Whether it is being carried out.
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
    /// A pose that was not to be recorded is reached.
    Passed {
        /// Id of the pose.
        pose: u32,
    },
    /// Something went wrong; the arm holds, damped.
    Fault(FaultReport),
    /// Samples of the control loop.
    Telemetry(heapless::Vec<Sample, MAX_BATCH>),
    /// Statistics of the links and of the tick.
    Statistics(Statistics),
}

/// Samples in one telemetry frame at most.
pub const MAX_BATCH: usize = 8;

/// Who the controller is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Banner {
    /// [`PROTOCOL_VERSION`](crate::protocol::PROTOCOL_VERSION) of the controller.
    pub protocol: u16,
    /// [`SCHEMA`](crate::protocol::SCHEMA) of the controller.
    pub schema: u64,
    /// Version of the firmware crate.
    pub version: heapless::String<16>,
    /// Hash of the build, where it was recorded.
    pub build: heapless::String<24>,
    /// Number of joints that it was built for.
    pub joints: u8,
    /// Control period, in µs.
    pub period_us: u32,
    /// Number of the oldest event that was not acknowledged: where a host that
    /// has just come begins to count.
    pub first_event: u32,
}

/// Phases of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Damped hold, waiting for a command.
    #[default]
    Idle,
    /// Free-space motion in joint coordinates.
    Moving,
    /// At rest at the approach frame, taring the wrench.
    Taring,
    /// Descending towards the sphere.
    Approaching,
    /// Contact made: soft, while the magnet seats the nest.
    Coupling,
    /// Test pull: is the nest seated?
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
    /// Damped gravity hold after a fault.
    Fault,
}

/// Entry into a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct PhaseChange {
    /// The phase entered.
    pub phase: Phase,
    /// The phase left.
    pub from: Phase,
    /// Device time, in µs.
    pub time_us: u64,
    /// Tick of the drive state on which it happened.
    pub tick: u64,
}

/// A contact: the force condition has held for its dwell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Contact {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time, in µs.
    pub time_us: u64,
    /// Force against the approach when declared, tared, in N.
    pub force_n: f64,
    /// Largest force against the approach since the descent began, in N.
    pub peak_n: f64,
    /// Force tared away, F0, in N.
    pub tare_n: [f64; 3],
    /// Computed TCP in F0, in m.
    pub tcp_m: [f64; 3],
    /// Distance descended, in m.
    pub travel_m: f64,
    /// Ticks from the crossing of the threshold that lasted to the declaration.
    pub latency_ticks: u32,
    /// How often the threshold was crossed but not held.
    pub early_crossings: u32,
}

/// The nest is seated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Coupled {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time, in µs.
    pub time_us: u64,
    /// Computed TCP in F0 when seated, in m.
    pub centre_m: [f64; 3],
    /// How far the TCP moved from contact to seat, in m.
    pub shift_m: f64,
    /// How far it moved under the test pull, in m.
    pub test_m: f64,
}

/// One-pass statistics of one signal.
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

/// One pose, averaged.
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
    /// Samples averaged.
    pub count: u32,
    /// Ticks missing between the first and the last sample.
    pub gaps: u32,
    /// Joint angles, in rad.
    pub q: heapless::Vec<SignalStatistics, MAX_JOINTS>,
    /// Measured joint torques, in N m.
    pub tau: heapless::Vec<SignalStatistics, MAX_JOINTS>,
    /// Largest distance of the computed TCP from its mean place while
    /// recording, in m.
    pub tcp_spread_m: f64,
    /// Mean estimated contact force, tared, F0, in N.
    pub force_n: [f64; 3],
}

/// What went wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// A joint is at the limit of its range.
    JointPosition,
    /// A joint is too fast.
    JointVelocity,
    /// A commanded torque stayed saturated.
    JointTorque,
    /// The estimated contact force is too large.
    Force,
    /// The arm does not follow its setpoint.
    PathDeviation,
    /// A motion did not settle in time.
    MotionTimeout,
    /// The tare wrench is absurd: tool or sensors are not what was declared.
    Tare,
    /// No contact within the travel.
    NoContact,
    /// The test pull moved the nest: it is not seated.
    NotSeated,
    /// The nest has left the sphere.
    ContactLost,
    /// The nest did not let go of the sphere.
    StillCoupled,
    /// Drive states are missing, repeated, frozen or out of order.
    StaleState,
    /// A drive state holds a NaN or an infinity, or too few joints.
    NotFinite,
    /// The drive is not ready.
    Drive,
    /// The control period was missed.
    Overrun,
    /// The host is silent.
    HostSilence,
    /// The controller contradicts itself.
    Internal,
    /// A joint angle has jumped: an encoder has lost its place.
    PositionJump,
    /// A measured torque is not the commanded one: a sensor or a motor fails.
    TorqueSensor,
    /// The TCP is too fast.
    TcpSpeed,
    /// The TCP leaves the workspace or comes too near to the plate.
    Workspace,
}

/// A fault, where and when.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultReport {
    /// What.
    pub fault: Fault,
    /// In which phase.
    pub phase: Phase,
    /// Device time, in µs.
    pub time_us: u64,
    /// Tick of the drive state.
    pub tick: u64,
    /// Joint concerned, from 1; 0 for none.
    pub joint: u8,
    /// The value that broke the limit, in the limit's unit.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

/// Why a command was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// The phase does not allow it.
    #[error("the controller is in a phase that does not allow this: wait, or send Stop")]
    Phase,
    /// A fault is pending.
    #[error("a fault is pending: clear it first")]
    FaultPending,
    /// Robot or tool were not accepted.
    #[error("the robot or tool description is not valid, or has another number of joints than this controller")]
    Robot,
    /// The procedure was not accepted.
    #[error("the procedure has a value out of range")]
    Procedure,
    /// A target is not finite, not a unit quaternion or vector, or out of limits.
    #[error("the target is not finite, not normalised or outside the joint limits")]
    Target,
    /// The controller has not been configured.
    #[error("the controller has no robot or procedure yet: send Robot and Configure first")]
    NotConfigured,
    /// The drive is not ready.
    #[error("the drive is not ready: enable it and try again")]
    Drive,
    /// A queue is full.
    #[error("the controller is busy: its queue is full, try again")]
    Busy,
    /// The start is too far ahead.
    #[error("the command is to start more than 5 s from now: send it later")]
    Start,
}

/// One sample of the control loop, in single precision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Sample {
    /// Tick of the drive state.
    pub tick: u64,
    /// Phase.
    pub phase: Phase,
    /// Joint angles, in rad; the first n are used.
    pub q: [f32; MAX_JOINTS],
    /// Joint velocities, in rad/s.
    pub dq: [f32; MAX_JOINTS],
    /// Measured torques, in N m.
    pub tau: [f32; MAX_JOINTS],
    /// Commanded torques, in N m.
    pub command: [f32; MAX_JOINTS],
    /// Estimated force of the environment on the arm at the TCP, tared, F0, in N.
    pub force_n: [f32; 3],
    /// Estimated torque about the TCP, F0, in N m.
    pub torque_nm: [f32; 3],
    /// Computed TCP in F0, in m.
    pub tcp_m: [f32; 3],
    /// Setpoint of the TCP in F0, in m.
    pub setpoint_m: [f32; 3],
    /// Set bits: 0 torque saturated, 1 rate limited, 2 near a singularity.
    pub flags: u8,
}

/// Statistics of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Statistics {
    /// Control ticks carried out.
    pub ticks: u64,
    /// Ticks for which no fresh drive state came.
    pub missed: u32,
    /// Commands that came after the time at which they were to start.
    pub late: u32,
    /// What the controller's side of the host link has received.
    pub link: LinkCounters,
}
