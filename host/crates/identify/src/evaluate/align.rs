//! Where the data stand before anything is identified: the pose of every
//! frame towards the robot's base, and the tool, with the robot's geometry as
//! it is nominally.
//!
//! For sample i in frame f, `r_i = R_f (p_i + A_i t) + b_f − y_i`, with the
//! nominal flange (A_i, p_i), the tool `t` and the target `y_i`. The start is a
//! rigid fit that gross errors cannot move (least median of squares over
//! random triplets); the end is Gauss-Newton over all frames and the tool with
//! Cauchy weights, whose scale is the median residual. So the tracker may
//! stand anywhere, the plate at any place, the tool may be tens of millimetres
//! from what was said, and some rows may be plainly wrong.

use std::collections::HashMap;

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use spherecal_model::fit_pose;
use spherecal_model::statistics::median;
use spherecal_shared::robot::Robot;

use super::align_targets::place;
use crate::flange::Flange;
use crate::targets::{first_target, reference_of};
use crate::{Experiment, Observation, Pose, Reference, Set};

/// How far (m, 1 sigma) a tool may be from what was said; settles the tool
/// where the poses cannot tell it from the frame.
const TOOL_REACH_M: f64 = 0.1;
/// Triplets tried per frame.
const TRIPLETS: usize = 300;
/// Samples that judge a triplet.
const SUBSAMPLE: usize = 200;
/// Rows that the frames are aligned by, spread evenly over each frame's; where
/// there are more, the rest is only judged. So many leave the frames within
/// micrometres.
const ALIGNED: usize = 20_000;
/// Most Gauss-Newton steps.
const STEPS: usize = 60;

/// Frames and tool of a data set, with a robot of given geometry.
#[derive(Clone, Debug)]
pub struct NominalFrames {
    /// Tool centre point in the last frame of the table, in m.
    pub tcp_m: Vector3<f64>,
    /// F0 seen from each frame.
    pub frames: Vec<(Reference, Pose)>,
    /// Targets 2.. in the last frame of the table, in m.
    pub targets_m: Vec<Vector3<f64>>,
    /// Orientation of the measured body in the last frame of the table.
    pub body: Option<Matrix3<f64>>,
    /// Distance of each calibration sample from its target, in m: index into
    /// the experiment's observations, and the distance. Of several targets the largest.
    pub distances_m: Vec<(usize, f64)>,
    /// Median of the TCP's distances, in m.
    pub median_m: f64,
    /// Median turn of the measured body against the flange, in rad.
    pub median_turn_rad: Option<f64>,
}

impl NominalFrames {
    /// Pose of a frame.
    pub fn frame(&self, reference: Reference) -> Option<&Pose> {
        self.frames.iter().find(|(r, _)| *r == reference).map(|(_, pose)| pose)
    }

    /// Calibration samples so far from their targets that no calibration of
    /// this robot explains them: beyond 10 mm and 15 times the median.
    pub fn gross(&self) -> Vec<(usize, f64)> {
        let limit = (15.0 * self.median_m).max(0.010);
        self.distances_m.iter().copied().filter(|(_, d)| *d > limit).collect()
    }
}

struct Item {
    frame: usize,
    rotation: Matrix3<f64>,
    flange: Vector3<f64>,
    target: Vector3<f64>,
}

struct AlignmentProblem {
    items: Vec<Item>,
    references: Vec<Reference>,
    nominal_tool: Vector3<f64>,
    free_tool: bool,
}

#[derive(Clone)]
struct Guess {
    tool: Vector3<f64>,
    frames: Vec<Pose>,
}

impl AlignmentProblem {
    fn residual(&self, item: &Item, guess: &Guess) -> Vector3<f64> {
        guess.frames[item.frame].point(&(item.flange + item.rotation * guess.tool)) - item.target
    }

    fn distances(&self, guess: &Guess) -> Vec<f64> {
        self.items.iter().map(|i| self.residual(i, guess).norm()).collect()
    }

