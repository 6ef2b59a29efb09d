//! Joint commands with which a controller of the nominal robot reaches its pose with the real one.
//!
//! A calibrated table helps only a controller that can be given one. Every other controller keeps its
//! nominal table; it is given corrected joint commands. `calibrated.toml` holds all numbers
//! (`[calibration]`); this module holds the arithmetic. It allocates nothing, its loops are bounded,
//! and it cannot panic: it may run in a control cycle.
//!
//! With the load of the nominal robot `m_j` (N m: the moment that holds the arm against gravity, at
//! the origin of joint j's frame, in its axes) the model of the real robot is
//!
//! ```text
//! angle of joint j = theta_j + q_j - compliance_j m_j[z] + sum over k of (cos_jk cos(k q_j) + sin_jk sin(k q_j))
//! p = TCP of the table with these angles
//!     + sum over j of ( -bending_j[x] m_j[x] x_j - bending_j[y] m_j[y] y_j ) x (p - o_j)
//!     + ( -tilt[x] m_0[x], -tilt[y] m_0[y], 0 ) x p
//! ```
//!
//! where `x_j`, `y_j`, `o_j` are the axes and the origin of frame j in F0, `m_0` is the moment that
//! holds the base about x and y of F0, and `p` on the right is the TCP of the table. The corrected
//! command `q` solves `p(q) = p_nominal(q_nominal)` and `R(q) = R_nominal(q_nominal)`, where `R` is
//! the orientation of the flange by the table of links.

use nalgebra::{Matrix6, Vector3, Vector6};

use super::dynamics::GRAVITY_M_S2;
use super::kinematics::{LinkTransform, MdhRow, next_frame};
use super::pose::Pose;
use crate::MAX_CHAIN;

/// Most orders of encoder harmonics: as many as the identification takes.
pub const MAX_ORDERS: usize = 64;
/// Largest distance of the TCP that is left (m).
const CLOSE_M: f64 = 1e-9;
/// Largest turn of the flange that is left (rad).
const CLOSE_RAD: f64 = 1e-9;
/// Most Newton steps. Corrections are some milliradians: each step gains several digits.
const ROUNDS: usize = 20;
/// Damping of a step, as a share of the largest entry of J J'.
const DAMPING: f64 = 1e-9;
/// Largest correction of a joint (rad): more is not an error of a robot, but a singular posture.
const MOST_RAD: f64 = 0.2;

/// One joint of both models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompensatedJoint {
    /// Row of the controller's own table.
    pub nominal: MdhRow<f64>,
    /// Row of the full model's table.
    pub calibrated: MdhRow<f64>,
    /// Mass of the link (kg); the last one holds the tool.
    pub mass_kg: f64,
    /// Its centre of mass in the joint's frame (m).
    pub com_m: [f64; 3],
    /// Compliance (rad/(N m)).
    pub compliance_rad_per_nm: f64,
    /// Bending of the link about x and y of its frame (rad/(N m)).
    pub bending_rad_per_nm: [f64; 2],
    /// Cosine and sine parts of the encoder's error by order, from 1 (rad).
    pub harmonics_rad: [[f64; 2]; MAX_ORDERS],
}

/// Why there is no corrected command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CompensateError {
    /// Another number of joints.
    #[error("{found} joint angles for {joints} joints: give one each")]
    Joints {
        /// Angles that were given.
        found: usize,
        /// Joints of the model.
        joints: usize,
    },
    /// An angle that is no number.
    #[error("the angle of joint {joint} is not a finite number")]
    NotFinite {
        /// Number of the joint, from 1.
        joint: usize,
    },
    /// No solution near the command.
    #[error(
        "the calibrated robot does not reach its pose near this posture: keep away from singular postures, and from the \
         edge of the workspace"
    )]
    Unreachable,
}

/// The nominal and the calibrated robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Compensator {
    joints: heapless::Vec<CompensatedJoint, MAX_CHAIN>,
    nominal_tcp_m: Vector3<f64>,
    calibrated_tcp_m: Vector3<f64>,
    tilt_rad_per_nm: [f64; 2],
}

/// Moments that hold the nominal robot (N m): see the module.
struct Load {
    joint: [Vector3<f64>; MAX_CHAIN],
    base: Vector3<f64>,
}

impl Compensator {
    /// `joints` from base to flange (those beyond [`MAX_CHAIN`] are left out), the TCPs in the last
    /// frame of each table (m), and the tilt of the base about x and y of F0 (rad/(N m)).
    pub fn new(
        joints: &[CompensatedJoint],
        nominal_tcp_m: [f64; 3],
        calibrated_tcp_m: [f64; 3],
        tilt_rad_per_nm: [f64; 2],
    ) -> Self {
        Self {
            joints: joints.iter().copied().take(MAX_CHAIN).collect(),
            nominal_tcp_m: nominal_tcp_m.into(),
            calibrated_tcp_m: calibrated_tcp_m.into(),
            tilt_rad_per_nm,
        }
    }

