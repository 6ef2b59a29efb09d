//! Forward kinematics and Jacobians in Craig's modified DH convention.
//!
//! Equation 4 of the paper, with Hayati's rotation `beta`:
//!
//! `T_i = Rx(alpha_{i-1}) Tx(a_{i-1}) Ry(beta_{i-1}) Rz(theta_i + q_i) Tz(d_i)`
//!
//! `beta` is for a joint whose axis is nearly parallel to the axis before: there
//! `d` cannot be told from the `d` of the neighbouring row, and `beta` takes its
//! place. With `beta = 0` this is exactly Equation 4. The functions work on slices
//! and loop over the shortest one, so they serve any number of joints and never
//! index out of bounds.

use nalgebra::{Matrix3, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::pose::Pose;
use crate::scalar::Real;

/// One row of the modified DH table: the transform from frame i-1 to frame i.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct MdhRow<T> {
    /// Twist about x_{i-1}, in rad.
    pub alpha: T,
    /// Length along x_{i-1}, in m.
    pub a: T,
    /// Hayati's rotation about y after the twist, in rad; 0 in plain MDH.
    #[serde(default)]
    pub beta: T,
    /// Offset added to the joint angle, about z_i, in rad.
    pub theta: T,
    /// Offset along z_i, in m.
    pub d: T,
}

/// The constant part of one row, precomputed: `R_i = fixed · Rz(theta + q)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkTransform<T: Real> {
    /// `Rx(alpha) Ry(beta)`.
    pub fixed: Matrix3<T>,
    /// Origin of frame i in frame i-1, in m. It does not depend on the joint angle.
    pub origin: Vector3<T>,
    /// Offset added to the joint angle, in rad.
    pub theta: T,
}

impl<T: Real> From<&MdhRow<T>> for LinkTransform<T> {
    fn from(row: &MdhRow<T>) -> Self {
        let (sa, ca) = row.alpha.sin_cos_of();
        let (sb, cb) = row.beta.sin_cos_of();
        let zero = T::zero();
        #[rustfmt::skip]
        let fixed = Matrix3::new(
            cb,       zero, sb,
            sa * sb,  ca,   -sa * cb,
            -ca * sb, sa,   ca * cb,
        );
        let z = fixed.column(2);
        let origin = Vector3::new(row.a + z[0] * row.d, z[1] * row.d, z[2] * row.d);
        Self {
            fixed,
            origin,
            theta: row.theta,
        }
    }
}

/// Pose of the next frame of the chain in F0: `parent · T_i(q)`.
#[inline]
pub fn next_frame<T: Real>(parent: &Pose<T>, link: &LinkTransform<T>, q: T) -> Pose<T> {
    next_frame_turned(parent, link, (link.theta + q).sin_cos_of())
}

/// As [`next_frame`], from sine and cosine of the whole joint angle `theta + q`.
#[inline]
pub fn next_frame_turned<T: Real>(parent: &Pose<T>, link: &LinkTransform<T>, (s, c): (T, T)) -> Pose<T> {
    let r = parent.rotation * link.fixed;
    let (x, y) = (r.column(0), r.column(1));
    let rotation = Matrix3::from_columns(&[x * c + y * s, y * c - x * s, r.column(2).into()]);
    Pose {
        rotation,
        position: parent.rotation * link.origin + parent.position,
    }
}

/// Writes the poses of frames F1..Fn in F0 to `out` and returns the last one, the
/// flange. `links`, `q` and `out` have n items each; the shortest one counts.
#[inline]
pub fn frames_into<T: Real>(links: &[LinkTransform<T>], q: &[T], out: &mut [Pose<T>]) -> Pose<T> {
    let mut frame = Pose::identity();
    for ((link, q), slot) in links.iter().zip(q).zip(out) {
        frame = next_frame(&frame, link, *q);
        *slot = frame;
    }
    frame
}

/// Derivatives of a point's position with respect to one row's parameters, in F0,
/// in m per rad or m per m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterColumns<T: Real> {
    /// `∂P/∂alpha_{i-1} = x_{i-1} × (P − O_{i-1})`.
    pub alpha: Vector3<T>,
    /// `∂P/∂a_{i-1} = x_{i-1}`.
    pub a: Vector3<T>,
    /// `∂P/∂theta_i = z_i × (P − O_i)`; also the column of the joint Jacobian.
    pub theta: Vector3<T>,
    /// `∂P/∂d_i = z_i`.
    pub d: Vector3<T>,
    /// `∂P/∂beta_{i-1}`: rotation about y after the twist, through the end of `a`.
    pub beta: Vector3<T>,
}

/// Derivatives of a point's position with respect to the parameters of row i
/// (Equation 6 of the paper).
///
/// `parent` and `frame` are the poses of F(i-1) and Fi in F0. `row` is row i of the
/// table. `p` is the point in F0; it is fixed in the last frame.
#[inline]
pub fn parameter_columns<T: Real>(
    parent: &Pose<T>,
    frame: &Pose<T>,
    row: &MdhRow<T>,
    p: &Vector3<T>,
) -> ParameterColumns<T> {
    let x: Vector3<T> = parent.rotation.column(0).into();
    let z = frame.z();
    let foot = parent.position + x * row.a;
    let (sa, ca) = row.alpha.sin_cos_of();
    let y: Vector3<T> = parent.rotation.column(1) * ca + parent.rotation.column(2) * sa;
    ParameterColumns {
        alpha: x.cross(&(p - parent.position)),
        a: x,
        theta: z.cross(&(p - frame.position)),
        d: z,
        beta: y.cross(&(p - foot)),
    }
}
