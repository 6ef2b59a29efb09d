//! The data for choosing poses: the visits, the candidates on each, and the information of every
//! candidate.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::build::sequence;
use super::candidates::{Candidate, CandidateVisit, candidates, visits};
use super::cell::Cell;
use super::design_request::DesignRequest;
use super::error::PlanError;
use super::grid::GridPose;
use super::optimal::Design;
use super::scene::Scene;
use super::selection::SelectionProblem;
use super::start::home;
use super::times::robot_time;
use super::travel::{Travel, tour};
use super::types::{Plan, Visit, Waypoint};
use spherecal_identify::{DesignModel, Options};
use spherecal_model::chain::Chain;
use spherecal_model::workspace;
use spherecal_shared::procedure::Procedure;

/// Validation configurations that the criterion averages over.
const VALIDATION: usize = 200;

/// Everything that a choice is made on.
pub(super) struct DesignProblem {
    pub(super) chain: Chain,
    pub(super) home: Waypoint,
    pub(super) visits: Vec<CandidateVisit>,
    pub(super) candidates: Vec<Candidate>,
    pub(super) problem: SelectionProblem,
    /// Number of candidates before any were removed.
    pub(super) considered: usize,
}

impl DesignProblem {
    /// All visits that the arm can make, without candidates.
    pub(super) fn visits(cell: &Cell, request: &DesignRequest) -> Result<Self, PlanError> {
        cell.check()?;
        let chain = Chain::new(&cell.robot, &cell.tool)?;
        let home = home(cell, &chain, &request.rules)?;
        let visits = visits(cell, &chain, &request.rules, &request.range, &home)?;
        Ok(Self {
            chain,
            home,
            visits,
            candidates: Vec::new(),
            problem: SelectionProblem::new(0, &[], &[]),
            considered: 0,
        })
    }

    /// The same with about `count` candidates over all visits.
    pub(super) fn with_candidates(
        &self,
        cell: &Cell,
        request: &DesignRequest,
        count: usize,
    ) -> Result<Self, PlanError> {
        let candidates = candidates(cell, &self.chain, &request.rules, &request.range, &self.visits, count);
        let model = model_of(cell, &request.options)?;
        let rows: Vec<Vec<f64>> = candidates
            .iter()
            .map(|c| {
                let visit = &self.visits[c.visit];
                model.observation(&c.joints, visit.sphere_id, visit.place as usize)
            })
            .collect();
        Ok(Self {
            chain: self.chain.clone(),
            home: self.home.clone(),
            visits: self.visits.clone(),
            problem: SelectionProblem::new(model.columns(), &rows, &predictions(&model, cell, &self.chain)),
            considered: candidates.len(),
            candidates,
        })
    }

    /// The same with only these candidates.
    pub(super) fn only(&self, which: &[usize]) -> Self {
        Self {
            chain: self.chain.clone(),
            home: self.home.clone(),
            visits: self.visits.clone(),
            candidates: which.iter().map(|c| self.candidates[*c].clone()).collect(),
            problem: self.problem.only(which),
            considered: self.considered,
        }
    }

    /// Spheres in placements: each is visited at least once.
    pub(super) fn groups(&self) -> usize {
        let keys: BTreeSet<(u32, u32)> = self.visits.iter().map(|v| (v.sphere_id, v.place)).collect();
        keys.len()
    }

    /// An empty design that weighs travel as the request says.
    pub(super) fn design(&self, request: &DesignRequest) -> Design<'_> {
        let mut design = Design::new(&self.problem);
        if request.patience.is_finite() {
            design.hurry(
                Travel::new(&self.chain, &self.candidates, &self.visits),
                request.patience,
            );
        }
        design
    }

    /// Grows a design to `count` poses. With several placements each one gets its part of the first
    /// half. The first poses in a new placement only determine where the plate is, so a greedy
    /// choice would never start there.
    pub(super) fn fill(&self, design: &mut Design<'_>, count: usize, mut on_step: impl FnMut(&Design<'_>)) {
        let places: BTreeSet<u32> = self.visits.iter().map(|v| v.place).collect();
        if places.len() > 1 {
            for (k, place) in (1..).zip(&places) {
                let here = |c: &Candidate| self.visits[c.visit].place == *place;
                design.allow(self.candidates.iter().map(here).collect());
                design.grow(k * count / (2 * places.len()), &mut on_step);
            }
        }
        design.allow(vec![true; self.candidates.len()]);
        design.grow(count, on_step);
    }

    /// The chosen candidates as a plan: visits in the order of least travel, poses in neighbour
    /// order.
    pub(super) fn plan(&self, cell: &Cell, request: &DesignRequest, chosen: &[usize]) -> Plan {
        let mut plan = Plan {
            robot: cell.robot.name.as_str().to_owned(),
            home: self.home.clone(),
            spheres: Vec::new(),
            planned: self.considered,
            reachable: self.considered,
            rejected: Vec::new(),
            robot_s: 0.0,
            promise: Vec::new(),
            obstacles: cell.obstacles,
        };
        let used = |v: usize| chosen.iter().any(|c| self.candidates[*c].visit == v);
        let indices: Vec<usize> = (0..self.visits.len()).filter(|v| used(*v)).collect();
        let visits: Vec<&CandidateVisit> = indices.iter().map(|v| &self.visits[*v]).collect();
        let mut first_id = 0;
        for (k, over_home) in tour(cell, &self.chain, &self.home, &visits) {
            let visit = visits[k];
            let mine = chosen.iter().filter_map(|c| self.candidates.get(*c));
            let poses: Vec<GridPose> = mine
                .filter(|c| c.visit == indices[k])
                .zip(0..)
                .map(|(c, index)| GridPose {
                    index,
                    pose: c.pose,
                    joints: c.joints.clone(),
                })
                .collect();
            let plate = cell.plates.get(visit.place as usize);
            let scene = plate.map(|plate| Scene::planned(cell, &self.chain, plate));
            let sequence = sequence(
                &self.chain,
                &request.rules,
                scene.as_ref(),
                &visit.start,
                &poses,
                first_id,
            );
            first_id += poses.len() as u32;
            plan.spheres.push(Visit {
                sphere_id: visit.sphere_id,
                place: visit.place,
                position_m: visit.start.neutral.position.into(),
                over_home,
                approach: visit.start.approach.clone(),
                approach_direction: visit.direction.into(),
                poses: sequence,
            });
        }
        plan.robot_s = robot_time(&plan, &cell.robot, &Procedure::default(), true);
        plan
    }
}

pub(super) fn model_of(cell: &Cell, options: &Options) -> Result<DesignModel, PlanError> {
    cell.check()?;
    let places = cell.plates.len() as u32;
    Ok(DesignModel::new(
        &cell.robot,
        &cell.tool,
        &cell.spheres,
        places,
        options,
    )?)
}

pub(super) fn predictions(model: &DesignModel, cell: &Cell, chain: &Chain) -> Vec<(Vec<f64>, Vector3<f64>, f64)> {
    let work = cell.work.clone().unwrap_or_else(|| workspace(chain, VALIDATION));
    work.iter().map(|q| model.prediction(q)).collect()
}
