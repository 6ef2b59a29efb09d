//! Why a campaign stopped.

use spherecal_shared::protocol::host::{Fault, FaultReport, Phase, Refusal};

use super::words::describe;

use spherecal_link::{JournalError, LinkError};

use super::Implausible;
use spherecal_shared::robot::RobotError;

/// What can end a campaign before its time.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// The link failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The journal failed. Events that were not stored were not acknowledged.
    #[error("{0}")]
    Journal(#[from] JournalError),
    /// The robot is not one that a controller drives.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The controller speaks another protocol.
    #[error(
        "the controller ({version}) speaks protocol {found}, but this program speaks {expected}: \
         use a firmware and a program of the same version"
    )]
    Protocol {
        /// Version of the firmware.
        version: String,
        /// Its protocol.
        found: u16,
        /// This program's.
        expected: u16,
    },
    /// Something commands the arm that is only to be read.
    #[error("{what}: stop what moves the robot, and begin again")]
    Commanded {
        /// What shows it.
        what: String,
    },
    /// The controller is of another version.
    #[error(
        "the controller's firmware is version {found} (build {build}), but this program is version {expected}: \
         use a firmware and a program of the same version"
    )]
    Version {
        /// Version of the firmware.
        found: String,
        /// Its build.
        build: String,
        /// Version of this program.
        expected: &'static str,
    },
    /// The controller's messages have another layout than this program's.
    #[error(
        "the controller's messages have another layout than this program's (schema {found}, expected {expected:016x}): \
         build firmware and program from the same sources (`scripts/cross.sh build`), and load the firmware again"
    )]
    Schema {
        /// Schema key and build of the firmware, as far as they could be read.
        found: String,
        /// Key of this program.
        expected: u64,
    },
    /// The controller was built for another arm.
    #[error(
        "the controller was built for {controller} joints, but the robot has {robot}: use the controller for this robot"
    )]
    Joints {
        /// Joints of the controller.
        controller: usize,
        /// Joints of the robot.
        robot: usize,
    },
    /// The controller sent an impossible value.
    #[error(
        "the controller sent an impossible value ({0}); it was not stored: check that controller, drive and program are of \
         the same version, then continue with --resume"
    )]
    Implausible(#[from] Implausible),
    /// The controller no longer knows this session.
    #[error(
        "the controller was restarted, or another host has taken it over: make sure that nobody else uses it and that the \
         arm is safe; then continue with --resume"
    )]
    Restarted,
    /// A command was refused.
    #[error("the controller refused to {what}: {refusal}")]
    Refused {
        /// The command.
        what: String,
        /// Why.
        refusal: Refusal,
    },
    /// No answer.
    #[error(
        "the controller did not {what} within {limit_s:.0} s of its own time (it is in phase {phase:?}): check the link and the controller"
    )]
    Timeout {
        /// What it should have done.
        what: String,
        /// How long was waited, in s.
        limit_s: f64,
        /// Phase that it was in.
        phase: Phase,
    },
    /// No sphere where one should be.
    #[error(
        "no contact with sphere {sphere} in {attempts} attempts: check that nothing pushes the arm, that the plate is in \
         place and that the waypoint of sphere {sphere} is within 10 mm; then continue with --resume"
    )]
    NoContact {
        /// The sphere.
        sphere: u32,
        /// Attempts made.
        attempts: u32,
    },
    /// The same trouble again and again.
    #[error(
        "sphere {sphere} was given up after {attempts} attempts, the last of which ended with {}: {}; \
         then continue with --resume", describe(report), remedy(report.fault)
    )]
    GivenUp {
        /// The sphere.
        sphere: u32,
        /// Attempts made.
        attempts: u32,
        /// The last fault.
        report: FaultReport,
    },
    /// A free motion failed again and again.
    #[error("the arm could not {what} in {attempts} attempts; the last ended with {}: {}", describe(report), remedy(report.fault))]
    Motion {
        /// What it should have done.
        what: String,
        /// Attempts made.
        attempts: u32,
        /// The last fault.
        report: FaultReport,
    },
    /// No clear way.
    #[error(
        "no way to {what} was found that keeps clear of spheres, plate and arm: guide the arm by hand to a place above \
         the plate, then continue with --resume"
    )]
    Blocked {
        /// What it should have done.
        what: String,
    },
    /// No room for the free motion of a first run.
    #[error(
        "joint {joint} cannot turn a little to either side, within its limits and clear of spheres, plate and arm: guide the \
         arm by hand to a place above the plate, away from the limits of its joints, and begin again"
    )]
    Crowded {
        /// Number of the joint, from 1.
        joint: usize,
    },
    /// The controller was lost.
    #[error(
        "the controller was silent for {silent_s:.0} s and does not answer the handshake: check its power and the \
         host link; then continue with --resume"
    )]
    Lost {
        /// How long it was silent, in s.
        silent_s: f64,
    },
    /// A sphere is not where it was.
    #[error(
        "sphere {sphere} is {by_mm:.0} mm from {}: the plate or a sphere was \
         moved; fix them and begin a new run, because earlier recordings would not fit later ones",
        expected_place(*sphere, *other)
    )]
    Moved {
        /// The sphere.
        sphere: u32,
        /// The sphere it was compared with; the same sphere where it was found before.
        other: u32,
        /// By how much, in mm.
        by_mm: f64,
    },
    /// A sphere moved a little.
    #[error(
        "sphere {sphere} is {by_mm:.2} mm from where it was at the same visit before, in {couplings} couplings in a row (limit \
         {limit_mm:.2} mm): the sphere, the plate or the robot's base moved, or the arm drifts; fix the cause and begin a \
         new run, because earlier recordings do not fit later ones"
    )]
    Shifted {
        /// The sphere.
        sphere: u32,
        /// Distance of the middle of the two couplings that agree best, in mm.
        by_mm: f64,
        /// Largest distance accepted, in mm.
        limit_mm: f64,
        /// Couplings that showed it.
        couplings: usize,
    },
    /// No two couplings of a sphere agree.
    #[error(
        "no two of {couplings} couplings of sphere {sphere} agree: the nearest two are {apart_mm:.2} mm apart (limit \
         {limit_mm:.2} mm); clean nest and sphere, check that sphere and plate are fastened, then continue with --resume"
    )]
    Scattered {
        /// The sphere.
        sphere: u32,
        /// Couplings.
        couplings: usize,
        /// Distance of the two that are nearest to each other, in mm.
        apart_mm: f64,
        /// Largest distance accepted, in mm.
        limit_mm: f64,
    },
    /// A sphere that was coupled before is not found again.
    #[error(
        "sphere {sphere} was coupled before and is not found there again, in {attempts} attempts (the last: {fault:?}): the \
         sphere or the plate moved, or something lies on it; fix the cause and begin a new run, because earlier \
         recordings may not fit"
    )]
    Gone {
        /// The sphere.
        sphere: u32,
        /// Attempts.
        attempts: u32,
        /// What the last attempt ended with.
        fault: Fault,
    },
    /// Too many poses failed.
    #[error(
        "{rejected} of {planned} poses were given up: something is wrong with the coupling or with the plan; \
         look at the faults, then continue with --resume"
    )]
    Rejected {
        /// Poses given up.
        rejected: usize,
        /// Poses planned.
        planned: usize,
    },
    /// The plate must be moved, and no operator can be asked.
    #[error(
        "the plate must be moved to placement {} of the plan, but nobody can confirm it at this terminal: \
         run without --json at a terminal, or plan one placement (give one of [[cell.placements]])", place + 1
    )]
    Plate {
        /// Placement, from 0.
        place: u32,
    },
    /// Stopped by the user.
    #[error("stopped on request: nothing is lost; continue with --resume")]
    Interrupted,
}

