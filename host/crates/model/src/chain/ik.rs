//! Inverse kinematics: joint angles for a TCP pose and an elbow angle.
//!
//! Arms of the spherical-rotational-spherical kind (iiwa 7 and 14, also with small errors from a
//! calibration) are solved in closed form on the nearest exact table, in all eight branches. Damped
//! Newton steps on the real table refine the solution. Any other arm of six or more joints is
//! solved by damped least squares from a seed ([`Chain::solve_from`]) or from many
//! ([`Chain::solve`]).

use core::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::JointLimits;
use spherecal_shared::{MAX_CHAIN, MAX_JOINTS};

use super::{Chain, ChainFrames, JointVector, TcpPose, rotation_vector, wrapped};
use crate::halton::spread;

/// A pose counts as solved if its errors in position (m), rotation (rad) and elbow angle (rad) are
/// below this.
pub const IK_TOLERANCE: f64 = 1e-11;
/// Steps of the polishing from a neighbouring pose.
const POLISH_STEPS: usize = 12;
/// Steps of the refinement from the exact table. With the elbow nearly straight, a millimetre in a
/// table is a tenth of a radian at the elbow.
const BRANCH_STEPS: usize = 60;
/// Smallest distance in a seed between the elbow and the line from shoulder to wrist, in m. Also
/// how far beyond the exact table's reach there is still a seed, because a real arm may be that
/// much longer.
const ELBOW_LEAST_M: f64 = 0.02;
/// Steps of the numerical solution from a distant seed.
const SEARCH_STEPS: usize = 120;
/// Seeds tried by [`Chain::solve`] on arms without a closed form.
const SEARCH_SEEDS: usize = 96;
/// Seeds tried if the first ones reach the pose, but outside the joint limits.
const SEARCH_SEEDS_MOST: usize = 1_536;

/// A shoulder, elbow or wrist pair of joints: signs of the two right-angle twists.
type Twists = (f64, f64);

/// The nearest exact spherical-rotational-spherical table.
#[derive(Clone, Copy, Debug)]
struct Srs {
    /// First shoulder twist pair, elbow pair, wrist pair.
    pairs: [Twists; 3],
    /// Rotation before joint 1.
    base: Matrix3<f64>,
    /// Shoulder S in F0, in m.
    shoulder: Vector3<f64>,
    /// Upper arm, forearm and flange offsets (d3, d5, d7), in m.
    lengths: [f64; 3],
}

impl Chain {
    /// The nearest exact table, when this is an arm of that kind: seven joints,
    /// right-angle twists within 0.05 rad, offsets under 5 mm.
    fn srs(&self) -> Option<Srs> {
        let rows: &[_; 7] = self.rows.as_slice().try_into().ok()?;
        let mut signs = [0.0; 7];
        for i in 1..7 {
            signs[i] = rows[i].alpha.signum();
            if (rows[i].alpha.abs() - FRAC_PI_2).abs() > 0.05 || rows[i].a.abs() > 0.005 || rows[i].beta.abs() > 0.05 {
                return None;
            }
        }
        if [1, 3, 5].into_iter().any(|i| rows[i].d.abs() > 0.005) {
            return None;
        }
        let lengths = [rows[2].d, rows[4].d, rows[6].d];
        if lengths[0].abs() < 0.05 || lengths[1].abs() < 0.05 {
            return None;
        }
        Some(Srs {
            pairs: [(signs[1], signs[2]), (signs[3], signs[4]), (signs[5], signs[6])],
            base: self.links[0].fixed,
            shoulder: self.links[0].origin,
            lengths,
        })
    }

    /// Whether [`Chain::solve`] is in closed form for this arm.
    pub fn closed_form(&self) -> bool {
        self.srs().is_some()
    }

