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
mod places;
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
pub use observe::{CampaignObserver, CampaignStage, Moved, Outcome, Progress, Rejected, Silent, TelemetrySummary};
pub use operate::{Answer, ManualControl, Order, operate};
pub use plausible::{Implausible, plausible};
pub use procedure::run;
pub use retry::{DescentEnd, Waypoints};
pub use session::Session;
pub use teach::{NoJournal, Operator, Taught, teach};
pub use tracker::{LaserMeasurementError, Tracker, TrackerError, measure_laser};
pub use words::describe;

/// How the campaign behaves.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RunOptions {
    /// Number of failed attempts after which a sphere is given up.
    pub attempts: u32,
    /// Number of failures after which a pose is given up.
    pub pose_attempts: u32,
    /// Share of poses given up, in percent, at which the campaign stops.
    pub rejected_percent: u32,
    /// Time from an event to the start of the command that answers it, in ms. The link must carry the event up and
    /// the command down within this time; otherwise the recordings depend on the link.
    pub lead_ms: u32,
    /// Whether a sphere is coupled until two couplings agree before it is measured.
    pub confirm_seats: bool,
    /// Whether every sphere is coupled once more after its poses, to see that it has not moved.
    pub second_visits: bool,
    /// Largest error of the waypoints along each axis, in m: it stands for quick hand-guiding (Section 4.2 of the
    /// paper). It is for simulated arms alone: the waypoints of a real arm are not moved. It has no effect where
    /// `cell.waypoints` or `--waypoints` gives taught ones.
    pub taught_error_m: f64,
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
        taught_error_m: 0.010,
    };

    /// The same with at least one attempt.
    pub fn options(&self) -> Self {
        Self {
            attempts: self.attempts.max(1),
            pose_attempts: self.pose_attempts.max(1),
            ..*self
        }
    }
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
