//! Candidates for the optimal plan: wide orientations and elbow angles about each sphere, in every
//! branch of the inverse kinematics that the arm can reach.

use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cell::Cell;
use super::error::PlanError;
use super::path::Rules;
use super::scene::Scene;
use super::start::{PlacedCell, Start};
use super::types::Waypoint;
use spherecal_model::chain::{Chain, TcpPose};
use spherecal_model::halton::halton;

/// How wide candidates may lie.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Range {
    /// Largest tilt about the tool's x and y, each, in rad.
    pub tilt_rad: f64,
    /// Largest turn about the tool's z, in rad.
    pub turn_rad: f64,
    /// Largest elbow angle either way, in rad; ignored without an elbow.
    pub elbow_rad: f64,
    /// Whether other branches of the inverse kinematics are visited too.
    pub branches: bool,
    /// Candidates in all, shared out over the visits.
    pub candidates: usize,
}

impl Default for Range {
    /// The tilt is the widest that a nest of three planes allows. The turn about the plate's normal
    /// and the elbow angle are wider, because nothing obstructs them.
    fn default() -> Self {
        Self {
            tilt_rad: 40f64.to_radians(),
            turn_rad: 120f64.to_radians(),
            elbow_rad: 100f64.to_radians(),
            branches: true,
            candidates: 3000,
        }
    }
}

/// Most branches per sphere; those with the largest distance to the joint limits first.
const MOST_BRANCHES: usize = 8;
/// Poses tried for each candidate wanted.
const TRIES: usize = 6;

/// A sphere in one placement and one branch.
#[derive(Clone)]
pub(super) struct CandidateVisit {
    pub(super) sphere_id: u32,
    pub(super) place: u32,
    pub(super) direction: Vector3<f64>,
    pub(super) start: Start,
}

/// A pose that could be recorded.
#[derive(Clone)]
pub(super) struct Candidate {
    pub(super) visit: usize,
    pub(super) pose: TcpPose,
    pub(super) joints: Vec<f64>,
}

/// All visits that the arm can make. The first branch of each sphere has the largest distance to
/// the joint limits.
/// Errors: the arm cannot reach a sphere in any branch.
pub(super) fn visits(
    cell: &Cell,
    chain: &Chain,
    rules: &Rules,
    range: &Range,
    home: &Waypoint,
) -> Result<Vec<CandidateVisit>, PlanError> {
    let mut visits = Vec::new();
    for (place, plate) in (0..).zip(&cell.plates) {
        let placed = PlacedCell::new(cell, chain, rules, plate);
        let yaw = placed.tool_yaw()?;
        for sphere in &cell.spheres {
            let all = placed.entered(home, sphere.id, placed.starts(sphere, yaw)?)?;
            let mut starts: Vec<Start> = all.into_iter().take(1).collect();
            let neutral = starts.first().map(|start| start.neutral);
            if let Some(neutral) = neutral.filter(|_| range.branches) {
                for start in others(&placed, range, sphere.id, &neutral) {
                    let known = starts.iter().any(|s| same_branch(chain, rules, s, &start));
                    if starts.len() < MOST_BRANCHES && !known && placed.straight(home, &start) {
                        starts.push(start);
                    }
                }
            }
            visits.extend(starts.into_iter().map(|start| CandidateVisit {
                sphere_id: sphere.id,
                place,
                direction: cell.approach_direction(plate),
                start,
            }));
        }
    }
    Ok(visits)
}

