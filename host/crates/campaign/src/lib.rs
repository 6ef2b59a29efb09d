//! The external controller of the paper. It sends poses one by one, receives recordings, has them
//! stored, and handles faults.
//!
//! Vocabulary: the *plan* ([`Plan`]) lists what the arm visits: home, and one [`Visit`](spherecal_plan::Visit) per sphere
//! with its poses. An *attempt* is one approach to a sphere. The *journal* stores events before
//! they are acknowledged.
//!
//! ```text
//!   Plan ─▶ Campaign ─ commands ─▶ HostEndpoint ─bytes─▶ Device (controller + drive)
//!              │  ▲ └────────────── events ──────┘
//!              ▼  └ Observer: progress, telemetry
//!           Journal: stored, then acknowledged
//! ```
//!
//! Algorithm 2: handshake, configure, home. For each sphere: approach frame, approach, couple; then
//! the poses, each only after the recording of the previous one is stored; then decouple, home.
//! After a fault (Section 6): clear it, decouple, retreat, couple again, and continue at the
//! interrupted pose. If the nest did not seat, the next attempt starts beside the waypoint
//! ([`Waypoints`]). After a fixed number of failed attempts, the campaign stops with a typed reason
//! ([`recovery`]). A controller that falls silent or was reset gets a new handshake and its
//! configuration, and retreats from the sphere. The campaign sees only the host link: neither the
//! plant nor its truth.

pub mod collect;
pub mod commission;
mod error;
mod force;
mod observe;
mod operate;
mod outcome;
mod places;
mod plate;
mod plausible;
mod procedure;
mod recover;
pub mod recovery;
mod rejects;
mod retry;
mod revisit;
mod seats;
mod session;
mod teach;
pub mod telemetry;
mod tracker;
mod words;

use std::collections::BTreeSet;

use spherecal_plan::Plan;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::Coupled;
use spherecal_shared::robot::{Robot, Tool};

pub use error::{CampaignError, remedy};
pub use force::{ForceSense, WrenchError};
pub use observe::{CampaignObserver, CampaignStage, Moved, Progress, Silent, TelemetrySummary};
pub use operate::{Answer, ManualControl, Order, operate};
pub use outcome::{Outcome, Rejected};
pub use plausible::{Implausible, plausible};
pub use procedure::run;
pub use retry::{DescentEnd, Waypoints};
pub use session::Session;
pub use teach::{NoJournal, Operator, Taught, teach};
pub use tracker::{LaserMeasurementError, Tracker, TrackerError, measure_laser};
pub use words::describe;

/// How a campaign behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunOptions {
    /// Failed attempts (without a new recording) after which a sphere is given up.
    pub attempts: u32,
    /// Failures after which a single pose is given up and the campaign tries the next one.
    pub pose_attempts: u32,
    /// Poses given up, in percent of those planned, after which the campaign stops.
    pub rejected_percent: u32,
    /// Delay from a command's cause to its start, in ms. A lossy link can deliver both within this
    /// time, so that no tick of the arm depends on the link.
    pub lead_ms: u32,
    /// Whether a sphere is coupled until two couplings agree before it is measured, so that its place
    /// is known even if the nest seats badly now and then.
    pub confirm_seats: bool,
    /// Whether every sphere is coupled once more after its poses, to see that it has not moved.
    pub second_visits: bool,
}

impl RunOptions {
    /// What a campaign does unless it is told otherwise.
    pub const DEFAULT: Self = Self {
        attempts: 3,
        pose_attempts: 2,
        rejected_percent: 25,
        lead_ms: 60,
        confirm_seats: false,
        second_visits: true,
    };
}

impl Default for RunOptions {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Everything that a campaign is made from.
#[derive(Clone, Debug)]
pub struct Assignment<'a> {
    /// Nominal robot.
    pub robot: &'a Robot,
    /// Nominal tool.
    pub tool: &'a Tool,
    /// Procedure.
    pub procedure: &'a Procedure,
    /// What to visit.
    pub plan: &'a Plan,
    /// Poses to skip: recorded or given up before (sphere, pose).
    pub done: &'a BTreeSet<(u32, u32)>,
    /// Where earlier sessions of the same run found the spheres, in that order.
    pub seated: &'a [Coupled],
    /// Behaviour.
    pub options: RunOptions,
}