    /// The branch of a spherical-rotational-spherical arm's configuration: the
    /// sides to which shoulder, elbow and wrist are bent.
    pub fn branch(&self, q: &[f64]) -> Option<[bool; 3]> {
        self.srs()?;
        let side = |joint: usize| self.side_angle(q, joint) >= 0.0;
        Some([side(1), side(3), side(5)])
    }

    /// Angle by which a joint (from 0) bends the arm, offset included, in rad.
    pub fn side_angle(&self, q: &[f64], joint: usize) -> f64 {
        let offset = self.rows.get(joint).map_or(0.0, |row| row.theta);
        wrapped(q.get(joint).copied().unwrap_or_default() + offset)
    }

    /// All solutions within the joint limits.
    ///
    /// In closed form, up to eight branches for the pose's elbow angle (0 if the pose has none).
    /// Otherwise the solutions that damped least squares finds from many seeds spread over the
    /// limits, each joint by full turns as near the middle of its limits as can be: joint 2 of a UR16e
    /// stood at 4.6 rad, and no way led there from home. Near-duplicates are removed. The list is empty
    /// if the pose is out of reach. The search from seeds also missed about one in 9,000 poses of a
    /// six-axis arm that are reachable only at a corner of its limits. Each solution meets pose and
    /// elbow angle to [`IK_TOLERANCE`].
    pub fn solve(&self, pose: &TcpPose) -> Vec<Vec<f64>> {
        let target = TcpPose {
            elbow: pose.elbow.or(self.has_elbow().then_some(0.0)),
            ..*pose
        };
        if let Some(srs) = self.srs() {
            let seeds = srs.branches(self, &target);
            let solutions = seeds
                .into_iter()
                .filter_map(|seed| self.polish(&target, &seed, BRANCH_STEPS))
                .filter(|q| self.limit_margin(q) >= 0.0);
            return distinct(solutions);
        }
        let reached = |index: usize| {
            // Beyond one turn, a limit only repeats the same branches.
            let seed = spread(&self.limits, index, 1.0, core::f64::consts::PI);
            self.polish(&target, &seed, SEARCH_STEPS)
        };
        let any: Vec<Vec<f64>> = (1..=SEARCH_SEEDS).filter_map(reached).collect();
        let within = distinct(any.iter().filter_map(|q| self.unwound(q)));
        if any.is_empty() || !within.is_empty() {
            return within;
        }
        // Branches outside the limits reach the pose. A branch inside them may attract only few
        // seeds.
        (SEARCH_SEEDS + 1..=SEARCH_SEEDS_MOST)
            .find_map(|index| reached(index).and_then(|q| self.unwound(&q)))
            .into_iter()
            .collect()
    }

    /// The solution reached from `seed` (rad) by damped least squares, within the joint limits. An
    /// arm of seven joints without a requested elbow angle stays near the seed in its null space.
    /// `None` if it does not converge.
    pub fn solve_from(&self, pose: &TcpPose, seed: &[f64]) -> Option<Vec<f64>> {
        self.turned(&self.polish(pose, seed, SEARCH_STEPS)?)
    }

    /// `q` (rad), with joints outside their limits moved by a full turn if that is inside. `None`
    /// if it is not.
    fn turned(&self, q: &[f64]) -> Option<Vec<f64>> {
        let near = q.iter().zip(&self.limits).map(|(q, limit)| {
            if (limit.min_rad..=limit.max_rad).contains(q) {
                *q
            } else {
                about_middle(*q, limit)
            }
        });
        let q: Vec<f64> = near.collect();
        (self.limit_margin(&q) >= 0.0).then_some(q)
    }

    /// `q` (rad), each joint by full turns as near the middle of its limits as can be. `None` if that is outside.
    fn unwound(&self, q: &[f64]) -> Option<Vec<f64>> {
        let near = q.iter().zip(&self.limits).map(|(q, limit)| about_middle(*q, limit));
        let q: Vec<f64> = near.collect();
        (self.limit_margin(&q) >= 0.0).then_some(q)
    }

