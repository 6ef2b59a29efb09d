//! Single requests to the Robot API: HTTP with JSON, which PolyScope X has instead of the dashboard.
//!
//! Sources: paths, bodies and the versions that have them are those of `dashboard_client_implementation_x` of the maker's client
//! library; the statuses, and the port (80), those of K-Michallik/remote_robot_controller. Whether the robot refuses to end a
//! protective stop in its first 5 s, as the dashboard does, is not documented; nor is what closing a message says when none is
//! open, so its refusal does not matter.

use serde_json::Value;
use spherecal_budget::robot::LINE;

use super::channel::Channel;
use super::dashboard::DashboardCommand;
use super::{ClientConfig, ClientError};
use crate::wire::{ControllerVersion, HttpAnswer, HttpRequest, ROBOT_API, WireError};

/// Characters of the robot's own words in an error.
const WORDS: usize = 200;

/// How the Robot API is asked for this: method, path, JSON. `None` where this software cannot.
fn call(command: DashboardCommand, version: ControllerVersion) -> Option<(&'static str, &'static str, &'static str)> {
    match command {
        // Since 10.14.0. Before it the message stays on the screen; the robot is unlocked all the same.
        DashboardCommand::CloseSafetyPopup if (version.major, version.minor) < (10, 14) => None,
        DashboardCommand::CloseSafetyPopup => Some(("DELETE", "/popup/v1/safety", "")),
        // Since 10.11.0.
        DashboardCommand::UnlockProtectiveStop => {
            Some(("PUT", "/robotstate/v1/state", r#"{"action":"UNLOCK_PROTECTIVE_STOP"}"#))
        }
        // Since 10.12.0.
        DashboardCommand::IsInRemoteControl => Some(("GET", "/system/v1/controlmode", "")),
    }
}

/// Asks the Robot API of a robot with this software for these things, one after the other. Returns the last answer, in the words
/// of the dashboard. What the software cannot do yet is left out.
///
/// # Errors
/// A [`ClientError`] if the Robot API cannot be reached, does not answer in time, or answers with what cannot be read;
/// [`ClientError::RobotApi`] if it refuses the last thing.
pub fn ask_robot_api(
    config: &ClientConfig,
    version: ControllerVersion,
    commands: &[DashboardCommand],
) -> Result<String, ClientError> {
    let mut last = Ok(String::new());
    for &command in commands {
        let Some((method, path, body)) = call(command, version) else {
            continue;
        };
        let request = HttpRequest {
            method: method.to_owned(),
            path: format!("{ROBOT_API}{path}"),
            body: body.as_bytes().to_vec(),
        };
        let answer = ask(config, command.name(), &request)?;
        last = if (200..300).contains(&answer.status) {
            read(command, &answer.body)
        } else {
            Err(ClientError::RobotApi {
                request: command.name(),
                status: answer.status,
                said: words(&answer.body),
            })
        };
    }
    last
}

fn ask(config: &ClientConfig, name: &'static str, request: &HttpRequest) -> Result<HttpAnswer, ClientError> {
    let after = config.response_timeout.min(LINE);
    let mut channel = Channel::connect(config, &config.addresses(config.robot_api_port())?)?;
    let deadline = channel.now() + after;
    channel.send(&request.encode(&channel.peer().to_string()))?;
    let mut closed = false;
    loop {
        if let Some(answer) = HttpAnswer::decode(&channel.received, closed)? {
            return Ok(answer);
        }
        match channel.receive(Some(deadline)) {
            Ok(true) => {}
            Ok(false) => {
                return Err(ClientError::NoAnswer {
                    request: name,
                    interface: "Robot API",
                    after,
                });
            }
            // What has come is all that comes.
            Err(ClientError::Closed) => closed = true,
            Err(error) => return Err(error),
        }
    }
}

/// What an answer says, as the dashboard would say it.
fn read(command: DashboardCommand, body: &[u8]) -> Result<String, ClientError> {
    if command != DashboardCommand::IsInRemoteControl {
        return Ok(words(body));
    }
    let json: Option<Value> = serde_json::from_slice(body).ok();
    match json.as_ref().and_then(|json| json.get("mode")?.as_str()) {
        Some("REMOTE") => Ok(true.to_string()),
        Some("LOCAL") => Ok(false.to_string()),
        _ => {
            let fault = "does not say its control mode";
            Err(WireError::Http { fault }.into())
        }
    }
}

/// The words for people in an answer: `message` and `details` of its JSON, or else all that came.
fn words(body: &[u8]) -> String {
    let json: Option<Value> = serde_json::from_slice(body).ok();
    let part = |name: &str| json.as_ref()?.get(name)?.as_str();
    let said: Vec<&str> = [part("message"), part("details")].into_iter().flatten().collect();
    let said = if said.is_empty() {
        String::from_utf8_lossy(body).into_owned()
    } else {
        said.join(" ")
    };
    said.chars().filter(|letter| !letter.is_control()).take(WORDS).collect()
}