    /// The joints, base to flange.
    pub fn joints(&self) -> &[CompensatedJoint] {
        &self.joints
    }

    /// TCP of the nominal robot in its last frame (m).
    pub fn nominal_tcp_m(&self) -> [f64; 3] {
        self.nominal_tcp_m.into()
    }

    /// TCP of the nominal robot in F0 (m), and the pose of its flange.
    pub fn nominal(&self, q: &[f64]) -> (Vector3<f64>, Pose<f64>) {
        let mut frame = Pose::identity();
        for (joint, q) in self.joints.iter().zip(q) {
            frame = next_frame(&frame, &LinkTransform::from(&joint.nominal), *q);
        }
        (frame.point(&self.nominal_tcp_m), frame)
    }

    /// TCP of the real robot in F0 (m) where the encoders read `q`, by the full model.
    pub fn tcp_m(&self, q: &[f64]) -> Vector3<f64> {
        self.full(q).0
    }

    /// TCP of the full model (m), frames and flange of its table at `q`.
    fn full(&self, q: &[f64]) -> (Vector3<f64>, [Pose<f64>; MAX_CHAIN], Pose<f64>) {
        let load = self.load(q);
        let mut table = [Pose::identity(); MAX_CHAIN];
        let mut deviated = [Pose::identity(); MAX_CHAIN];
        let (mut plain, mut frame) = (Pose::identity(), Pose::identity());
        for (j, (joint, q)) in self.joints.iter().zip(q).enumerate() {
            let link = LinkTransform::from(&joint.calibrated);
            let mut deviation = -joint.compliance_rad_per_nm * load.joint[j].z;
            for (order, [cosine, sine]) in (1..).zip(&joint.harmonics_rad) {
                if *cosine == 0.0 && *sine == 0.0 {
                    continue;
                }
                let angle = f64::from(order) * q;
                deviation += cosine * libm::cos(angle) + sine * libm::sin(angle);
            }
            plain = next_frame(&plain, &link, *q);
            frame = next_frame(&frame, &link, *q + deviation);
            table[j] = plain;
            deviated[j] = frame;
        }
        let rigid = frame.point(&self.calibrated_tcp_m);
        let mut tcp = rigid;
        for ((joint, frame), moment) in self.joints.iter().zip(&deviated).zip(&load.joint) {
            let [x, y] = joint.bending_rad_per_nm;
            let turn = frame.rotation.column(0) * (-x * moment.x) + frame.rotation.column(1) * (-y * moment.y);
            tcp += turn.cross(&(rigid - frame.position));
        }
        let [x, y] = self.tilt_rad_per_nm;
        tcp += Vector3::new(-x * load.base.x, -y * load.base.y, 0.0).cross(&rigid);
        (tcp, table, plain)
    }

    /// Moments that hold the nominal robot at `q`.
    fn load(&self, q: &[f64]) -> Load {
        let mut frames = [Pose::identity(); MAX_CHAIN];
        let mut frame = Pose::identity();
        for (slot, (joint, q)) in frames.iter_mut().zip(self.joints.iter().zip(q)) {
            frame = next_frame(&frame, &LinkTransform::from(&joint.nominal), *q);
            *slot = frame;
        }
        let mut load = Load {
            joint: [Vector3::zeros(); MAX_CHAIN],
            base: Vector3::zeros(),
        };
        let (mut mass, mut moment) = (0.0, Vector3::zeros());
        let frames_of_joints = self.joints.iter().zip(&frames).zip(&mut load.joint);
        for ((joint, frame), slot) in frames_of_joints.rev() {
            mass += joint.mass_kg;
            moment += frame.point(&Vector3::from(joint.com_m)) * joint.mass_kg;
            let holding = (moment - frame.position * mass).cross(&Vector3::z()) * GRAVITY_M_S2;
            *slot = frame.rotation.tr_mul(&holding);
        }
        load.base = moment.cross(&Vector3::z()) * GRAVITY_M_S2;
        load
    }

