//! From a cell to a plan.

use serde::{Deserialize, Serialize};

use super::cell::Cell;
use super::error::PlanError;
use super::grid::{Grid, GridPose};
use super::order::{move_size, round_trip, spread};
use super::path::{Rules, between};
use super::scene::Scene;
use super::start::{PlacedCell, Start, home};
use super::times::{Turns, robot_time};
use super::types::{Plan, PlannedPose, Rejection, Visit};
use spherecal_model::chain::{Chain, TcpPose, quaternion};
use spherecal_shared::procedure::Procedure;

/// What to plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanRequest {
    /// The grid about each sphere.
    pub grid: Grid,
    /// What configurations and moves must keep.
    pub rules: Rules,
    /// Largest number of recorded poses over all spheres, well spread; `None` for every reachable
    /// one.
    pub poses: Option<usize>,
}

impl PlanRequest {
    /// The paper's whole grid.
    pub fn paper() -> Self {
        Self {
            grid: Grid::paper(),
            rules: Rules::paper(),
            poses: None,
        }
    }

    /// The paper's whole grid for an arm that carries it out.
    pub fn paper_on_an_arm() -> Self {
        Self {
            rules: Rules::paper_on_an_arm(),
            ..Self::paper()
        }
    }

    /// `poses` poses in all, spread over the paper's ranges.
    pub fn spread(poses: usize) -> Self {
        Self {
            grid: Grid::paper(),
            rules: Rules::default(),
            poses: Some(poses),
        }
    }
}

/// The paper's whole grid (Section 4.2), in neighbour order.
///
/// # Errors
/// See [`plan`].
pub fn paper_plan(cell: &Cell) -> Result<Plan, PlanError> {
    plan(cell, &PlanRequest::paper())
}

/// About `poses` poses in all, spread over the paper's ranges.
///
/// # Errors
/// See [`plan`].
pub fn spread_plan(cell: &Cell, poses: usize) -> Result<Plan, PlanError> {
    plan(cell, &PlanRequest::spread(poses))
}

/// Plans a calibration.
///
/// # Errors
/// [`Cell::check`] refuses the cell, no poses are requested, or the arm cannot reach a sphere.
pub fn plan(cell: &Cell, request: &PlanRequest) -> Result<Plan, PlanError> {
    cell.check()?;
    if request.poses == Some(0) {
        return Err(PlanError::OutOfRange {
            field: "poses",
            value: 0.0,
            remedy: "ask for at least one pose",
        });
    }
    let chain = Chain::new(&cell.robot, &cell.tool)?;
    let visits = cell.spheres.len() * cell.plates.len();
    let home = home(cell, &chain, &request.rules)?;
    let mut plan = Plan {
        robot: cell.robot.name.as_str().to_owned(),
        home: home.clone(),
        spheres: Vec::new(),
        planned: 0,
        reachable: 0,
        rejected: Vec::new(),
        robot_s: 0.0,
        promise: Vec::new(),
        obstacles: cell.obstacles,
    };
    for (place, plate) in (0..).zip(&cell.plates) {
        let placed = PlacedCell::new(cell, &chain, &request.rules, plate);
        let yaw = placed.tool_yaw()?;
        for sphere in &cell.spheres {
            let starts = placed.entered(&home, sphere.id, placed.starts(sphere, yaw)?)?;
            let Some(start) = starts.into_iter().next() else {
                continue;
            };
            let (good, bad) = request.grid.reachable(&placed, sphere.id, &start);
            let first_id = plan.planned as u32;
            plan.planned += request.grid.len(&chain);
            plan.reachable += good.len();
            plan.rejected.extend(bad.into_iter().map(|(index, obstacle)| Rejection {
                id: first_id + index,
                sphere_id: sphere.id,
                obstacle,
            }));
            let chosen = match request.poses {
                None => good,
                Some(total) => {
                    let nth = plan.spheres.len();
                    let share = (total + visits - 1 - nth) / visits;
                    let poses: Vec<TcpPose> = good.iter().map(|g| g.pose).collect();
                    let keep = spread(&start.neutral, &poses, share);
                    keep.into_iter().filter_map(|k| good.get(k).cloned()).collect()
                }
            };
            let poses = sequence(&chain, &request.rules, None, &start, &chosen, first_id);
            plan.spheres.push(Visit {
                sphere_id: sphere.id,
                place,
                position_m: start.neutral.position.into(),
                over_home: true,
                approach: start.approach,
                approach_direction: cell.approach_direction(plate).into(),
                poses,
            });
        }
    }
    plan.robot_s = robot_time(&plan, &cell.robot, &Procedure::default(), true);
    Ok(plan)
}

