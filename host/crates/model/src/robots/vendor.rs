//! How vendors' ROS descriptions name joints and write their origins.
//!
//! | form | file | keys | base convention |
//! |---|---|---|---|
//! | Universal Robots | `ur_description`, `kinematics_params` | `kinematics: shoulder .. wrist_3` | `shoulder` is given in `base_link_inertia`: `base_link` turned by 180 degrees about z |
//! | Franka | `franka_description`, `kinematics.yaml` | `joint1 .. joint8`, each with `kinematic:` | `joint1` is given in `link0`, the robot's own base; `joint8` is the flange |
//! | plain | none | `kinematics:`, one key per joint name; `axis_x, axis_y, axis_z` where the axis is not z | the first joint is given in the root link |
//!
//! The nominal origins of the built-in robots stand here too, because their
//! modified DH frames are not the link frames of the vendors' files.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt::Write as _;

use spherecal_shared::robot::built_in;

use super::model::{Origin, RobotModel};
use super::urdf::{JointMotion, Urdf, UrdfChain};
use super::urdf_in;

/// The vendor's way to write joint origins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    UniversalRobots,
    Franka,
    Plain,
}

/// Keys of Universal Robots' calibration, base to flange; the link behind each
/// joint is named by it.
pub(super) const UR_KEYS: [&str; 6] = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"];
/// Joints of Universal Robots, base to flange.
const UR_JOINTS: [&str; 6] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];

/// A joint origin as a file writes it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct JointOrigin {
    pub(super) key: String,
    /// Position in the parent link, in m.
    pub(super) xyz: [f64; 3],
    /// Roll, pitch and yaw, in rad: R = Rz(yaw) Ry(pitch) Rx(roll).
    pub(super) rpy: [f64; 3],
    /// Direction of the joint's axis in its own link.
    pub(super) axis: [f64; 3],
}

/// The axis of every joint in the vendors' forms.
pub(super) const Z: [f64; 3] = [0.0, 0.0, 1.0];

/// The form that a URDF's chain has by its names.
pub(super) fn form(urdf: &Urdf, chain: &UrdfChain) -> Form {
    let turning: Vec<_> = chain
        .path
        .iter()
        .map(|&i| &urdf.joints[i])
        .filter(|j| j.motion == JointMotion::Turns)
        .collect();
    let all = |end: &dyn Fn(usize) -> String, count: usize| {
        turning.len() == count && turning.iter().enumerate().all(|(k, j)| j.child.ends_with(&end(k)))
    };
    if all(&|k| format!("{}_link", UR_KEYS.get(k).unwrap_or(&"?")), 6) {
        Form::UniversalRobots
    } else if all(&|k| format!("link{}", k + 1), 7)
        && turning
            .iter()
            .zip(1..)
            .all(|(j, k)| j.name.ends_with(&format!("joint{k}")))
    {
        Form::Franka
    } else {
        Form::Plain
    }
}

/// Key of turning joint `k` (from 0) of a chain in a form.
pub(super) fn key(form: Form, k: usize, joint: &str) -> String {
    match form {
        Form::UniversalRobots => (*UR_KEYS.get(k).unwrap_or(&"")).to_owned(),
        Form::Franka => format!("joint{}", k + 1),
        Form::Plain => joint.to_owned(),
    }
}

/// The base convention of a form, for the head of a file.
pub(super) fn base_words(form: Form, root: &str) -> String {
    match form {
        Form::UniversalRobots => "Base: \"shoulder\" is given in base_link_inertia, that is base_link turned by 180 degrees about z, as in \
             ur_description; the controller's own Base frame has those axes. For ur_description: kinematics_params:=FILE."
            .to_owned(),
        Form::Franka => "Base: joint1 is given in link0, the robot's own base frame, as in franka_description; joint8 is the flange \
             (nominal). For franka_description: robots/NAME/kinematics.yaml."
            .to_owned(),
        Form::Plain => format!("Base: the first joint is given in the root link {root}."),
    }
}

fn origins<const N: usize>(rows: [(&str, [f64; 3], [f64; 3]); N]) -> Vec<JointOrigin> {
    rows.into_iter()
        .map(|(key, xyz, rpy)| JointOrigin {
            key: key.to_owned(),
            xyz,
            rpy,
            axis: Z,
        })
        .collect()
}

/// The built-in robots of Universal Robots.
pub(super) const UR_ROBOTS: [&str; 9] = ["ur5e", "ur10e", "ur3e", "ur16e", "ur20", "ur30", "ur3", "ur5", "ur10"];

/// Nominal origins of a robot of Universal Robots from the lengths of its data sheet (m).
pub(super) fn ur([d1, a2, a3, d4, d5, d6]: [f64; 6]) -> Vec<JointOrigin> {
    let [shoulder, upper_arm, forearm, wrist_1, wrist_2, wrist_3] = UR_KEYS;
    origins([
        (shoulder, [0.0, 0.0, d1], [0.0; 3]),
        (upper_arm, [0.0; 3], [FRAC_PI_2, 0.0, 0.0]),
        (forearm, [-a2, 0.0, 0.0], [0.0; 3]),
        (wrist_1, [-a3, 0.0, d4], [0.0; 3]),
        (wrist_2, [0.0, -d5, 0.0], [FRAC_PI_2, 0.0, 0.0]),
        (wrist_3, [0.0, d6, 0.0], [FRAC_PI_2, PI, PI]),
    ])
}