/// Neutral poses in other branches, with the elbow at the largest distance to the joint limits;
/// sorted by that distance.
fn others(placed: &PlacedCell<'_>, range: &Range, sphere: u32, neutral: &TcpPose) -> Vec<Start> {
    let (chain, rules) = (placed.chain, placed.rules);
    let elbows: Vec<Option<f64>> = match neutral.elbow {
        Some(_) => (-4..=4).map(|k| Some(f64::from(k) / 4.0 * range.elbow_rad)).collect(),
        None => vec![None],
    };
    let mut found: Vec<(f64, Start)> = Vec::new();
    for elbow in elbows {
        let pose = TcpPose { elbow, ..*neutral };
        for q in chain.solve(&pose) {
            let kept = rules.passing().configuration(chain, &q);
            if kept.and_then(|()| placed.scene.standing(&q, Some(sphere))).is_err() {
                continue;
            }
            let room = chain.limit_margin(&q);
            if let Ok(start) = placed.start_at(pose, q) {
                found.push((room, start));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, start)| start).collect()
}

/// Whether two starts are in the same branch: by the sides to which shoulder, elbow and wrist are
/// bent, or, on arms without these, by a motion that leads from one to the other at the sphere.
fn same_branch(chain: &Chain, rules: &Rules, a: &Start, b: &Start) -> bool {
    match (chain.branch(&a.joints), chain.branch(&b.joints)) {
        (Some(a), Some(b)) => a == b,
        _ => rules
            .follow(chain, &a.neutral, &a.joints, &b.neutral)
            .is_ok_and(|q| q.iter().zip(&b.joints).all(|(x, y)| (x - y).abs() < 1e-6)),
    }
}

/// About `count` candidates of all visits together that keep the rules, are reached continuously
/// from their visit's start, and stand clear.
pub(super) fn candidates(
    cell: &Cell,
    chain: &Chain,
    rules: &Rules,
    range: &Range,
    visits: &[CandidateVisit],
    count: usize,
) -> Vec<Candidate> {
    let scenes: Vec<Scene> = cell
        .plates
        .iter()
        .map(|plate| Scene::planned(cell, chain, plate))
        .collect();
    let share = count.div_ceil(visits.len().max(1));
    let of = |(index, visit): (usize, &CandidateVisit)| -> Vec<Candidate> {
        (0..TRIES * share)
            .filter_map(|k| {
                let pose = wide(range, &visit.start, 1 + k, index);
                let joints = reached(chain, rules, &visit.start, &pose)?;
                Some(Candidate {
                    visit: index,
                    pose,
                    joints,
                })
            })
            .take(share)
            .filter(|candidate| {
                let scene = scenes.get(visit.place as usize);
                scene.is_some_and(|scene| {
                    scene.standing(&candidate.joints, Some(visit.sphere_id)).is_ok()
                        && scene.may_leave(&candidate.joints)
                })
            })
            .collect()
    };
    visits.par_iter().enumerate().flat_map_iter(of).collect()
}

/// Item `k` of the poses spread over the ranges about the start of visit `index`. Each visit shifts
/// the sequence by another part of the ranges.
fn wide(range: &Range, start: &Start, k: usize, index: usize) -> TcpPose {
    let shift = index as f64 * 0.618_033_988_75;
    let u = |dimension: usize| 2.0 * (halton(k, dimension) + shift).fract() - 1.0;
    let turn = Rotation3::from_euler_angles(u(0) * range.tilt_rad, u(1) * range.tilt_rad, u(2) * range.turn_rad);
    TcpPose {
        position: start.neutral.position,
        rotation: start.neutral.rotation * turn,
        elbow: start.neutral.elbow.map(|_| u(3) * range.elbow_rad),
    }
}

/// Joints of a pose that may be recorded and is reached from the start.
fn reached(chain: &Chain, rules: &Rules, start: &Start, pose: &TcpPose) -> Option<Vec<f64>> {
    // If the end itself is cheap to solve, it is checked before the path.
    if let Some(branch) = chain.branch(&start.joints) {
        let solutions = chain.solve(pose);
        let good = |q: &Vec<f64>| chain.branch(q) == Some(branch) && rules.configuration(chain, q).is_ok();
        if !solutions.iter().any(good) {
            return None;
        }
    }
    let coarse = Rules {
        step_rad: 2.0 * rules.step_rad,
        ..*rules
    };
    let q = coarse.follow(chain, &start.neutral, &start.joints, pose).ok()?;
    rules.configuration(chain, &q).ok().map(|()| q)
}