    /// Writes the command in place of `nominal` (rad, one per joint) to `command` (of the same
    /// length). An arm with more than six joints changes its posture by as little as it can.
    ///
    /// # Errors
    /// See [`CompensateError`]; `command` is then not to be used. Joint limits are the caller's.
    pub fn command(&self, nominal: &[f64], command: &mut [f64]) -> Result<(), CompensateError> {
        let joints = self.joints.len();
        for given in [nominal.len(), command.len()] {
            if given != joints {
                return Err(CompensateError::Joints { found: given, joints });
            }
        }
        if let Some(k) = nominal.iter().position(|q| !q.is_finite()) {
            return Err(CompensateError::NotFinite { joint: k + 1 });
        }
        let (wanted, flange) = self.nominal(nominal);
        command.copy_from_slice(nominal);
        for _ in 0..ROUNDS {
            let (tcp, frames, reached) = self.full(command);
            let off = wanted - tcp;
            let turn = rotation_vector(&(flange.rotation * reached.rotation.transpose()));
            if off.norm() < CLOSE_M && turn.norm() < CLOSE_RAD {
                return Ok(());
            }
            // Least motion of the joints that takes both out: J' (J J' + damping)^-1.
            let arms = frames.iter().take(joints);
            let mut square = Matrix6::zeros();
            let mut columns = [Vector6::zeros(); MAX_CHAIN];
            for (slot, frame) in columns.iter_mut().zip(arms) {
                let z: Vector3<f64> = frame.rotation.column(2).into();
                let v = z.cross(&(tcp - frame.position));
                *slot = Vector6::new(v.x, v.y, v.z, z.x, z.y, z.z);
                square += *slot * slot.transpose();
            }
            let damping = DAMPING * square.diagonal().max();
            for k in 0..6 {
                square[(k, k)] += damping;
            }
            let error = Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z);
            let Some(factor) = square.cholesky() else { break };
            let weighted = factor.solve(&error);
            for ((angle, first), column) in command.iter_mut().zip(nominal).zip(&columns) {
                *angle += column.dot(&weighted);
                // Not a number fails the comparison, too.
                if !((*angle - first).abs() <= MOST_RAD) {
                    return Err(CompensateError::Unreachable);
                }
            }
        }
        Err(CompensateError::Unreachable)
    }
}

/// Rotation vector of a small rotation, by its antisymmetric part: exact at zero, and enough to
/// converge.
fn rotation_vector(r: &nalgebra::Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Robot, iiwa7, iiwa7_tool};

    /// The same robot with links of other lengths and with effects.
    fn compensator(robot: &Robot) -> Compensator {
        let joint = |(j, joint): (usize, &crate::robot::Joint)| {
            let mut calibrated = joint.mdh;
            calibrated.a += 3e-4;
            calibrated.theta += 1e-3 * (j as f64 - 2.0);
            calibrated.alpha -= 4e-4;
            let mut harmonics_rad = [[0.0; 2]; MAX_ORDERS];
            harmonics_rad[0] = [2e-4, -1e-4];
            harmonics_rad[1] = [1e-4, 5e-5];
            CompensatedJoint {
                nominal: joint.mdh,
                calibrated,
                mass_kg: joint.link.mass_kg,
                com_m: joint.link.com_m,
                compliance_rad_per_nm: 2e-5,
                bending_rad_per_nm: [2e-6, -1e-6],
                harmonics_rad,
            }
        };
        let joints: heapless::Vec<_, MAX_CHAIN> = robot.joints.iter().enumerate().map(joint).collect();
        Compensator::new(&joints, iiwa7_tool().tcp_m, [0.051, -0.0004, 0.1003], [1e-6, 2e-6])
    }

    const POSTURES: [[f64; 7]; 3] = [
        [0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1],
        [-1.5, 1.2, 0.8, 1.0, -0.7, -1.1, 2.0],
        [2.0, -0.9, 1.4, -1.7, 1.9, 1.3, -2.4],
    ];

    // Fails if the full model does not stand where the controller's own model wants it, or if a
    // correction is larger than the errors of the robot explain.
    #[test]
    fn the_corrected_command_reaches_the_nominal_pose() {
        let compensator = compensator(&iiwa7());
        for nominal in POSTURES {
            let mut command = [0.0; 7];
            compensator.command(&nominal, &mut command).unwrap();
            let (wanted, flange) = compensator.nominal(&nominal);
            assert!((compensator.tcp_m(&nominal) - wanted).norm() > 3e-4);
            assert!((compensator.tcp_m(&command) - wanted).norm() < CLOSE_M);
            let reached = compensator.full(&command).2;
            assert!((reached.rotation - flange.rotation).norm() < 1e-8);
            assert!(command.iter().zip(&nominal).all(|(a, b)| (a - b).abs() < 0.03));
        }
    }

    // Fails if angles that cannot be used are not refused, or if a singular posture gives a command.
    #[test]
    fn bad_angles_and_singular_postures_are_refused() {
        let compensator = compensator(&iiwa7());
        let mut command = [0.0; 7];
        assert_eq!(
            compensator.command(&[0.0; 6], &mut command),
            Err(CompensateError::Joints { found: 6, joints: 7 })
        );
        let mut angles = POSTURES[0];
        angles[4] = f64::NAN;
        assert_eq!(
            compensator.command(&angles, &mut command),
            Err(CompensateError::NotFinite { joint: 5 })
        );
        // Stretched out: the real robot, which is shorter here, does not reach so far.
        let stretched = [0.2, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(
            compensator.command(&stretched, &mut command),
            Err(CompensateError::Unreachable)
        );
    }
}