fn posed(id: u32, via: bool, pose: &TcpPose, joints: Vec<f64>) -> PlannedPose {
    PlannedPose {
        id,
        via,
        orientation: quaternion(&pose.rotation),
        elbow_rad: pose.elbow,
        joints,
    }
}

/// Places along a turn at which the arm must be able to leave, as shares of the turn.
const LEAVES_AT: [f64; 3] = [0.25, 0.5, 0.75];

/// Whether the arm turns from one pose, with its joint angles, to another without a jump, and could leave on the way: a turn may
/// stop anywhere. Between two poses of an FR3 that it could leave the arm was almost stretched, lost its nest, and pulled at it with
/// 45 N. The paper's grid, whose turns are small, was not chosen by that.
fn turns_to(
    chain: &Chain,
    rules: &Rules,
    scene: Option<&Scene>,
    from: (&TcpPose, &[f64]),
    to: (&TcpPose, &[f64]),
) -> bool {
    let end = rules.follow(chain, from.0, from.1, to.0);
    let continuous = end.is_ok_and(|q| q.iter().zip(to.1).all(|(a, b)| (a - b).abs() < 1e-6));
    let leaves = |scene: &Scene| {
        LEAVES_AT.iter().all(|share| {
            let q = rules.follow(chain, from.0, from.1, &between(from.0, to.0, *share));
            q.is_ok_and(|q| scene.may_leave(&q))
        })
    };
    continuous && scene.is_none_or(leaves)
}

/// Orders the poses and makes every move between them continuous, with a way off the sphere on it if there is a scene. If the
/// direct move is not, it goes through the neutral pose. After the last
/// pose comes the neutral one, in which the nest leaves the sphere in the orientation of the
/// approach. Vias have ids from 1,000,000 on.
pub(super) fn sequence(
    chain: &Chain,
    rules: &Rules,
    scene: Option<&Scene>,
    start: &Start,
    chosen: &[GridPose],
    first_id: u32,
) -> Vec<PlannedPose> {
    let neutral = (&start.neutral, start.joints.as_slice());
    let at = |k: usize| chosen.get(k).map_or(neutral, |g| (&g.pose, g.joints.as_slice()));
    let turns = Turns::new(&Procedure::default(), chain.limits());
    let tour = round_trip(chosen.len(), |a, b| {
        let (a, b) = (at(a), at(b));
        if rules.stray_m > 0.0 {
            // At small angles of joint 2 the elbow's way of 10 degrees turns joint 1 by 60. Friction then holds the arm short
            // of the pose, and it creeps for longer than a recording waits: 34 of 1,800 poses. Beside such a pose lies
            // another with nearly its joint angles.
            let turns = a.1.iter().zip(b.1).map(|(a, b)| (a - b).abs());
            turns.fold(move_size(a.0, b.0), f64::max)
        } else {
            turns.between_s(a, b)
        }
    });
    let mut out: Vec<PlannedPose> = Vec::new();
    let mut here = (start.neutral, start.joints.clone());
    let mut vias = 0;
    for next in tour.into_iter().filter_map(|k| chosen.get(k)) {
        if !turns_to(chain, rules, scene, (&here.0, &here.1), (&next.pose, &next.joints)) {
            let via = posed(
                1_000_000 + 2 * first_id + vias,
                true,
                &start.neutral,
                start.joints.clone(),
            );
            vias += 1;
            out.push(via);
        }
        out.push(posed(first_id + next.index, false, &next.pose, next.joints.clone()));
        here = (next.pose, next.joints.clone());
    }
    if !out.is_empty() && turns_to(chain, rules, None, (&here.0, &here.1), neutral) {
        out.push(posed(
            1_000_000 + 2 * first_id + vias,
            true,
            &start.neutral,
            start.joints.clone(),
        ));
    }
    out
}

#[cfg(test)]
#[path = "build_tests.rs"]
mod tests;
