//! From what a run measured to calibrated models, Table 5 and the verdict.

use std::collections::{BTreeMap, BTreeSet};

use spherecal_shared::protocol::host::{Contact, Coupled, FaultReport, Recording};
use spherecal_shared::robot::{Robot, Tool};

use super::course::course;
use super::link_record::LinkRecord;
use super::{Config, JobError, Link, Simulator};
use spherecal_identify::arcs::{Measured, MeasuredArc};
use spherecal_identify::{
    CampaignRecord, Estimator, EvaluateOptions, Evaluation, Experiment, Observation, Options, Recordings, Set, Sphere,
    Target, TrackerRecordings,
};
use spherecal_model::LaserShot;
use spherecal_plan::Plan;

/// Everything that a run measured.
#[derive(Clone, Debug)]
pub struct Measurements {
    /// Seed.
    pub seed: u64,
    /// Link, as on the command line.
    pub link_name: String,
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool.
    pub tool: Tool,
    /// Configuration.
    pub config: Config,
    /// Plan.
    pub plan: Plan,
    /// The plate's certificate.
    pub spheres: Vec<Sphere>,
    /// Recordings, in the order in which they came.
    pub recordings: Vec<Recording>,
    /// Poses that were given up: sphere, pose.
    pub rejected: BTreeSet<(u32, u32)>,
    /// Contacts.
    pub contacts: Vec<Contact>,
    /// Couplings.
    pub couplings: Vec<Coupled>,
    /// Faults.
    pub faults: Vec<FaultReport>,
    /// Laser shots; none without a tracker.
    pub laser: Vec<LaserShot>,
    /// What host and controller counted on the host link.
    pub link: LinkRecord,
    /// Device time, in s.
    pub simulated_s: f64,
    /// Time on the wall, in s.
    pub wall_s: f64,
}

impl Measurements {
    /// Whether the arm was a simulation: in this program, or behind a drive that said so in any
    /// session of the run.
    pub fn simulated(&self) -> bool {
        self.link.simulated || self.link_name.parse::<Link>().is_ok_and(|link| link.simulated())
    }

    /// The sphere contacts as plain data.
    pub fn experiment(&self) -> Experiment {
        let place: BTreeMap<(u32, u32), u32> = self
            .plan
            .spheres
            .iter()
            .flat_map(|visit| visit.poses.iter().map(|p| ((visit.sphere_id, p.id), visit.place)))
            .collect();
        let observations = self.recordings.iter().map(|recording| Observation {
            seat: None,
            q: recording.q.iter().map(|s| s.mean).collect(),
            tau: Some(recording.tau.iter().map(|s| s.mean).collect()),
            target: Target::Sphere {
                sphere: recording.sphere,
                place: place.get(&(recording.sphere, recording.pose)).copied().unwrap_or(0),
            },
            set: Set::Calibrate,
        });
        Experiment {
            robot: self.robot.clone(),
            tool: self.tool,
            spheres: self.spheres.clone(),
            observations: observations.collect(),
        }
    }

    /// Everything that the evaluation looks at, as plain data.
    pub fn to_recordings(&self) -> Recordings {
        let worst = self.couplings.iter().max_by(|a, b| a.test_m.total_cmp(&b.test_m));
        Recordings {
            tracker: (!self.laser.is_empty()).then(|| TrackerRecordings {
                calibration: self.shots(LaserShot::CALIBRATE),
                base_arcs: self.arcs(LaserShot::BASE),
                tool_arcs: self.arcs(LaserShot::TOOL),
                frames: None,
                plate: None,
                validation: self.shots(LaserShot::VALIDATE),
            }),
            campaign: Some(CampaignRecord {
                planned: self.plan.recorded(),
                worst_seat_m: worst.map_or(0.0, |c| c.test_m),
                worst_seat_sphere: worst.map(|c| c.sphere),
                given_up: self.rejected.iter().copied().collect(),
                faults: self.faults.len(),
                simulated: self.simulated(),
            }),
            course: Some(course(&self.recordings, &self.couplings)),
            ..Recordings::new(self.experiment())
        }
    }

    /// The laser shots of a purpose.
    pub(super) fn shots(&self, purpose: &str) -> Vec<Measured> {
        let shots = self.laser.iter().filter(|s| s.purpose == purpose);
        let measured = shots.map(|s| Measured {
            q: s.q.clone(),
            point_m: s.point_m,
        });
        measured.collect()
    }

    fn arcs(&self, prefix: &str) -> Vec<MeasuredArc> {
        let mut arcs: BTreeMap<usize, Vec<Measured>> = BTreeMap::new();
        for shot in &self.laser {
            if let Some(joint) = shot.purpose.strip_prefix(prefix).and_then(|j| j.parse().ok()) {
                arcs.entry(joint).or_default().push(Measured {
                    q: shot.q.clone(),
                    point_m: shot.point_m,
                });
            }
        }
        arcs.into_iter()
            .map(|(joint, measured)| MeasuredArc { joint, measured })
            .collect()
    }
}

/// Identifies all models and judges them on the validation measurements. The simulator knows the laws of its errors, for
/// comparison.
///
/// # Errors
/// Data that cannot be identified or judged.
pub fn evaluate(m: &Measurements, simulator: &dyn Simulator) -> Result<Evaluation, JobError> {
    let options = EvaluateOptions {
        identify: Options {
            seed: m.seed,
            ..m.config.identify.clone()
        },
        // The campaign knows its frames and tool.
        align: false,
        work: Some(spherecal_identify::workspace(&m.robot, &m.tool)),
        models: vec![
            Estimator::Laser,
            Estimator::LaserFull,
            Estimator::PaperNelderMead,
            Estimator::KnownLaws,
        ],
        known_laws: simulator.known_laws(&m.config, m.robot.dof()),
        accuracy_mm: m.config.plan.accuracy_mm,
        ..EvaluateOptions::default()
    };
    Ok(spherecal_identify::evaluate(&m.to_recordings(), &options, &mut |_| {})?)
}
