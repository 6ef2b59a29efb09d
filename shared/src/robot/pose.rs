//! The one rigid transform of the project: rotation and position.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use crate::scalar::Real;

/// Largest deviation of a stored rotation matrix from orthonormal rows.
const ORTHONORMAL: f64 = 1e-6;

/// Pose of a frame B in a frame A, `X_AB`: rotation and position.
///
/// `X_AB.point(p_B)` is the point `p_B` in frame A, and `X_AB.compose(X_BC)` is
/// `X_AC`. The frames in the robot's kinematics are poses in the base frame F0.
///
/// In a file it has the fields `rotation` (three rows, no unit) and `position`
/// (three numbers, in m). Reading refuses a matrix that is not a rotation.
///
/// ```
/// use nalgebra::{Matrix3, Vector3};
/// use spherecal_shared::robot::Pose;
///
/// // B is turned by 90 degrees about z and lies 1 m along x of A.
/// let quarter = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
/// let pose = Pose::new(quarter, Vector3::new(1.0, 0.0, 0.0));
/// assert_eq!(pose.point(&Vector3::new(2.0, 0.0, 0.0)), Vector3::new(1.0, 2.0, 0.0));
/// assert_eq!(pose.compose(&pose.inverse()), Pose::identity());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(try_from = "Fields<T>", into = "Fields<T>")]
#[cfg_attr(feature = "schema", schemars(bound = "T: Real + schemars::JsonSchema"))]
#[serde(bound(serialize = "T: Real + Serialize", deserialize = "T: Real + Deserialize<'de>"))]
pub struct Pose<T: Real = f64> {
    /// Rotation: its columns are the axes of frame B in frame A.
    #[cfg_attr(feature = "schema", schemars(with = "[[f64; 3]; 3]"))]
    pub rotation: Matrix3<T>,
    /// Origin of frame B in frame A, in m.
    #[cfg_attr(feature = "schema", schemars(with = "[f64; 3]"))]
    pub position: Vector3<T>,
}

/// Why a stored pose was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// A number is NaN or infinite.
    #[error("position or rotation has a number that is not finite: give finite numbers")]
    NotFinite,
    /// The rows of the matrix are not orthonormal, or it is a reflection.
    #[error("rotation is not a rotation matrix: its rows must be orthonormal to 1e-6, with determinant +1")]
    NotARotation,
}

impl<T: Real> Pose<T> {
    /// The pose with the given rotation and position (m).
    #[inline]
    pub fn new(rotation: Matrix3<T>, position: Vector3<T>) -> Self {
        Self { rotation, position }
    }

    /// The pose of a frame in itself.
    pub fn identity() -> Self {
        Self {
            rotation: Matrix3::identity(),
            position: Vector3::zeros(),
        }
    }

    /// `X_AC` from this pose `X_AB` and `inner`, `X_BC`.
    #[inline]
    pub fn compose(&self, inner: &Self) -> Self {
        Self {
            rotation: self.rotation * inner.rotation,
            position: self.point(&inner.position),
        }
    }

    /// `X_BA`: the pose of frame A in frame B.
    #[inline]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            position: -(rotation * self.position),
        }
    }

    /// The point `p`, given in frame B, in frame A.
    #[inline]
    pub fn point(&self, p: &Vector3<T>) -> Vector3<T> {
        self.rotation * p + self.position
    }

    /// The point `p`, given in frame A, in frame B.
    #[inline]
    pub fn inverse_point(&self, p: &Vector3<T>) -> Vector3<T> {
        self.rotation.tr_mul(&(p - self.position))
    }

    /// Rotation vector of the rotation, in rad.
    pub fn rotation_vector(&self) -> Vector3<T> {
        Rotation3::from_matrix_unchecked(self.rotation).scaled_axis()
    }

    /// The z axis of frame B in frame A; for a joint's frame the joint axis.
    #[inline]
    pub fn z(&self) -> Vector3<T> {
        self.rotation.column(2).into()
    }
}

impl<T: Real> Default for Pose<T> {
    fn default() -> Self {
        Self::identity()
    }
}

