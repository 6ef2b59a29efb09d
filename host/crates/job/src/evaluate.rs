//! From measurements to calibrated models and Table 5: plain data in, plain
//! data out.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Contact, Coupled, FaultReport, Recording};
use spherecal_shared::robot::{Robot, Tool};

use super::bound::bound_options;
use super::link_record::LinkRecord;
use super::{Config, JobError};
use spherecal_identify::arcs::{Measured, MeasuredArc, MeasuredFrames, frames_from_arcs};
use spherecal_identify::validate::{Prediction, ValidationTable, validate};
use spherecal_identify::{
    Calibration, Experiment, IdentifyError, Method, Observation, Options, Pose, Set, Sphere, Target, choose_model,
    identify,
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
    /// What host and controller counted on the host link.
    pub link: LinkRecord,
    /// Device time, in s.
    pub simulated_s: f64,
    /// Time on the wall, in s.
    pub wall_s: f64,
}

/// What the laser tracker's measurements amount to.
#[derive(Clone, Debug)]
pub struct LaserReference {
    /// Base and tool from arcs.
    pub frames: MeasuredFrames,
    /// The paper's laser calibration: geometry, base and tool held at the arcs'.
    pub geometry: Calibration,
    /// The same measurements with the structured estimator.
    pub structured: Calibration,
}

/// Models and how good they are.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Calibrated from sphere contacts.
    pub sphere: Calibration,
    /// What it was calibrated from.
    pub experiment: Experiment,
    /// The laser tracker's side.
    pub laser: Option<LaserReference>,
    /// The paper's estimator on the sphere contacts, where it came to an end.
    pub paper: Option<Calibration>,
    /// What any estimator could do with the same recordings, in simulation.
    pub bound: Option<Calibration>,
    /// Table 5.
    pub table: Option<ValidationTable>,
    /// Validation configurations and what the tracker measured there.
    pub shots: Vec<LaserShot>,
    /// Remarks for people: models that could not be made, and why.
    pub remarks: Vec<String>,
}

