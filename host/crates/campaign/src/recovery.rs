//! What becomes of each fault: detected how and when, what arm and host do, how
//! often, and what a person does after that.
//!
//! One [`Policy`] for each [`Fault`] and for a controller that is lost ([`LOST_S`]);
//! `docs/recovery.md` is made from it, and a test holds the page against it.
//!
//! Whatever the fault, the path is that of the paper's Section 6: the arm holds,
//! damped, where it was; the host clears the fault, pulls the nest off the
//! sphere if it is on, moves to the approach frame, couples again and goes on
//! at the pose where it was. No homing. What differs is how long it waits
//! before, and whether the pose is to blame.

use spherecal_link::fault_name;
use spherecal_shared::protocol::host::Fault;

/// What is done about a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// What is detected.
    pub detected: &'static str,
    /// Time from what is detected to the fault, in ms, with the procedure's defaults.
    pub within_ms: u32,
    /// What the arm does besides holding.
    pub arm: &'static str,
    /// Time before the fault is first cleared, in s; twice as long each time
    /// that it comes back at once.
    pub pause_s: f64,
    /// Whether the pose that was turned to or recorded is to blame: given up
    /// after [`pose_attempts`](super::Options::pose_attempts).
    pub blames_pose: bool,
}

/// Every fault that a controller declares.
pub const FAULTS: [Fault; 21] = [
    Fault::JointPosition,
    Fault::JointVelocity,
    Fault::JointTorque,
    Fault::Force,
    Fault::PathDeviation,
    Fault::MotionTimeout,
    Fault::Tare,
    Fault::NoContact,
    Fault::NotSeated,
    Fault::ContactLost,
    Fault::StillCoupled,
    Fault::StaleState,
    Fault::NotFinite,
    Fault::Drive,
    Fault::Overrun,
    Fault::HostSilence,
    Fault::Internal,
    Fault::PositionJump,
    Fault::TorqueSensor,
    Fault::TcpSpeed,
    Fault::Workspace,
];

/// After this long without a word the controller counts as lost, in s: it was
/// reset, or the link is down. Statistics come every second.
pub const LOST_S: f64 = 3.0;
/// How long the host then repeats the handshake before it gives up, in s.
pub const HANDSHAKE_S: f64 = 30.0;

const HOLDS: &str = "holds";
const BRAKES: &str = "keeps the last torque for 23 ms at most, then brakes; holds when states come again";

/// What is done about `fault`.
pub fn policy(fault: Fault) -> Policy {
    let (detected, within_ms, arm, pause_s, blames_pose) = match fault {
        Fault::JointPosition => (
            "a joint leaves its range less the margin (half of it while leaving a sphere)",
            1,
            HOLDS,
            0.5,
            true,
        ),
        Fault::JointVelocity => ("a joint exceeds its share of the speed limit", 1, HOLDS, 0.5, true),
        Fault::JointTorque => ("a torque saturated for 50 ms", 51, HOLDS, 0.5, true),
        Fault::Force => ("more than 100 N at the TCP for 10 ms", 60, HOLDS, 2.0, true),
        Fault::PathDeviation => (
            "the arm is 0.1 rad, 150 mm or, turning, 0.3 rad off its path",
            1,
            HOLDS,
            2.0,
            true,
        ),
        Fault::MotionTimeout => (
            "a motion has not settled 3 s (turning 4 s) past its end",
            1,
            HOLDS,
            0.5,
            true,
        ),
        Fault::Tare => ("more than 12 N at rest in free space", 800, HOLDS, 2.0, false),
        Fault::NoContact => (
            "80 mm travelled, or the plate's bound reached, without contact",
            1,
            HOLDS,
            0.5,
            false,
        ),
        Fault::NotSeated => (
            "the nest gives way while coupling or under the test pull",
            600,
            HOLDS,
            0.5,
            false,
        ),
        Fault::ContactLost => (
            "the TCP 5 mm away or faster than 15 mm/s for 10 ms; 1 mm away under the pull that ends a recording",
            10,
            HOLDS,
            0.5,
            true,
        ),
        Fault::StillCoupled => ("30 mm not reached 3 s past the retreat's end", 1, HOLDS, 0.5, false),
        Fault::StaleState => (
            "4 states missing, repeated or late in a row, or 21 frozen; one angle 21 times the same while its torque changes by 5 % of its limit, 10 N m at least: brakes then until the fault is cleared",
            21,
            BRAKES,
            1.0,
            false,
        ),
        Fault::NotFinite => (
            "4 states in a row with a NaN, an infinity or too few joints",
            4,
            BRAKES,
            1.0,
            false,
        ),
        Fault::Drive => ("the drive is not ready", 1, BRAKES, 2.0, false),
        Fault::Overrun => ("4 control periods missed in a row", 4, HOLDS, 1.0, false),
        Fault::HostSilence => (
            "no frame from the host for 2 s while it is needed",
            2001,
            HOLDS,
            0.5,
            false,
        ),
        Fault::Internal => ("the mass matrix is not positive definite", 1, BRAKES, 0.5, false),
        Fault::PositionJump => (
            "an angle jumps farther than its joint can run, 4 states in a row",
            4,
            "keeps the last torque for 3 ms, then brakes; holds when the angle is back",
            2.0,
            false,
        ),
        Fault::TorqueSensor => (
            "a torque differs by 15 % of its limit, 10 N m at least, to one side for 20 ms",
            21,
            "brakes until the fault is cleared",
            2.0,
            false,
        ),
        Fault::TcpSpeed => ("the TCP faster than 1.3 m/s for 5 ms", 6, HOLDS, 0.5, true),
        Fault::Workspace => ("the TCP leaves the workspace for 5 ms", 6, HOLDS, 0.5, true),
    };
    Policy {
        detected,
        within_ms,
        arm,
        pause_s,
        blames_pose,
    }
}

/// The table of `docs/recovery.md`: one line of Markdown for each fault.
pub fn table() -> String {
    let mut text = String::from(
        "| fault | what is detected | within, ms | the arm | waits, s | the pose is to blame | when it gives up, a person |\n\
         |---|---|---:|---|---:|---|---|\n",
    );
    for fault in FAULTS {
        let p = policy(fault);
        text.push_str(&format!(
            "| `{}` | {} | {} | {} | {} | {} | {} |\n",
            fault_name(fault),
            p.detected,
            p.within_ms,
            p.arm,
            p.pause_s,
            if p.blames_pose { "yes" } else { "no" },
            super::remedy(fault)
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a fault is missing from the list, or twice in it.
    #[test]
    fn every_fault_has_its_policy() {
        let names: std::collections::BTreeSet<String> = FAULTS.iter().map(|f| fault_name(*f)).collect();
        assert_eq!(names.len(), FAULTS.len());
        // Its last variant has the number of all before it.
        let last = postcard::to_allocvec(&FAULTS[FAULTS.len() - 1]).expect("a number");
        assert_eq!(usize::from(last[0]), FAULTS.len() - 1);
        let none = postcard::from_bytes::<Fault>(&[FAULTS.len() as u8]);
        assert!(none.is_err(), "{none:?} has no policy");
    }
}
