//! From a cell to a plan.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::cell::{Cell, PlatePose};
use super::error::PlanError;
use super::grid::{Grid, GridPose};
use super::order::{order, spread};
use super::path::{Obstacle, Rules, move_angle};
use super::times::{RECORD_S, VISIT_S, motion_s, turn_s};
use super::types::{Plan, PlannedPose, Rejection, Visit, Waypoint};
use spherecal_identify::Sphere;
use spherecal_model::chain::{Chain, TcpPose, quaternion};

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
    let mut plan = Plan {
        robot: cell.robot.name.as_str().to_owned(),
        home: home(cell, &chain, &request.rules)?,
        spheres: Vec::new(),
        planned: 0,
        reachable: 0,
        rejected: Vec::new(),
        robot_s: 0.0,
        promise: Vec::new(),
        obstacles: super::scene::Obstacles::default(),
    };
    for (place, plate) in (0..).zip(&cell.plates) {
        let yaw = tool_yaw(cell, &chain, &request.rules, plate)?;
        for sphere in &cell.spheres {
            let start = Start::new(cell, &chain, &request.rules, plate, sphere, yaw)?;
            let (good, bad) = request
                .grid
                .reachable(&chain, &request.rules, &start.neutral, &start.joints);
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
            let poses = sequence(&chain, &request.rules, &start, &chosen, first_id);
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
    plan.robot_s = robot_time(&plan);
    Ok(plan)
}

/// Where work at a sphere begins.
#[derive(Clone)]
pub(super) struct Start {
    /// The neutral pose at the sphere's centre.
    pub(super) neutral: TcpPose,
    /// Its joint angles, in rad.
    pub(super) joints: Vec<f64>,
    /// The approach waypoint above it.
    pub(super) approach: Waypoint,
}

impl Start {
    /// The neutral pose with the largest distance to the joint limits, and the approach above it.
    pub(super) fn new(
        cell: &Cell,
        chain: &Chain,
        rules: &Rules,
        plate: &PlatePose,
        sphere: &Sphere,
        yaw: f64,
    ) -> Result<Self, PlanError> {
        let neutral = cell.neutral_pose(chain, plate, sphere, yaw);
        let refuse = |obstacle| {
            let p = neutral.position * 1e3;
            PlanError::SphereOutOfReach {
                sphere: sphere.id,
                x_mm: p.x,
                y_mm: p.y,
                z_mm: p.z,
                obstacle,
            }
        };
        let joints = roomiest(chain, rules, &neutral).map_err(refuse)?;
        Self::from_joints(cell, chain, rules, plate, neutral, joints).map_err(refuse)
    }

    /// The approach above a neutral pose that is already solved.
    pub(super) fn from_joints(
        cell: &Cell,
        chain: &Chain,
        rules: &Rules,
        plate: &PlatePose,
        neutral: TcpPose,
        joints: Vec<f64>,
    ) -> Result<Self, Obstacle> {
        let above = TcpPose {
            position: neutral.position - cell.approach_direction(plate) * cell.approach_height_m,
            ..neutral
        };
        let approach_joints = rules.follow(chain, &neutral, &joints, &above)?;
        Ok(Self {
            neutral,
            joints,
            approach: waypoint(&above, approach_joints),
        })
    }
}

/// The solution of a pose that keeps the rules for passing and has the largest distance to the
/// joint limits.
pub(super) fn roomiest(chain: &Chain, rules: &Rules, pose: &TcpPose) -> Result<Vec<f64>, Obstacle> {
    let mut best: Option<Vec<f64>> = None;
    let mut obstacle = Obstacle::OutOfReach;
    for q in chain.solve(pose) {
        match rules.passing().configuration(chain, &q) {
            Ok(()) => {
                let better = best
                    .as_ref()
                    .is_none_or(|b| chain.limit_margin(&q) > chain.limit_margin(b));
                if better {
                    best = Some(q);
                }
            }
            Err(why) => obstacle = why,
        }
    }
    best.ok_or(obstacle)
}

/// The tool's yaw: the cell's own, or the one of twelve whose worst sphere has the largest distance
/// to the joint limits.
pub(super) fn tool_yaw(cell: &Cell, chain: &Chain, rules: &Rules, plate: &PlatePose) -> Result<f64, PlanError> {
    if let Some(yaw) = cell.tool_yaw_rad {
        return Ok(yaw);
    }
    let mut best: Option<(f64, f64)> = None;
    let mut refusal = PlanError::NoSpheres;
    for k in 0..12 {
        let yaw = f64::from(k) * core::f64::consts::TAU / 12.0;
        let mut room = f64::INFINITY;
        for sphere in &cell.spheres {
            match Start::new(cell, chain, rules, plate, sphere, yaw) {
                Ok(start) => room = room.min(chain.limit_margin(&start.joints)),
                Err(why) => {
                    room = f64::NEG_INFINITY;
                    refusal = why;
                }
            }
        }
        if room.is_finite() && best.is_none_or(|(r, _)| room > r) {
            best = Some((room, yaw));
        }
    }
    best.map(|(_, yaw)| yaw).ok_or(refusal)
}

/// Home: the neutral orientation high above the middle of the first plate.
///
/// # Errors
/// There is no plate, or none within the arm's reach.
pub fn home(cell: &Cell, chain: &Chain, rules: &Rules) -> Result<Waypoint, PlanError> {
    let plate = cell.plates.first().ok_or(PlanError::NoPlate)?;
    let yaw = tool_yaw(cell, chain, rules, plate)?;
    let pose = TcpPose {
        position: Vector3::from(plate.centre_m) - cell.approach_direction(plate) * cell.home_height_m,
        rotation: cell.neutral(plate, yaw),
        elbow: chain.has_elbow().then_some(0.0),
    };
    let joints = roomiest(chain, rules, &pose).map_err(|obstacle| PlanError::SphereOutOfReach {
        sphere: 0,
        x_mm: pose.position.x * 1e3,
        y_mm: pose.position.y * 1e3,
        z_mm: pose.position.z * 1e3,
        obstacle,
    })?;
    Ok(waypoint(&pose, joints))
}

pub(super) fn waypoint(pose: &TcpPose, joints: Vec<f64>) -> Waypoint {
    Waypoint {
        position_m: pose.position.into(),
        orientation: quaternion(&pose.rotation),
        elbow_rad: pose.elbow,
        joints,
    }
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

/// Orders the poses and makes every move between them continuous. If the direct move is not, it
/// goes through poses on the two paths to neutral, which are known to be continuous. After the last
/// pose comes the neutral one, in which the nest leaves the sphere in the orientation of the
/// approach. Vias have ids from 1,000,000 on.
pub(super) fn sequence(
    chain: &Chain,
    rules: &Rules,
    start: &Start,
    chosen: &[GridPose],
    first_id: u32,
) -> Vec<PlannedPose> {
    let poses: Vec<TcpPose> = chosen.iter().map(|g| g.pose).collect();
    let tour = order(&start.neutral, &poses);
    let mut out: Vec<PlannedPose> = Vec::new();
    let mut here = (start.neutral, start.joints.clone());
    let mut vias = 0;
    for next in tour.into_iter().filter_map(|k| chosen.get(k)) {
        let direct = rules.follow(chain, &here.0, &here.1, &next.pose);
        let continuous = direct.is_ok_and(|q| q.iter().zip(&next.joints).all(|(a, b)| (a - b).abs() < 1e-6));
        if !continuous {
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
    let back = rules.follow(chain, &here.0, &here.1, &start.neutral);
    let returns = back.is_ok_and(|q| q.iter().zip(&start.joints).all(|(a, b)| (a - b).abs() < 1e-6));
    if returns && !out.is_empty() {
        out.push(posed(
            1_000_000 + 2 * first_id + vias,
            true,
            &start.neutral,
            start.joints.clone(),
        ));
    }
    out
}

/// Predicted time of turning through the poses and recording, in s.
pub(super) fn turning_time(start: &TcpPose, poses: &[PlannedPose]) -> f64 {
    let mut here = *start;
    let mut time = 0.0;
    for pose in poses {
        let next = TcpPose {
            position: here.position,
            rotation: spherecal_model::chain::rotation_of(&pose.orientation),
            elbow: pose.elbow_rad,
        };
        time += turn_s(move_angle(&here, &next));
        if !pose.via {
            time += RECORD_S;
        }
        here = next;
    }
    time
}

/// Predicted time of a whole plan, in s: travelling, approaching, turning, recording.
pub(super) fn robot_time(plan: &Plan) -> f64 {
    let home = &plan.home.joints;
    let mut here = home;
    let mut time = 0.0;
    for visit in &plan.spheres {
        if visit.over_home {
            time += motion_s(here, home);
            here = home;
        }
        let approach = &visit.approach;
        let start = TcpPose {
            position: visit.position_m.into(),
            rotation: spherecal_model::chain::rotation_of(&approach.orientation),
            elbow: approach.elbow_rad,
        };
        time += motion_s(here, &approach.joints) + VISIT_S + turning_time(&start, &visit.poses);
        here = &approach.joints;
    }
    time + motion_s(here, home)
}

#[cfg(test)]
#[path = "build_tests.rs"]
mod tests;
