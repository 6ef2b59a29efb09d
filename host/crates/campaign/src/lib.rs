//! The external controller of the paper. It sends poses one by one, receives recordings, has them
//! stored, and handles faults.
//!
//! Vocabulary: the *tour* ([`Tour`]) lists what the arm visits: home, and one [`Stop`] per sphere
//! with its poses. An *attempt* is one approach to a sphere. The *journal* stores events before
//! they are acknowledged.
//!
//! ```text
//!   Tour ─▶ Campaign ─ commands ─▶ HostEndpoint ─bytes─▶ Device (controller + drive)
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

use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::Coupled;
use spherecal_shared::robot::{Robot, Tool};

pub use error::{CampaignError, remedy};
pub use observe::{Moved, Observer, Progress, Silent, Stage, TelemetrySummary};
pub use operate::{Answer, CommandPort, Order, operate};
pub use outcome::{Outcome, Rejected};
pub use plausible::{Implausible, plausible};
pub use procedure::run;
pub use retry::{Trace, Waypoints};
pub use session::Session;
pub use teach::{Nowhere, Operator, Taught, teach};
pub use tracker::{LaserMeasurementError, Tracker, TrackerError, measure_laser};

/// What is to be visited.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tour {
    /// Joint angles of the home frame, in rad.
    pub home: Vec<f64>,
    /// Spheres, in the order in which they are visited.
    pub stops: Vec<Stop>,
}

/// One sphere.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// Id of the sphere.
    pub sphere: u32,
    /// Placement of the plate in which the stop is visited, from 0.
    pub place: u32,
    /// Its nominal centre in F0, in m.
    pub centre_m: [f64; 3],
    /// Whether the path to the approach frame leads over home. Otherwise it leads straight from the
    /// previous stop, if that stop ended without a fault.
    pub over_home: bool,
    /// Joint angles of the approach frame, in rad.
    pub approach: Vec<f64>,
    /// Direction of the approach in F0, a unit vector.
    pub direction: [f64; 3],
    /// Poses, in the order in which they are visited.
    pub poses: Vec<TourPose>,
}

/// One pose about a sphere.
#[derive(Clone, Debug, PartialEq)]
pub struct TourPose {
    /// Id of the pose.
    pub pose: u32,
    /// Whether it is recorded, or only passed through.
    pub record: bool,
    /// Orientation of FT in F0, unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
    /// Elbow angle, in rad, for arms that have one.
    pub elbow_rad: Option<f64>,
    /// Joint angles that solve the pose with the nominal model, in rad.
    pub posture: Vec<f64>,
}

impl Tour {
    /// Poses that are recorded.
    pub fn poses(&self) -> usize {
        self.stops
            .iter()
            .map(|s| s.poses.iter().filter(|p| p.record).count())
            .sum()
    }

    /// Whether the plate is moved on the way.
    pub fn several_places(&self) -> bool {
        self.stops.iter().any(|s| s.place != 0)
    }
}

/// How a campaign behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Failed attempts (without a new recording) after which a sphere is given up.
    pub attempts: u32,
    /// Failures after which a single pose is given up and the campaign tries the next one.
    pub pose_attempts: u32,
    /// Poses given up, in percent of those planned, after which the campaign stops.
    pub rejected_percent: u32,
    /// Delay from a command's cause to its start, in ms. A lossy link can deliver both within this
    /// time, so that no tick of the arm depends on the link.
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
    /// What to visit.
    pub tour: &'a Tour,
    /// Poses to skip: recorded or given up before (sphere, pose).
    pub done: &'a BTreeSet<(u32, u32)>,
    /// Where earlier sessions of the same run found the spheres, in that order.
    pub seated: &'a [Coupled],
    /// Behaviour.
    pub options: Options,
}
