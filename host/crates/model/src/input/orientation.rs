//! Orientations by three numbers: Euler angles and rotation vectors.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::robots::frames::{rot_x, rot_y, rot_z};

/// An orientation by three numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Orientation {
    /// Turns about these axes (0 is x) of the turning body, one after the other. `backwards`: the numbers stand in the
    /// reverse order (roll, pitch, yaw).
    Euler {
        axes: [u8; 3],
        backwards: bool,
        degrees: bool,
    },
    /// Axis times angle.
    RotationVector { degrees: bool },
}

impl std::fmt::Display for Orientation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let unit = |degrees: &bool| if *degrees { "degrees" } else { "rad" };
        match self {
            Self::Euler {
                backwards: true,
                degrees,
                ..
            } => write!(f, "roll, pitch and yaw about fixed axes, in {}", unit(degrees)),
            Self::Euler { axes, degrees, .. } => {
                let names: String = axes.iter().map(|axis| char::from(b'x' + axis)).collect();
                write!(f, "turns about {names} of the turning body, in {}", unit(degrees))
            }
            Self::RotationVector { degrees } => write!(f, "a rotation vector, in {}", unit(degrees)),
        }
    }
}

impl Orientation {
    /// Roll, pitch and yaw about the fixed axes x, y and z: `Rz(yaw) Ry(pitch) Rx(roll)`.
    pub(super) fn rpy(degrees: bool) -> Self {
        Self::Euler {
            axes: [2, 1, 0],
            backwards: true,
            degrees,
        }
    }

    /// Angles about the axes that `letters` name, such as `zyx`.
    pub(super) fn euler(letters: &str, degrees: bool) -> Option<Self> {
        let axis = |letter: u8| match letter {
            b'x' => Some(0),
            b'y' => Some(1),
            b'z' => Some(2),
            _ => None,
        };
        let [a, b, c] = *letters.as_bytes() else { return None };
        let axes = [axis(a)?, axis(b)?, axis(c)?];
        (a != b && b != c).then_some(Self::Euler {
            axes,
            backwards: false,
            degrees,
        })
    }

    /// The quaternion w, x, y, z of three numbers.
    pub(super) fn quaternion(self, numbers: [f64; 3]) -> [f64; 4] {
        let (Self::Euler { degrees, .. } | Self::RotationVector { degrees }) = self;
        let mut angles = if degrees { numbers.map(f64::to_radians) } else { numbers };
        let rotation = match self {
            Self::RotationVector { .. } => Rotation3::new(Vector3::from(angles)).into_inner(),
            Self::Euler { axes, backwards, .. } => {
                if backwards {
                    angles.reverse();
                }
                axes.iter().zip(angles).fold(Matrix3::identity(), |at, (axis, angle)| {
                    at * match axis {
                        0 => rot_x(angle),
                        1 => rot_y(angle),
                        _ => rot_z(angle),
                    }
                })
            }
        };
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        [q.w, q.i, q.j, q.k]
    }
}
