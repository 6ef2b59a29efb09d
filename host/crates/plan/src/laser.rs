//! Plans the laser measurements: configurations distributed as in Tables 3 and 4 of the paper, and
//! the arcs of Section 4.3.
//!
//! The paper gives mean, standard deviation, minimum and maximum of the TCP coordinates. Joint
//! angles are drawn uniformly within limits and kept if the TCP lies in the table's box and the arm
//! is clear of table and itself. They are weighted by the maximum-entropy distribution with the
//! table's means and deviations. A set is drawn by these weights, and points are exchanged until
//! the set itself has these statistics. A robot of another reach gets the same statistics scaled by
//! its reach.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use spherecal_shared::robot::{Robot, Tool};

use serde::{Deserialize, Serialize};
use spherecal_model::Chain;

use super::laser_spread::choose;
pub use super::laser_spread::{Spread, TABLE_3, TABLE_4};

/// Configurations to calibrate from (Table 3).
pub const CALIBRATION_POINTS: usize = 284;
/// Configurations to validate by (Table 4).
pub const VALIDATION_POINTS: usize = 125;
/// Points on the base arcs, both together.
pub const BASE_ARC_POINTS: usize = 150;
/// Points on the tool arcs, all three together.
pub const TOOL_ARC_POINTS: usize = 153;

/// Share of every joint's range that is used.
const OF_RANGE: f64 = 0.95;
/// Reach of the iiwa 7 with its tool, on which Tables 3 and 4 are based: the sum of all lengths of
/// its table and the TCP's distance from the flange, in m.
const PAPER_REACH_M: f64 = 1.266 + 0.111_803_398_874_989_5;
/// Smallest height of the arm above the table (z = 0 of F0), in m, and smallest distance between
/// links that are not neighbours; both at the paper's reach.
const ABOVE_TABLE_M: f64 = 0.08;
const APART_M: f64 = 0.15;
/// Size of the pool from which a set is drawn, and the largest number of draws to fill it.
const POOL: usize = 4000;
const MOST_DRAWS: usize = 2_000_000;

/// Why no plan could be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LaserPlanError {
    /// Too few configurations have the TCP in the table's box.
    #[error(
        "only {found} of {tried} random configurations of robot {robot} bring the TCP into the measuring volume, \
         {needed} are needed: check the joint limits and the tool"
    )]
    Unreachable {
        /// Name of the robot.
        robot: String,
        /// Configurations found.
        found: usize,
        /// Configurations tried.
        tried: usize,
        /// Configurations needed.
        needed: usize,
    },
    /// Arcs need an axis pair at either end.
    #[error("robot {robot} has {joints} joints: the arcs need at least 3")]
    TooFewJoints {
        /// Name of the robot.
        robot: String,
        /// Its joints.
        joints: usize,
    },
}

/// A planned arc: one joint turns, the others rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arc {
    /// The joint that turns, from 1.
    pub joint: usize,
    /// Joint angles in rad, in the order of motion.
    pub configurations: Vec<Vec<f64>>,
}

/// The planned laser measurements, as joint angles in rad.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaserPlan {
    /// Configurations to calibrate from (284, Table 3).
    pub calibration: Vec<Vec<f64>>,
    /// Other configurations to judge by (125, Table 4).
    pub validation: Vec<Vec<f64>>,
    /// Arcs of joints 1 and 2 (75 points each).
    pub base_arcs: Vec<Arc>,
    /// Arcs of the last three joints (51 points each).
    pub tool_arcs: Vec<Arc>,
}

/// Plans the laser measurements for `robot` with its nominal `tool`.
///
/// # Errors
/// Fewer than three joints, or joint limits that keep the TCP out of the volume.
pub fn plan(robot: &Robot, tool: &Tool, seed: u64) -> Result<LaserPlan, LaserPlanError> {
    let n = robot.dof();
    if n < 3 {
        return Err(LaserPlanError::TooFewJoints {
            robot: robot.name.to_string(),
            joints: n,
        });
    }
    let arm = Planner::new(robot, tool);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6c61_7365_7200_0000);
    let calibration = arm.spread(&mut rng, &TABLE_3, CALIBRATION_POINTS)?;
    let validation = arm.spread(&mut rng, &TABLE_4, VALIDATION_POINTS)?;
    let rest = arm.pool(&mut rng, &TABLE_4.scaled(arm.scale), 80)?;
    let base_arcs = arm.arcs(&rest, &[1, 2], BASE_ARC_POINTS);
    let last = if n > 3 { vec![n - 2, n - 1, n] } else { vec![n - 1, n] };
    let tool_arcs = arm.arcs(&rest, &last, TOOL_ARC_POINTS);
    Ok(LaserPlan {
        calibration,
        validation,
        base_arcs,
        tool_arcs,
    })
}

/// The arm with its limits, as the generator needs it.
struct Planner {
    name: String,
    chain: Chain,
    range: Vec<(f64, f64)>,
    scale: f64,
}

impl Planner {
    fn new(robot: &Robot, tool: &Tool) -> Self {
        let lengths: f64 = robot.joints.iter().map(|j| j.mdh.a.abs() + j.mdh.d.abs()).sum();
        let range = robot
            .joints
            .iter()
            .map(|j| {
                let middle = f64::midpoint(j.limits.min_rad, j.limits.max_rad);
                let half =
                    (OF_RANGE * 0.5 * (j.limits.max_rad - j.limits.min_rad)).min(OF_RANGE * std::f64::consts::PI);
                (middle - half, middle + half)
            })
            .collect();
        Self {
            name: robot.name.to_string(),
            chain: Chain::unchecked(robot, tool),
            range,
            scale: (lengths + tool.tcp().norm()) / PAPER_REACH_M,
        }
    }

