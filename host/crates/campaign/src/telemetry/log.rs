//! What happened, beside the signals: events of the controller, faults, and remarks for people.
//!
//! | topic | type | message |
//! |---|---|---|
//! | `/events` | [`EventMessage`] | each event of the controller but telemetry and statistics |
//! | `/faults` | [`FaultMessage`] | each fault: its name, the phase, value and limit, and the same in words |
//! | `/contact` | [`ContactPoint`] | for each recording: the TCP is at (0, 0, 0) of the frame `sphere_N` |
//! | `/log` | [`LogMessage`] | faults and remarks of the host, as lines of text |

use serde::Serialize;
use serde_json::Value;
use spherecal_model::name_of;
use spherecal_shared::protocol::host::{Event, FaultReport, Recording};

use super::messages::Xyz;
use super::ros::{Header, RosMessage, Time};
use super::utc::Moment;
use crate::words::describe;

/// An event of the controller: `spherecal_msgs/msg/Event`.
#[derive(Clone, Debug, Serialize)]
pub struct EventMessage {
    /// Time, UTC.
    pub stamp: Time,
    /// Name of the event, as the host protocol has it.
    pub kind: String,
    /// Its fields, as the host protocol has them, in JSON.
    pub data: String,
}

impl EventMessage {
    /// From an event. `None` for telemetry and statistics, which have many.
    pub(super) fn new(utc_ns: u64, event: &Event) -> Option<Self> {
        if matches!(event, Event::Telemetry(_) | Event::Statistics(_)) {
            return None;
        }
        // An enumeration is an object with one field: its name.
        let Ok(Value::Object(fields)) = serde_json::to_value(event) else {
            return None;
        };
        let (kind, data) = fields.into_iter().next()?;
        Some(Self {
            stamp: Time::from_ns(utc_ns),
            kind,
            data: data.to_string(),
        })
    }
}

impl RosMessage for EventMessage {
    const TOPIC: &'static str = "/events";
    const TYPE: &'static str = "spherecal_msgs/msg/Event";
    const FIELDS: &'static str = "builtin_interfaces/Time stamp\nstring kind\nstring data\n";
}

/// A fault: `spherecal_msgs/msg/Fault`.
#[derive(Clone, Debug, Serialize)]
pub struct FaultMessage {
    /// Time, UTC.
    pub stamp: Time,
    /// Name of the fault, as the host protocol has it.
    pub fault: String,
    /// Name of the phase in which it happened.
    pub phase: String,
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
    pub(super) fn new(utc_ns: u64, report: &FaultReport) -> Self {
        Self {
            stamp: Time::from_ns(utc_ns),
            fault: name_of(report.fault),
            phase: name_of(report.phase),
            joint: report.joint,
            value: report.value,
            limit: report.limit,
            text: describe(report),
        }
    }
}

impl RosMessage for FaultMessage {
    const TOPIC: &'static str = "/faults";
    const TYPE: &'static str = "spherecal_msgs/msg/Fault";
    const FIELDS: &'static str = "builtin_interfaces/Time stamp\nstring fault\nstring phase\nuint8 joint\n\
                                  float64 value\nfloat64 limit\nstring text\n";
}

/// A contact that was recorded: `geometry_msgs/msg/PointStamped`.
#[derive(Clone, Debug, Serialize)]
pub struct ContactPoint {
    /// Middle of the recording, and the frame of the sphere.
    header: Header<'static>,
    /// The TCP in that frame: its origin.
    point: Xyz,
}

impl ContactPoint {
    /// From a recording; `at` ties its device times to UTC.
    pub(super) fn new(at: Moment, recording: &Recording) -> Self {
        let middle_us = recording.start_us.midpoint(recording.end_us);
        Self {
            header: Header {
                stamp: Time::from_ns(at.utc_ns_of(middle_us)),
                frame_id: format!("sphere_{}", recording.sphere).into(),
            },
            point: Xyz::default(),
        }
    }
}

impl RosMessage for ContactPoint {
    const TOPIC: &'static str = "/contact";
    const TYPE: &'static str = "geometry_msgs/msg/PointStamped";
    const FIELDS: &'static str = "std_msgs/Header header\ngeometry_msgs/Point point\n";
}

/// How much a line of the log matters: the numbers of `rcl_interfaces/msg/Log`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// A remark.
    Info = 20,
    /// A fault.
    Error = 40,
}

/// A line of text: `rcl_interfaces/msg/Log`.
#[derive(Clone, Debug, Serialize)]
pub struct LogMessage<'a> {
    /// Time, UTC.
    pub stamp: Time,
    /// Number of its [`Level`].
    pub level: u8,
    /// Who wrote it.
    pub name: &'static str,
    /// The line.
    pub msg: &'a str,
    /// Source file; always empty.
    pub file: &'static str,
    /// Function; always empty.
    pub function: &'static str,
    /// Line of the source file; always 0.
    pub line: u32,
}

impl<'a> LogMessage<'a> {
    pub(super) fn new(utc_ns: u64, level: Level, line: &'a str) -> Self {
        Self {
            stamp: Time::from_ns(utc_ns),
            level: level as u8,
            name: "spherecal",
            msg: line,
            file: "",
            function: "",
            line: 0,
        }
    }
}

impl RosMessage for LogMessage<'_> {
    const TOPIC: &'static str = "/log";
    const TYPE: &'static str = "rcl_interfaces/msg/Log";
    const FIELDS: &'static str = "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n\
                                  string function\nuint32 line\n";
}
