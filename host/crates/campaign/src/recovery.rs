//! The reaction to each fault: how and when it is detected, what arm and host do, how often, and
//! what an operator does after that.
//!
//! There is one [`Policy`] for each [`Fault`], and one rule for a controller that is lost
//! ([`LOST_S`]). `docs/recovery.md` contains the table that this module prints; a test compares the
//! two.
//!
//! Every fault takes the path of the paper's Section 6. The arm holds, damped, where it was. The
//! host clears the fault, decouples the nest if it is coupled, moves to the approach frame, couples
//! again and continues at the interrupted pose. It does not home. The faults differ in how long the
//! host waits first and in whether the pose is the cause.

use spherecal_model::name_of;
use spherecal_shared::protocol::host::Fault;

/// What is done about a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// What is detected.
    pub detected: &'static str,
    /// Time from the detected condition to the fault, in ms, with the procedure's defaults.
    pub within_ms: u32,
    /// What the arm does besides holding.
    pub arm: &'static str,
    /// Delay before the fault is first cleared, in s. The delay doubles each time the fault returns
    /// at once.
    pub pause_s: f64,
    /// Whether the pose being turned to or recorded is the cause. Such a pose is given up after
    /// [`pose_attempts`](super::RunOptions::pose_attempts).
    pub blames_pose: bool,
}

/// Every fault that a controller declares.
pub const FAULTS: [Fault; 25] = [
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
    Fault::Unstable,
    Fault::KineticEnergy,
    Fault::Pressing,
    Fault::Disturbance,
];

/// After this long without a frame the controller counts as lost, in s: it was reset, or the link
/// is down. In normal operation statistics arrive every second.
pub const LOST_S: f64 = 3.0;
/// How long the host then repeats the handshake before it gives up, in s.
pub const HANDSHAKE_S: f64 = 30.0;

const HOLDS: &str = "holds";
const GIVES_WAY: &str = "holds with at most 5 N beyond model error, and gives way to more by up to 100 mm";
const BRAKES: &str = "keeps the last torque for 23 ms at most, then brakes; holds when states arrive again";

const STOPS: &str = "brakes until the fault is cleared";

/// What is done about `fault`.
pub fn policy(fault: Fault) -> Policy {
    let (detected, within_ms, arm, pause_s, blames_pose) = match fault {
        Fault::JointPosition => (
            "a joint is closer to its limit than the margin (half the margin while leaving a sphere)",
            1,
            HOLDS,
            0.5,
            true,
        ),
        Fault::JointVelocity => (
            "a joint exceeds its share of the speed limit",
            1,
            "holds; brakes if a joint is faster than its limit for 2 ms",
            0.5,
            true,
        ),
        Fault::JointTorque => ("a torque saturated for 50 ms", 51, HOLDS, 0.5, true),
        Fault::Force => (
            "a steady force of more than 100 N at the TCP for 10 ms",
            60,
            HOLDS,
            2.0,
            true,
        ),
        Fault::PathDeviation => (
            "the arm is 0.1 rad, 150 mm or, turning, 0.3 rad off its path",
            1,
            HOLDS,
            2.0,
            true,
        ),
        Fault::MotionTimeout => (
            "a motion has not settled 3 s (turning and recording 4 s; 12 s if it is there and creeps) past its end",
            1,
            HOLDS,
            0.5,
            true,
        ),
        Fault::Tare => (
            "a force of more than 12 N at rest in free space",
            800,
            HOLDS,
            2.0,
            false,
        ),
        Fault::NoContact => (
            "no contact after 80 mm, or before the bound at the plate",
            1,
            HOLDS,
            0.5,
            false,
        ),
        Fault::NotSeated => (
            "the nest moves while coupling or under the test pull",
            600,
            HOLDS,
            0.5,
            false,
        ),
        Fault::ContactLost => (
            "the TCP is 5 mm away or faster than 15 mm/s for 10 ms (and more by what joint offsets of 25 mrad explain), 0.2 mm away in a recording, or 3 mm away under the pull that ends it, or 0.75 mm away 1.5 s later",
            10,
            HOLDS,
            0.5,
            true,
        ),
        Fault::StillCoupled => (
            "the nest is less than 30 mm away 3 s after the end of the retreat",
            1,
            HOLDS,
            0.5,
            false,
        ),
        Fault::StaleState => (
            "4 states missing, repeated or late in a row, or 21 frozen; one angle repeated 21 times while its torque changes by 5 % of its limit, at least 10 N m: then the arm brakes until the fault is cleared",
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
            "an angle jumps farther than its joint can move, in 4 states in a row",
            4,
            "keeps the last torque for 3 ms, then brakes; holds when the angle is plausible again",
            2.0,
            false,
        ),
        Fault::TorqueSensor => (
            "a torque deviates to one side by 15 % of its limit, at least 10 N m, for 20 ms",
            21,
            STOPS,
            2.0,
            false,
        ),
        Fault::TcpSpeed => ("the TCP is faster than 1.3 m/s for 5 ms", 6, HOLDS, 0.5, true),
        Fault::Workspace => ("the TCP is outside the workspace for 5 ms", 6, HOLDS, 0.5, true),
        Fault::Unstable => (
            "a joint swings to and fro, faster and faster, with more than 15 % of its speed limit (at most 0.4 rad/s), or is faster than its limit for 2 ms",
            1,
            STOPS,
            2.0,
            false,
        ),
        Fault::KineticEnergy => (
            "the arm has 5 J more kinetic energy than its setpoint for 3 ms",
            3,
            STOPS,
            2.0,
            false,
        ),
        Fault::Pressing => (
            "a force of more than 15 N at the TCP for 50 ms in a free motion, of 40 N for 200 ms while the nest is on a sphere, or of 34 N for 50 ms or 20 N for 250 ms on the way off it (for 50 ms from 5 mm off; [more for a stronger magnet](design/control.md#the-control-law))",
            51,
            GIVES_WAY,
            2.0,
            true,
        ),
        Fault::Disturbance => (
            "a free motion does not reach its target 3 s past its end, and a joint needs more than 1/12 of its torque limit (2 to 10 N m) beyond the model",
            3001,
            HOLDS,
            2.0,
            false,
        ),
    };
    Policy {
        detected,
        within_ms,
        arm,
        pause_s,
        blames_pose,
    }
}

/// The table of `docs/recovery.md`: one line of Markdown per fault.
pub fn table() -> String {
    let mut text = String::from(
        "| fault | what is detected | within, ms | the arm | host waits, s | the pose is the cause | what to do if it gives up |\n\
         |---|---|---:|---|---:|---|---|\n",
    );
    for fault in FAULTS {
        let p = policy(fault);
        text.push_str(&format!(
            "| `{}` | {} | {} | {} | {} | {} | {} |\n",
            name_of(fault),
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
        let names: std::collections::BTreeSet<String> = FAULTS.iter().map(|f| name_of(*f)).collect();
        assert_eq!(names.len(), FAULTS.len());
        // Its last variant has the number of all before it.
        let last = postcard::to_allocvec(&FAULTS[FAULTS.len() - 1]).expect("a number");
        assert_eq!(usize::from(last[0]), FAULTS.len() - 1);
        let none = postcard::from_bytes::<Fault>(&[FAULTS.len() as u8]);
        assert!(none.is_err(), "{none:?} has no policy");
    }
}