    /// The solution continuous with `q`: a few Newton steps, without full turns.
    pub fn follow(&self, pose: &TcpPose, q: &[f64]) -> Option<Vec<f64>> {
        self.polish(pose, q, POLISH_STEPS)
    }

    /// Damped Newton steps on position, rotation and, if requested, elbow angle. `None` if the
    /// error does not fall below [`IK_TOLERANCE`].
    fn polish(&self, pose: &TcpPose, seed: &[f64], steps: usize) -> Option<Vec<f64>> {
        // Arms that controllers drive are solved often, and in less room.
        if self.dof() <= MAX_JOINTS {
            self.polish_in::<MAX_JOINTS>(pose, seed, steps)
        } else {
            self.polish_in::<MAX_CHAIN>(pose, seed, steps)
        }
    }

    fn polish_in<const MOST: usize>(&self, pose: &TcpPose, seed: &[f64], steps: usize) -> Option<Vec<f64>> {
        let n = self.dof();
        if seed.len() != n {
            return None;
        }
        let mut q = JointVector::<MOST>::zeros();
        for (slot, value) in q.iter_mut().zip(seed) {
            *slot = *value;
        }
        let with_elbow = pose.elbow.is_some() && self.has_elbow();
        let mut posture = self.posture::<MOST>(&q.as_slice()[..n]);
        let mut error = self.error(pose, &posture, with_elbow)?;
        let mut size = error.norm();
        // Damping in (m or rad)²: small enough to keep Newton's convergence, and raised if a step
        // increases the error.
        let mut damping = 1e-9;
        for _ in 0..steps {
            if size < 1e-14 {
                break;
            }
            let jacobian = self.jacobian(&posture, with_elbow);
            let mut normal: SMatrix<f64, MOST, MOST> = jacobian.transpose() * jacobian;
            for k in 0..MOST {
                normal[(k, k)] += damping;
            }
            let mut step = Cholesky::new(&normal)?.solve(&(jacobian.transpose() * error));
            let largest = step.amax();
            if largest > 0.5 {
                step *= 0.5 / largest;
            }
            let next = q + step;
            let next_posture = self.posture(&next.as_slice()[..n]);
            let Some(next_error) = self.error(pose, &next_posture, with_elbow) else {
                damping = (damping * 10.0).max(1e-4);
                continue;
            };
            let next_size = next_error.norm();
            if next_size < size {
                (q, posture, error, size) = (next, next_posture, next_error, next_size);
                damping = (damping * 0.1).max(1e-10);
            } else if size < IK_TOLERANCE {
                break;
            } else {
                damping = (damping * 30.0).max(1e-7);
            }
        }
        (size < IK_TOLERANCE).then(|| q.as_slice()[..n].to_vec())
    }

    /// Task error: position, rotation vector of the difference, elbow angle. `None` if the elbow
    /// angle is requested but not defined.
    fn error<const MOST: usize>(
        &self,
        pose: &TcpPose,
        posture: &ChainFrames<MOST>,
        with_elbow: bool,
    ) -> Option<SVector<f64, 7>> {
        let difference = pose.rotation * Rotation3::from_matrix_unchecked(posture.rotation).inverse();
        let turn = rotation_vector(&difference);
        let shift = pose.position - posture.tcp;
        let swivel = match (with_elbow, pose.elbow) {
            (true, Some(wanted)) => wrapped(wanted - self.elbow_at(posture)?),
            _ => 0.0,
        };
        let e = SVector::<f64, 7>::from([shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, swivel]);
        e.iter().all(|v| v.is_finite()).then_some(e)
    }
}

