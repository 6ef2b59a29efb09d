//! What the robot side's dashboard says, and does.

use std::sync::atomic::Ordering;

use super::controls::{Controls, Unlock};
use crate::wire::{ControllerVersion, RobotMode, RuntimeState, SafetyMode, words};

/// What a client reads first.
pub(super) const GREETING: &[u8] = b"Connected: Universal Robots Dashboard Server\n";

/// The first line that has come, without its end.
pub(super) fn line(received: &mut Vec<u8>) -> Option<String> {
    let end = received.iter().position(|byte| *byte == b'\n')?;
    let line: Vec<u8> = received.drain(..=end).collect();
    Some(String::from_utf8_lossy(&line).trim().to_owned())
}

/// What the dashboard of a robot with this software says, and does. `stopped_s`: how long the robot has been stopped.
pub(super) fn answer(line: &str, version: ControllerVersion, controls: &Controls, stopped_s: f64) -> String {
    let mode = controls.robot_mode.load(Ordering::Relaxed);
    let safety = controls.safety_mode.load(Ordering::Relaxed);
    let state = controls.runtime_state.load(Ordering::Relaxed);
    let runs = state == RuntimeState::Playing.number();
    match line.to_ascii_lowercase().as_str() {
        "robotmode" => format!(
            "Robotmode: {}",
            words(RobotMode::from_number(mode).map(RobotMode::name), mode)
        ),
        "safetystatus" | "safetymode" => {
            format!(
                "Safetystatus: {}",
                words(SafetyMode::from_number(safety).map(SafetyMode::name), safety)
            )
        }
        "running" => format!("Program running: {runs}"),
        "programstate" => format!("{} spherecal", if runs { "PLAYING" } else { "STOPPED" }),
        "is in remote control" => controls.remote.load(Ordering::Relaxed).to_string(),
        "close safety popup" => "closing safety popup".to_owned(),
        "stop" => {
            controls.stop_program.store(true, Ordering::Relaxed);
            "Stopped".to_owned()
        }
        "unlock protective stop" => {
            if controls.unlock(stopped_s) == Unlock::TooEarly {
                return "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop \
                        before unlocking"
                    .to_owned();
            }
            "Protective stop releasing".to_owned()
        }
        "polyscopeversion" => format!("URSoftware {version} (simulated by spherecal)"),
        "get serial number" => "00000000000".to_owned(),
        "quit" => "Disconnected".to_owned(),
        other => format!("could not understand: '{other}'"),
    }
}

#[cfg(test)]
mod tests {
    use super::{Controls, answer};
    use crate::wire::{ControllerVersion, KinematicsInfo, Series};

    // Fails if the dashboard tells another software than RTDE does, so that a CB3 seems to be an e-Series robot.
    #[test]
    fn the_dashboard_tells_the_software_of_its_robot() {
        let version = super::super::RobotConfig::new(Series::Cb3, KinematicsInfo::default()).version;
        for (version, told) in [
            (version, "URSoftware 3.15.0.0 "),
            (ControllerVersion::default(), "URSoftware 0.0.0.0 "),
        ] {
            let said = answer("PolyscopeVersion", version, &Controls::default(), 0.0);
            assert!(said.starts_with(told), "{said}");
        }
    }
}
