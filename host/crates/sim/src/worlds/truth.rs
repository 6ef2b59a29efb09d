//! One robot with all its errors: where the TCP really is.
//!
//! A joint stands at `q + theta + e(q)`, with `q` what its encoder says and
//!
//! `e = Σ_k (A_k cos kq + B_k sin kq) + smooth(q) + cross(q_i, q_j)
//!      − c g − c₂ g|g| − h tanh(g / 0.5 N m) + white`
//!
//! where `g` is the torque that holds the joint against gravity: the load sags.
//! Links bend and the base tilts in proportion to the other moments.

use nalgebra::{Matrix3, Rotation3, Vector3};
use spherecal_shared::robot::kinematics::next_frame;
use spherecal_shared::robot::{GRAVITY_M_S2, LinkTransform, Pose, Robot, Tool};

/// Torque over which hysteresis changes sides, in N m.
const HYSTERESIS_NM: f64 = 0.5;

/// A cosine wave of a joint angle: amplitude (rad), order, phase (rad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// Amplitude, in rad.
    pub amplitude: f64,
    /// Waves per rad of the joint itself.
    pub order: f64,
    /// Waves per rad of the other joint (cross terms; else 0).
    pub other_order: f64,
    /// Phase, in rad.
    pub phase: f64,
}

/// Errors of one joint that no geometric model has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointErrors {
    /// Compliance, in rad/(N m).
    pub compliance: f64,
    /// Quadratic compliance, in rad/(N m)².
    pub quadratic: f64,
    /// Half width of the torque hysteresis, in rad.
    pub hysteresis: f64,
    /// Harmonics, ripple and smooth random functions of the joint.
    pub waves: Vec<Wave>,
    /// Functions of this joint and another.
    pub cross: Vec<Wave>,
    /// The other joint of [`Self::cross`], from 0.
    pub other: usize,
    /// Bending of the link about x and y of the joint's frame, in rad/(N m).
    pub bending: [f64; 2],
}

/// A robot with all its errors.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The true robot (geometry; masses as nominal).
    pub robot: Robot,
    /// The true tool.
    pub tool: Tool,
    /// F0 in the tracker frame.
    pub base: Pose,
    /// Plate in F0.
    pub plate: Pose,
    /// Centres of the spheres in the plate's frame, in m, by index.
    pub spheres_m: Vec<[f64; 3]>,
    /// Ids of the spheres.
    pub sphere_ids: Vec<u32>,
    /// Joint errors, base to flange.
    pub joints: Vec<JointErrors>,
    /// Tilt of the base under its load about x and y of F0, in rad/(N m).
    pub tilt: [f64; 2],
    /// White error of every joint at every pose (1 sigma), in rad.
    pub white_rad: f64,
    /// Factor that the drawn geometric errors were rescaled by.
    pub geometry_scale: f64,
}

/// Moments that hold an arm against gravity.
struct Holding {
    /// In each joint's frame, in N m; z is the joint's torque.
    joint: Vec<Vector3<f64>>,
    /// At the origin of F0, in N m.
    base: Vector3<f64>,
}

impl Truth {
    fn links(&self) -> Vec<LinkTransform<f64>> {
        self.robot.joints.iter().map(|j| LinkTransform::from(&j.mdh)).collect()
    }

    /// The evaluator of this truth: what is constant computed once.
    pub fn evaluator(&self) -> Evaluator<'_> {
        let last = self.robot.dof().saturating_sub(1);
        let bodies = self.robot.joints.iter().enumerate().map(|(i, joint)| {
            let body = if i == last {
                joint.link.combined(&self.tool.body)
            } else {
                joint.link
            };
            (body.mass_kg, body.com())
        });
        Evaluator {
            truth: self,
            links: self.links(),
            bodies: bodies.collect(),
        }
    }
}

/// Evaluates a truth.
pub struct Evaluator<'a> {
    truth: &'a Truth,
    links: Vec<LinkTransform<f64>>,
    bodies: Vec<(f64, Vector3<f64>)>,
}

