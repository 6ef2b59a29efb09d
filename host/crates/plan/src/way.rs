//! Ways of a free arm that keep clear of its cell: straight joint motions, through vias where the
//! straight motion is not clear.
//!
//! A motion is *clear* if it keeps every margin of the [`Scene`]. Where the arm already stands within
//! a margin, for instance at a sphere or outside of the workspace, only motion is clear that does
//! not come nearer. A margin that the target itself does not keep is not asked for on the way.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::scene::Scene;
use spherecal_model::chain::TcpPose;

/// Largest step of a checked motion, in rad per joint and in m of the TCP.
const STEP_RAD: f64 = 0.02;
const STEP_M: f64 = 0.005;
/// How far a clearance may shrink where it is below its margin, in m.
pub(super) const SLACK_M: f64 = 5e-4;
/// Heights of vias above the present place and above the target, in m.
const LIFTS_M: [f64; 4] = [0.03, 0.07, 0.12, 0.18];
/// Steps of a lift along its line, in m.
pub(super) const LIFT_STEP_M: f64 = 0.01;
/// Configurations that the search draws, the length of its steps, and how far it looks beyond start
/// and target, in rad.
const DRAWS: u32 = 1500;
const GROWTH_RAD: f64 = 0.15;
const AROUND_RAD: f64 = 0.6;

