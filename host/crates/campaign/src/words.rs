//! A fault in words: value, limit and unit.

use spherecal_shared::protocol::host::{Fault, FaultReport, Phase};

/// Unit of a fault's value and limit, and the factor from the unit in the report.
fn unit(report: &FaultReport) -> (f64, &'static str) {
    let degrees = (180.0 / core::f64::consts::PI, "degrees");
    let millimetres = (1e3, "mm");
    match report.fault {
        Fault::JointPosition | Fault::PositionJump => degrees,
        Fault::JointVelocity => (degrees.0, "degrees/s"),
        Fault::JointTorque | Fault::TorqueSensor | Fault::Disturbance => (1.0, "N m"),
        Fault::Force | Fault::Tare | Fault::Pressing => (1.0, "N"),
        Fault::PathDeviation if report.phase == Phase::Approaching => millimetres,
        Fault::PathDeviation => degrees,
        // While turning it is an angle or, at the end, a speed.
        Fault::MotionTimeout if report.phase == Phase::Turning => (1.0, "rad or rad/s"),
        Fault::MotionTimeout => degrees,
        Fault::NoContact | Fault::NotSeated | Fault::ContactLost | Fault::StillCoupled | Fault::Workspace => {
            millimetres
        }
        Fault::StaleState | Fault::NotFinite | Fault::Overrun => (1.0, "periods"),
        Fault::HostSilence => (1.0, "s"),
        Fault::TcpSpeed => (1.0, "m/s"),
        Fault::Unstable => (1.0, "rad/s"),
        Fault::KineticEnergy => (1.0, "J"),
        Fault::Drive | Fault::Internal => (1.0, ""),
    }
}

/// A number with as many digits as show that it differs from the limit.
fn number(value: f64, digits: usize) -> String {
    format!("{value:.digits$}")
}

/// A fault in words: what, where, value, limit and unit.
pub fn describe(report: &FaultReport) -> String {
    let joint = if report.joint == 0 {
        String::new()
    } else {
        format!(", joint {}", report.joint)
    };
    let at = format!("{:?} while {:?}{joint}", report.fault, report.phase);
    let (factor, unit) = unit(report);
    let (value, limit) = (report.value * factor, report.limit * factor);
    let digits = |x: f64| if x.abs() < 10.0 { 2 } else { 1 };
    let (v, l) = (number(value, digits(value)), number(limit, digits(limit)));
    let what = match report.fault {
        Fault::Drive | Fault::Internal => return at,
        Fault::JointPosition => {
            let beyond = number((value - limit).abs(), 3);
            return format!("{at} ({v} {unit}, {beyond} {unit} beyond the limit of {l} {unit} with its margin)");
        }
        Fault::PathDeviation if report.value.abs() <= report.limit.abs() => {
            return format!(
                "{at} (something held the arm: it could not go on, {v} {unit} off its path; the limit is {l} {unit})"
            );
        }
        Fault::ContactLost if report.value.abs() <= report.limit.abs() => {
            return format!(
                "{at} (the nest moved faster than a seated one, {v} {unit} from where it seated; the limit is {l} {unit})"
            );
        }
        Fault::Workspace => return format!("{at} ({v} {unit} outside)"),
        Fault::StillCoupled => "moved off by",
        _ => "value",
    };
    format!("{at} ({what} {v} {unit}, limit {l} {unit})")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recovery::FAULTS;

    // Fails if a fault with a limit is told without its value, its limit or its unit, or as beyond
    // a limit that it does not exceed.
    #[test]
    fn every_fault_is_told_with_value_limit_and_unit() {
        for fault in FAULTS {
            for phase in [Phase::Moving, Phase::Approaching, Phase::Turning] {
                let report = FaultReport {
                    fault,
                    phase,
                    time_us: 0,
                    tick: 0,
                    joint: 2,
                    value: 0.0419,
                    limit: 0.1,
                };
                let text = describe(&report);
                let (factor, unit) = unit(&report);
                assert!(
                    text.starts_with(&format!("{fault:?} while {phase:?}, joint 2")),
                    "{text}"
                );
                assert_eq!(text.contains(" beyond "), fault == Fault::JointPosition, "{text}");
                if !unit.is_empty() {
                    assert!(text.contains(unit), "{text}");
                    let value = 0.0419 * factor;
                    let shown = number(value, if value < 10.0 { 2 } else { 1 });
                    assert!(text.contains(&shown), "{text}: no {shown}");
                }
                assert!(crate::remedy(fault).len() > 20);
            }
        }
        // A nest that was lost by its speed is not told as beyond a distance.
        let lost = |value| FaultReport {
            fault: Fault::ContactLost,
            phase: Phase::Coupled,
            time_us: 0,
            tick: 0,
            joint: 0,
            value,
            limit: 0.005,
        };
        assert!(describe(&lost(0.00086)).contains("faster than a seated one, 0.86 mm from where"));
        assert!(describe(&lost(0.0061)).contains("value 6.10 mm, limit 5.00 mm"));
        let at_limit = FaultReport {
            fault: Fault::JointPosition,
            phase: Phase::Moving,
            time_us: 0,
            tick: 0,
            joint: 4,
            value: -2.08443,
            limit: -2.08440,
        };
        assert!(
            describe(&at_limit).contains("0.002 degrees beyond"),
            "{}",
            describe(&at_limit)
        );
    }
}
