//! The robot's own motion generators: what a command asks of the joints.
//!
//! A Cartesian command is turned into joint angles by the nearest solution of the nominal kinematics. The elbow that a
//! command may ask for is not followed.

use nalgebra::{SMatrix, SVector};

use super::kinematics::{flange, inverted, product};
use super::limits::ArmLimits;
use crate::wire::{ErrorFlag, IDENTITY, MoveGeneratorMode, RobotCommand};
use crate::{JOINTS, PERIOD_S};

/// How far the first command may be from where the arm stands, rad and m.
const START: f64 = 1e-3;
/// Step of the numeric derivative, rad: the middle between rounding and curvature.
const STEP: f64 = 1e-6;
/// Newton steps to the nearest solution: each doubles the digits, and the goal of a period is a millimetre away.
const NEWTON: usize = 4;
/// Damping of a step: it matters only where the arm is singular.
const DAMPING: f64 = 1e-9;

/// What the motion generator wants of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Desired {
    /// Positions, rad.
    pub(super) q: [f64; JOINTS],
    /// Velocities, rad/s.
    pub(super) dq: [f64; JOINTS],
    /// Accelerations, rad/s^2.
    pub(super) ddq: [f64; JOINTS],
}

impl Desired {
    pub(super) fn at_rest(q: [f64; JOINTS]) -> Self {
        let [dq, ddq] = [[0.0; JOINTS]; 2];
        Self { q, dq, ddq }
    }

    /// What comes a period after this if no command says otherwise: the velocity stays.
    pub(super) fn extrapolated(&self) -> Self {
        Self {
            q: std::array::from_fn(|j| self.q[j] + PERIOD_S * self.dq[j]),
            dq: self.dq,
            ddq: [0.0; JOINTS],
        }
    }

    /// What a command wants, a period after this. `ee` is the end effector in the flange frame; `first`: the motion begins.
    /// Errors: the error that a robot stops with.
    pub(super) fn next(
        &self,
        generator: MoveGeneratorMode,
        command: &RobotCommand,
        ee: &[f64; 16],
        limits: &ArmLimits,
        first: bool,
    ) -> Result<Self, ErrorFlag> {
        use ErrorFlag as E;
        use MoveGeneratorMode as G;
        let q = match generator {
            G::None => return Ok(*self),
            G::JointPosition => command.q_c,
            G::JointVelocity => std::array::from_fn(|j| self.q[j] + PERIOD_S * command.dq_c[j]),
            G::CartesianPosition => {
                let goal = product(&command.O_T_EE_c, &inverted(ee));
                if first && distance(&flange(&self.q), &goal).amax() > START {
                    return Err(E::CartesianPositionMotionGeneratorStartPoseInvalid);
                }
                solved(&goal, self.q)
            }
            G::CartesianVelocity => moved(&command.O_dP_EE_c, ee, self.q),
        };
        if first && generator == G::JointPosition && (0..JOINTS).any(|j| (q[j] - self.q[j]).abs() > START) {
            return Err(E::JointPositionMotionGeneratorStartPoseInvalid);
        }
        let dq: [f64; JOINTS] = std::array::from_fn(|j| (q[j] - self.q[j]) / PERIOD_S);
        let ddq = std::array::from_fn(|j| (dq[j] - self.dq[j]) / PERIOD_S);
        let joints = matches!(generator, G::JointPosition | G::JointVelocity);
        let error = |of_joints, of_cartesian| Err(if joints { of_joints } else { of_cartesian });
        for joint in 0..JOINTS {
            let jerk = (ddq[joint] - self.ddq[joint]) / PERIOD_S;
            let (slowest, fastest) = limits.velocity_at(joint, q[joint]);
            if !(limits.lower[joint] <= q[joint] && q[joint] <= limits.upper[joint]) {
                return error(
                    E::JointMotionGeneratorPositionLimitsViolation,
                    E::CartesianMotionGeneratorJointPositionLimitsViolation,
                );
            }
            if !(slowest <= dq[joint] && dq[joint] <= fastest) {
                return error(
                    E::JointMotionGeneratorVelocityLimitsViolation,
                    E::CartesianMotionGeneratorJointVelocityLimitsViolation,
                );
            }
            if ddq[joint].abs() > limits.acceleration[joint] {
                return error(
                    E::JointMotionGeneratorVelocityDiscontinuity,
                    E::CartesianMotionGeneratorJointVelocityDiscontinuity,
                );
            }
            if jerk.abs() > limits.jerk[joint] {
                return error(
                    E::JointMotionGeneratorAccelerationDiscontinuity,
                    E::CartesianMotionGeneratorJointAccelerationDiscontinuity,
                );
            }
        }
        Ok(Self { q, dq, ddq })
    }
}

/// From one pose to another: translation (m) and rotation vector (rad), both small, in the base frame.
fn distance(from: &[f64; 16], to: &[f64; 16]) -> SVector<f64, 6> {
    let turn = product(to, &inverted(from));
    SVector::from([
        to[12] - from[12],
        to[13] - from[13],
        to[14] - from[14],
        0.5 * (turn[6] - turn[9]),
        0.5 * (turn[8] - turn[2]),
        0.5 * (turn[1] - turn[4]),
    ])
}