    /// Robust cost: the sum of Cauchy losses at scale `s`, and of the tool's prior.
    fn cost(&self, guess: &Guess, s: f64) -> f64 {
        let data: f64 = self.distances(guess).iter().map(|d| (d / s).powi(2).ln_1p()).sum();
        data + (guess.tool - self.nominal_tool).norm_squared() / TOOL_REACH_M.powi(2)
    }

    /// Rigid fit of one frame to the nominal tool: that of the triplet whose median
    /// residual over a subsample is least, or the fit of all.
    fn start_frame(&self, frame: usize, random: &mut ChaCha8Rng) -> Pose {
        let own: Vec<&Item> = self.items.iter().filter(|i| i.frame == frame).collect();
        let from: Vec<Vector3<f64>> = own.iter().map(|i| i.flange + i.rotation * self.nominal_tool).collect();
        let onto: Vec<Vector3<f64>> = own.iter().map(|i| i.target).collect();
        let stride = own.len().div_ceil(SUBSAMPLE).max(1);
        let middle = |pose: &Pose| {
            let d: Vec<f64> = (0..own.len())
                .step_by(stride)
                .map(|k| (pose.point(&from[k]) - onto[k]).norm_squared())
                .collect();
            median(d)
        };
        let mut best = fit_pose(&from, &onto).unwrap_or_default();
        let mut least = middle(&best);
        if own.len() >= 4 {
            for _ in 0..TRIPLETS {
                let pick: [usize; 3] = core::array::from_fn(|_| random.random_range(0..own.len()));
                if pick[0] == pick[1] || pick[1] == pick[2] || pick[0] == pick[2] {
                    continue;
                }
                let Some(pose) = fit_pose(&pick.map(|k| from[k]), &pick.map(|k| onto[k])) else {
                    continue;
                };
                let now = middle(&pose);
                if now < least {
                    (least, best) = (now, pose);
                }
            }
        }
        best
    }

    /// Damped Gauss-Newton with Cauchy weights from a start.
    fn refine(&self, mut guess: Guess) -> Guess {
        let m = 6 * self.references.len() + 3;
        let tool_at = m - 3;
        let mut damping = 1e-6;
        for _ in 0..STEPS {
            let d = self.distances(&guess);
            let s = (1.5 * median(d)).max(1e-6);
            let mut h = DMatrix::<f64>::zeros(m, m);
            let mut g = DVector::<f64>::zeros(m);
            for item in &self.items {
                let pose = &guess.frames[item.frame];
                let r = self.residual(item, &guess);
                let w = 1.0 / (s * s + r.norm_squared());
                let turned = pose.rotation * (item.flange + item.rotation * guess.tool);
                let mut j = nalgebra::SMatrix::<f64, 3, 9>::zeros();
                j.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
                j.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-turned.cross_matrix()));
                if self.free_tool {
                    j.fixed_view_mut::<3, 3>(0, 6)
                        .copy_from(&(pose.rotation * item.rotation));
                }
                let jtj = j.transpose() * j * w;
                let jtr = j.transpose() * r * w;
                let at = |k: usize| if k < 6 { 6 * item.frame + k } else { tool_at + k - 6 };
                for a in 0..9 {
                    g[at(a)] += jtr[a];
                    for b in 0..9 {
                        h[(at(a), at(b))] += jtj[(a, b)];
                    }
                }
            }
            let prior = TOOL_REACH_M.powi(-2);
            for k in 0..3 {
                h[(tool_at + k, tool_at + k)] += prior;
                g[tool_at + k] += prior * (guess.tool - self.nominal_tool)[k];
            }
            let before = self.cost(&guess, s);
            let mut moved = 0.0;
            for _ in 0..8 {
                let mut damped = h.clone();
                for k in 0..m {
                    damped[(k, k)] += damping * h[(k, k)].max(1e-12);
                }
                let Some(step) = nalgebra::Cholesky::new(damped).map(|c| -c.solve(&g)) else {
                    damping = (damping * 10.0).max(1e-9);
                    continue;
                };
                let mut next = guess.clone();
                for (f, pose) in next.frames.iter_mut().enumerate() {
                    let turn = Vector3::new(step[6 * f + 3], step[6 * f + 4], step[6 * f + 5]);
                    pose.position += Vector3::new(step[6 * f], step[6 * f + 1], step[6 * f + 2]);
                    pose.rotation = Rotation3::new(turn) * pose.rotation;
                }
                if self.free_tool {
                    next.tool += Vector3::new(step[tool_at], step[tool_at + 1], step[tool_at + 2]);
                }
                if self.cost(&next, s) <= before {
                    moved = step.amax();
                    guess = next;
                    damping *= 0.3;
                    break;
                }
                damping = (damping * 10.0).max(1e-9);
            }
            if moved < 1e-10 {
                break;
            }
        }
        guess
    }
}

