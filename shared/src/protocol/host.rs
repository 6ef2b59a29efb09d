//! The host link: commands down, events up.
//!
//! Every command carries a sequence number, and [`Event::Reply`] answers it. The
//! controller answers a repeated number again and does not carry the command out
//! twice. It sends every event whose [`Uplink::event`] is not 0 again until the
//! host acknowledges it ([`Command::Acknowledge`]), so no recording, contact or
//! fault is lost. The host drops events that it has already seen, so none counts
//! twice.
//!
//! A *session* starts with a host's [`Command::Hello`], the handshake. Its number
//! ([`SessionId`]) is in every frame. It tells frames of an earlier host, or of a
//! controller before its restart, from present ones. Session and number together
//! identify an event for ever.
//!
//! A command may name the device time at which it starts
//! ([`Downlink::start_us`]). A host that derives this time from the event that led
//! to the command, with some time for repeats, gets the same motion at the same
//! tick, even if the link loses frames meanwhile.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::Joints;
use crate::procedure::Procedure;
use crate::robot::{DrivenRobot, Tool};

mod event;
mod impedance;
mod timing;

pub use event::{
    Banner, Contact, Coupled, Event, Fault, FaultReport, MAX_BATCH, Phase, PhaseChange, Recording, Refusal, Sample,
    SignalStatistics, Statistics,
};
pub use impedance::{ImpedanceCommand, OutOfRange};
pub use timing::{Cost, CycleCost, LoopTiming, OCTAVES, Octaves, STAGES, Stage};

super::frame::message!(Downlink, "host/down");
super::frame::message!(Uplink, "host/up");

/// Number of a session. The host draws one at random for every [`Command::Hello`].
pub type SessionId = [u8; 4];

/// A frame from the host to the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Downlink {
    /// Session of the sender. The controller ignores commands of any session other
    /// than the one of the last handshake.
    pub session: SessionId,
    /// Number of the command, from 1, one more for each new command. A repeat has
    /// the same number. [`Command::Hello`] of a new session restarts the count.
    /// Acknowledgements and keep-alives carry 0 and are not answered.
    pub sequence: u32,
    /// Device time at which the command starts, in µs, at most [`START_MOST_US`]
    /// from now. 0 or a time that has passed means at once. A command that comes
    /// while another one waits replaces it.
    pub start_us: u64,
    /// What to do.
    pub command: Command,
}

/// Longest time from now to a command's start, in µs.
pub const START_MOST_US: u64 = 5_000_000;

impl Downlink {
    /// A command that starts at once, in the session with number 0: for a host
    /// that never shares its controller with another.
    pub fn at_once(sequence: u32, command: Command) -> Self {
        Self {
            session: SessionId::default(),
            sequence,
            start_us: 0,
            command,
        }
    }
}

/// A request of the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[allow(clippy::large_enum_variant)] // Stored in place: the controller does not allocate.
pub enum Command {
    /// The handshake. [`Event::Banner`] answers it in addition to the reply.
    Hello,
    /// Sets the robot's nominal model. Refused unless the controller is idle.
    Robot(DrivenRobot),
    /// Sets the tool and the procedure. Refused unless the controller is idle.
    Configure {
        /// The tool at the flange, with the nest.
        tool: Tool,
        /// The procedure.
        procedure: Procedure,
    },
    /// Moves in free space to joint angles.
    Move {
        /// Target, in rad, base to flange.
        target: Joints,
    },
    /// At the approach frame: tares, descends until contact and couples.
    Approach(ApproachCommand),
    /// The next pose about the coupled sphere.
    Pose(PoseCommand),
    /// Leaves the sphere: moves back along the approach.
    Decouple,
    /// Stops any motion and holds, damped.
    Stop,
    /// Ends a fault. The controller is idle and holds afterwards.
    ClearFault,
    /// Turns hand-guiding on or off: gravity-compensated and damped.
    HandGuide {
        /// Whether it starts or ends.
        on: bool,
    },
    /// The host has stored event `event`; the controller does not send this one
    /// again. A host that wants events in order acknowledges only the next one
    /// and drops later ones: they come again.
    Acknowledge {
        /// Number of the event.
        event: u32,
    },
    /// Shows that the host is alive; does nothing else.
    KeepAlive,
    /// Leaves a sphere that an earlier controller has touched: moves back against
    /// `direction`, the direction of that approach.
    Retreat {
        /// Direction of the approach in F0, a unit vector.
        direction: [f64; 3],
    },
    /// Holds the arm by a Cartesian spring; while it does, sets the spring anew. [`Command::Stop`] ends it.
    Impedance(ImpedanceCommand),
}

/// An approach to a sphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ApproachCommand {
    /// Id of the sphere, copied into contacts and recordings.
    pub sphere: u32,
    /// Direction of the approach in F0, a unit vector.
    pub direction: [f64; 3],
}

/// A pose about the sphere: the TCP stays in place and the tool turns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PoseCommand {
    /// Id of the pose, copied into the recording.
    pub pose: u32,
    /// Orientation of FT in F0 as a unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
    /// Elbow angle in rad ([`crate::robot::elbow`]), for arms that have one.
    pub elbow_rad: Option<f64>,
    /// Joint angles of the pose, in rad. On a redundant arm without an elbow angle
    /// the null space moves to them. May be empty.
    pub posture: Joints,
    /// Whether to record at the pose or only to pass through it.
    pub record: bool,
}

/// A frame from the controller to the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Uplink {
    /// Session in which the event happened. For messages with event number 0 it
    /// is the session of the last handshake; all zero before the first.
    pub session: SessionId,
    /// Number of the event, from 1. 0 for what is not sent again: telemetry,
    /// replies, statistics.
    pub event: u32,
    /// The event.
    pub body: Event,
}