impl Srs {
    /// Joint angles of the eight branches on the exact table; fewer when the
    /// pose is out of reach (none) or the limits exclude an angle.
    fn branches(&self, chain: &Chain, pose: &TcpPose) -> Vec<Vec<f64>> {
        let [upper, fore, last] = self.lengths;
        let flange = pose.position - pose.rotation * chain.tcp;
        let approach = pose.rotation.matrix().column(2).into_owned();
        let wrist = flange - approach * last;
        let line = wrist - self.shoulder;
        let length = line.norm();
        if length.is_nan() || length <= 1e-6 {
            return Vec::new();
        }
        let n = line / length;
        let along = (upper * upper - fore * fore + length * length) / (2.0 * length);
        let square = upper * upper - along * along;
        let short = (length - upper.abs() - fore.abs()).max((upper.abs() - fore.abs()).abs() - length);
        if square.is_nan() || short > ELBOW_LEAST_M {
            return Vec::new();
        }
        let height = square.max(ELBOW_LEAST_M * ELBOW_LEAST_M).sqrt();
        let up = Vector3::new(-n.x * n.z, -n.y * n.z, 1.0 - n.z * n.z);
        let Some(u) = up.try_normalize(1e-9) else {
            return Vec::new();
        };
        let (sin, cos) = pose.elbow.unwrap_or(0.0).sin_cos();
        let elbow = self.shoulder + n * along + (u * cos + n.cross(&u) * sin) * height;
        let bone = |to: Vector3<f64>, length: f64| to.normalize() * length.signum();
        let directions = [bone(elbow - self.shoulder, upper), bone(wrist - elbow, fore), approach];
        (0..8u8)
            .filter_map(|branch| {
                let mut angles = [0.0; 7];
                let mut frame = self.base;
                for (k, direction) in directions.iter().enumerate() {
                    let (first, second) = self.pairs[k];
                    let sign = if branch & (1 << k) == 0 { 1.0 } else { -1.0 };
                    let v = frame.transpose() * direction;
                    let tilt = sign * (-first * second * v.z).clamp(-1.0, 1.0).acos();
                    let turn = (second * sign * v.y).atan2(second * sign * v.x);
                    angles[2 * k] = turn;
                    angles[2 * k + 1] = tilt;
                    frame = frame * about_z(turn) * about_x(first) * about_z(tilt) * about_x(second);
                }
                let rest = frame.transpose() * pose.rotation.matrix();
                angles[6] = rest[(1, 0)].atan2(rest[(0, 0)]);
                angles
                    .iter()
                    .zip(&chain.rows)
                    .zip(&chain.limits)
                    .map(|((t, row), limit)| into_limits(t - row.theta, limit.min_rad, limit.max_rad))
                    .collect()
            })
            .collect()
    }
}

/// `angle` (rad) by full turns as near the middle of a joint's limits as can be.
fn about_middle(angle: f64, limit: &JointLimits) -> f64 {
    let middle = 0.5 * (limit.min_rad + limit.max_rad);
    wrapped(angle - middle) + middle
}

/// The solutions without repetitions, full turns included.
fn distinct(solutions: impl Iterator<Item = Vec<f64>>) -> Vec<Vec<f64>> {
    let mut found: Vec<Vec<f64>> = Vec::new();
    for q in solutions {
        let new = found
            .iter()
            .all(|other| other.iter().zip(&q).any(|(a, b)| wrapped(a - b).abs() > 1e-3));
        if new {
            found.push(q);
        }
    }
    found
}

/// `angle` plus the number of full turns that brings it nearest to zero within the limits, with a
/// small tolerance for the refinement.
fn into_limits(angle: f64, min: f64, max: f64) -> Option<f64> {
    let angle = wrapped(angle);
    let slack = 0.02;
    [angle, angle - TAU, angle + TAU]
        .into_iter()
        .find(|a| (min - slack..=max + slack).contains(a))
}

fn about_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}

/// A right-angle turn about x, of the given sign.
fn about_x(sign: f64) -> Matrix3<f64> {
    Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -sign, 0.0, sign, 0.0)
}

#[cfg(test)]
#[path = "ik_tests.rs"]
mod tests;
