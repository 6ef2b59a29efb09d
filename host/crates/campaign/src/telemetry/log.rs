//! What happened, beside the signals: events of the controller, faults, and remarks for people.
//!
//! | topic | type | message |
//! |---|---|---|
//! | `/events` | [`EventMessage`] | each event of the controller but telemetry and statistics |
//! | `/faults` | [`FaultMessage`] | each fault: its name, the phase, value and limit, and the same in words |
//! | `/log` | [`LogMessage`] | faults and remarks of the host, as lines of text |

use serde::Serialize;
use serde_json::{Value, json};
use spherecal_shared::protocol::host::{Event, Fault, FaultReport, Phase};

use super::messages::{Stamp, TelemetryMessage};
use crate::words::describe;

/// An event of the controller.
#[derive(Clone, Debug, Serialize)]
pub struct EventMessage {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// Name of the event, as the host protocol has it.
    pub kind: String,
    /// Its fields, as the host protocol has them.
    pub data: Value,
}

impl EventMessage {
    /// From an event. `None` for telemetry and statistics, which have many.
    pub(super) fn new(timestamp: Stamp, event: &Event) -> Option<Self> {
        if matches!(event, Event::Telemetry(_) | Event::Statistics(_)) {
            return None;
        }
        // An enumeration is an object with one field: its name.
        let Ok(Value::Object(fields)) = serde_json::to_value(event) else {
            return None;
        };
        let (kind, data) = fields.into_iter().next()?;
        Some(Self { timestamp, kind, data })
    }
}

impl TelemetryMessage for EventMessage {
    const TOPIC: &'static str = "/events";
    const SCHEMA: &'static str = "spherecal.Event";
    fn properties() -> Value {
        json!({ "timestamp": Stamp::schema(), "kind": { "type": "string" }, "data": { "type": "object" } })
    }
}

/// A fault.
#[derive(Clone, Debug, Serialize)]
pub struct FaultMessage {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// The fault.
    pub fault: Fault,
    /// The phase in which it happened.
    pub phase: Phase,
    /// Joint concerned, from 1; 0 for none.
    pub joint: u8,
    /// The value beyond the limit, in SI units.
    pub value: f64,
    /// The limit, in SI units.
    pub limit: f64,
    /// The same in words.
    pub text: String,
}

impl FaultMessage {
    /// From a report.
    pub(super) fn new(timestamp: Stamp, report: &FaultReport) -> Self {
        Self {
            timestamp,
            fault: report.fault,
            phase: report.phase,
            joint: report.joint,
            value: report.value,
            limit: report.limit,
            text: describe(report),
        }
    }
}

impl TelemetryMessage for FaultMessage {
    const TOPIC: &'static str = "/faults";
    const SCHEMA: &'static str = "spherecal.Fault";
    fn properties() -> Value {
        let (text, number) = (json!({ "type": "string" }), json!({ "type": "number" }));
        json!({ "timestamp": Stamp::schema(), "fault": text, "phase": text, "joint": { "type": "integer" },
                "value": number, "limit": number, "text": text })
    }
}

/// How much a line of the log matters: the numbers of `foxglove.Log`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// A remark.
    Info = 2,
    /// A fault.
    Error = 4,
}

/// The shape of `foxglove.Log`.
#[derive(Clone, Debug, Serialize)]
pub struct LogMessage {
    /// Time, UTC.
    pub timestamp: Stamp,
    /// Number of its [`Level`].
    pub level: u8,
    /// The line.
    pub message: String,
    /// Who wrote it.
    pub name: &'static str,
    /// Source file; always empty.
    pub file: &'static str,
    /// Line of the source file; always 0.
    pub line: u32,
}

impl LogMessage {
    /// A line.
    pub(super) fn new(timestamp: Stamp, level: Level, message: &str) -> Self {
        Self {
            timestamp,
            level: level as u8,
            message: message.to_owned(),
            name: "spherecal",
            file: "",
            line: 0,
        }
    }
}

impl TelemetryMessage for LogMessage {
    const TOPIC: &'static str = "/log";
    const SCHEMA: &'static str = "foxglove.Log";
    fn properties() -> Value {
        let (text, whole) = (json!({ "type": "string" }), json!({ "type": "integer" }));
        json!({ "timestamp": Stamp::schema(), "level": whole, "message": text, "name": text, "file": text,
                "line": whole })
    }
}
