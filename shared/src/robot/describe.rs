//! Serialisable descriptions of a robot and its tool, checked before use.
//!
//! A description comes from the built-in table, a TOML file, a URDF file or the
//! host link. Only a description that [`Robot::check`] has accepted is used.

use core::fmt;

use nalgebra::{Matrix3, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::kinematics::MdhRow;
use crate::{MAX_CHAIN, MAX_JOINTS};

/// Mass distribution of one rigid body, in a stated frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Inertia {
    /// Mass, in kg.
    pub mass_kg: f64,
    /// Centre of mass in the body's frame, in m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass, in the axes of the body's frame: xx, yy,
    /// zz, xy, xz, yz, in kg m². The off-diagonal values are the matrix elements,
    /// not the products of inertia, which have the opposite sign.
    pub inertia_kg_m2: [f64; 6],
}

impl Inertia {
    /// Centre of mass as a vector, in m.
    pub fn com(&self) -> Vector3<f64> {
        Vector3::from(self.com_m)
    }

    /// Inertia matrix about the centre of mass, in kg m².
    pub fn matrix(&self) -> Matrix3<f64> {
        let [xx, yy, zz, xy, xz, yz] = self.inertia_kg_m2;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// The mass distribution of both bodies together; both are given in one frame.
    pub fn combined(&self, other: &Self) -> Self {
        let mass = self.mass_kg + other.mass_kg;
        if mass <= 0.0 {
            return *self;
        }
        let com = (self.com() * self.mass_kg + other.com() * other.mass_kg) / mass;
        let about = |body: &Self| {
            let r = body.com() - com;
            body.matrix() + (Matrix3::identity() * r.norm_squared() - r * r.transpose()) * body.mass_kg
        };
        let m = about(self) + about(other);
        Self {
            mass_kg: mass,
            com_m: com.into(),
            inertia_kg_m2: [m[(0, 0)], m[(1, 1)], m[(2, 2)], m[(0, 1)], m[(0, 2)], m[(1, 2)]],
        }
    }
}

/// Limits of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct JointLimits {
    /// Smallest angle, in rad.
    pub min_rad: f64,
    /// Largest angle, in rad.
    pub max_rad: f64,
    /// Largest speed in both directions, in rad/s.
    pub velocity_rad_s: f64,
    /// Largest torque in both directions, in N m.
    pub torque_nm: f64,
}

/// Share of a joint's torque limit that may be an error of its sensor. Within the play of a sensor a law that takes its
/// reading for a disturbance would compensate the gravity torque a second time, and press a nest off its sphere; and a
/// bias would be a jolt as the brakes open.
const SENSOR_SHARE: f64 = 0.015;

impl JointLimits {
    /// Torque that may be an error of the joint's sensor, in N m.
    #[inline]
    pub fn sensor_error_nm(&self) -> f64 {
        SENSOR_SHARE * self.torque_nm
    }
}

/// One joint and the link that it moves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Joint {
    /// Modified DH row that leads to this joint's frame.
    pub mdh: MdhRow<f64>,
    /// The link, in this joint's frame.
    pub link: Inertia,
    /// The joint's limits.
    pub limits: JointLimits,
    /// Rotor inertia at the link side (gear ratio squared times rotor inertia), in
    /// kg m²; 0 if the drive compensates it.
    #[serde(default)]
    pub rotor_kg_m2: f64,
}

/// A serial robot with at most `MOST` revolute joints.
///
/// The host computes with chains of up to [`MAX_CHAIN`] joints, and has no other type. The controller and the links have
/// [`DrivenRobot`]. Both are the same on a wire and in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Robot<const MOST: usize = MAX_CHAIN> {
    /// Name, such as `iiwa7`.
    pub name: heapless::String<32>,
    /// Joints from base to flange.
    #[serde(rename = "joint")]
    pub joints: heapless::Vec<Joint, MOST>,
}

/// The tool at the flange. Its frame FT has the axes of the flange frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Tool {
    /// Tool centre point in the flange frame, in m: the centre of a seated sphere.
    pub tcp_m: [f64; 3],
    /// Mass distribution in the flange frame.
    pub body: Inertia,
}

impl Tool {
    /// Tool centre point in the flange frame, in m.
    pub fn tcp(&self) -> Vector3<f64> {
        Vector3::from(self.tcp_m)
    }
}

/// Why a description was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RobotError {
    /// The robot has no joints.
    #[error("the robot has no joints: list at least one [[joint]]")]
    NoJoints,
    /// The robot has more joints than any controller drives.
    #[error(
        "the robot has {found} joints and a controller drives at most {MAX_JOINTS}: name a base or a tip between which \
         there are no more, as FILE.urdf#BASE:TIP (`identify` takes up to {MAX_CHAIN})"
    )]
    TooManyJoints {
        /// Number of joints in the description.
        found: usize,
    },
    /// The controller was built for another number of joints.
    #[error(
        "the robot has {found} joints, this controller was built for {expected}: use a controller built for {found}"
    )]
    JointCount {
        /// Number of joints in the description.
        found: usize,
        /// Number of joints that the controller was built for.
        expected: usize,
    },
    /// A number is NaN or infinite.
    #[error("{}: {field} is {value}: give a finite number", part(*joint))]
    NotFinite {
        /// Joint, from 1; 0 is the tool.
        joint: usize,
        /// Field of the description.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A number is not physically possible.
    #[error("{}: {field} is {value}: {remedy}", part(*joint))]
    OutOfRange {
        /// Joint, from 1; 0 is the tool.
        joint: usize,
        /// Field of the description.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
}

/// The part of the robot that `joint` stands for, in words.
fn part(joint: usize) -> impl fmt::Display {
    struct Part(usize);
    impl fmt::Display for Part {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            match self.0 {
                0 => f.write_str("tool"),
                joint => write!(f, "joint {joint}"),
            }
        }
    }
    Part(joint)
}

