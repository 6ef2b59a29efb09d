//! Observers of a campaign, what they are shown, and what a session came to.

use serde::{Deserialize, Serialize};
use spherecal_link::Arrival;
use spherecal_link::native::DriveRecord;
use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_shared::protocol::host::{Contact, FaultReport, Phase, Sample, Statistics};

use crate::force::magnitude;
use crate::telemetry::RunKey;

/// What the campaign is about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CampaignStage {
    /// Handshake and configuring.
    #[default]
    Connect,
    /// To the home frame.
    Home,
    /// Waiting for the plate to be moved.
    Plate,
    /// Being led to a sphere by hand.
    Teach,
    /// To a sphere's approach frame.
    Approach,
    /// Descending, touching, coupling.
    Couple,
    /// Poses.
    Poses,
    /// Leaving the sphere.
    Decouple,
    /// After a fault.
    Recover,
    /// All done.
    Done,
}

/// Where the campaign is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Progress {
    /// What it is about.
    pub stage: CampaignStage,
    /// Phase of the controller.
    pub phase: Phase,
    /// Id of the current sphere; 0 for none.
    pub sphere: u32,
    /// Poses recorded or given up, earlier sessions included.
    pub done: usize,
    /// Of those, done in earlier sessions.
    pub done_before: usize,
    /// Poses in the plan.
    pub poses: usize,
    /// Faults in this session.
    pub faults: usize,
    /// Device time, in s.
    pub device_s: f64,
    /// Estimated contact force, in N, from the newest telemetry.
    pub force_n: f64,
    /// Whether that force says nothing, because the arm is near a singular posture (see [`ForceSense`](crate::force::ForceSense)).
    pub force_is_vague: bool,
    /// What the drive measured of its real-time loop, if a robot's own interface is in this process.
    #[serde(skip)]
    pub drive: Option<DriveRecord>,
}

/// Whether the plate was moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moved {
    /// The plate is in its placement.
    Yes,
    /// Not yet.
    NotYet,
    /// There is nobody to move it.
    Nobody,
}

/// An observer of a campaign. Every method does nothing unless it is overridden.
pub trait CampaignObserver {
    /// The run that is measured, once it is in the store and before its first event.
    fn run(&mut self, _run: &RunKey) {}

    /// An event came from the controller (telemetry included). It is already stored.
    fn event(&mut self, _now_us: u64, _arrival: &Arrival) {}

    /// Progress: called on every event, and at least every 100 ms of device time.
    fn progress(&mut self, _progress: &Progress) {}

    /// A remark for people.
    fn note(&mut self, _text: &str) {}

    /// Asks for the plate to be moved to a placement, from 0, while the arm is at home. The
    /// campaign calls it again until the plate is there. Without an operator to ask, it never is.
    fn plate(&mut self, _place: u32) -> Moved {
        Moved::Nobody
    }

    /// Whether the recordings so far are enough. The campaign asks before every visit and every pose; after a yes it takes no
    /// further pose, leaves its sphere, and ends as after its last pose. `None` where the answer is not known yet: the
    /// campaign asks again one control period later. If the device `waits`, no time of the arm passes meanwhile, so the
    /// answer must be waited for: else the run would depend on how fast it comes.
    fn enough(&mut self, _waits: bool) -> Option<bool> {
        Some(false)
    }
}

/// Nobody watches.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl CampaignObserver for Silent {}

/// What telemetry amounted to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TelemetrySummary {
    /// Samples received.
    pub samples: u64,
    /// Samples with a saturated torque.
    pub saturated: u64,
    /// Samples whose torque was limited in rate.
    pub rate_limited: u64,
    /// Samples near a singularity.
    pub near_singular: u64,
    /// Largest estimated contact force that the errors of the torque sensors do not explain, in N.
    pub max_force_n: f64,
    /// Largest joint speed, in rad/s.
    pub max_speed_rad_s: f64,
    /// Largest commanded torque, in N m.
    pub max_torque_nm: f64,
}

impl TelemetrySummary {
    /// Adds one sample; `is_vague` says whether its force says nothing.
    pub(super) fn add(&mut self, sample: &Sample, is_vague: impl Fn(&Sample) -> bool) {
        let largest = |values: &[f32]| values.iter().fold(0.0f64, |m, v| m.max(f64::from(v.abs())));
        self.samples += 1;
        self.saturated += u64::from(sample.flags & 1);
        self.rate_limited += u64::from(sample.flags >> 1 & 1);
        self.near_singular += u64::from(sample.flags >> 2 & 1);
        let force_n = magnitude(sample);
        if force_n > self.max_force_n && !is_vague(sample) {
            self.max_force_n = force_n;
        }
        self.max_speed_rad_s = self.max_speed_rad_s.max(largest(&sample.dq));
        self.max_torque_nm = self.max_torque_nm.max(largest(&sample.command));
    }
}

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
