//! What a drawn robot records: contacts, laser points, arcs, validation.

use std::sync::OnceLock;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use spherecal_identify::arcs::{LaserError, Measured, MeasuredArc, MeasuredFrames, frames_from_arcs};
use spherecal_identify::{Experiment, Observation, Pose, Set, Target, fit_pose, paper_plate};
use spherecal_plan as plan;
use spherecal_plan::laser::{self, Arc, LaserPlan, LaserPlanError};
use spherecal_sim::worlds::{Evaluator, Truth};
use spherecal_sim::worlds::{Recipe, World, draw};

/// Poses of the paper's grid on the three spheres together.
pub const GRID_SPHERES: usize = 1875;

/// A pose at which a contact is to be recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedPose {
    /// Id of the sphere.
    pub sphere: u32,
    /// Joint angles of the nominal robot, in rad.
    pub q: Vec<f64>,
}

/// Why a trial could not be made.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WorldError {
    /// The laser measurements could not be planned.
    #[error(transparent)]
    LaserPlan(#[from] LaserPlanError),
    /// The arcs gave no frames.
    #[error(transparent)]
    Arcs(#[from] LaserError),
    /// The poses could not be planned.
    #[error("the poses could not be planned: {0}")]
    Grid(String),
    /// A pose is out of the drawn robot's reach.
    #[error("pose {index} on sphere {sphere} is out of the drawn robot's reach: leave it out of the plan")]
    Reach {
        /// Index of the pose.
        index: usize,
        /// Id of its sphere.
        sphere: u32,
    },
    /// An estimator failed.
    #[error("{world} seed {seed}, {estimator}: {reason}")]
    Estimator {
        /// The world.
        world: World,
        /// The seed.
        seed: u64,
        /// The estimator.
        estimator: &'static str,
        /// Why.
        reason: String,
    },
}

/// Everything that one drawn robot records, and the truth apart.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The world.
    pub world: World,
    /// The seed.
    pub seed: u64,
    /// Contacts on the spheres; nominal robot and tool.
    pub spheres: Experiment,
    /// Laser points to calibrate by; nominal robot and tool.
    pub laser: Experiment,
    /// Arcs of joints 1 and 2.
    pub base_arcs: Vec<MeasuredArc>,
    /// Arcs of joints 5 to 7.
    pub tool_arcs: Vec<MeasuredArc>,
    /// Base and tool as the paper measures them, with the world's offsets.
    pub frames: MeasuredFrames,
    /// The plate in the tracker frame, from its spheres as the tracker sees them.
    pub plate: Pose,
    /// Validation measurements.
    pub validation: Vec<Measured>,
    /// Where the TCP really was at each of them, tracker frame, in m.
    pub validation_truth_m: Vec<[f64; 3]>,
    /// Indices of the contacts that are bad couplings.
    pub bad: Vec<usize>,
    /// The robot that recorded it: for the judge alone.
    pub truth: Truth,
}

/// The reachable poses of the paper's grid (Section 4.2), planned once.
///
/// # Errors
/// A planner that refuses its own nominal cell.
pub fn paper_poses() -> Result<&'static [PlannedPose], WorldError> {
    static POSES: OnceLock<Result<Vec<PlannedPose>, WorldError>> = OnceLock::new();
    let poses = POSES.get_or_init(|| {
        let made = plan::paper_plan(&plan::Cell::iiwa7()).map_err(|e| WorldError::Grid(e.to_string()))?;
        let visits = made.spheres.iter().flat_map(|visit| {
            let recorded = visit.poses.iter().filter(|p| !p.via);
            recorded.map(|p| PlannedPose {
                sphere: visit.sphere_id,
                q: p.joints.clone(),
            })
        });
        Ok(visits.collect())
    });
    poses.as_deref().map_err(Clone::clone)
}

/// The laser measurements of a seed, planned once each.
fn laser_plan(seed: u64) -> Result<LaserPlan, WorldError> {
    Ok(laser::plan(&iiwa7(), &iiwa7_tool(), seed)?)
}

/// Draws the robot of `seed` in `world` and records everything, contacts on the
/// paper's whole grid.
///
/// # Errors
/// See [`WorldError`]; none occurs with the built-in worlds.
pub fn record(world: World, seed: u64) -> Result<Trial, WorldError> {
    record_poses(world, &world.recipe(), seed, paper_poses()?)
}

/// Where the plate of the nominal cell stands in F0.
fn plate_in_base() -> Pose {
    let spheres = paper_plate();
    let cell = plan::Cell::iiwa7();
    let placed = &cell.plates[0];
    let centroid = spheres
        .iter()
        .map(|s| Vector3::from(s.position_m))
        .sum::<Vector3<f64>>()
        / spheres.len() as f64;
    let rotation = *placed.rotation().matrix();
    Pose {
        rotation,
        position: Vector3::from(placed.centre_m) - rotation * centroid,
    }
}

/// Noise of one stream of measurements, independent of the others.
struct Noise(ChaCha8Rng);

impl Noise {
    fn new(seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7472_6961_6c73);
        rng.set_stream(stream);
        Self(rng)
    }

    fn normal(&mut self, sigma: f64) -> f64 {
        let unit: f64 = StandardNormal.sample(&mut self.0);
        unit * sigma
    }

    fn vector(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal(sigma))
    }

    fn joints(&mut self, n: usize, sigma: f64) -> Vec<f64> {
        (0..n).map(|_| self.normal(sigma)).collect()
    }

    fn direction(&mut self) -> Vector3<f64> {
        self.vector(1.0).normalize()
    }
}