fn finite(joint: usize, field: &'static str, value: f64) -> Result<(), RobotError> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(RobotError::NotFinite { joint, field, value })
    }
}

/// Refuses `value` if it is not finite or if `good` is false.
fn require(joint: usize, field: &'static str, value: f64, good: bool, remedy: &'static str) -> Result<(), RobotError> {
    finite(joint, field, value)?;
    if good {
        Ok(())
    } else {
        Err(RobotError::OutOfRange {
            joint,
            field,
            value,
            remedy,
        })
    }
}

fn check_body(joint: usize, body: &Inertia) -> Result<(), RobotError> {
    require(
        joint,
        "mass_kg",
        body.mass_kg,
        (0.0..=1e4).contains(&body.mass_kg),
        "a mass is zero or positive, and at most 10000 kg",
    )?;
    for value in body.com_m {
        require(
            joint,
            "com_m",
            value,
            value.abs() <= 5.0,
            "a centre of mass lies within 5 m of its frame",
        )?;
    }
    for (k, value) in body.inertia_kg_m2.into_iter().enumerate() {
        require(
            joint,
            "inertia_kg_m2",
            value,
            value.abs() <= 1e4 && (k >= 3 || value >= 0.0),
            "xx, yy and zz are zero or positive, and none is beyond 10000",
        )?;
    }
    Ok(())
}

/// A robot that a controller drives.
pub type DrivenRobot = Robot<MAX_JOINTS>;

impl Robot {
    /// The robot as a controller takes it.
    ///
    /// # Errors
    /// [`RobotError::TooManyJoints`] for more than [`MAX_JOINTS`].
    pub fn driven(&self) -> Result<DrivenRobot, RobotError> {
        let joints = heapless::Vec::from_slice(&self.joints);
        Ok(Robot {
            name: self.name.clone(),
            joints: joints.map_err(|_| RobotError::TooManyJoints { found: self.dof() })?,
        })
    }
}

impl<const MOST: usize> Robot<MOST> {
    /// Number of joints.
    pub fn dof(&self) -> usize {
        self.joints.len()
    }

    /// Checks every number of the description.
    ///
    /// # Errors
    /// The first field that is not finite or not possible, with its value.
    pub fn check(&self) -> Result<(), RobotError> {
        if self.joints.is_empty() {
            return Err(RobotError::NoJoints);
        }
        for (index, joint) in self.joints.iter().enumerate() {
            let i = index + 1;
            let row = &joint.mdh;
            for (field, angle) in [("alpha", row.alpha), ("beta", row.beta), ("theta", row.theta)] {
                require(i, field, angle, angle.abs() <= 100.0, "angles are in rad, at most 100")?;
            }
            require(i, "a", row.a, row.a.abs() <= 10.0, "lengths are in m, at most 10")?;
            require(i, "d", row.d, row.d.abs() <= 10.0, "lengths are in m, at most 10")?;
            check_body(i, &joint.link)?;
            let l = &joint.limits;
            require(i, "min_rad", l.min_rad, l.min_rad >= -1e4, "must be at least -10000")?;
            require(
                i,
                "max_rad",
                l.max_rad,
                l.max_rad > l.min_rad && l.max_rad <= 1e4,
                "must exceed min_rad, and be at most 10000",
            )?;
            require(
                i,
                "velocity_rad_s",
                l.velocity_rad_s,
                l.velocity_rad_s > 0.0 && l.velocity_rad_s <= 1e3,
                "must be positive, and at most 1000",
            )?;
            require(
                i,
                "torque_nm",
                l.torque_nm,
                l.torque_nm > 0.0 && l.torque_nm <= 1e5,
                "must be positive, and at most 100000",
            )?;
            require(
                i,
                "rotor_kg_m2",
                joint.rotor_kg_m2,
                (0.0..=1e4).contains(&joint.rotor_kg_m2),
                "must be zero or positive, and at most 10000",
            )?;
        }
        Ok(())
    }
}

impl Tool {
    /// Checks every number of the description.
    ///
    /// # Errors
    /// The first field that is not finite or not possible, with its value.
    pub fn check(&self) -> Result<(), RobotError> {
        for value in self.tcp_m {
            require(
                0,
                "tcp_m",
                value,
                value.abs() <= 2.0,
                "the TCP lies within 2 m of the flange",
            )?;
        }
        check_body(0, &self.body)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::iiwa7;

    // Fails if the host's robot is another one on a wire than the controller's, or if nine joints reach a controller.
    #[test]
    fn a_robot_is_the_same_for_the_host_and_for_a_controller() {
        let mut robot = iiwa7();
        let driven = robot.driven().unwrap();
        assert_eq!(DrivenRobot::SCHEMA, <Robot as Schema>::SCHEMA);
        let mut buffers = [[0; 4096]; 3];
        let [own, other, nine] = &mut buffers;
        let bytes = postcard::to_slice(&robot, own).unwrap();
        assert_eq!(bytes, postcard::to_slice(&driven, other).unwrap());
        assert_eq!(postcard::from_bytes::<DrivenRobot>(bytes).unwrap(), driven);
        for _ in 7..9 {
            robot.joints.push(robot.joints[0]).unwrap();
        }
        assert_eq!(robot.driven(), Err(RobotError::TooManyJoints { found: 9 }));
        let bytes = postcard::to_slice(&robot, nine).unwrap();
        assert!(postcard::from_bytes::<DrivenRobot>(bytes).is_err());
        assert_eq!(postcard::from_bytes::<Robot>(bytes).unwrap(), robot);
    }
}