impl Scene {
    /// By how much the joint motion through these angles (rad) comes too near to something, in m.
    /// At most [`SLACK_M`] is clear. `goal` has the clearances of the target.
    pub(super) fn too_near(&self, path: &[&[f64]], goal: &[f64]) -> f64 {
        let Some(first) = path.first() else { return 0.0 };
        let mut floor = self.clearances(first);
        let mut worst = 0.0f64;
        for pair in path.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let turn = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let way = (self.chain.pose(a).position - self.chain.pose(b).position).norm();
            let parts = (turn / STEP_RAD).max(way / STEP_M).ceil().max(1.0);
            for part in 1..=parts as usize {
                let now = self.clearances(&between(a, b, part as f64 / parts));
                for ((floor, now), goal) in floor.iter_mut().zip(now).zip(goal) {
                    worst = worst.max(floor.min(goal.min(0.0)) - now);
                    *floor = floor.max(now);
                }
            }
        }
        worst
    }

    fn clear(&self, path: &[&[f64]], goal: &[f64]) -> bool {
        self.too_near(path, goal) <= SLACK_M
    }

    /// Whether the straight joint motion between two configurations (rad) is clear.
    pub fn is_clear(&self, from: &[f64], to: &[f64]) -> bool {
        self.clear(&[from, to], &self.clearances(to))
    }

    /// The configurations through which a clear way leads from `from` to `to` (rad), `to` at the
    /// end: `to` alone where the straight joint motion is clear. `None` if no way was found, or if the arm is under the
    /// plate: each way up from there would count as one that comes no nearer.
    pub fn way(&self, from: &[f64], to: &[f64]) -> Option<Vec<Vec<f64>>> {
        if from.len() != to.len() || self.is_below_the_plate(from) {
            return None;
        }
        let goal = self.clearances(to);
        if self.clear(&[from, to], &goal) {
            return Some(vec![to.to_vec()]);
        }
        let starts = self.lifts(from);
        let mut ends = self.lifts(to);
        ends.insert(0, to.to_vec());
        // Straight up, over, and down; or over home.
        for start in &starts {
            if !self.clear(&[from, start], &goal) {
                continue;
            }
            for end in &ends {
                for middle in [None, self.home.as_deref()] {
                    let mut path = vec![from, start.as_slice()];
                    path.extend(middle);
                    path.push(end);
                    if end != to {
                        path.push(to);
                    }
                    if self.clear(&path, &goal) {
                        return Some(path[1..].iter().map(|q| q.to_vec()).collect());
                    }
                }
            }
        }
        self.search(from, to, &goal)
    }

    /// Whether the controller takes these angles (rad) as the target of a motion. It refuses what is within its margin of a
    /// limit, also for an arm that stands there.
    fn may_be_target(&self, q: &[f64]) -> bool {
        self.chain.limit_margin(q) >= self.limits.position_margin_rad
    }

    /// Configurations straight above `q` (rad), and behind it along the tool's axis, that may be a target.
    fn lifts(&self, q: &[f64]) -> Vec<Vec<f64>> {
        let pose = self.chain.pose(q);
        let back = -(pose.rotation * Vector3::z());
        let mut lifts = Vec::new();
        for direction in [self.up, back] {
            let (mut joints, mut reached) = (q.to_vec(), 0.0);
            'line: for lift in LIFTS_M {
                while reached + 1e-9 < lift {
                    reached += LIFT_STEP_M;
                    let above = TcpPose {
                        position: pose.position + direction * reached,
                        elbow: None,
                        ..pose
                    };
                    match self.chain.follow(&above, &joints) {
                        Some(next) => joints = next,
                        None => break 'line,
                    }
                }
                if self.may_be_target(&joints) {
                    lifts.push(joints.clone());
                }
            }
        }
        lifts
    }

    /// Grows two trees of clear motions, from both ends, until they meet.
    fn search(&self, from: &[f64], to: &[f64], goal: &[f64]) -> Option<Vec<Vec<f64>>> {
        let mut random = ChaCha8Rng::seed_from_u64(0x7761_7900);
        // The tree of the target grows backwards, away from it: there the target's margins count.
        let mut trees = [vec![(from.to_vec(), 0usize)], vec![(to.to_vec(), 0usize)]];
        for draw in 0..DRAWS {
            let side = (draw % 2) as usize;
            let sample: Vec<f64> = from
                .iter()
                .zip(to)
                .zip(self.chain.limits())
                .map(|((a, b), limit)| {
                    let low = (a.min(*b) - AROUND_RAD).max(limit.min_rad);
                    let high = (a.max(*b) + AROUND_RAD).min(limit.max_rad);
                    low + (high - low).max(0.0) * random.random::<f64>()
                })
                .collect();
            let Some(new) = self.grow(&mut trees[side], &sample, goal, side == 1) else {
                continue;
            };
            // Lets the other tree come towards it.
            while let Some(next) = self.grow(&mut trees[1 - side], &new, goal, side == 0) {
                if next == new {
                    return Some(self.shortened(from, &join(&trees, &new), goal));
                }
            }
        }
        None
    }

    /// Adds the end of one step from the nearest node towards `target` to a tree. `None` if the
    /// step is not clear or has no length.
    fn grow(
        &self,
        tree: &mut Vec<(Vec<f64>, usize)>,
        target: &[f64],
        goal: &[f64],
        backwards: bool,
    ) -> Option<Vec<f64>> {
        let far = |q: &[f64]| q.iter().zip(target).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let nearest = (0..tree.len()).min_by(|a, b| far(&tree[*a].0).total_cmp(&far(&tree[*b].0)))?;
        let node = tree[nearest].0.clone();
        let distance = far(&node);
        if distance < 1e-12 {
            return None;
        }
        let next = if distance <= GROWTH_RAD {
            target.to_vec()
        } else {
            between(&node, target, GROWTH_RAD / distance)
        };
        let path: [&[f64]; 2] = if backwards { [&next, &node] } else { [&node, &next] };
        if !self.may_be_target(&next) || !self.clear(&path, goal) {
            return None;
        }
        tree.push((next.clone(), nearest));
        Some(next)
    }

    /// A way without the vias that it does not need.
    fn shortened(&self, from: &[f64], way: &[Vec<f64>], goal: &[f64]) -> Vec<Vec<f64>> {
        let mut short: Vec<Vec<f64>> = Vec::new();
        let mut next = 0;
        while next < way.len() {
            let here = short.last().map_or(from, Vec::as_slice);
            let farthest = (next..way.len()).rev().find(|k| self.clear(&[here, &way[*k]], goal));
            let taken = farthest.unwrap_or(next);
            short.push(way[taken].clone());
            next = taken + 1;
        }
        short
    }
}

fn between(a: &[f64], b: &[f64], t: f64) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + (b - a) * t).collect()
}

/// The way from the root of the first tree over the common node to that of the second.
fn join(trees: &[Vec<(Vec<f64>, usize)>; 2], meeting: &[f64]) -> Vec<Vec<f64>> {
    let to_root = |tree: &[(Vec<f64>, usize)]| {
        let mut way = Vec::new();
        let mut at = tree.iter().rposition(|(q, _)| q == meeting).unwrap_or(0);
        while at != 0 {
            way.push(tree[at].0.clone());
            at = tree[at].1;
        }
        way
    };
    let mut way = to_root(&trees[0]);
    way.reverse();
    way.extend(to_root(&trees[1]).into_iter().skip(1));
    way.extend(trees[1].first().map(|(root, _)| root.clone()));
    way
}

#[cfg(test)]
#[path = "way_tests.rs"]
mod tests;
