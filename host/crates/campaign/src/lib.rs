//! The external controller of the paper: sends poses one by one, hears
//! recordings, has them stored, and deals with what goes wrong.
//!
//! Vocabulary: the planner's [`Plan`](spherecal_plan::Plan) says what is to be
//! visited: home, and one [`Visit`](spherecal_plan::Visit) after the other, each to
//! a sphere with its poses; an *attempt* is one approach to a sphere;
//! the *journal* is where events go before they are acknowledged.
//!
//! ```text
//!   Plan ─▶ Campaign ─ commands ─▶ HostEndpoint ─bytes─▶ Device (controller + drive)
//!              │  ▲ └────────────── events ──────┘
//!              ▼  └ Observer: progress, telemetry
//!           Journal: stored, then acknowledged
//! ```
//!
//! Algorithm 2: greet, configure, home; for each sphere: approach frame,
//! approach, couple; poses, each only when the recording of the last is stored;
//! decouple, home. After a fault, Section 6: clear it, decouple, move away,
//! couple again, from beside the waypoint where the nest did not find its seat
//! ([`Waypoints`]), and go on at the pose where it was; after so many attempts in
//! vain, stop with a typed reason ([`recovery`]). A controller that falls silent
//! or was reset is greeted and configured again, and retreats from the sphere.
//! The campaign sees only the host link: no
//! plant, no truth.

mod error;
mod observe;
mod operate;
mod outcome;
mod places;
mod plausible;
mod procedure;
mod recover;
pub mod recovery;
mod retreat;
mod retry;
mod session;
mod teach;
pub mod telemetry;
mod tracker;

use std::collections::BTreeSet;

use spherecal_plan::Plan;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::Coupled;
use spherecal_shared::robot::{Robot, Tool};

pub use error::{CampaignError, remedy};
pub use observe::{Moved, Observer, Progress, Silent, Stage, TelemetrySummary};
pub use operate::{Answer, ManualControl, Order, operate};
pub use outcome::{Outcome, Rejected};
pub use plausible::{Implausible, plausible};
pub use procedure::run;
pub use retry::{DescentEnd, Waypoints};
pub use session::Session;
pub use teach::{NoJournal, Operator, Taught, teach};
pub use tracker::{LaserMeasurementError, Tracker, TrackerError, measure_laser};

/// How a campaign behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Attempts in vain (without a new recording) after which a sphere is given up.
    pub attempts: u32,
    /// Failures after which a single pose is given up and the next one tried.
    pub pose_attempts: u32,
    /// Poses given up, in percent of those planned, after which the campaign stops.
    pub rejected_percent: u32,
    /// How long after its cause a command starts, in ms: time for a lossy link
    /// to get both through, without a tick of the arm depending on it.
    pub lead_ms: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            attempts: 3,
            pose_attempts: 2,
            rejected_percent: 25,
            lead_ms: 60,
        }
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
    /// What to visit, from the planner.
    pub plan: &'a Plan,
    /// Poses that need not be visited: recorded or given up before (sphere, pose).
    pub done: &'a BTreeSet<(u32, u32)>,
    /// Where the spheres were found in earlier sessions of the same run, in that order.
    pub seated: &'a [Coupled],
    /// Behaviour.
    pub options: Options,
}
