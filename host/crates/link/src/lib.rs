//! The drive link and the host link, and the parts at their ends.
//!
//! Vocabulary: the *drive* moves the joints (the simulated plant, an external simulator, the
//! gateway of a real arm). The *controller* is the firmware, wherever it runs. The *cell* is both
//! in lock-step, one control period after the other. The *endpoint* is the host's end of its link.
//!
//! ```text
//!   campaign ─ HostEndpoint ──bytes──▶ Controller ◀─DriveState── Drive
//!                    ▲                  │      └───DriveCommand──▶ │
//!                    └──────bytes───────┘   LocalDevice: one tick of both
//! ```
//!
//! | mode | [`Controller`] | [`Drive`] |
//! |---|---|---|
//! | `sim` | [`InProcess`] | the simulated arm of `spherecal-sim` |
//! | `qemu` | [`Qemu`](qemu::Qemu) | the same |
//! | `serial:` | a board ([`Serial`]) | its own |
//! | `tcp:` | [`InProcess`] | [`RemoteDrive`](tcp::RemoteDrive) |
//! | `udp:` | [`InProcess`] | the same |
//! | `franka:` | [`InProcess`] | [`FrankaDrive`](native::FrankaDrive) |
//! | `fri:` | [`InProcess`] | [`KukaDrive`](native::KukaDrive) |
//! | `ur:` | [`InProcess`] | [`UrDrive`](native::UrDrive) |
//! | `controller:` | another process ([`Remote`](tcp::Remote)) | its own |
//! | `grpc:` | a service of `spherecal-services` | its own |
//!
//! The host steps a [`Device`]: a cell, or the far end of a socket. The host link carries bytes in every mode.

mod attended;
mod cell;
mod endpoint;
mod journal;
mod keep_alive;
mod lossy;
pub mod native;
pub mod qemu;
mod serial;
mod state_reader;
pub mod tcp;

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::{FrameError, LinkCounters};
use spherecal_shared::protocol::host::{LoopTiming, Refusal};

pub use attended::Attended;
pub use cell::{InProcess, LocalDevice, check_drive, check_hello, controller_in_process};
pub use endpoint::{Arrival, HostEndpoint, Timing};
pub use journal::{Journal, JournalError};
pub use keep_alive::KeepAlives;
pub use lossy::{Injected, Lossy, LossyError};
pub use serial::Serial;
pub use state_reader::{DriveReader, FrankaReader, JointReading, KukaReader, StateReader, UrReader};

/// Why a link failed for good. Frames that were lost, damaged or repeated are repaired and counted;
/// they are not errors.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No controller was built for that many joints.
    #[error(
        "the robot has {joints} joints, but the controllers in this program are built for 6 and 7; \
         use a robot with as many joints"
    )]
    Joints {
        /// Joints of the robot.
        joints: usize,
    },
    /// Drive and robot are not the same machine.
    #[error("the drive has {drive} joints, but the robot has {robot}: choose the robot that the drive link controls")]
    OtherRobot {
        /// Joints of the drive.
        drive: usize,
        /// Joints of the robot.
        robot: usize,
    },
    /// The drive speaks another protocol.
    #[error("the drive speaks protocol {found}, but this program speaks {expected}: use matching versions")]
    Protocol {
        /// Protocol of the drive.
        found: u16,
        /// Protocol of this program.
        expected: u16,
    },
    /// The drive's control period is out of range.
    #[error("the drive's control period is {period_us} µs: set it between 1000 and 4000 µs")]
    Period {
        /// Its period, in µs.
        period_us: u32,
    },
    /// The drive's hello has the number of no session.
    #[error(
        "the drive's hello has session 0, which asks for a hello: number the sessions of the drive, with another number \
         after each start (docs/drive-link.md)"
    )]
    NoSession,
    /// A limit of the drive's hello cannot be.
    #[error(
        "joint {joint} has {field} {value} in the drive's hello: give finite limits, a range that is not empty, and a \
         largest speed and torque above 0, in rad, rad/s and N m (docs/drive-link.md)"
    )]
    HelloLimit {
        /// Joint, from 1.
        joint: usize,
        /// Which limit, with its unit.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// The drive's hello has inertias for some of its joints.
    #[error(
        "the drive's hello has {found} inertias of motors for {joints} joints (motor_kg_m2): give one for each joint, or \
         an empty list if the drive's own torque control already makes up for the motors' inertia"
    )]
    MotorCount {
        /// How many.
        found: usize,
        /// Joints of the robot.
        joints: usize,
    },
    /// The inertia of a motor in the drive's hello cannot be.
    #[error(
        "the motor of joint {joint} has {inertia} kg m² in the drive's hello (motor_kg_m2): give its inertia seen at the \
         joint, from 0 to 50 kg m²"
    )]
    Motor {
        /// Joint, from 1.
        joint: usize,
        /// Its inertia, in kg m².
        inertia: f64,
    },
    /// The drive answers too late.
    #[error(
        "the drive's delay is {latency_us} µs (latency_us of its handshake), more than 5000 µs: no gains are safe \
         with it; run the controller nearer to the drive, or on a board"
    )]
    Latency {
        /// Its delay, in µs.
        latency_us: u32,
    },
    /// A message does not fit a frame.
    #[error("a message for the controller cannot be framed: {0}")]
    Frame(#[from] FrameError),
    /// The controller cannot work with the drive.
    #[error("the controller refused the drive: {0}")]
    Refused(Refusal),
    /// A command for an arm with another number of joints.
    #[error("a command has {found} torques, but the arm has {joints} joints: use a controller for this arm")]
    Torques {
        /// Torques of the command.
        found: usize,
        /// Joints of the drive.
        joints: usize,
    },
    /// The controller in QEMU failed.
    #[error(transparent)]
    Qemu(#[from] qemu::QemuError),
    /// A link between processes failed.
    #[error(transparent)]
    Tcp(#[from] tcp::TcpError),
    /// A device, drive or controller defined outside this crate failed.
    #[error("{source}")]
    Device {
        /// The error that it reported.
        source: Box<dyn std::error::Error + Send + Sync>,
        /// Whether the user's input caused it.
        input: bool,
    },
    /// A serial device cannot be opened.
    #[error(
        "{link} cannot be opened: {source}; {found}. Name the board's device, and join the group that may \
         open it (`spherecal doctor` names it)"
    )]
    Serial {
        /// Which link.
        link: String,
        /// What the system said.
        source: std::io::Error,
        /// Which devices there are.
        found: String,
    },
    /// The rate after the @ is not a number.
    #[error(
        "{link}: the text after the @ is not a rate in bits per second: give serial:DEVICE or, for example, serial:DEVICE@921600"
    )]
    Baud {
        /// Which link.
        link: String,
    },
    /// A transport failed.
    #[error("{link}: {source}: check the connection and start again with --resume")]
    Transport {
        /// Which link.
        link: String,
        /// What the system said.
        source: std::io::Error,
    },
}

