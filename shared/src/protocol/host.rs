//! The host link: commands down, events up.
//!
//! Every command carries a sequence number and is answered once by
//! [`Event::Reply`]; a command that comes again with the same number is
//! answered again and not carried out twice. Every event with a non-zero
//! [`Uplink::event`] is sent again until the host acknowledges it
//! ([`Command::Acknowledge`]), so that no recording, contact or fault is lost,
//! and the host drops what it has already seen, so that none counts twice.
//!
//! A *session* begins with a host's [`Command::Hello`] and has a number of its
//! own ([`SessionId`]), which every frame carries: late frames of an earlier
//! host, or of a controller before its restart, are told from those of now, and
//! an event is known for good by its session and number.
//!
//! A command may name the device time at which it is to be carried out
//! ([`Downlink::start_us`]). A host that counts it from the event that made it
//! decide, with some time for repeats, has the arm do the same at the same
//! tick, whatever the link loses meanwhile.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::Joints;
use crate::procedure::Procedure;
use crate::robot::{Robot, Tool};

mod event;

pub use event::{
    Banner, Contact, Coupled, Event, Fault, FaultReport, MAX_BATCH, Phase, PhaseChange, Recording, Refusal, Sample,
    SignalStatistics, Statistics,
};

/// Number of a session: drawn by the host for every [`Command::Hello`].
pub type SessionId = [u8; 4];

/// A frame from the host to the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Downlink {
    /// The sender's session. What does not belong to the one that the
    /// controller was greeted for is not obeyed.
    pub session: SessionId,
    /// Number of the command, from 1, growing by one with each new command; a
    /// repeat has the same. [`Command::Hello`] of a new session restarts the
    /// count; acknowledgements and keep-alives carry 0 and are not answered.
    pub sequence: u32,
    /// Device time at which to carry it out, in µs, [`START_MOST_US`] ahead at
    /// most; what has passed means at once, and so does 0. A command that comes
    /// while another one waits takes its place.
    pub start_us: u64,
    /// What to do.
    pub command: Command,
}

/// How far ahead of the present a command's start may lie, in µs.
pub const START_MOST_US: u64 = 5_000_000;

impl Downlink {
    /// A command to be carried out at once, of a session that has no number of
    /// its own: for hosts that are the only one there will ever be.
    pub fn at_once(sequence: u32, command: Command) -> Self {
        Self {
            session: SessionId::default(),
            sequence,
            start_us: 0,
            command,
        }
    }
}

/// What the host asks of the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[allow(clippy::large_enum_variant)] // No allocation on the controller: it is stored in place.
pub enum Command {
    /// First contact; answered by [`Event::Banner`] besides the reply.
    Hello,
    /// Sets the robot's nominal model; refused unless idle.
    Robot(Robot),
    /// Sets the tool and the procedure; refused unless idle.
    Configure {
        /// The tool at the flange, nest included.
        tool: Tool,
        /// The procedure.
        procedure: Procedure,
    },
    /// Moves in free space to joint angles.
    Move {
        /// Target, in rad, base to flange.
        target: Joints,
    },
    /// From the approach frame: tare, descend, touch, couple.
    Approach(ApproachCommand),
    /// The next pose about the coupled sphere.
    Pose(PoseCommand),
    /// Leave the sphere and retreat along the approach.
    Decouple,
    /// Stop any motion and hold, damped.
    Stop,
    /// Leave a fault; the controller holds and is idle afterwards.
    ClearFault,
    /// Hand-guiding on or off: gravity-compensated, damped.
    HandGuide {
        /// Whether to start or end it.
        on: bool,
    },
    /// The host has stored event number `event`; just this one is not sent
    /// again. A host that wants events in order acknowledges only the next in
    /// order and drops what runs ahead: it comes again.
    Acknowledge {
        /// Number of the event.
        event: u32,
    },
    /// Nothing to do; the host lives.
    KeepAlive,
    /// Leave a sphere that a controller before this one has touched: retreat
    /// against `direction`, which was that of the approach.
    Retreat {
        /// Direction of the approach in F0, a unit vector.
        direction: [f64; 3],
    },
}

/// Where to touch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ApproachCommand {
    /// Id of the sphere, carried into contacts and recordings.
    pub sphere: u32,
    /// Direction of the approach in F0, a unit vector.
    pub direction: [f64; 3],
}

/// A pose about the sphere: the TCP stays, the tool turns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PoseCommand {
    /// Id of the pose, carried into the recording.
    pub pose: u32,
    /// Orientation of FT in F0 as a unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
    /// Elbow angle in rad ([`crate::robot::elbow`]), for arms that have one.
    pub elbow_rad: Option<f64>,
    /// Joint angles that solve the pose, in rad: where the null space is drawn
    /// to on a redundant arm without an elbow angle. May be empty.
    pub posture: Joints,
    /// Whether to record there, or only to pass through.
    pub record: bool,
}

/// A frame from the controller to the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Uplink {
    /// Session in which it happened; that of the last greeting for what carries
    /// no number, all zero before the first.
    pub session: SessionId,
    /// Number of the event, from 1; 0 for what is not sent again (telemetry,
    /// replies, statistics).
    pub event: u32,
    /// What happened.
    pub body: Event,
}
