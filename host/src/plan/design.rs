//! The optimal plan: poses chosen by the TCP error that they leave over the
//! workspace, with the accuracy to expect, before anything has moved.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::build::{VISIT_S, home, sequence, turning_time};
use super::candidates::{Candidate, Range, Visit, candidates, visits};
use super::cell::Cell;
use super::chain::Chain;
use super::error::PlanError;
use super::grid::GridPose;
use super::ik::halton;
use super::optimal::{Design, Problem};
use super::path::Rules;
use super::types::{Accuracy, Plan, SpherePlan};
use crate::identify::rows::DesignModel;
use crate::identify::{IdentifyError, Options};

/// Validation configurations that the criterion averages over.
const VALIDATION: usize = 200;
/// Poses over which the accuracy curve is computed at most.
const LONGEST: usize = 400;

/// Under so many poses only one branch of each sphere is visited.
const FEW: usize = 30;

/// What to plan.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignRequest {
    /// Poses in all.
    pub poses: usize,
    /// How wide they may lie.
    pub range: Range,
    /// What configurations and moves must keep.
    pub rules: Rules,
    /// Model, priors and noise that accuracy is predicted with.
    pub options: Options,
    /// Exchange passes after the greedy choice.
    pub passes: usize,
    /// A branch of a sphere is only visited for at least so many poses: each
    /// visit costs an approach and a coupling.
    pub least_per_visit: usize,
}

impl DesignRequest {
    /// `poses` poses over the default ranges. So few that branches are not
    /// worth their visits keep to one of each sphere.
    pub fn new(poses: usize) -> Self {
        let range = Range::default();
        Self {
            poses,
            range: Range {
                branches: range.branches && poses >= FEW,
                candidates: range.candidates.min(600 + 16 * poses),
                ..range
            },
            rules: Rules::default(),
            options: Options::default(),
            passes: 2,
            least_per_visit: (poses / 30).max(3),
        }
    }
}

/// Chooses and orders the poses. What they promise is in [`Plan::promise`].
///
/// # Errors
/// A cell or a request that makes no sense, a sphere that the arm cannot come
/// to, or options that identification refuses.
pub fn design(cell: &Cell, request: &DesignRequest) -> Result<Plan, PlanError> {
    if request.poses == 0 {
        return Err(PlanError::OutOfRange {
            field: "poses",
            value: 0.0,
            remedy: "ask for at least one pose",
        });
    }
    let ground = Ground::new(cell, request)?;
    let problem = &ground.problem;
    let mut allowed = vec![true; ground.candidates.len()];
    let mut design = Design::new(problem);
    let mut scout = design.clone();
    ground.fill(&mut scout, &allowed, request.poses, |_| ());
    // Visits that are hardly used are not worth an approach and a coupling;
    // the first visit to each sphere stays.
    let mut used = vec![0usize; ground.visits.len()];
    for c in &scout.chosen {
        used[ground.candidates[*c].visit] += 1;
    }
    let first = |v: usize| {
        let key = |v: &Visit| (v.sphere_id, v.place);
        ground.visits[..v].iter().all(|w| key(w) != key(&ground.visits[v]))
    };
    let mut kept: Vec<bool> = (0..used.len())
        .map(|v| used[v] >= request.least_per_visit || (first(v) && used[v] > 0))
        .collect();
    if !kept.contains(&true) {
        kept = used.iter().map(|count| *count > 0).collect();
    }
    for (slot, candidate) in allowed.iter_mut().zip(&ground.candidates) {
        *slot = kept[candidate.visit];
    }
    let floor = 1.0 / request.options.noise.inflation;
    let accuracy = |design: &Design<'_>| {
        let predicted = design.predicted(floor);
        Accuracy {
            poses: design.chosen.len(),
            mean_mm: predicted.mean * 1e3,
            worst_mm: predicted.worst * 1e3,
        }
    };
    let mut curve = vec![accuracy(&design)];
    ground.fill(&mut design, &allowed, request.poses, |d| {
        if worth_noting(d.chosen.len()) {
            curve.push(accuracy(d));
        }
    });
    design.exchange(request.passes, 0.005);
    let mut plan = ground.plan(cell, request, &design.chosen);
    let accuracy = accuracy(&design);
    plan.promise
        .extend(curve.into_iter().filter(|a| a.poses < accuracy.poses));
    plan.promise.push(accuracy);
    Ok(plan)
}

