//! A robot with its tool, compiled for a number of joints and a scalar.
//!
//! [`Arm`] precomputes everything that does not depend on the joint angles. It
//! stands between the description ([`Robot`], [`Tool`]) and all computation.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::describe::{Robot, RobotError, Tool};
use super::kinematics::{LinkTransform, MdhRow, ParameterColumns, frames_into, parameter_columns};
use super::pose::Pose;
use crate::scalar::{Real, lit};

/// Constants of one body in its own frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body<T: Real> {
    pub(super) mass: T,
    pub(super) com: Vector3<T>,
    /// Inertia about the centre of mass.
    pub(super) inertia: Matrix3<T>,
}

/// A robot of `N` revolute joints with its tool, ready to compute with.
///
/// The tool's mass is part of the last link. Gravity points along −z of F0.
#[derive(Clone, Debug)]
pub struct Arm<T: Real, const N: usize> {
    pub(super) rows: [MdhRow<T>; N],
    pub(super) links: [LinkTransform<T>; N],
    pub(super) bodies: [Body<T>; N],
    pub(super) rotor: [T; N],
    pub(super) tcp: Vector3<T>,
}

impl<T: Real, const N: usize> Arm<T, N> {
    /// Compiles a description.
    ///
    /// # Errors
    /// As [`Robot::check`] and [`Tool::check`]; also if the robot does not have `N`
    /// joints.
    pub fn new<const MOST: usize>(robot: &Robot<MOST>, tool: &Tool) -> Result<Self, RobotError> {
        robot.check()?;
        tool.check()?;
        if robot.dof() != N {
            return Err(RobotError::JointCount {
                found: robot.dof(),
                expected: N,
            });
        }
        let zero = T::zero();
        let nothing = Body {
            mass: zero,
            com: Vector3::zeros(),
            inertia: Matrix3::zeros(),
        };
        let mut arm = Self {
            rows: [MdhRow {
                alpha: zero,
                a: zero,
                beta: zero,
                theta: zero,
                d: zero,
            }; N],
            links: [LinkTransform {
                fixed: Matrix3::identity(),
                origin: Vector3::zeros(),
                theta: zero,
            }; N],
            bodies: [nothing; N],
            rotor: [zero; N],
            tcp: tool.tcp().map(lit),
        };
        for (i, joint) in robot.joints.iter().enumerate().take(N) {
            let m = &joint.mdh;
            let row = MdhRow {
                alpha: lit(m.alpha),
                a: lit(m.a),
                beta: lit(m.beta),
                theta: lit(m.theta),
                d: lit(m.d),
            };
            let body = if i + 1 == N {
                joint.link.combined(&tool.body)
            } else {
                joint.link
            };
            arm.rows[i] = row;
            arm.links[i] = LinkTransform::from(&row);
            arm.bodies[i] = Body {
                mass: lit(body.mass_kg),
                com: body.com().map(lit),
                inertia: body.matrix().map(lit),
            };
            arm.rotor[i] = lit(joint.rotor_kg_m2);
        }
        Ok(arm)
    }

    /// The modified DH table.
    pub fn rows(&self) -> &[MdhRow<T>; N] {
        &self.rows
    }

    /// Reflected rotor inertias, in kg m².
    pub fn rotor(&self) -> &[T; N] {
        &self.rotor
    }

    /// Poses of frames F1..Fn in F0 at joint angles `q` (rad).
    #[inline]
    pub fn frames(&self, q: &[T; N]) -> [Pose<T>; N] {
        let mut frames = [Pose::identity(); N];
        frames_into(&self.links, q, &mut frames);
        frames
    }

    /// Pose of the TCP frame FT in F0: the axes of the flange, the origin at the TCP.
    #[inline]
    pub fn tcp_frame(&self, frames: &[Pose<T>; N]) -> Pose<T> {
        let flange = frames.last().copied().unwrap_or_else(Pose::identity);
        Pose {
            rotation: flange.rotation,
            position: flange.point(&self.tcp),
        }
    }

    /// Geometric Jacobian at point `p` (m, F0), one column per joint. Rows 0 to 2
    /// are the linear velocity, rows 3 to 5 the angular velocity, in F0 and per
    /// rad/s.
    #[inline]
    pub fn jacobian(&self, frames: &[Pose<T>; N], p: &Vector3<T>) -> SMatrix<T, 6, N> {
        let mut jacobian = SMatrix::<T, 6, N>::zeros();
        for i in 0..N {
            let z = frames[i].z();
            let v = z.cross(&(p - frames[i].position));
            for k in 0..3 {
                jacobian[(k, i)] = v[k];
                jacobian[(k + 3, i)] = z[k];
            }
        }
        jacobian
    }

    /// Derivatives of the position of `p` with respect to the parameters of every
    /// row (Equation 6 of the paper). `p` is given in F0, in m, and fixed in the
    /// last frame.
    pub fn parameter_jacobian(&self, frames: &[Pose<T>; N], p: &Vector3<T>) -> [ParameterColumns<T>; N] {
        let mut parent = Pose::identity();
        core::array::from_fn(|i| {
            let columns = parameter_columns(&parent, &frames[i], &self.rows[i], p);
            parent = frames[i];
            columns
        })
    }
}
