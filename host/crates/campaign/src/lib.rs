//! The external controller of the paper: sends poses one by one, hears
//! recordings, has them stored, and deals with what goes wrong.
//!
//! Vocabulary: the *tour* is what is to be visited ([`Tour`]): home, and one
//! [`Stop`] a sphere with its poses; an *attempt* is one approach to a sphere;
//! the *journal* is where events go before they are acknowledged.
//!
//! ```text
//!   Tour ─▶ Campaign ─ commands ─▶ HostEndpoint ─bytes─▶ Device (controller + drive)
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

use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::Coupled;
use spherecal_shared::robot::{Robot, Tool};

pub use error::{CampaignError, remedy};
pub use observe::{Moved, Observer, Progress, Silent, Stage, TelemetrySummary};
pub use operate::{Answer, CommandPort, Order, operate};
pub use outcome::{Outcome, Rejected};
pub use plausible::{Implausible, plausible};
pub use procedure::run;
pub use retry::{DescentEnd, Waypoints};
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
    /// Placement of the plate, from 0, that it is visited in.
    pub place: u32,
    /// Its nominal centre in F0, in m.
    pub centre_m: [f64; 3],
    /// Whether the way to the approach frame leads over home; else it comes
    /// straight from the stop before, if nothing went wrong there.
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
    /// What to visit.
    pub tour: &'a Tour,
    /// Poses that need not be visited: recorded or given up before (sphere, pose).
    pub done: &'a BTreeSet<(u32, u32)>,
    /// Where the spheres were found in earlier sessions of the same run, in that order.
    pub seated: &'a [Coupled],
    /// Behaviour.
    pub options: Options,
}
