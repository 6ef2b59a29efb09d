//! Shows a run to others while it is in progress: on the web page, from any machine.
//!
//! Vocabulary: a run's *scene* is what does not change (robot, plate, how many
//! poses); a *frame* is what it is doing now; a *contact* the force trace
//! around one contact; its *end* says what came of it.
//!
//! ```text
//!   campaign ─▶ Watch (an Observer) ─▶ bounded channel ─┬─▶ Hub ─▶ every browser
//!                                                       └─▶ LiveView.Publish ─▶ Hub of a server
//! ```
//!
//! Data flow one way. A viewer cannot delay the campaign: if the channel is full, a frame is lost,
//! and a browser that is too slow is sent the whole state that the [`Hub`] keeps.

mod hub;
mod real_time;
mod scatter;
mod scene;
mod watch;

use serde::{Deserialize, Serialize};
use spherecal_shared::protocol::host::Phase;

use spherecal_campaign::CampaignStage;
use spherecal_campaign::telemetry::ContactTrace;

pub use hub::{Hub, RunId};
pub use real_time::{RealTime, Times};
pub use scatter::Scatter;
pub use scene::{LiveScene, SceneJoint, SceneSphere};
pub use watch::{LiveWatch, eta_s};

/// Messages that may wait in the channel.
pub const WAITING: usize = 32;

/// A message to the viewers of a run; as JSON `{"frame": {…}}`, by its kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ViewerMessage {
    /// What does not change; the first message.
    Scene(LiveScene),
    /// Its present state, about twenty times per second.
    Frame(Frame),
    /// A contact, half a second after its trigger.
    Contact(LiveContact),
    /// A remark for people.
    Note {
        /// In words.
        text: String,
    },
    /// The last message.
    End(End),
}

/// What a run is doing now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// What the campaign is about.
    pub stage: CampaignStage,
    /// Phase of the controller.
    pub phase: Phase,
    /// Id of the current sphere; 0 for none.
    pub sphere: u32,
    /// Poses recorded or given up.
    pub done: usize,
    /// Poses that the plan records.
    pub poses: usize,
    /// Contacts so far.
    pub contacts: usize,
    /// Faults so far.
    pub faults: usize,
    /// Whether the drive has said that its arm is simulated.
    pub simulated: bool,
    /// Device time, in s.
    pub device_s: f64,
    /// Time since this session began, in s.
    pub wall_s: f64,
    /// Remaining time, in s; `None` until it is known.
    pub eta_s: Option<f64>,
    /// How far the nominal model's TCP scatters on each visit, in mm (root mean square), although
    /// the real TCP stood still; `None` until two recordings of a visit exist.
    pub residual_mm: Option<f64>,
    /// Joint angles, in rad; empty before the first telemetry.
    pub q: Vec<f32>,
    /// Measured joint torques, in N m.
    pub tau: Vec<f32>,
    /// TCP as the controller computes it, in F0, in m.
    pub tcp_m: [f32; 3],
    /// Estimated contact force, in F0, in N.
    pub force_n: [f32; 3],
    /// Whether that force says nothing, because the arm is near a singular posture.
    #[serde(default)]
    pub force_is_vague: bool,
    /// Device time (s) and magnitude of the force (N) since the previous frame, where it is no such force.
    pub forces: Vec<(f64, f32)>,
    /// How well the real-time loop keeps its period, if the run drives a robot over its own interface.
    #[serde(default)]
    pub real_time: Option<RealTime>,
}

/// A contact and the force around it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveContact {
    /// Force against the approach when contact was declared, in N.
    pub force_n: f64,
    /// Distance descended, in mm.
    pub travel_mm: f64,
    /// The force around it: the largest of every 4 ms.
    pub trace: ContactTrace,
}

/// What came of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct End {
    /// Its number in the page's own store; `None` if the run is in another store.
    pub run: Option<i64>,
    /// Whether its result may be used; `None` without a result.
    pub trusted: Option<bool>,
    /// In words.
    pub text: String,
}
