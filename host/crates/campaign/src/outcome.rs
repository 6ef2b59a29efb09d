//! What a session of a campaign came to.

use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_shared::protocol::host::{Contact, FaultReport, Statistics};

use super::observe::TelemetrySummary;
use spherecal_link::native::DriveRecord;

/// A pose that was given up.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejected {
    /// Id of the sphere.
    pub sphere: u32,
    /// Id of the pose.
    pub pose: u32,
    /// Why.
    pub reason: String,
}

/// What a session of a campaign came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Firmware version and build.
    pub firmware: String,
    /// Poses recorded in this session.
    pub recorded: usize,
    /// Poses given up in this session.
    pub rejected: Vec<Rejected>,
    /// Faults, in order.
    pub faults: Vec<FaultReport>,
    /// Contacts, in order.
    pub contacts: Vec<Contact>,
    /// Device time, in µs.
    pub simulated_us: u64,
    /// Control periods.
    pub ticks: u64,
    /// What the host's end of the link counted.
    pub link: LinkCounters,
    /// What the controller counted.
    pub statistics: Statistics,
    /// What telemetry amounted to.
    pub telemetry: TelemetrySummary,
    /// What the drive measured of itself, if it is a robot's own interface.
    pub drive: Option<DriveRecord>,
}
