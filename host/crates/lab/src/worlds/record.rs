//! What a drawn robot records: contacts, laser points, arcs and validation points.

use std::sync::OnceLock;

use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use spherecal_identify::arcs::{LaserError, Measured, MeasuredArc, MeasuredFrames, frames_from_arcs};
use spherecal_identify::{Experiment, Observation, Pose, Set, Target, fit_pose, paper_plate};
use spherecal_plan as plan;
use spherecal_plan::laser::{self, Arc, LaserPlan, LaserPlanError};
use spherecal_sim::plant::{PlantConfig, PlantError, StillArm, TrueCell};
use spherecal_sim::worlds::World;

/// Time from one contact to the next, in s: what the plans of 150 poses predict.
pub const CONTACT_S: f64 = 4.0;

/// A pose at which a contact is to be recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactPose {
    /// Number of the coupling: poses that follow each other in one are recorded without letting go of the sphere.
    pub coupling: usize,
    /// Id of the sphere.
    pub sphere: u32,
    /// Joint angles of the nominal robot, in rad.
    pub q: Vec<f64>,
}

/// Why a trial could not be made.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WorldError {
    /// The robot could not be drawn.
    #[error(transparent)]
    Draw(#[from] PlantError),
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
    #[error("pose {index} on sphere {sphere} is out of the drawn robot's reach: remove it from the plan")]
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

/// All recordings of one drawn robot, and its truth apart.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The world.
    pub world: World,
    /// The seed.
    pub seed: u64,
    /// Contacts on the spheres; nominal robot and tool.
    pub spheres: Experiment,
    /// Laser points for the calibration; nominal robot and tool.
    pub laser: Experiment,
    /// Arcs of joints 1 and 2.
    pub base_arcs: Vec<MeasuredArc>,
    /// Arcs of joints 5 to 7.
    pub tool_arcs: Vec<MeasuredArc>,
    /// Base and tool as the paper measures them, with the world's offsets.
    pub frames: MeasuredFrames,
    /// The plate in the tracker frame, from its spheres as the tracker measures them.
    pub plate: Pose,
    /// Validation measurements.
    pub validation: Vec<Measured>,
    /// Where the TCP really was at each of them, tracker frame, in m.
    pub validation_truth_m: Vec<[f64; 3]>,
    /// Indices of the contacts that are 3 to 6 mm off.
    pub bad: Vec<usize>,
    /// Laws that the robot was drawn from.
    pub plant: PlantConfig,
    /// The robot that recorded it: for the judge alone.
    pub truth: TrueCell<7>,
}

/// The reachable poses of the paper's grid (Section 4.2), planned once.
///
/// # Errors
/// The planner refuses its own nominal cell.
pub fn paper_poses() -> Result<&'static [ContactPose], WorldError> {
    static POSES: OnceLock<Result<Vec<ContactPose>, WorldError>> = OnceLock::new();
    let poses = POSES.get_or_init(|| {
        let made = plan::paper_plan(&plan::Cell::iiwa7()).map_err(|e| WorldError::Grid(e.to_string()))?;
        Ok(planned_poses(&made))
    });
    poses.as_deref().map_err(Clone::clone)
}

/// The poses that a plan records, in its order.
pub fn planned_poses(plan: &plan::Plan) -> Vec<ContactPose> {
    let visits = plan.spheres.iter().enumerate().flat_map(|(coupling, visit)| {
        let recorded = visit.poses.iter().filter(|p| !p.via);
        recorded.map(move |p| ContactPose {
            coupling,
            sphere: visit.sphere_id,
            q: p.joints.clone(),
        })
    });
    visits.collect()
}

/// The laser measurements of a seed, planned once each.
fn laser_plan(seed: u64) -> Result<LaserPlan, WorldError> {
    Ok(laser::plan(&iiwa7(), &iiwa7_tool(), seed)?)
}

/// Draws the robot of `seed` in `world` and simulates all recordings, with contacts on the paper's
/// whole grid.
///
/// # Errors
/// See [`WorldError`]; none occurs with the built-in worlds.
pub fn record(world: World, seed: u64) -> Result<Trial, WorldError> {
    record_poses(world, seed, paper_poses()?)
}

/// Noise of one stream of measurements, independent of the other streams.
struct NoiseStream(ChaCha8Rng);

impl NoiseStream {
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

    fn direction(&mut self) -> Vector3<f64> {
        self.vector(1.0).normalize()
    }
}

/// Like [`record`], with contacts at any poses.
///
/// # Errors
/// See [`WorldError`].
pub fn record_poses(world: World, seed: u64, poses: &[ContactPose]) -> Result<Trial, WorldError> {
    record_plant(world, PlantConfig { seed, ..world.plant() }, poses)
}