/// Nominal origins of the Panda and the FR3 (m).
fn franka() -> Vec<JointOrigin> {
    let quarter = |sign: f64| [sign * FRAC_PI_2, 0.0, 0.0];
    origins([
        ("joint1", [0.0, 0.0, 0.333], [0.0; 3]),
        ("joint2", [0.0; 3], quarter(-1.0)),
        ("joint3", [0.0, -0.316, 0.0], quarter(1.0)),
        ("joint4", [0.0825, 0.0, 0.0], quarter(1.0)),
        ("joint5", [-0.0825, 0.384, 0.0], quarter(-1.0)),
        ("joint6", [0.0; 3], quarter(1.0)),
        ("joint7", [0.088, 0.0, 0.0], quarter(1.0)),
        ("joint8", [0.0, 0.0, 0.107], [0.0; 3]),
    ])
}

/// The vendor's description of a robot that came without any and whose nominal
/// table is that of a built-in robot.
pub(super) fn description_of(model: &RobotModel) -> Option<RobotModel> {
    match model.origin {
        Origin::Urdf(_) => None,
        _ => model.built_in().and_then(|known| nominal(&known.name)),
    }
}

/// Inertia of each motor of an arm of Universal Robots, seen at its joint, kg m². The maker does not state it. This is what
/// MuJoCo Menagerie gives UR5e and UR10e (`armature`). It is a guess for the others.
pub const UR_MOTOR_KG_M2: f64 = 0.1;

/// The lengths d1, a2, a3, d4, d5, d6 (m) of a built-in robot of Universal Robots, by its name, as its data sheet states them: without
/// signs.
pub fn ur_lengths(name: &str) -> Option<[f64; 6]> {
    let robot = built_in(UR_ROBOTS.iter().find(|known| **known == name)?)?;
    let row = |joint: usize| robot.joints.get(joint).map(|joint| joint.mdh);
    Some([row(0)?.d, row(2)?.a, row(3)?.a, row(3)?.d, row(4)?.d, row(5)?.d])
}

/// The nominal description of a built-in robot by its vendor, where it is known.
fn nominal(name: &str) -> Option<RobotModel> {
    let (form, origins) = match name {
        "panda" | "fr3" => (Form::Franka, franka()),
        _ => (Form::UniversalRobots, ur(ur_lengths(name)?)),
    };
    urdf_in::load(name, &urdf_text(form, name, &origins, None), None).ok()
}

/// Names of a built-in robot's joints in its vendor's description; empty where
/// vendors' descriptions differ.
pub(super) fn joint_names(name: &str) -> Vec<String> {
    match name {
        name if UR_ROBOTS.contains(&name) => UR_JOINTS.map(str::to_owned).to_vec(),
        "panda" | "fr3" => (1..=7).map(|k| format!("{name}_joint{k}")).collect(),
        _ => Vec::new(),
    }
}

/// A minimal URDF (no masses, wide limits) with the vendor's names for these origins; `tip` is where its tip is behind
/// them.
pub(super) fn urdf_text(form: Form, name: &str, origins: &[JointOrigin], tip: Option<&JointOrigin>) -> String {
    let attribute = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    let name = attribute(name);
    let mut out = format!("<?xml version=\"1.0\"?>\n<robot name=\"{name}\">\n");
    let mut parent = match form {
        Form::Franka => format!("{name}_link0"),
        _ => "base_link".to_owned(),
    };
    let _ = writeln!(out, "  <link name=\"{parent}\"/>");
    let mut add = |joint: &str, child: &str, turns: Option<[f64; 3]>, xyz: [f64; 3], rpy: [f64; 3]| {
        let _ = writeln!(
            out,
            "  <link name=\"{child}\"/>\n  <joint name=\"{joint}\" type=\"{}\">\n    \
             <origin xyz=\"{} {} {}\" rpy=\"{} {} {}\"/>\n    <parent link=\"{parent}\"/>\n    <child link=\"{child}\"/>",
            if turns.is_some() { "revolute" } else { "fixed" },
            xyz[0],
            xyz[1],
            xyz[2],
            rpy[0],
            rpy[1],
            rpy[2]
        );
        if let Some([x, y, z]) = turns {
            let _ = writeln!(
                out,
                "    <axis xyz=\"{x} {y} {z}\"/>\n    <limit lower=\"{}\" upper=\"{}\"/>",
                -2.0 * PI,
                2.0 * PI
            );
        }
        let _ = writeln!(out, "  </joint>");
        child.clone_into(&mut parent);
    };
    if form == Form::UniversalRobots {
        add(
            "base_link-base_link_inertia",
            "base_link_inertia",
            None,
            [0.0; 3],
            [0.0, 0.0, PI],
        );
    }
    for (k, origin) in origins.iter().enumerate() {
        let number = k + 1;
        let (joint, child, turns) = match form {
            Form::UniversalRobots => (
                (*UR_JOINTS.get(k).unwrap_or(&"")).to_owned(),
                format!("{}_link", origin.key),
                Some(Z),
            ),
            Form::Franka => (
                format!("{name}_joint{number}"),
                format!("{name}_link{number}"),
                (number <= 7).then_some(Z),
            ),
            Form::Plain => (attribute(&origin.key), format!("link_{number}"), Some(origin.axis)),
        };
        add(&joint, &child, turns, origin.xyz, origin.rpy);
    }
    match (form, tip) {
        (_, Some(tip)) => add("flange-tool0", "tool0", None, tip.xyz, tip.rpy),
        (Form::UniversalRobots, None) => {
            add(
                "wrist_3-flange",
                "flange",
                None,
                [0.0; 3],
                [0.0, -FRAC_PI_2, -FRAC_PI_2],
            );
            add("flange-tool0", "tool0", None, [0.0; 3], [FRAC_PI_2, 0.0, FRAC_PI_2]);
        }
        (Form::Franka, None) => {}
        (Form::Plain, None) => add("flange-tool0", "tool0", None, [0.0; 3], [0.0; 3]),
    }
    out + "</robot>\n"
}