/// The accuracy curve up to 400 poses or `wanted_mm`, whichever comes first,
/// and with it the answer how many poses the asked mean error takes: the last
/// item's, if it meets it.
///
/// # Errors
/// See [`design`].
pub fn accuracy_curve(cell: &Cell, request: &DesignRequest, wanted_mm: f64) -> Result<Vec<Accuracy>, PlanError> {
    if wanted_mm.is_nan() || wanted_mm < 0.0 {
        return Err(PlanError::OutOfRange {
            field: "wanted accuracy (mm)",
            value: wanted_mm,
            remedy: "give a positive mean error in mm",
        });
    }
    let ground = Ground::new(cell, request)?;
    let mut design = Design::new(&ground.problem);
    let floor = 1.0 / request.options.noise.inflation;
    let mut curve: Vec<Accuracy> = Vec::new();
    for poses in 1..=LONGEST {
        design.grow(poses, |_| ());
        let predicted = design.predicted(floor);
        let met = predicted.mean * 1e3 <= wanted_mm;
        if met || worth_noting(poses) {
            curve.push(Accuracy {
                poses,
                mean_mm: predicted.mean * 1e3,
                worst_mm: predicted.worst * 1e3,
            });
        }
        if met || design.chosen.len() < poses {
            break;
        }
    }
    Ok(curve)
}

/// Predicted accuracy of a plan made in any way (the paper's grid, say).
///
/// # Errors
/// See [`design`].
pub fn predicted_accuracy(cell: &Cell, plan: &Plan, options: &Options) -> Result<Accuracy, PlanError> {
    let model = model_of(cell, options)?;
    let chain = Chain::new(&cell.robot, &cell.tool)?;
    let rows: Vec<Vec<f64>> = plan
        .spheres
        .iter()
        .flat_map(|visit| {
            let recorded = visit.poses.iter().filter(|p| !p.via);
            recorded.map(|p| model.observation(&p.joints, visit.sphere_id, visit.place as usize))
        })
        .collect();
    let problem = Problem::new(model.columns(), &rows, &predictions(&model, &chain));
    let all = Design::with_all(&problem);
    let predicted = all.predicted(1.0 / options.noise.inflation);
    Ok(Accuracy {
        poses: rows.len(),
        mean_mm: predicted.mean * 1e3,
        worst_mm: predicted.worst * 1e3,
    })
}

/// Numbers of poses that the curve keeps: all small ones, then every fifth.
fn worth_noting(poses: usize) -> bool {
    poses <= 10 || poses.is_multiple_of(5)
}

fn model_of(cell: &Cell, options: &Options) -> Result<DesignModel, PlanError> {
    cell.check()?;
    let places = cell.plates.len() as u32;
    DesignModel::new(&cell.robot, &cell.tool, &cell.spheres, places, options)
        .map_err(|e: IdentifyError| PlanError::Model(e.to_string()))
}

fn predictions(model: &DesignModel, chain: &Chain) -> Vec<(Vec<f64>, Vector3<f64>, f64)> {
    validation(chain).iter().map(|q| model.prediction(q)).collect()
}

/// Configurations spread over the joint limits whose TCP lies in front of the
/// arm, in the box of the paper's Table 4 scaled to the arm's reach.
pub(super) fn validation(chain: &Chain) -> Vec<Vec<f64>> {
    let configuration = |k: usize| -> Vec<f64> {
        let joint = |(j, l): (usize, &spherecal_shared::robot::JointLimits)| {
            let middle = 0.5 * (l.min_rad + l.max_rad);
            let half = (0.5 * (l.max_rad - l.min_rad)).min(core::f64::consts::PI);
            middle + 0.95 * half * (2.0 * halton(k, j) - 1.0)
        };
        chain.limits().iter().enumerate().map(joint).collect()
    };
    // Reach as the farthest TCP of many; the iiwa 7 with the paper's tool has 1.4 m.
    let reach = (1..=500)
        .map(|k| chain.pose(&configuration(k)).position.norm())
        .fold(0.1, f64::max);
    let scale = reach / 1.4;
    let inside = |p: &Vector3<f64>| {
        (-0.05..=1.0).contains(&(p.x / scale)) && (p.y / scale).abs() <= 0.6 && (0.13..=1.15).contains(&(p.z / scale))
    };
    (1..20_000)
        .map(configuration)
        .filter(|q| inside(&chain.pose(q).position))
        .take(VALIDATION)
        .collect()
}

