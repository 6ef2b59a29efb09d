//! A robot with its tool, compiled for computing: TCP frame, Jacobian, elbow
//! angle, inverse kinematics, for any number of joints.
//!
//! Code that needs the nominal kinematics on slices uses [`Chain`]: the planner, the laser
//! tracker's plan and arcs, the campaign's retreat.

use spherecal_shared::robot::{JointLimits, LinkTransform, MdhRow, Pose, Robot, RobotError, Tool};

mod ik;

use nalgebra::{Matrix3, Matrix6xX, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};
use spherecal_shared::robot::elbow::elbow;
use spherecal_shared::robot::kinematics::frames_into;
use spherecal_shared::{MAX_CHAIN, MAX_JOINTS};

pub use ik::IK_TOLERANCE;

/// Room for `MOST` joints: for arms that controllers drive, and for longer chains.
type JointVector<const MOST: usize> = SVector<f64, MOST>;
/// Task Jacobian: rows 0-2 position (m), 3-5 rotation (rad), 6 elbow (rad).
type TaskJacobian<const MOST: usize> = SMatrix<f64, 7, MOST>;

/// Where the TCP is to be, seen from F0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TcpPose {
    /// Tool centre point in F0, in m.
    pub position: Vector3<f64>,
    /// Rotation of FT in F0.
    pub rotation: Rotation3<f64>,
    /// Elbow angle in rad ([`spherecal_shared::robot::elbow`]), where it is
    /// asked for (or, as a result, where the arm has one).
    pub elbow: Option<f64>,
}

/// Frames and TCP at one configuration.
#[derive(Clone, Debug)]
struct ChainFrames<const MOST: usize> {
    /// F1..Fn in F0; the rest is unused.
    frames: [Pose<f64>; MOST],
    /// Rotation of the flange and of FT.
    rotation: Matrix3<f64>,
    /// TCP in F0, in m.
    tcp: Vector3<f64>,
}

/// A robot with its tool, compiled.
#[derive(Clone, Debug)]
pub struct Chain {
    rows: Vec<MdhRow<f64>>,
    links: Vec<LinkTransform<f64>>,
    limits: Vec<JointLimits>,
    tcp: Vector3<f64>,
}

impl Chain {
    /// Compiles a robot and its tool.
    ///
    /// # Errors
    /// What [`Robot::check`] and [`Tool::check`] refuse, and robots with fewer
    /// than six joints, which cannot take up an orientation.
    pub fn new(robot: &Robot, tool: &Tool) -> Result<Self, ChainError> {
        robot.check()?;
        tool.check()?;
        if robot.dof() < 6 {
            return Err(ChainError::TooFewJoints { found: robot.dof() });
        }
        Ok(Self::unchecked(robot, tool))
    }

    /// Compiles a description that its owner has checked, of any number of
    /// joints up to [`MAX_CHAIN`]: for forward kinematics.
    pub fn unchecked(robot: &Robot, tool: &Tool) -> Self {
        let rows: Vec<_> = robot.joints.iter().map(|j| j.mdh).collect();
        Self {
            links: rows.iter().map(LinkTransform::from).collect(),
            rows,
            limits: robot.joints.iter().map(|j| j.limits).collect(),
            tcp: tool.tcp(),
        }
    }

    /// Number of joints.
    pub fn dof(&self) -> usize {
        self.links.len()
    }

    /// Joint limits, base to flange.
    pub fn limits(&self) -> &[JointLimits] {
        &self.limits
    }

    /// Rows of the modified DH table, base to flange.
    pub fn rows(&self) -> &[MdhRow<f64>] {
        &self.rows
    }

    /// Tool centre point in the flange frame, in m.
    pub fn tcp(&self) -> Vector3<f64> {
        self.tcp
    }

    /// Frames F1..Fn in F0 at `q` (rad).
    pub fn frames(&self, q: &[f64]) -> Vec<Pose<f64>> {
        let mut frames = vec![Pose::identity(); self.links.len()];
        frames_into(&self.links, q, &mut frames);
        frames
    }

    /// The TCP in F0 for frames of this chain, in m.
    pub fn tcp_of(&self, frames: &[Pose<f64>]) -> Vector3<f64> {
        frames.last().map_or(self.tcp, |flange| flange.point(&self.tcp))
    }

    /// Jacobian of the TCP at `q` (rad): rows 0-2 position (m), 3-5 rotation (rad); a column for each joint.
    pub fn tcp_jacobian(&self, q: &[f64]) -> Matrix6xX<f64> {
        let jacobian = self.jacobian(&self.posture::<MAX_CHAIN>(q), false);
        Matrix6xX::from_fn(self.dof(), |row, joint| jacobian[(row, joint)])
    }

    /// Smallest singular value of the 6 x n TCP Jacobian at `q` (m and rad).
    pub fn smallest_singular_value(&self, q: &[f64]) -> f64 {
        if self.dof() <= MAX_JOINTS {
            self.smallest_in::<MAX_JOINTS>(q)
        } else {
            self.smallest_in::<MAX_CHAIN>(q)
        }
    }

    fn smallest_in<const MOST: usize>(&self, q: &[f64]) -> f64 {
        let jacobian = self.jacobian(&self.posture::<MOST>(q), false);
        let six = jacobian.fixed_rows::<6>(0);
        (six * six.transpose()).symmetric_eigenvalues().min().max(0.0).sqrt()
    }

    /// Whether the elbow angle is a coordinate of this arm (seven joints).
    pub fn has_elbow(&self) -> bool {
        self.dof() == 7
    }

