//! From what a run measured to calibrated models, Table 5 and the verdict.

use std::collections::{BTreeMap, BTreeSet};

use spherecal_shared::protocol::host::{Contact, Coupled, FaultReport, Recording};
use spherecal_shared::robot::{Robot, Tool};

use super::accuracy::EarlyEnding;
use super::link::LinkRecord;
use super::{Config, ConfigError, JobError, Link, PreparedRun};
use spherecal_identify::arcs::{Measured, MeasuredArc};
use spherecal_identify::causes::Course;
use spherecal_identify::evaluate::EvaluationStep;
use spherecal_identify::{
    CampaignRecord, Comparison, EvaluateOptions, Evaluation, Experiment, Observation, Options, Recordings, RowNames,
    Set, Sphere, Target, TrackerRecordings,
};
use spherecal_model::LaserShot;
use spherecal_model::chain::Chain;
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
    /// Why it ended before its last planned pose, if the accuracy that was asked for was reached there.
    pub ended_early: Option<EarlyEnding>,
    /// What host and controller counted on the host link.
    pub link: LinkRecord,
    /// Device time, in s.
    pub simulated_s: f64,
    /// Time on the wall, in s.
    pub wall_s: f64,
}

impl Measurements {
    /// Those of a run before its first pose.
    pub fn before(prepared: &PreparedRun, link: &Link) -> Self {
        Self {
            seed: prepared.config.seed,
            link_name: link.to_string(),
            robot: prepared.robot.clone(),
            tool: prepared.tool,
            config: prepared.config.clone(),
            plan: prepared.plan.clone(),
            spheres: prepared.spheres.clone(),
            recordings: Vec::new(),
            rejected: BTreeSet::new(),
            contacts: Vec::new(),
            couplings: Vec::new(),
            faults: Vec::new(),
            laser: Vec::new(),
            ended_early: None,
            link: LinkRecord::default(),
            simulated_s: 0.0,
            wall_s: 0.0,
        }
    }

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
        let mut recordings = Recordings::new(self.experiment());
        for (sample, recording) in recordings.samples.iter_mut().zip(&self.recordings) {
            sample.number = recording.pose.into();
        }
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
                planned: match self.ended_early {
                    // No later pose was wanted.
                    Some(_) => self.recordings.len() + self.rejected.len(),
                    None => self.plan.recorded(),
                },
                worst_seat_m: worst.map_or(0.0, |c| c.test_m),
                worst_seat_sphere: worst.map(|c| c.sphere),
                given_up: self.rejected.iter().copied().collect(),
                faults: self.faults.len(),
                simulated: self.simulated(),
            }),
            course: Some(course(&self.recordings, &self.couplings)),
            named_by: RowNames::Pose,
            ..recordings
        }
    }

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

/// Identifies all models and judges them on the validation measurements. `progress` is called before each step.
///
/// # Errors
/// Data that cannot be identified or judged.
pub fn evaluate(m: &Measurements, progress: &mut dyn FnMut(EvaluationStep)) -> Result<Evaluation, JobError> {
    let compared = EvaluateOptions {
        models: vec![Comparison::laser(), Comparison::laser_full()],
        ..EvaluateOptions::default()
    };
    evaluate_with(m, compared, progress)
}

/// The same without models for comparison. The verdict is the same.
/// Errors: data that cannot be identified.
pub(super) fn evaluate_alone(m: &Measurements) -> Result<Evaluation, JobError> {
    evaluate_with(m, EvaluateOptions::default(), &mut |_| ())
}

fn evaluate_with(
    m: &Measurements,
    compared: EvaluateOptions,
    progress: &mut dyn FnMut(EvaluationStep),
) -> Result<Evaluation, JobError> {
    let work = match &m.config.cell.work {
        Some(work) => work
            .configurations(&Chain::unchecked(&m.robot, &m.tool))
            .map_err(ConfigError::from)?,
        None => spherecal_identify::workspace(&m.robot, &m.tool),
    };
    let options = EvaluateOptions {
        identify: Options {
            seed: m.seed,
            ..m.config.identify.clone()
        },
        // The campaign knows its frames and tool.
        align: false,
        work: Some(work),
        accuracy_mm: m.config.plan.accuracy_mm,
        ..compared
    };
    Ok(spherecal_identify::evaluate(&m.to_recordings(), &options, progress)?)
}

/// The course of a run: when and in which coupling each recording was made.
///
/// A recording belongs to the last coupling of its sphere before it, so two successive
/// couplings of one sphere are two. The clock of a controller that was restarted begins
/// again: then the order alone says when.
fn course(recordings: &[Recording], couplings: &[Coupled]) -> Course {
    let mut coupling = Vec::with_capacity(recordings.len());
    let mut count = 0;
    let mut before = None;
    for recording in recordings {
        let seated = |c: &&Coupled| c.sphere == recording.sphere && c.time_us <= recording.start_us;
        let latest = couplings.iter().filter(seated).map(|c| c.time_us).max();
        let now = Some((recording.sphere, latest));
        if before.is_some() && before != now {
            count += 1;
        }
        before = now;
        coupling.push(count);
    }
    let starts: Vec<u64> = recordings.iter().map(|r| r.start_us).collect();
    let time = match (starts.first(), starts.last()) {
        (Some(first), Some(last)) if first < last && starts.is_sorted() => {
            let span = (last - first) as f64;
            starts.iter().map(|start| (start - first) as f64 / span).collect()
        }
        _ => {
            let last = starts.len().saturating_sub(1).max(1) as f64;
            (0..starts.len()).map(|k| k as f64 / last).collect()
        }
    };
    Course {
        coupling,
        time,
        ..Course::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording(sphere: u32, start_us: u64) -> Recording {
        Recording {
            sphere,
            pose: 0,
            start_us,
            end_us: start_us + 1,
            count: 1,
            gaps: 0,
            q: std::iter::empty().collect(),
            tau: std::iter::empty().collect(),
            tcp_spread_m: 0.0,
            force_n: [0.0; 3],
        }
    }

    fn coupled(sphere: u32, time_us: u64) -> Coupled {
        Coupled {
            sphere,
            time_us,
            centre_m: [0.0; 3],
            shift_m: 0.0,
            test_m: 0.0,
        }
    }

    // Fails if two successive couplings of one sphere count as one, or if the time is not
    // the device's.
    #[test]
    fn successive_couplings_of_one_sphere_are_told_apart() {
        let couplings = [coupled(2, 10), coupled(1, 100), coupled(1, 200)];
        let recordings = [(2, 20), (1, 110), (1, 120), (1, 220)].map(|(sphere, at)| recording(sphere, at));
        let course = course(&recordings, &couplings);
        assert_eq!(course.coupling, [0, 1, 1, 2]);
        assert_eq!(course.time, [0.0, 0.45, 0.5, 1.0]);
    }

    // Fails if a clock that begins again makes the time run backwards.
    #[test]
    fn a_restarted_clock_leaves_the_order() {
        let couplings = [coupled(1, 100), coupled(1, 5)];
        let recordings = [(1, 110), (1, 120), (1, 6), (1, 7), (1, 8)].map(|(sphere, at)| recording(sphere, at));
        let course = course(&recordings, &couplings);
        assert_eq!(course.coupling, [0, 0, 1, 1, 1]);
        assert_eq!(course.time, [0.0, 0.25, 0.5, 0.75, 1.0]);
    }
}