impl LinkError {
    /// Wraps the error of a device, drive or controller defined outside this crate.
    pub fn device(source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Device {
            source: source.into(),
            input: false,
        }
    }

    /// Whether the user's input is the cause (exit code 2), not the link.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Joints { .. } | Self::Serial { .. } | Self::Baud { .. } => true,
            Self::Device { input, .. } => *input,
            _ => false,
        }
    }
}

/// Controller and drive together, as the host sees them. A device keeps the device's time and
/// exchanges bytes of the host link, one control period after the other.
#[auto_impl::auto_impl(Box)]
pub trait Device: Send {
    /// Device time, in µs since the first period.
    fn now_us(&self) -> u64;

    /// Control periods carried out.
    fn ticks(&self) -> u64;

    /// One control period. `down` are the host's bytes; the controller's are
    /// appended to `up`.
    ///
    /// # Errors
    /// When controller, drive or a link between them fails for good.
    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError>;

    /// Moves the plate to one of its placements, from 0. Returns whether it could; in a real cell
    /// an operator moves the plate.
    fn move_plate(&mut self, place: u32) -> bool {
        let _ = place;
        false
    }

    /// What the drive measures of itself, if it is in this process and a robot's own interface.
    fn monitor(&self) -> Option<native::Monitor> {
        None
    }

    /// Whether the drive moves a simulated arm, as its hello says. `None` where nobody has told it before the first
    /// command: a board, a service.
    fn simulated(&self) -> Option<bool> {
        None
    }

    /// Whether its time stands still until [`step`](Self::step) is called, as that of a simulation in lock-step does.
    fn waits(&self) -> bool {
        true
    }

    /// Gives it what makes keep-alives while nobody steps it. Does nothing where its time passes in
    /// [`step`](Self::step) only.
    fn keep_alive(&mut self, keep_alives: &KeepAlives) {
        let _ = keep_alives;
    }
}

/// The controller, wherever it runs: one control period at a time.
pub trait Controller: Send {
    /// Passes the drive's hello to the controller, once, before the first period.
    ///
    /// # Errors
    /// When the controller cannot work with such a drive.
    fn connect(&mut self, hello: &DriveHello) -> Result<(), LinkError>;

    /// Reports control periods that passed without a tick before this one. A controller with its
    /// own clock counts them itself.
    fn missed(&mut self, _periods: u32) {}

    /// States how punctual the loop was until now, for the host.
    fn timing(&mut self, _timing: LoopTiming) {}

    /// Passes the joint state of this period and the host's bytes to the controller. Returns the
    /// torque command, and appends the controller's bytes for the host to `up`. `now_us` is the
    /// device's time, in µs.
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
#[auto_impl::auto_impl(Box)]
pub trait Drive: Send {
    /// The drive's hello.
    fn hello(&self) -> &DriveHello;

    /// Carries out `command` for one control period and writes the state at its end. The first call
    /// has no command and writes the present state. In a later call without a command the brakes
    /// are closed for this period.
    ///
    /// # Errors
    /// When the drive or the transport to it fails for good.
    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError>;

    /// Sends the command of the next [`exchange`](Self::exchange) at once, so that it does not wait for what else the
    /// thread does in this period. That exchange gets the same command and does not send it again. A drive that waits
    /// for its controller has nothing to do here.
    ///
    /// # Errors
    /// When the drive or the transport to it fails for good.
    fn answer(&mut self, command: &DriveCommand) -> Result<(), LinkError> {
        let _ = command;
        Ok(())
    }

    /// Control periods that passed without an exchange before the last one; zero if drive and
    /// controller wait for each other.
    fn missed(&self) -> u32 {
        0
    }

    /// How punctual its loop is; `None` if drive and controller wait for each other.
    fn timing(&self) -> Option<LoopTiming> {
        None
    }

    /// Moves the plate of a simulated cell, see [`Device::move_plate`].
    fn move_plate(&mut self, place: u32) -> bool {
        let _ = place;
        false
    }

    /// What was received from the drive, if it is behind a wire.
    fn counters(&self) -> LinkCounters {
        LinkCounters::new()
    }

    /// What it measures of itself, if it speaks a robot's own interface.
    fn monitor(&self) -> Option<native::Monitor> {
        None
    }
}