/// Like [`record_poses`], with a robot drawn from `plant` (its seed included) instead of the
/// world's own laws. `world` then only says how many contacts are bad.
///
/// # Errors
/// See [`WorldError`].
pub fn record_plant(world: World, plant: PlantConfig, poses: &[ContactPose]) -> Result<Trial, WorldError> {
    let seed = plant.seed;
    let planned = laser_plan(seed)?;
    let reference: Vec<[f64; 7]> = planned.validation.iter().map(|q| joints(q)).collect();
    let truth = TrueCell::draw_on(&iiwa7(), &iiwa7_tool(), &plant, &reference)?;
    let (spheres, bad) = contacts(&truth, &plant, world, seed, poses)?;

    let tracker = tracker_frame(&plant);
    let mut arm = StillArm::new(&truth, &plant);
    arm.wait(plant.tracker.after_s);
    let mut see = NoiseStream::new(seed, 2);
    let mut measure = |q: &Vec<f64>| {
        let rest = arm.go_to(&joints(q));
        arm.wait(plant.tracker.shot_s);
        let real = tracker.inverse_point(&rest.tcp.position);
        let seen = real + see.vector(plant.tracker.sigma_m);
        let measured = Measured {
            q: rest.q.to_vec(),
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
    let mut off = NoiseStream::new(seed, 3);
    let sideways = off.0.random_range(0.0..std::f64::consts::TAU);
    frames.tool_m[0] += plant.tracker.remount_m * sideways.cos();
    frames.tool_m[1] += plant.tracker.remount_m * sideways.sin();
    frames.base.position += off.direction() * plant.tracker.restation_m;

    // The tracker sees each sphere's centre ten times.
    let seen: Vec<_> = truth
        .spheres
        .iter()
        .flatten()
        .map(|s| tracker.inverse_point(s) + off.vector(plant.tracker.sigma_m / 10f64.sqrt()))
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
                seat: None,
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
        plant,
        truth,
    })
}

/// Seven joint angles; those that are missing count as zero.
fn joints(q: &[f64]) -> [f64; 7] {
    core::array::from_fn(|i| q.get(i).copied().unwrap_or_default())
}

/// Pose of the tracker in F0.
fn tracker_frame(plant: &PlantConfig) -> Pose {
    let [roll, pitch, yaw] = plant.tracker.rpy_rad;
    Pose {
        rotation: *Rotation3::from_euler_angles(roll, pitch, yaw).matrix(),
        position: Vector3::from(plant.tracker.position_m),
    }
}

impl Trial {
    /// F0 in the tracker frame, as it really is: for the judge alone.
    pub fn base(&self) -> Pose {
        let tracker = tracker_frame(&self.plant);
        Pose {
            rotation: tracker.rotation.transpose(),
            position: -tracker.rotation.tr_mul(&tracker.position),
        }
    }
}

/// Contacts at `poses`, and which of them are 3 to 6 mm off.
fn contacts(
    truth: &TrueCell<7>,
    plant: &PlantConfig,
    world: World,
    seed: u64,
    poses: &[ContactPose],
) -> Result<(Experiment, Vec<usize>), WorldError> {
    let spheres = paper_plate();
    let mut arm = StillArm::new(truth, plant);
    // Apart, so that W4's other contacts are the same with and without bad ones.
    let mut chance = NoiseStream::new(seed, 4);
    let mut bad = Vec::new();
    let mut observations = Vec::with_capacity(poses.len());
    let mut coupling = None;
    for (index, pose) in poses.iter().enumerate() {
        if coupling.is_some_and(|last| last != pose.coupling) {
            arm.decouple();
        }
        coupling = Some(pose.coupling);
        let at = spheres.iter().position(|s| s.id == pose.sphere);
        let centre = at.and_then(|k| truth.spheres.get(k).copied().flatten());
        let mut target = centre.ok_or(WorldError::Reach {
            index,
            sphere: pose.sphere,
        })?;
        let roll: f64 = chance.0.random();
        let (far, direction) = (chance.0.random_range(3e-3..6e-3), chance.direction());
        if roll < world.bad_contacts() {
            bad.push(index);
            target += direction * far;
        }
        let rest = arm.go_to_contact(&joints(&pose.q), &target).ok_or(WorldError::Reach {
            index,
            sphere: pose.sphere,
        })?;
        arm.wait(CONTACT_S);
        observations.push(Observation {
            seat: None,
            q: rest.q.to_vec(),
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
        spheres,
        observations,
    };
    Ok((experiment, bad))
}