/// The place from which a sphere was found to be off, in words: where it was itself, or where another one says it is.
fn expected_place(sphere: u32, other: u32) -> String {
    if sphere == other {
        "where it was found before".to_owned()
    } else {
        format!("its expected position relative to sphere {other}")
    }
}

/// The operator's remedy for a fault.
pub fn remedy(fault: Fault) -> &'static str {
    match fault {
        Fault::JointPosition => {
            "a pose is too close to a joint limit, or something pushed the arm there: clear the arm, or plan with a larger \
             margin"
        }
        Fault::JointVelocity => {
            "something pushed the arm, or it is too fast: clear the arm, or lower procedure.turn.speed_rad_s or \
             procedure.motion.speed_rad_s; if the joint oscillates, the drive answers too late (`spherecal stability`) or \
             declares the wrong torque_sign"
        }
        Fault::JointTorque => "check tool mass and centre of mass, and that nothing blocks the arm",
        Fault::Force => "the arm hit something or the nest is jammed: clear the path",
        Fault::PathDeviation => {
            "something blocks or pushes the arm: clear the path; where nothing touches it, a cable or friction holds the joint that \
             is named: free the cable, or warm the joint up"
        }
        Fault::MotionTimeout => "the arm does not settle: check friction and payload, or raise settle_s",
        Fault::Tare => {
            "something pushes the arm at rest, the declared tool mass or centre of mass is wrong, or a torque sensor is off: \
             clear the arm, and check the tool"
        }
        Fault::NoContact => "check that the sphere is in place and that its waypoint is within 10 mm",
        Fault::NotSeated => {
            "clean nest and sphere, check that the magnet holds, and teach the waypoint closer; far above the sphere, friction \
             that the torque sensors do not see felt like a contact"
        }
        Fault::ContactLost => "clean nest and sphere, check the magnet, and fasten a plate that swings",
        Fault::StillCoupled => "pull the nest off by hand, or raise procedure.decouple.retreat_m",
        Fault::StaleState => {
            "the drive does not keep its period: check the drive link; where a joint is named, check its encoder"
        }
        Fault::NotFinite => {
            "the drive sends values that are not numbers or that no arm can have: check the drive or its gateway"
        }
        Fault::Drive => "release the emergency stop and enable the drives",
        Fault::Overrun => "the controller misses its period: reduce its load",
        Fault::HostSilence => "the host link was silent: check the network and the load of this computer",
        Fault::PositionJump => "an encoder lost its position: reference the joint and restart the controller",
        Fault::TorqueSensor => {
            "a torque sensor or a motor fails: run the drive's self-test, and have the joint inspected; on a new drive, check \
             torque_sign and motor_kg_m2 in its handshake (for franka:, fri: and ur: in [cell.drive])"
        }
        Fault::TcpSpeed => "lower procedure.motion.speed_rad_s, and find out what pushes the arm",
        Fault::Workspace => "the path leaves procedure.limits.workspace or reaches the plate: check plate and plan",
        Fault::Unstable => {
            "control makes the joint oscillate, unless something struck the arm: the drive answers later than the latency_us \
             of its handshake, or it declares wrong motor_kg_m2 or torque_sign; measure its delay and declare it (for \
             franka:, fri: and ur: in [cell.drive])"
        }
        Fault::KineticEnergy => {
            "control or something outside drives the arm: find out what pushes it, and check latency_us, motor_kg_m2 and \
             torque_sign in the drive's handshake"
        }
        Fault::Pressing => {
            "the arm pressed on something, or something pressed on it: clear the path, and check the waypoints, the declared \
             tool mass, and that the nest turns freely on the sphere and comes off it (a magnet of more than 26.5 N: \
             procedure.decouple.magnet_n)"
        }
        Fault::Disturbance => {
            "something holds the joint: loosen cables and hoses there, have its torque sensor zeroed, and check payload and friction"
        }
        Fault::Internal => "this is a defect of the controller: report it with the database",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a fault whose cause was found in a simulation does not name it: a nest without a magnet, friction behind the torque
    // sensors, a plate that swings, a tool that is not declared, drives that are off.
    #[test]
    fn causes_that_were_found_are_named() {
        for (fault, cause) in [
            (Fault::NotSeated, "magnet"),
            (Fault::NotSeated, "friction that the torque sensors do not see"),
            (Fault::ContactLost, "a plate that swings"),
            (Fault::Pressing, "tool mass"),
            (Fault::Tare, "the declared tool mass"),
            (Fault::Drive, "emergency stop"),
        ] {
            assert!(remedy(fault).contains(cause), "{}", remedy(fault));
        }
    }

    // Fails if a sphere is said to be off relative to itself, or if the sphere it was compared with is not named.
    #[test]
    fn a_moved_sphere_is_compared_with_what_it_is_compared_with() {
        let words = |other| {
            let moved = CampaignError::Moved {
                sphere: 1,
                other,
                by_mm: 20.4,
            };
            moved.to_string()
        };
        assert!(words(1).starts_with("sphere 1 is 20 mm from where it was found before: the plate"));
        assert!(words(3).starts_with("sphere 1 is 20 mm from its expected position relative to sphere 3: the plate"));
    }
}