    /// Whether the arm is clear of the table and of itself, in a simplified sense: the polyline of
    /// frame origins and TCP is above the table, and pieces that are not neighbours keep a
    /// distance.
    fn clear(&self, q: &[f64]) -> Option<Vector3<f64>> {
        let frames = self.chain.frames(q);
        let tcp = self.chain.tcp_of(&frames);
        let mut line = vec![Vector3::zeros()];
        for p in frames.iter().map(|f| f.position).chain([tcp]) {
            if line.last().is_none_or(|end| (p - end).norm() > 0.03 * self.scale) {
                line.push(p);
            }
        }
        let high = line.iter().skip(2).all(|p| p.z > ABOVE_TABLE_M * self.scale);
        let pieces: Vec<_> = line.windows(2).map(|w| (w[0], w[1])).collect();
        let near = APART_M * self.scale;
        let apart = (0..pieces.len()).all(|i| {
            (i + 2..pieces.len()).all(|j| {
                // Pieces joined by a short piece can never be far apart.
                let between: f64 = pieces[i + 1..j].iter().map(|(a, b)| (b - a).norm()).sum();
                between < 1.5 * near || distance(&pieces[i], &pieces[j]) > near
            })
        });
        (high && apart).then_some(tcp)
    }

    /// `size` random configurations with the TCP inside the box of `target`.
    fn pool(
        &self,
        rng: &mut ChaCha8Rng,
        target: &Spread,
        size: usize,
    ) -> Result<Vec<(Vec<f64>, Vector3<f64>)>, LaserPlanError> {
        let mut pool = Vec::with_capacity(size);
        for _ in 0..MOST_DRAWS {
            let q: Vec<f64> = self
                .range
                .iter()
                .map(|(low, high)| rng.random_range(*low..=*high))
                .collect();
            if let Some(tcp) = self.clear(&q).filter(|tcp| target.holds(tcp)) {
                pool.push((q, tcp));
                if pool.len() == size {
                    return Ok(pool);
                }
            }
        }
        Err(LaserPlanError::Unreachable {
            robot: self.name.clone(),
            found: pool.len(),
            tried: MOST_DRAWS,
            needed: size,
        })
    }

    /// `count` configurations whose TCPs have the table's statistics.
    fn spread(&self, rng: &mut ChaCha8Rng, table: &Spread, count: usize) -> Result<Vec<Vec<f64>>, LaserPlanError> {
        let target = table.scaled(self.scale);
        let pool = self.pool(rng, &target, POOL)?;
        let points: Vec<_> = pool.iter().map(|(_, tcp)| *tcp).collect();
        let chosen = choose(rng, &points, &target, count);
        Ok(chosen.into_iter().map(|i| pool[i].0.clone()).collect())
    }

    /// Arcs of `joints` (from 1) about one of the `rest` configurations: the one whose smallest
    /// product of free turn and radius is largest.
    fn arcs(&self, rest: &[(Vec<f64>, Vector3<f64>)], joints: &[usize], points: usize) -> Vec<Arc> {
        let score = |q: &[f64]| {
            let frames = self.chain.frames(q);
            let tcp = self.chain.tcp_of(&frames);
            let of = |joint: &usize| {
                let (low, high) = self.free(q, joint - 1);
                let frame = &frames[joint - 1];
                let w = tcp - frame.position;
                let radius = (w - frame.z() * w.dot(&frame.z())).norm();
                (high - low).min(3.0) * radius.min(0.3 * self.scale)
            };
            joints.iter().map(of).fold(f64::INFINITY, f64::min)
        };
        let best = rest
            .iter()
            .map(|(q, _)| (score(q), q))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(&[] as &[f64], |(_, q)| q);
        let count = points / joints.len();
        joints
            .iter()
            .map(|joint| {
                let (low, high) = self.free(best, joint - 1);
                let configurations = (0..count)
                    .map(|i| {
                        let mut q = best.to_vec();
                        q[joint - 1] = low + (high - low) * i as f64 / (count - 1) as f64;
                        q
                    })
                    .collect();
                Arc {
                    joint: *joint,
                    configurations,
                }
            })
            .collect()
    }

    /// How far joint `i` (from 0) can turn in both directions from `q` and stay clear.
    fn free(&self, q: &[f64], i: usize) -> (f64, f64) {
        const STEP: f64 = 0.04;
        let (low, high) = self.range[i];
        let walk = |sign: f64| {
            let mut trial = q.to_vec();
            loop {
                let next = trial[i] + sign * STEP;
                if next < low || next > high {
                    return trial[i];
                }
                let here = trial[i];
                trial[i] = next;
                if self.clear(&trial).is_none() {
                    return here;
                }
            }
        };
        (walk(-1.0), walk(1.0))
    }
}

/// Distance between two segments, in m.
fn distance(a: &(Vector3<f64>, Vector3<f64>), b: &(Vector3<f64>, Vector3<f64>)) -> f64 {
    let (u, v, w) = (a.1 - a.0, b.1 - b.0, a.0 - b.0);
    let (uu, uv, vv) = (u.norm_squared(), u.dot(&v), v.norm_squared());
    let (uw, vw) = (u.dot(&w), v.dot(&w));
    let determinant = uu * vv - uv * uv;
    let mut s = if determinant > 1e-12 {
        ((uv * vw - vv * uw) / determinant).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let mut t = if vv > 1e-12 { (uv * s + vw) / vv } else { 0.0 };
    if !(0.0..=1.0).contains(&t) {
        t = t.clamp(0.0, 1.0);
        s = if uu > 1e-12 {
            ((uv * t - uw) / uu).clamp(0.0, 1.0)
        } else {
            0.0
        };
    }
    (w + u * s - v * t).norm()
}