/// Everything that a choice is made on.
struct Ground {
    chain: Chain,
    home: super::types::Waypoint,
    visits: Vec<Visit>,
    candidates: Vec<Candidate>,
    problem: Problem,
}

impl Ground {
    fn new(cell: &Cell, request: &DesignRequest) -> Result<Self, PlanError> {
        cell.check()?;
        let chain = Chain::new(&cell.robot, &cell.tool)?;
        let home = home(cell, &chain, &request.rules)?;
        let visits = visits(cell, &chain, &request.rules, &request.range, &home)?;
        let candidates = candidates(&chain, &request.rules, &request.range, &visits);
        let model = model_of(cell, &request.options)?;
        let rows: Vec<Vec<f64>> = candidates
            .iter()
            .map(|c| {
                let visit = &visits[c.visit];
                model.observation(&c.joints, visit.sphere_id, visit.place as usize)
            })
            .collect();
        let problem = Problem::new(model.columns(), &rows, &predictions(&model, &chain));
        Ok(Self {
            chain,
            home,
            visits,
            candidates,
            problem,
        })
    }

    /// Grows a design to `count` poses among `allowed`. With several placements
    /// each gets its part of the first half: the first poses in a new place
    /// only tell where the plate is, so a greedy choice would never begin there.
    fn fill(&self, design: &mut Design<'_>, allowed: &[bool], count: usize, mut on_step: impl FnMut(&Design<'_>)) {
        let places: BTreeSet<u32> = self.visits.iter().map(|v| v.place).collect();
        if places.len() > 1 {
            for (k, place) in (1..).zip(&places) {
                let here = |(c, ok): (&Candidate, &bool)| *ok && self.visits[c.visit].place == *place;
                design.allow(self.candidates.iter().zip(allowed).map(here).collect());
                design.grow(k * count / (2 * places.len()), &mut on_step);
            }
        }
        design.allow(allowed.to_vec());
        design.grow(count, on_step);
    }

    fn plan(&self, cell: &Cell, request: &DesignRequest, chosen: &[usize]) -> Plan {
        let mut plan = Plan {
            robot: cell.robot.name.as_str().to_owned(),
            home: self.home.clone(),
            spheres: Vec::new(),
            planned: self.candidates.len(),
            reachable: self.candidates.len(),
            rejected: Vec::new(),
            robot_s: 0.0,
            promise: Vec::new(),
        };
        let mut first_id = 0;
        for (index, visit) in self.visits.iter().enumerate() {
            let mine = chosen.iter().filter_map(|c| self.candidates.get(*c));
            let poses: Vec<GridPose> = mine
                .filter(|c| c.visit == index)
                .zip(0..)
                .map(|(c, index)| GridPose {
                    index,
                    pose: c.pose,
                    joints: c.joints.clone(),
                })
                .collect();
            if poses.is_empty() {
                continue;
            }
            let sequence = sequence(&self.chain, &request.rules, &visit.start, &poses, first_id);
            first_id += poses.len() as u32;
            plan.robot_s += VISIT_S + turning_time(&visit.start.neutral, &sequence);
            plan.spheres.push(SpherePlan {
                sphere_id: visit.sphere_id,
                place: visit.place,
                position_m: visit.start.neutral.position.into(),
                approach: visit.start.approach.clone(),
                approach_direction: visit.direction.into(),
                poses: sequence,
            });
        }
        plan
    }
}

#[cfg(test)]
#[path = "design_tests.rs"]
mod tests;
