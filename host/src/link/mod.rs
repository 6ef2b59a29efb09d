//! The two links, and what stands at their ends.
//!
//! Vocabulary: the *drive* is whatever moves the joints (the simulated plant, an
//! external simulator, the gateway of a real arm); the *controller* is the
//! firmware, wherever it runs; the *cell* is both in lock-step, one control
//! period after the other; the *endpoint* is the host's end of the host link.
//!
//! ```text
//!   campaign ─ HostEndpoint ──bytes──▶ Controller ◀─DriveState── Drive
//!                    ▲                  │      └───DriveCommand──▶ │
//!                    └──────bytes───────┘   Cell: one tick of both
//! ```
//!
//! | mode | [`Controller`] | [`Drive`] |
//! |---|---|---|
//! | `sim` | [`InProcess`] | [`SimulatedArm`] |
//! | `qemu` | [`Qemu`](qemu::Qemu) | [`SimulatedArm`] |
//! | `serial:` | behind bytes | [`SimulatedArm`] or a gateway |
//! | `tcp:` | [`InProcess`] | behind bytes |
//!
//! The host link is bytes in every mode, also in-process, so that framing,
//! numbering, acknowledgement and repetition are exercised by every run.

mod cell;
mod endpoint;
mod in_process;
pub mod qemu;
mod simulated;

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::FrameError;

pub use cell::Cell;
pub use endpoint::{Arrival, HostEndpoint, Timing};
pub use in_process::{InProcess, controller_in_process};
pub use simulated::{SimulatedArm, SimulatedArmError, simulated_arm};

/// Why a link failed for good. What can be repaired (lost, damaged, repeated
/// frames) is repaired and counted, not reported here.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No controller was built for that many joints.
    #[error(
        "the robot has {joints} joints: controllers in this program are built for {built}; \
         use a robot with as many joints"
    )]
    Joints {
        /// Joints of the robot.
        joints: usize,
        /// Numbers of joints that there are controllers for.
        built: &'static str,
    },
    /// Drive and robot are not the same machine.
    #[error("the drive has {drive} joints, the robot {robot}: choose the robot that stands behind the drive link")]
    OtherRobot {
        /// Joints of the drive.
        drive: usize,
        /// Joints of the robot.
        robot: usize,
    },
    /// The drive speaks another protocol.
    #[error("the drive speaks protocol {found}, this program {expected}: use versions that belong together")]
    Protocol {
        /// Protocol of the drive.
        found: u16,
        /// Protocol of this program.
        expected: u16,
    },
    /// A control period that cannot be.
    #[error("the drive's control period is {period_us} µs: give one from 100 to 10000 µs")]
    Period {
        /// Its period, in µs.
        period_us: u32,
    },
    /// A message does not fit a frame.
    #[error("a message for the controller cannot be framed: {0}")]
    Frame(#[from] FrameError),
    /// The drive stopped working.
    #[error("the drive failed: {0}")]
    Drive(String),
    /// The controller in QEMU failed.
    #[error(transparent)]
    Qemu(#[from] qemu::QemuError),
    /// A transport failed.
    #[error("{link}: {source}: check the connection and start again with --resume")]
    Transport {
        /// Which link.
        link: String,
        /// What the system said.
        source: std::io::Error,
    },
}

/// The controller, wherever it runs: one control period at a time.
pub trait Controller: Send {
    /// Tells the controller what the drive says of itself, once, before the
    /// first period.
    ///
    /// # Errors
    /// When the controller cannot work with such a drive.
    fn connect(&mut self, hello: &DriveHello) -> Result<(), LinkError>;

    /// Hands over the joint state of this period and the host's bytes; takes
    /// the torque command, and appends the controller's bytes for the host to
    /// `up`. `now_us` is the device's time, in µs.
    ///
    /// # Errors
    /// When the transport to the controller fails for good.
    fn exchange(
        &mut self,
        now_us: u64,
        state: &DriveState,
        down: &[u8],
        up: &mut Vec<u8>,
    ) -> Result<DriveCommand, LinkError>;
}

/// The drive, wherever it is: one control period at a time.
pub trait Drive: Send {
    /// What the drive says of itself.
    fn hello(&self) -> &DriveHello;

    /// Carries out `command` for one control period (none at the very first
    /// call) and writes the state at its end.
    ///
    /// # Errors
    /// When the drive or the transport to it fails for good.
    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError>;
}
