//! Travel time to a pose, and the order of visits with the least travel.

use super::candidates::{Candidate, CandidateVisit};
use super::cell::Cell;
use super::order::round_trip;
use super::scene::Scene;
use super::times::{Turns, motion_s, record_s};
use super::types::Waypoint;
use spherecal_model::chain::Chain;
use spherecal_shared::procedure::Procedure;

/// Travel cost of a candidate: the turn from the nearest chosen pose of its visit, or from the
/// start of the visit.
#[derive(Clone)]
pub(super) struct Travel<'a> {
    turns: Turns,
    /// Time of a recording, in s.
    record_s: f64,
    candidates: &'a [Candidate],
    visits: &'a [CandidateVisit],
    /// Time from the nearest chosen pose, in s, by candidate.
    reach_s: Vec<f64>,
}

impl<'a> Travel<'a> {
    /// Nothing chosen.
    pub(super) fn new(chain: &'a Chain, candidates: &'a [Candidate], visits: &'a [CandidateVisit]) -> Self {
        let procedure = Procedure::default();
        let mut travel = Self {
            turns: Turns::new(&procedure, chain.limits()),
            record_s: record_s(&procedure),
            candidates,
            visits,
            reach_s: Vec::new(),
        };
        travel.reach_s = candidates.iter().map(|c| travel.start_s(c)).collect();
        travel
    }

    /// Time from where the visit begins, in s.
    fn start_s(&self, c: &Candidate) -> f64 {
        let start = &self.visits[c.visit].start;
        self.turns
            .between_s((&start.neutral, &start.joints), (&c.pose, &c.joints))
    }

    pub(super) fn add(&mut self, chosen: usize) {
        let new = &self.candidates[chosen];
        for (reach, c) in self.reach_s.iter_mut().zip(self.candidates) {
            if c.visit == new.visit {
                *reach = reach.min(between_s(&self.turns, new, c));
            }
        }
    }

    /// A candidate was taken out, and these are left.
    pub(super) fn remove(&mut self, gone: usize, left: &[usize]) {
        let visit = self.candidates[gone].visit;
        let here: Vec<&Candidate> = left
            .iter()
            .map(|c| &self.candidates[*c])
            .filter(|c| c.visit == visit)
            .collect();
        for k in 0..self.candidates.len() {
            let c = &self.candidates[k];
            if c.visit == visit {
                let start = self.start_s(c);
                let nearest = here.iter().map(|other| between_s(&self.turns, other, c));
                self.reach_s[k] = nearest.fold(start, f64::min);
            }
        }
    }

    /// Share of a candidate's gain that counts: gain per second, relative to a pose without travel.
    /// The larger `patience`, the smaller the discount.
    pub(super) fn share(&self, candidate: usize, patience: f64) -> f64 {
        let record_s = patience * self.record_s;
        record_s / (record_s + self.reach_s[candidate])
    }
}

/// Time of the turn between two candidates of a visit, in s.
fn between_s(turns: &Turns, a: &Candidate, b: &Candidate) -> f64 {
    turns.between_s((&a.pose, &a.joints), (&b.pose, &b.joints))
}

/// The order of visits with the least travel, from home and back, and for each visit whether its
/// path leads over home: it does if the straight joint motion from the previous visit is not clear.
pub(super) fn tour(cell: &Cell, chain: &Chain, home: &Waypoint, visits: &[&CandidateVisit]) -> Vec<(usize, bool)> {
    let at = |k: usize| visits.get(k).map_or(&home.joints, |v| &v.start.approach.joints);
    let n = visits.len();
    let scenes: Vec<Scene> = cell
        .plates
        .iter()
        .map(|plate| Scene::planned(cell, chain, plate))
        .collect();
    let over_home = |a: usize, b: usize| motion_s(at(a), &home.joints) + motion_s(&home.joints, at(b));
    let mut direct = vec![false; n * n];
    for a in 0..n {
        for b in 0..a {
            let same_place = visits[a].place == visits[b].place;
            let clear = same_place
                && scenes
                    .get(visits[a].place as usize)
                    .is_some_and(|scene| scene.is_clear(at(a), at(b)));
            direct[a * n + b] = clear;
            direct[b * n + a] = clear;
        }
    }
    let is_direct = |a: usize, b: usize| a < n && b < n && direct[a * n + b];
    let cost = |a: usize, b: usize| {
        if a == n || b == n || is_direct(a, b) {
            motion_s(at(a), at(b))
        } else {
            over_home(a, b)
        }
    };
    let mut order = round_trip(n, cost);
    // The plate is moved once to each of its placements.
    order.sort_by_key(|k| visits[*k].place);
    let mut before = n;
    order
        .into_iter()
        .map(|k| {
            let over = !is_direct(before, k);
            before = k;
            (k, over)
        })
        .collect()
}
