//! What the robot side's Robot API says, and does: that of PolyScope X, as far as our client and that of the maker need it.
//!
//! Sources: see the client's module of this name. The words for people are our own. Not documented, and chosen here: that a
//! protective stop can be ended after 5 s only, as by the dashboard; and the status 501 for what is not simulated.

use std::sync::atomic::Ordering;

use serde_json::{Value, json};

use super::controls::{Controls, Unlock};
use crate::wire::{
    ControllerVersion, HTTP_CONFLICT, HTTP_FORBIDDEN, HTTP_OK, HttpAnswer, HttpRequest, ROBOT_API, RobotMode,
    RuntimeState, SafetyMode, WireError, words,
};

/// The answer to a request that came to the Robot API of a robot with this software. `stopped_s`: how long the robot has been
/// stopped.
pub(super) fn answer(
    request: Result<&HttpRequest, &WireError>,
    version: ControllerVersion,
    controls: &Controls,
    stopped_s: f64,
) -> HttpAnswer {
    let (status, json) = match request {
        Ok(request) => done(request, version, controls, stopped_s),
        Err(error) => (400, message(&error.to_string())),
    };
    HttpAnswer {
        status,
        body: json.to_string().into_bytes(),
    }
}

fn message(words: &str) -> Value {
    json!({ "message": words })
}

fn done(request: &HttpRequest, version: ControllerVersion, controls: &Controls, stopped_s: f64) -> (u16, Value) {
    let HttpRequest { method, path, body } = request;
    let path = path.strip_prefix(ROBOT_API).unwrap_or_default();
    let has_popups = (version.major, version.minor) >= (10, 14);
    let remote = controls.remote.load(Ordering::Relaxed);
    if method != "GET" && !remote {
        let words = "the robot is in local control: choose remote control at the teach pendant";
        return (HTTP_FORBIDDEN, message(words));
    }
    let json: Value = serde_json::from_slice(body).unwrap_or_default();
    let action = json.get("action").and_then(Value::as_str);
    let mode = |word: &str| (HTTP_OK, json!({ "mode": word, "message": "" }));
    match (method.as_str(), path) {
        // By it the maker's client library learns what there is.
        ("GET", "/openapi.json") => {
            let version = if has_popups { "5.0.107" } else { "3.1.4" };
            (HTTP_OK, json!({ "info": { "version": version } }))
        }
        ("GET", "/system/v1/controlmode") => mode(if remote { "REMOTE" } else { "LOCAL" }),
        ("GET", "/system/v1/operationalmode") => mode("AUTOMATIC"),
        ("GET", "/robotstate/v1/robotmode") => {
            let number = controls.robot_mode.load(Ordering::Relaxed);
            mode(&words(RobotMode::from_number(number).map(RobotMode::name), number))
        }
        ("GET", "/robotstate/v1/safetymode") => {
            let number = controls.safety_mode.load(Ordering::Relaxed);
            mode(&words(SafetyMode::from_number(number).map(SafetyMode::name), number))
        }
        ("GET", "/program/v1/state") => {
            let runs = controls.runtime_state.load(Ordering::Relaxed) == RuntimeState::Playing.number();
            let state = if runs { "PLAYING" } else { "STOPPED" };
            (HTTP_OK, json!({ "state": state, "message": "" }))
        }
        ("PUT", "/program/v1/state") if action == Some("stop") => {
            controls.stop_program.store(true, Ordering::Relaxed);
            (HTTP_OK, message("stopped"))
        }
        ("PUT", "/robotstate/v1/state") if action == Some("UNLOCK_PROTECTIVE_STOP") => match controls.unlock(stopped_s)
        {
            Unlock::Done => (HTTP_OK, message("the protective stop is released")),
            Unlock::NotStopped => (HTTP_CONFLICT, message("the robot is in no protective stop")),
            Unlock::TooEarly => (HTTP_CONFLICT, message("a protective stop is locked for 5 s")),
        },
        ("PUT", "/program/v1/state" | "/robotstate/v1/state") if action.is_some() => {
            (501, message("this simulated robot does not do that"))
        }
        ("PUT", "/program/v1/state" | "/robotstate/v1/state") => (422, message("the body names no action")),
        ("DELETE", "/popup/v1/safety") if has_popups => (HTTP_OK, message("closed")),
        _ => (404, message("there is no such request")),
    }
}
