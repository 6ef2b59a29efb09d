//! The built-in robots.
//!
//! Sources for the KUKA LBR iiwa 7 R800: kinematics from the paper's Table 2,
//! masses and inertias from lbr-stack/lbr_fri_ros2_stack `lbr_description`
//! (Apache-2.0), torque limits from KUKA's brochure as quoted by Drake's iiwa
//! README (BSD-3-Clause). The joint drives of the real arm close a torque loop at
//! the link side, so the nominal model has no rotor inertia.

use core::f64::consts::FRAC_PI_2;

use super::builtin_arms::{self as arms, Row as ArmRow};
use super::describe::{Inertia, Joint, JointLimits, Robot, Tool};
use super::kinematics::MdhRow;

/// Names of the built-in robots. Of several that are equally near to a wrong name, the first is suggested.
pub const BUILT_IN: &[&str] = &[
    "iiwa7", "iiwa14", "panda", "fr3", "ur5e", "ur10e", "ur3e", "ur16e", "ur20", "ur30", "ur3", "ur5", "ur10", "irb120",
];

#[rustfmt::skip]
const IIWA7: [ArmRow; 7] = [
    ([0.0, 0.0, 0.0, 0.34], [-2.9670597283903604, 2.9670597283903604, 1.710422666954443, 176.0], 3.394011,
     [0.0, -0.034819, -0.069201], [0.021383, 0.020403, 0.007563, 0.0, 0.0, 0.003797]),
    ([-FRAC_PI_2, 0.0, 0.0, 0.0], [-2.0943951023931953, 2.0943951023931953, 1.710422666954443, 176.0], 4.031991,
     [0.0, -0.086944, 0.029293], [0.031697, 0.009666, 0.03008, 0.0, 0.0, -0.005889]),
    ([FRAC_PI_2, 0.0, 0.0, 0.4], [-2.9670597283903604, 2.9670597283903604, 1.7453292519943295, 110.0], 3.394011,
     [0.0, 0.034819, -0.069201], [0.021383, 0.020403, 0.007563, 0.0, 0.0, -0.003797]),
    ([FRAC_PI_2, 0.0, 0.0, 0.0], [-2.0943951023931953, 2.0943951023931953, 2.2689280275926285, 110.0], 4.031989,
     [0.0, 0.086944, 0.029293], [0.031695, 0.009665, 0.030079, 0.0, 0.0, 0.005889]),
    ([-FRAC_PI_2, 0.0, 0.0, 0.4], [-2.9670597283903604, 2.9670597283903604, 2.443460952792061, 110.0], 1.529239,
     [0.0, -0.029824, -0.116233], [0.008485, 0.007136, 0.003848, 0.0, 0.0, 0.002806]),
    ([-FRAC_PI_2, 0.0, 0.0, 0.0], [-2.0943951023931953, 2.0943951023931953, core::f64::consts::PI, 40.0], 2.403626,
     [0.0, -0.00495, 0.00032], [0.007067, 0.004629, 0.006804, 0.0, 0.0, -0.000311]),
    ([FRAC_PI_2, 0.0, 0.0, 0.126], [-3.0543261909900767, 3.0543261909900767, core::f64::consts::PI, 40.0], 0.259474,
     [3e-06, -2e-06, -0.021218], [0.000171, 0.000171, 0.000299, 0.0, 0.0, 0.0]),
];

/// KUKA LBR iiwa 7 R800.
pub fn iiwa7() -> Robot {
    robot("iiwa7", &IIWA7)
}

/// The built-in robot with a name of [`BUILT_IN`].
pub fn built_in(name: &str) -> Option<Robot> {
    let rows: &[ArmRow] = match name {
        "iiwa7" => &IIWA7,
        "iiwa14" => &arms::IIWA14,
        "panda" => &arms::PANDA,
        "fr3" => &arms::FR3,
        "ur5e" => &arms::UR5E,
        "ur10e" => &arms::UR10E,
        "ur3e" => &arms::UR3E,
        "ur16e" => &arms::UR16E,
        "ur20" => &arms::UR20,
        "ur30" => &arms::UR30,
        "ur3" => &arms::UR3,
        "ur5" => &arms::UR5,
        "ur10" => &arms::UR10,
        "irb120" => &arms::IRB120,
        _ => return None,
    };
    Some(robot(name, rows))
}

fn robot(name: &str, rows: &[ArmRow]) -> Robot {
    let mut robot = Robot {
        name: heapless::String::new(),
        joints: heapless::Vec::new(),
    };
    // All fit: at most 7 letters of 32, at most 7 joints of 20.
    let _ = robot.name.push_str(name);
    for &([alpha, a, theta, d], [min_rad, max_rad, velocity_rad_s, torque_nm], mass_kg, com_m, inertia_kg_m2) in rows {
        let _ = robot.joints.push(Joint {
            mdh: MdhRow {
                alpha,
                a,
                beta: 0.0,
                theta,
                d,
            },
            link: Inertia {
                mass_kg,
                com_m,
                inertia_kg_m2,
            },
            limits: JointLimits {
                min_rad,
                max_rad,
                velocity_rad_s,
                torque_nm,
            },
            rotor_kg_m2: 0.0,
        });
    }
    robot
}

/// The calibration tool of the iiwa 7: 1.5 kg, with the nest eccentric from the
/// flange as in Figure 3 of the paper. The paper gives no numbers; these are ours.
pub fn iiwa7_tool() -> Tool {
    Tool {
        tcp_m: [0.050, 0.0, 0.100],
        body: Inertia {
            mass_kg: 1.5,
            com_m: [0.025, 0.0, 0.050],
            inertia_kg_m2: [0.0012, 0.0022, 0.0022, 0.0, 0.0, 0.0],
        },
    }
}