/// Aligns the calibration set of an experiment with a robot of given geometry;
/// `free_tool` estimates the tool as well, else it stays nominal.
pub fn align(experiment: &Experiment, robot: &Robot, free_tool: bool) -> NominalFrames {
    let flange = Flange::new(robot);
    let calibrating = |o: &&Observation| o.set == Set::Calibrate;
    let mut references: Vec<Reference> = Vec::new();
    let mut numbers: HashMap<Reference, usize> = HashMap::new();
    let mut counts: Vec<usize> = Vec::new();
    for o in experiment.observations.iter().filter(calibrating) {
        let reference = reference_of(&o.target);
        let frame = *numbers.entry(reference).or_insert_with(|| {
            references.push(reference);
            counts.push(0);
            references.len() - 1
        });
        counts[frame] += 1;
    }
    let total: usize = counts.iter().sum();
    let stride = total.div_ceil(ALIGNED).max(1);
    let item = |o: &Observation| {
        let at = flange.at(&o.q);
        Some(Item {
            frame: numbers.get(&reference_of(&o.target)).copied().unwrap_or_default(),
            rotation: at.rotation,
            flange: at.position,
            target: first_target(&o.target, &experiment.spheres)?,
        })
    };
    // Every frame keeps its first row and every `stride`-th after it.
    let mut seen = vec![0_usize; references.len()];
    let sees = |o: &&Observation| first_target(&o.target, &experiment.spheres).is_some();
    let chosen = experiment.observations.iter().filter(calibrating).filter(sees);
    let chosen = chosen.filter(|o| {
        let frame = numbers.get(&reference_of(&o.target)).copied().unwrap_or_default();
        seen[frame] += 1;
        (seen[frame] - 1).is_multiple_of(stride)
    });
    let problem = AlignmentProblem {
        items: chosen.filter_map(item).collect(),
        references,
        nominal_tool: experiment.tool.tcp(),
        free_tool,
    };
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let frames = (0..problem.references.len())
        .map(|f| problem.start_frame(f, &mut random))
        .collect();
    let guess = problem.refine(Guess {
        tool: problem.nominal_tool,
        frames,
    });
    let all = experiment.observations.par_iter().enumerate();
    let mut distances_m: Vec<(usize, f64)> = all
        .filter(|(_, o)| o.set == Set::Calibrate)
        .filter_map(|(index, o)| Some((index, problem.residual(&item(o)?, &guess).norm())))
        .collect();
    let d: Vec<f64> = distances_m.iter().map(|d| d.1).collect();
    let frames: Vec<(Reference, Pose)> = problem.references.into_iter().zip(guess.frames).collect();
    let placed = place(experiment, &flange, &frames, &mut distances_m);
    NominalFrames {
        tcp_m: guess.tool,
        targets_m: placed.targets_m,
        body: placed.body,
        median_turn_rad: placed.median_turn_rad,
        median_m: median(d),
        frames,
        distances_m,
    }
}