impl Evaluator<'_> {
    /// Moments that hold the arm, from the frames of undeflected links at `q`.
    fn holding(&self, q: &[f64]) -> Holding {
        let mut frames = Vec::with_capacity(q.len());
        let mut frame = Pose::identity();
        for (link, angle) in self.links.iter().zip(q) {
            frame = next_frame(&frame, link, *angle);
            frames.push(frame);
        }
        let mut joint = vec![Vector3::zeros(); frames.len()];
        let (mut mass, mut first) = (0.0, Vector3::zeros());
        for i in (0..frames.len()).rev() {
            let (m, com) = &self.bodies[i];
            mass += m;
            first += frames[i].point(com) * *m;
            let holding = (first - frames[i].position * mass).cross(&Vector3::z()) * GRAVITY_M_S2;
            joint[i] = frames[i].rotation.tr_mul(&holding);
        }
        Holding {
            joint,
            base: first.cross(&Vector3::z()) * GRAVITY_M_S2,
        }
    }

    /// Errors of all joints at encoder angles `q` under `holding`, white noise aside.
    fn errors(&self, q: &[f64], holding: &Holding) -> Vec<f64> {
        let each = self.truth.joints.iter().enumerate().map(|(i, joint)| {
            let angle = q[i];
            let own: f64 = joint
                .waves
                .iter()
                .map(|w| w.amplitude * (w.order * angle + w.phase).cos())
                .sum();
            let other = q[joint.other.min(q.len() - 1)];
            let both: f64 = joint
                .cross
                .iter()
                .map(|w| w.amplitude * (w.order * angle + w.other_order * other + w.phase).cos())
                .sum();
            let g = holding.joint[i].z;
            own + both - joint.compliance * g - joint.quadratic * g * g.abs()
                + joint.hysteresis * (g / HYSTERESIS_NM).tanh()
        });
        each.collect()
    }

    /// TCP in F0 (m) at encoder angles `q` with white joint errors `white` (rad),
    /// and the frames of the joints there.
    pub fn tcp_and_frames(&self, q: &[f64], white: &[f64]) -> (Vector3<f64>, Vec<Pose<f64>>) {
        let holding = self.holding(q);
        let errors = self.errors(q, &holding);
        let [x, y] = self.truth.tilt;
        let tilt = Vector3::new(-x * holding.base.x, -y * holding.base.y, 0.0);
        let mut frame = Pose {
            rotation: *Rotation3::new(tilt).matrix(),
            position: Vector3::zeros(),
        };
        let mut frames = Vec::with_capacity(q.len());
        for (i, link) in self.links.iter().enumerate() {
            frame = next_frame(&frame, link, q[i] + errors[i] + white.get(i).copied().unwrap_or(0.0));
            let [x, y] = self.truth.joints[i].bending;
            if x != 0.0 || y != 0.0 {
                let m = &holding.joint[i];
                frame.rotation *= Rotation3::new(Vector3::new(-x * m.x, -y * m.y, 0.0)).matrix();
            }
            frames.push(frame);
        }
        (frame.point(&self.truth.tool.tcp()), frames)
    }

    /// TCP in F0 (m) at encoder angles `q` with white joint errors `white` (rad).
    pub fn tcp(&self, q: &[f64], white: &[f64]) -> Vector3<f64> {
        self.tcp_and_frames(q, white).0
    }

    /// Encoder angles near `q` (rad) at which the TCP is at `target` (m, F0):
    /// the smallest change of the joints. `None` where that does not converge.
    pub fn reach(&self, q: &[f64], target: &Vector3<f64>, white: &[f64]) -> Option<Vec<f64>> {
        let mut q = q.to_vec();
        for _ in 0..12 {
            let (tcp, frames) = self.tcp_and_frames(&q, white);
            let miss = target - tcp;
            if miss.norm() < 1e-11 {
                return Some(q);
            }
            let columns: Vec<Vector3<f64>> = frames.iter().map(|f| f.z().cross(&(tcp - f.position))).collect();
            let square = columns.iter().fold(Matrix3::zeros(), |s, c| s + c * c.transpose());
            let pull = square.try_inverse()? * miss;
            for (angle, column) in q.iter_mut().zip(&columns) {
                *angle += column.dot(&pull);
            }
        }
        None
    }
}