/// A pose as files have it.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
struct Fields<T> {
    rotation: [[T; 3]; 3],
    position: [T; 3],
}

impl<T: Real> From<Pose<T>> for Fields<T> {
    fn from(pose: Pose<T>) -> Self {
        Self {
            // nalgebra's arrays are columns; those of the transpose are rows.
            rotation: pose.rotation.transpose().into(),
            position: pose.position.into(),
        }
    }
}

impl<T: Real> TryFrom<Fields<T>> for Pose<T> {
    type Error = PoseError;

    fn try_from(fields: Fields<T>) -> Result<Self, PoseError> {
        let rotation = Matrix3::from(fields.rotation).transpose();
        let position = Vector3::from(fields.position);
        if !rotation
            .iter()
            .chain(position.iter())
            .all(nalgebra::ComplexField::is_finite)
        {
            return Err(PoseError::NotFinite);
        }
        let deviation = (rotation * rotation.transpose() - Matrix3::identity()).amax();
        let limit = crate::scalar::lit::<T>(ORTHONORMAL);
        if deviation > limit || rotation.determinant() < T::zero() {
            return Err(PoseError::NotARotation);
        }
        Ok(Self { rotation, position })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose(values: [f64; 6]) -> Pose<f64> {
        let [a, b, c, x, y, z] = values;
        Pose::new(
            *Rotation3::from_scaled_axis(Vector3::new(a, b, c)).matrix(),
            Vector3::new(x, y, z),
        )
    }

    proptest! {
        // Against homogeneous matrices. Fails if composition or inverse has its
        // factors in the wrong order.
        #[test]
        fn poses_compose_as_homogeneous_matrices(
            a in prop::array::uniform6(-3.0f64..3.0),
            b in prop::array::uniform6(-3.0f64..3.0),
            p in prop::array::uniform3(-3.0f64..3.0),
        ) {
            let homogeneous = |x: &Pose<f64>| {
                let mut matrix = x.rotation.to_homogeneous();
                matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&x.position);
                matrix
            };
            let (a, b, p) = (pose(a), pose(b), Vector3::from(p));
            let both = a.compose(&b);
            prop_assert!((homogeneous(&both) - homogeneous(&a) * homogeneous(&b)).norm() < 1e-13);
            prop_assert!((both.point(&p) - a.point(&b.point(&p))).norm() < 1e-13);
            prop_assert!((a.inverse().point(&a.point(&p)) - p).norm() < 1e-13);
            prop_assert!((a.inverse_point(&a.point(&p)) - p).norm() < 1e-13);
            prop_assert!((homogeneous(&a.compose(&a.inverse())) - nalgebra::Matrix4::identity()).norm() < 1e-13);
        }

        // Fails if a pose changes in a file.
        #[test]
        fn a_pose_reads_back(values in prop::array::uniform6(-3.0f64..3.0)) {
            let pose = pose(values);
            let text = toml::to_string(&pose).expect("a table");
            prop_assert_eq!(toml::from_str::<Pose<f64>>(&text).expect("a pose"), pose);
        }
    }

    // Fails if the file has columns where rows are meant.
    #[test]
    fn the_file_has_rows() {
        let text = "rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\nposition = [1.0, 2.0, 3.0]";
        let pose: Pose<f64> = toml::from_str(text).expect("a pose");
        assert_eq!(pose.point(&Vector3::x()), Vector3::new(1.0, 3.0, 3.0));
    }

    // Fails if a matrix that is not a rotation is accepted.
    #[test]
    fn what_is_not_a_rotation_is_refused() {
        let read = |rotation: &str| {
            toml::from_str::<Pose<f64>>(&std::format!("rotation = {rotation}\nposition = [0.0, 0.0, 0.0]"))
                .map_err(|error| std::string::ToString::to_string(&error))
        };
        for rotation in [
            "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.001]]",
            "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]",
            "[[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]",
        ] {
            let error = read(rotation).expect_err("refused");
            assert!(error.contains("not a rotation matrix"), "{error}");
        }
        let error = read("[[nan, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]").expect_err("refused");
        assert!(error.contains("not finite"), "{error}");
    }
}