    /// TCP pose at joint angles `q` (rad), with the elbow angle where there is one.
    pub fn pose(&self, q: &[f64]) -> TcpPose {
        let posture = self.posture::<MAX_CHAIN>(q);
        TcpPose {
            position: posture.tcp,
            rotation: Rotation3::from_matrix_unchecked(posture.rotation),
            elbow: self.elbow_at(&posture),
        }
    }

    /// Distance of the nearest joint limit, in rad; negative outside.
    pub fn limit_margin(&self, q: &[f64]) -> f64 {
        q.iter()
            .zip(&self.limits)
            .map(|(q, l)| (q - l.min_rad).min(l.max_rad - q))
            .fold(f64::INFINITY, f64::min)
    }

    fn posture<const MOST: usize>(&self, q: &[f64]) -> ChainFrames<MOST> {
        let mut frames = [Pose::identity(); MOST];
        let flange = frames_into(&self.links, q, &mut frames);
        ChainFrames {
            rotation: flange.rotation,
            tcp: flange.point(&self.tcp),
            frames,
        }
    }

    /// Elbow angle in rad, for an arm of seven joints away from its degenerate places.
    fn elbow_at<const MOST: usize>(&self, posture: &ChainFrames<MOST>) -> Option<f64> {
        if !self.has_elbow() {
            return None;
        }
        elbow(posture.frames.get(..7)?).map(|e| e.angle)
    }

    /// Task Jacobian at a posture: per rad/s of each joint the TCP's velocity,
    /// the angular velocity and, with `with_elbow`, the elbow's rate.
    fn jacobian<const MOST: usize>(&self, posture: &ChainFrames<MOST>, with_elbow: bool) -> TaskJacobian<MOST> {
        let mut jacobian = TaskJacobian::zeros();
        for (i, frame) in posture.frames.iter().enumerate().take(self.dof()) {
            let z = frame.z();
            let v = z.cross(&(posture.tcp - frame.position));
            for k in 0..3 {
                jacobian[(k, i)] = v[k];
                jacobian[(k + 3, i)] = z[k];
            }
        }
        if with_elbow && let Some(row) = self.elbow_gradient(posture) {
            for (i, value) in row.into_iter().enumerate() {
                jacobian[(6, i)] = value;
            }
        }
        jacobian
    }

    /// Derivative of the elbow angle with respect to each joint angle.
    ///
    /// With S, E, W the origins of F2, F4, F6 and n the unit vector S→W, the
    /// angle is atan2(s, c), s = n·(z × (E−S)), c = (E−S)_z − n_z n·(E−S).
    fn elbow_gradient<const MOST: usize>(&self, posture: &ChainFrames<MOST>) -> Option<[f64; 7]> {
        if !self.has_elbow() {
            return None;
        }
        let [_, f2, _, f4, _, f6, ..] = posture.frames.as_slice() else {
            return None;
        };
        let (line, arm) = (f6.position - f2.position, f4.position - f2.position);
        let length = line.norm();
        let n = line / length;
        let up = Vector3::z();
        let (along, turned) = (n.dot(&arm), up.cross(&arm));
        let (s, c) = (n.dot(&turned), arm.z - n.z * along);
        let square = s * s + c * c;
        if !(length > 1e-6 && square > 1e-12) {
            return None;
        }
        // Velocity of frame m's origin with joint i: only joints below it move it.
        let velocity = |i: usize, m: usize| {
            let frame = &posture.frames[i];
            if i < m {
                frame.z().cross(&(posture.frames[m].position - frame.position))
            } else {
                Vector3::zeros()
            }
        };
        Some(core::array::from_fn(|i| {
            let shoulder = velocity(i, 1);
            let (d_line, d_arm) = (velocity(i, 5) - shoulder, velocity(i, 3) - shoulder);
            let d_n = (d_line - n * n.dot(&d_line)) / length;
            let d_s = d_n.dot(&turned) + n.dot(&up.cross(&d_arm));
            let d_c = d_arm.z - d_n.z * along - n.z * (d_n.dot(&arm) + n.dot(&d_arm));
            (c * d_s - s * d_c) / square
        }))
    }
}

/// Unit quaternion w, x, y, z of a rotation, as the host link carries it (w >= 0).
pub fn quaternion(rotation: &Rotation3<f64>) -> [f64; 4] {
    let q = UnitQuaternion::from_rotation_matrix(rotation);
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [q.w * sign, q.i * sign, q.j * sign, q.k * sign]
}

/// Rotation of a quaternion w, x, y, z.
pub fn rotation_of(q: &[f64; 4]) -> Rotation3<f64> {
    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix()
}

/// Angle wrapped into (−π, π].
pub fn wrapped(angle: f64) -> f64 {
    let turned = angle.rem_euclid(core::f64::consts::TAU);
    if turned > core::f64::consts::PI {
        turned - core::f64::consts::TAU
    } else {
        turned
    }
}

/// Rotation vector, also near half a turn and with no loss near zero.
pub fn rotation_vector(r: &Rotation3<f64>) -> Vector3<f64> {
    let m = r.matrix();
    let sine = Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]) * 0.5;
    let (s, c) = (sine.norm(), (m.trace() - 1.0) * 0.5);
    if s < 1e-9 {
        return if c > 0.0 { sine } else { r.scaled_axis() };
    }
    sine * (s.atan2(c) / s)
}

/// Angle of the rotation between two orientations, in rad (exact near zero,
/// where the arc cosine of the trace is not).
pub fn turn_between(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
    rotation_vector(&(b * a.inverse())).norm()
}

/// A robot or tool that kinematics cannot be computed with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ChainError {
    /// The robot's or the tool's description was refused.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// An arm that cannot take up any orientation at a point.
    #[error("the robot has {found} joints: turning about a sphere takes at least 6")]
    TooFewJoints {
        /// Joints of the description.
        found: usize,
    },
}