/// The same with any recipe and contacts at any poses.
///
/// # Errors
/// See [`WorldError`].
pub fn record_poses(world: World, recipe: &Recipe, seed: u64, poses: &[PlannedPose]) -> Result<Trial, WorldError> {
    let planned = laser_plan(seed)?;
    let truth = draw(recipe, seed, &planned.validation, &plate_in_base());
    let arm = truth.evaluator();
    let (spheres, bad) = contacts(&truth, &arm, recipe, seed, poses)?;

    let mut see = Noise::new(seed, 2);
    let mut measure = |q: &Vec<f64>| {
        let white = see.joints(q.len(), truth.white_rad);
        let real = truth.base.point(&arm.tcp(q, &white));
        let seen = real + see.vector(recipe.tracker_m);
        let encoder = q.iter().map(|q| q + see.normal(recipe.encoder_rad)).collect();
        let measured = Measured {
            q: encoder,
            point_m: seen.into(),
        };
        (measured, <[f64; 3]>::from(real))
    };
    let laser_points: Vec<Measured> = planned.calibration.iter().map(|q| measure(q).0).collect();
    let (validation, validation_truth_m) = planned.validation.iter().map(&mut measure).unzip();
    let mut arcs = |planned: &[Arc]| -> Vec<MeasuredArc> {
        let arcs = planned.iter().map(|arc| MeasuredArc {
            joint: arc.joint,
            measured: arc.configurations.iter().map(|q| measure(q).0).collect(),
        });
        arcs.collect()
    };
    let (base_arcs, tool_arcs) = (arcs(&planned.base_arcs), arcs(&planned.tool_arcs));
    let mut frames = frames_from_arcs(&iiwa7(), &base_arcs, &tool_arcs)?;
    let mut off = Noise::new(seed, 3);
    let sideways = off.0.random_range(0.0..std::f64::consts::TAU);
    frames.tool_m[0] += recipe.tool_off_m * sideways.cos();
    frames.tool_m[1] += recipe.tool_off_m * sideways.sin();
    frames.base.position += off.direction() * recipe.base_off_m;

    // The tracker sees each sphere's centre ten times.
    let centres: Vec<_> = truth.spheres_m.iter().map(|s| Vector3::from(*s)).collect();
    let seen: Vec<_> = centres
        .iter()
        .map(|s| truth.base.point(&truth.plate.point(s)) + off.vector(recipe.tracker_m / 10f64.sqrt()))
        .collect();
    let certified: Vec<_> = paper_plate().iter().map(|s| Vector3::from(s.position_m)).collect();
    let plate = fit_pose(&certified, &seen).unwrap_or_default();

    let laser = Experiment {
        robot: iiwa7(),
        tool: iiwa7_tool(),
        spheres: Vec::new(),
        observations: laser_points
            .iter()
            .map(|m| Observation {
                q: m.q.clone(),
                tau: None,
                target: Target::Point(m.point_m),
                set: Set::Calibrate,
            })
            .collect(),
    };
    Ok(Trial {
        world,
        seed,
        spheres,
        laser,
        base_arcs,
        tool_arcs,
        frames,
        plate,
        validation,
        validation_truth_m,
        bad,
        truth,
    })
}

/// Contacts at `poses`, and which of them are bad couplings.
fn contacts(
    truth: &Truth,
    arm: &Evaluator<'_>,
    recipe: &Recipe,
    seed: u64,
    poses: &[PlannedPose],
) -> Result<(Experiment, Vec<usize>), WorldError> {
    let mut noise = Noise::new(seed, 1);
    // Apart, so that W4's other contacts are the same with and without bad ones.
    let mut chance = Noise::new(seed, 4);
    let mut bad = Vec::new();
    let mut observations = Vec::with_capacity(poses.len());
    for (index, pose) in poses.iter().enumerate() {
        let at = truth.sphere_ids.iter().position(|id| *id == pose.sphere);
        let centre = at.and_then(|k| truth.spheres_m.get(k)).copied().unwrap_or_default();
        let mut target = truth.plate.point(&Vector3::from(centre)) + noise.vector(recipe.seating_m);
        let roll: f64 = chance.0.random();
        let (far, direction) = (chance.0.random_range(3e-3..6e-3), chance.direction());
        if roll < recipe.bad_couplings {
            bad.push(index);
            target += direction * far;
        }
        let white = noise.joints(pose.q.len(), truth.white_rad);
        let q = arm.reach(&pose.q, &target, &white).ok_or(WorldError::Reach {
            index,
            sphere: pose.sphere,
        })?;
        observations.push(Observation {
            q: q.into_iter().map(|q| q + noise.normal(recipe.encoder_rad)).collect(),
            tau: None,
            target: Target::Sphere {
                sphere: pose.sphere,
                place: 0,
            },
            set: Set::Calibrate,
        });
    }
    let experiment = Experiment {
        robot: iiwa7(),
        tool: iiwa7_tool(),
        spheres: paper_plate(),
        observations,
    };
    Ok((experiment, bad))
}
