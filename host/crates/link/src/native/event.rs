//! What happened to a robot behind its own interface, in its own words.

use std::time::Duration;

/// Something that a person should know of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DriveEvent {
    /// How the controller's thread is scheduled.
    Scheduled(spherecal_realtime::Granted),
    /// The robot accepts torques from now on.
    Started,
    /// A Franka robot's own model states no limits: those of the data sheet count.
    ModelUnread(spherecal_fci::robot::ModelError),
    /// A Franka robot ended the motion: a reflex, the user stop, a safety function.
    FrankaEnded(spherecal_fci::client::MotionEnd),
    /// A Franka robot does not start a motion.
    FrankaNotReady {
        /// Its mode.
        mode: spherecal_fci::wire::RobotMode,
        /// Its active errors and the reason of its last reflex.
        errors: spherecal_fci::wire::ErrorSet,
    },
    /// A KUKA cabinet ended commanding.
    KukaEnded(spherecal_fri::client::CommandingEnd),
    /// The client waits for the application on the cabinet to start its motion.
    KukaWaits(spherecal_fri::wire::SessionState),
    /// The robot does not permit commands yet.
    KukaNotReady(spherecal_fri::client::EndCause),
    /// A robot of Universal Robots ended the program.
    UrEnded(spherecal_ur::client::ProgramEnd),
    /// A robot of Universal Robots did not run the program that was sent.
    UrNotStarted,
    /// A robot of Universal Robots is asked to end its protective stop.
    UrUnlocking,
    /// The Robot API of PolyScope X refused to end a protective stop, with this HTTP status.
    UrUnlockRefused(u16),
    /// A robot of Universal Robots stays stopped: a person has to act.
    UrPersonNeeded(spherecal_ur::client::Unready),
    /// No state came for this long.
    Silent(Duration),
    /// States came again.
    Back,
    /// The connection was lost and made again.
    Reconnected,
    /// The drive asks the robot to clear the errors of a reflex.
    Recovering,
    /// The robot stays in its reflex: a person has to act.
    PersonNeeded(spherecal_fci::wire::ErrorSet),
}

impl std::fmt::Display for DriveEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Scheduled(granted) => granted.fmt(f),
            Self::Started => f.write_str("the robot accepts torques"),
            Self::ModelUnread(error) => write!(f, "{error}; the limits of the maker's data sheet are kept"),
            Self::FrankaEnded(end) => end.fmt(f),
            Self::FrankaNotReady { mode, errors } => {
                write!(f, "the robot does not start a motion: mode {mode} ({errors})")
            }
            Self::KukaEnded(end) => end.fmt(f),
            Self::KukaWaits(session) => write!(
                f,
                "the cabinet's session is in {session}: start the application, and answer its question with \"Move\""
            ),
            Self::KukaNotReady(cause) => write!(f, "the cabinet permits no commands: {cause}"),
            Self::UrEnded(end) => end.fmt(f),
            Self::UrNotStarted => f.write_str(
                "the robot did not run the program: choose remote control at the teach pendant (Settings, System, Remote Control; \
                 PolyScope X: in the safety overview, in automatic mode)",
            ),
            Self::UrUnlocking => f.write_str("asking the robot to end the protective stop"),
            Self::UrUnlockRefused(status) => {
                let remedy = spherecal_ur::client::remedy(*status);
                write!(f, "the robot did not end the protective stop (HTTP status {status}): {remedy}")
            }
            Self::UrPersonNeeded(unready) => unready.fmt(f),
            Self::Silent(after) => write!(
                f,
                "no state from the robot for {} ms: check cable and network",
                after.as_millis()
            ),
            Self::Back => f.write_str("the robot sends states again"),
            Self::Reconnected => f.write_str("the connection to the robot was lost and made again"),
            Self::Recovering => f.write_str("clearing the errors of the reflex"),
            Self::PersonNeeded(errors) => write!(
                f,
                "the robot stays in its reflex ({errors}): open Desk, and move the arm back by hand if a joint is \
                 beyond its limit"
            ),
        }
    }
}