impl Measurements {
    /// The sphere contacts as plain data.
    pub fn experiment(&self) -> Experiment {
        let place: BTreeMap<(u32, u32), u32> = self
            .plan
            .spheres
            .iter()
            .flat_map(|visit| visit.poses.iter().map(|p| ((visit.sphere_id, p.id), visit.place)))
            .collect();
        let observations = self.recordings.iter().map(|recording| Observation {
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

    fn shots(&self, purpose: &str) -> Vec<LaserShot> {
        self.laser.iter().filter(|s| s.purpose == purpose).cloned().collect()
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

/// Identifies all models and judges them on the validation measurements.
///
/// # Errors
/// Data that cannot be identified or judged.
pub fn evaluate(m: &Measurements) -> Result<Evaluation, JobError> {
    let mut remarks = Vec::new();
    let experiment = m.experiment();
    let mut options = Options {
        seed: m.seed,
        ..m.config.identify.clone()
    };
    let refusal;
    (options.model, refusal) = choose_model(&experiment, &options)?;
    remarks.extend(refusal.map(|r| r.to_string()));
    let sphere = identify(&experiment, &options)?;
    let laser = if m.laser.is_empty() {
        None
    } else {
        Some(laser(m, &options)?)
    };
    let tool_m = laser.as_ref().map_or(m.tool.tcp_m, |l| l.frames.tool_m);
    let paper = paper(&experiment, &options, tool_m, &mut remarks);
    let bound = bound(m, &experiment, &mut remarks);
    let shots = m.shots(LaserShot::VALIDATE);
    let table = match &laser {
        Some(laser) if !shots.is_empty() => {
            let rest = [("paper_nelder_mead", paper.as_ref()), ("bound", bound.as_ref())];
            Some(judge(m, &sphere, laser, &rest, &shots)?)
        }
        _ => None,
    };
    Ok(Evaluation {
        sphere,
        experiment,
        laser,
        paper,
        bound,
        table,
        shots,
        remarks,
    })
}

fn laser(m: &Measurements, options: &Options) -> Result<LaserReference, JobError> {
    let frames = frames_from_arcs(&m.robot, &m.arcs(LaserShot::BASE), &m.arcs(LaserShot::TOOL))?;
    let observations: Vec<Observation> = m
        .shots(LaserShot::CALIBRATE)
        .into_iter()
        .map(|shot| Observation {
            q: shot.q,
            tau: None,
            target: Target::Point(shot.point_m),
            set: Set::Calibrate,
        })
        .collect();
    let mut experiment = Experiment {
        robot: m.robot.clone(),
        tool: m.tool,
        spheres: Vec::new(),
        observations,
    };
    let structured = Options {
        method: Method::Map,
        base: Some(frames.base),
        ..options.clone()
    };
    let structured = identify(&experiment, &structured)?;
    // The paper holds base and tool at what the arcs gave.
    experiment.tool.tcp_m = frames.tool_m;
    let geometry = Options {
        method: Method::GaussNewton,
        base: Some(frames.base),
        ..options.clone()
    };
    let geometry = identify(&experiment, &geometry)?;
    Ok(LaserReference {
        frames,
        geometry,
        structured,
    })
}

/// The paper's estimator: 100 random poses a sphere, mini-batches of 32 pairs,
/// Nelder-Mead (Sections 3.2 and 4.2).
fn paper(
    experiment: &Experiment,
    options: &Options,
    tool_m: [f64; 3],
    remarks: &mut Vec<String>,
) -> Option<Calibration> {
    let mut experiment = experiment.clone();
    experiment.tool.tcp_m = tool_m;
    let options = Options {
        method: Method::NelderMead,
        ..options.clone()
    };
    match identify(&experiment, &options) {
        Ok(calibration) => Some(calibration),
        Err(IdentifyError::Method { .. }) => None,
        Err(error) => {
            remarks.push(format!("the paper's Nelder-Mead gave no model: {error}"));
            None
        }
    }
}

/// The bound, where the plant was ours and its laws are known.
fn bound(m: &Measurements, experiment: &Experiment, remarks: &mut Vec<String>) -> Option<Calibration> {
    if m.laser.is_empty() {
        return None;
    }
    let plant = m.config.plant().ok()?;
    match identify(experiment, &bound_options(&plant, m.robot.dof())) {
        Ok(calibration) => Some(calibration),
        Err(error) => {
            remarks.push(format!("the bound could not be computed: {error}"));
            None
        }
    }
}

/// Table 5. Nominal and paper-like models have base and tool from the arcs, as
/// in the paper; structured models have their own tool.
fn judge(
    m: &Measurements,
    sphere: &Calibration,
    laser: &LaserReference,
    rest: &[(&str, Option<&Calibration>)],
    shots: &[LaserShot],
) -> Result<ValidationTable, JobError> {
    let mut tool = m.tool;
    tool.tcp_m = laser.frames.tool_m;
    let nominal = Chain::new(&m.robot, &tool)?;
    let points = |tcp: &dyn Fn(&[f64]) -> Vector3<f64>| shots.iter().map(|s| tcp(&s.q).into()).collect();
    let mut models = vec![
        prediction("nominal", points(&|q| nominal.pose(q).position), None),
        prediction("sphere", points(&|q| sphere.tcp_m(q, None)), None),
        prediction(
            "laser",
            points(&|q| laser.geometry.tcp_m(q, None)),
            Some(laser.geometry.base),
        ),
        prediction(
            "laser_structured",
            points(&|q| laser.structured.tcp_m(q, None)),
            Some(laser.structured.base),
        ),
    ];
    for (name, model) in rest {
        if let Some(model) = model {
            models.push(prediction(name, points(&|q| model.tcp_m(q, None)), None));
        }
    }
    let measured: Vec<[f64; 3]> = shots.iter().map(|s| s.point_m).collect();
    Ok(validate(&measured, &laser.frames.base, &models)?)
}

fn prediction(name: &str, points_m: Vec<[f64; 3]>, own_base: Option<Pose>) -> Prediction {
    Prediction {
        name: name.to_owned(),
        points_m,
        own_base,
    }
}
