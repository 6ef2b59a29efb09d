//! The robot model that the robot side sends: kinematics and limits in URDF.

use std::fmt::Write as _;

use super::kinematics::{FLANGE_M, MDH};
use super::limits::JointLimits;
use crate::wire::Version;

/// The nominal model of the robot that speaks this version. It has kinematics and limits, and no inertias.
///
/// Beside `<limit>` stands `<position_based_velocity_limits>`, which the official client of version 10 requires. The
/// Panda has no such limits; its model says a deceleration so high that they never bind.
pub fn urdf(version: Version) -> String {
    let limits = JointLimits::of(version);
    let name = if version.is_panda() { "panda" } else { "fr3" };
    let mut out = format!("<?xml version=\"1.0\"?>\n<robot name=\"{name}\">\n  <link name=\"{name}_link0\"/>\n");
    for (joint, (a, d, alpha)) in MDH.iter().enumerate() {
        let n = joint + 1;
        // Craig: rotate about x by alpha, move along x by a, then along the new z by d.
        let (y, z) = (-d * alpha.sin(), d * alpha.cos());
        let (offset, deceleration) = match &limits.near_stops {
            Some(near) => (near.velocity_offset[joint], near.deceleration[joint]),
            None => (0.0, 1e6),
        };
        // Writing to a string cannot fail.
        let _ = write!(
            out,
            "  <link name=\"{name}_link{n}\"/>\n  <joint name=\"{name}_joint{n}\" type=\"revolute\">\n    \
             <origin xyz=\"{a} {y} {z}\" rpy=\"{alpha} 0 0\"/>\n    <parent link=\"{name}_link{joint}\"/>\n    \
             <child link=\"{name}_link{n}\"/>\n    <axis xyz=\"0 0 1\"/>\n    \
             <limit lower=\"{}\" upper=\"{}\" velocity=\"{}\" effort=\"{}\"/>\n    \
             <position_based_velocity_limits velocity_offset=\"{offset}\" deceleration_limit=\"{deceleration}\"/>\n  \
             </joint>\n",
            limits.lower[joint], limits.upper[joint], limits.velocity[joint], limits.torque[joint],
        );
    }
    let _ = write!(
        out,
        "  <link name=\"{name}_link8\"/>\n  <joint name=\"{name}_joint8\" type=\"fixed\">\n    \
         <origin xyz=\"0 0 {FLANGE_M}\" rpy=\"0 0 0\"/>\n    <parent link=\"{name}_link7\"/>\n    \
         <child link=\"{name}_link8\"/>\n  </joint>\n</robot>\n"
    );
    out
}