/// The derivative of the pose of a frame at the flange by the joints.
fn jacobian(ee: &[f64; 16], q: &[f64; JOINTS]) -> SMatrix<f64, 6, JOINTS> {
    let pose = |q: &[f64; JOINTS]| product(&flange(q), ee);
    let here = pose(q);
    let mut out = SMatrix::<f64, 6, JOINTS>::zeros();
    for joint in 0..JOINTS {
        let mut there = *q;
        there[joint] += STEP;
        out.set_column(joint, &(distance(&here, &pose(&there)) / STEP));
    }
    out
}

/// The smallest motion of the joints that moves the frame by this.
fn least(jacobian: &SMatrix<f64, 6, JOINTS>, by: &SVector<f64, 6>) -> SVector<f64, JOINTS> {
    let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * DAMPING;
    // It is positive definite by its damping.
    square
        .cholesky()
        .map_or_else(SVector::zeros, |c| jacobian.transpose() * c.solve(by))
}

/// The joint angles near `q` that bring the flange to this pose.
fn solved(goal: &[f64; 16], q: [f64; JOINTS]) -> [f64; JOINTS] {
    let mut q = SVector::from(q);
    for _ in 0..NEWTON {
        let here: [f64; JOINTS] = q.into();
        q += least(&jacobian(&IDENTITY, &here), &distance(&flange(&here), goal));
    }
    q.into()
}

/// The joint angles a period later if the end effector moves with this twist, m/s and rad/s in the base frame.
fn moved(twist: &[f64; 6], ee: &[f64; 16], q: [f64; JOINTS]) -> [f64; JOINTS] {
    let by = SVector::from(*twist) * PERIOD_S;
    (SVector::from(q) + least(&jacobian(ee, &q), &by)).into()
}

#[cfg(test)]
mod tests {
    use super::super::READY;
    use super::*;

    fn command(change: impl FnOnce(&mut RobotCommand)) -> RobotCommand {
        let mut command = RobotCommand::torque(1, [0.0; JOINTS]);
        change(&mut command);
        command
    }

    // Fails if joint angles for a pose do not reach it, or are not the nearest ones.
    #[test]
    fn a_pose_is_reached() {
        let mut goal = flange(&READY);
        goal[12] += 2e-4;
        goal[14] -= 1e-4;
        let q = solved(&goal, READY);
        assert!(distance(&flange(&q), &goal).amax() < 1e-12);
        assert!((0..JOINTS).all(|j| (q[j] - READY[j]).abs() < 2e-3), "{q:?}");
    }

    // Fails if a twist moves the end effector otherwise than it says.
    #[test]
    fn a_twist_moves_the_end_effector() {
        let mut ee = IDENTITY;
        ee[14] = 0.1;
        let twist = [0.1, 0.0, -0.05, 0.0, 0.2, 0.0];
        let pose = |q: &[f64; JOINTS]| product(&flange(q), &ee);
        let by = distance(&pose(&READY), &pose(&moved(&twist, &ee, READY)));
        for (by, twist) in by.iter().zip(twist) {
            assert!((by - PERIOD_S * twist).abs() < 1e-7, "{by} {twist}");
        }
    }

    // Fails if a command that a robot refuses passes, or its error has another name.
    #[test]
    fn impossible_commands_have_their_errors() {
        use ErrorFlag as E;
        use MoveGeneratorMode as G;
        let limits = &ArmLimits::FR3;
        let rest = Desired::at_rest(READY);
        let next = |generator, first, change: &dyn Fn(&mut RobotCommand)| {
            let command = command(change);
            rest.next(generator, &command, &IDENTITY, limits, first).err()
        };
        let at = |by: f64| {
            move |c: &mut RobotCommand| {
                c.q_c = READY;
                c.q_c[2] += by;
            }
        };
        assert_eq!(next(G::JointPosition, true, &at(0.0)), None);
        let start = Some(E::JointPositionMotionGeneratorStartPoseInvalid);
        assert_eq!(next(G::JointPosition, true, &at(2e-3)), start);
        let fast = Some(E::JointMotionGeneratorVelocityLimitsViolation);
        assert_eq!(next(G::JointPosition, false, &at(3e-3)), fast);
        let jump = Some(E::JointMotionGeneratorVelocityDiscontinuity);
        assert_eq!(next(G::JointPosition, false, &at(5e-4)), jump);
        let jerk = Some(E::JointMotionGeneratorAccelerationDiscontinuity);
        assert_eq!(next(G::JointPosition, false, &at(8e-6)), jerk);
        let velocity = |c: &mut RobotCommand| c.dq_c[0] = 0.5;
        assert_eq!(next(G::JointVelocity, false, &velocity), jump);
        let pose = |c: &mut RobotCommand| {
            c.O_T_EE_c = flange(&READY);
            c.O_T_EE_c[13] += 5e-3;
        };
        let start = Some(E::CartesianPositionMotionGeneratorStartPoseInvalid);
        assert_eq!(next(G::CartesianPosition, true, &pose), start);
        let twist = |c: &mut RobotCommand| c.O_dP_EE_c[1] = 0.5;
        let jump = Some(E::CartesianMotionGeneratorJointVelocityDiscontinuity);
        assert_eq!(next(G::CartesianVelocity, false, &twist), jump);
    }
}
