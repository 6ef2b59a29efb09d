//! Arms and what they stand on and hold.

use super::super::tips::row;
use super::Outcome::{self, Read, Refused};

/// Fingers of a gripper: `count` fingers of `joints` joints on `from`.
fn fingers(prefix: &str, from: &str, count: usize, joints: usize) -> String {
    (1..=count)
        .map(|k| row(&format!("{prefix}{k}_"), from, joints))
        .collect()
}

const WHEELS: &str = "left_wheel_joint continuous base_link left_wheel; right_wheel_joint continuous base_link right_wheel; \
                      caster_joint continuous base_link caster_link;";
const HEAD: &str = "head_pan_joint revolute torso head_pan_link; head_tilt_joint revolute head_pan_link head_tilt_link; \
                    camera_joint fixed head_tilt_link camera_link;";

/// Arms and what they stand on and hold.
pub(super) fn robots() -> Vec<(&'static str, String, Outcome)> {
    let torso = format!("torso_joint prismatic base_link torso; {WHEELS} {HEAD}");
    let arm = |prefix: &str, from: &str, n: usize| row(prefix, from, n);
    let six = arm("", "base_link", 6);
    vec![
        (
            "mobile base and torso",
            format!("{torso} {}", arm("arm_", "torso", 7)),
            Read("base_link", "arm_link7", 7),
        ),
        (
            "mobile base, torso and gripper",
            format!(
                "{torso} {} grip fixed arm_link7 gripper_link; {}",
                arm("arm_", "torso", 7),
                fingers("gripper_finger", "gripper_link", 2, 1)
            ),
            Read("base_link", "arm_link7", 7),
        ),
        (
            "a mobile base without an arm",
            format!("{WHEELS} lidar fixed base_link laser;"),
            Refused("no joint moves an arm"),
        ),
        (
            "rail",
            format!("rail prismatic world base_link; {six} t fixed link6 tool0;"),
            Read("world", "tool0", 6),
        ),
        (
            "rail, fixed to the world",
            format!("w fixed world track; rail prismatic track base_link; {six}"),
            Read("world", "link6", 6),
        ),
        (
            "gantry and wrist",
            format!(
                "x prismatic world a; y prismatic a b; z prismatic b c; {}",
                arm("w", "c", 3)
            ),
            Read("world", "wlink3", 3),
        ),
        (
            "a rail alone",
            "rail prismatic world cart".to_owned(),
            Refused("0 turning joints"),
        ),
        (
            "two arms",
            format!("{torso} {} {}", arm("l_", "torso", 7), arm("r_", "torso", 7)),
            Refused("l_link7, r_link7"),
        ),
        (
            "two arms with tool0",
            format!(
                "{} {} a fixed l_link6 left/tool0; b fixed r_link6 right/tool0;",
                arm("l_", "world", 6),
                arm("r_", "world", 6)
            ),
            Refused("left/tool0, right/tool0"),
        ),
        (
            "two arms, one with tool0",
            format!(
                "{} {} a fixed l_link6 tool0;",
                arm("l_", "world", 6),
                arm("r_", "world", 6)
            ),
            Read("world", "tool0", 6),
        ),
        (
            "humanoid",
            format!(
                "{torso} {} {} {} {}",
                arm("l_", "torso", 7),
                arm("r_", "torso", 7),
                arm("ll_", "base_link", 6),
                arm("rl_", "base_link", 6)
            ),
            Refused("l_link7"),
        ),
        (
            "floating base",
            format!("f floating world base_link; {six}"),
            Read("base_link", "link6", 6),
        ),
        (
            "planar base",
            format!("f planar odom base_footprint; g fixed base_footprint base_link; {six}"),
            Read("base_footprint", "link6", 6),
        ),
        (
            "a floating joint within the arm",
            format!(
                "{} f floating link3 odd; {}",
                arm("", "base_link", 3),
                arm("b", "odd", 3)
            ),
            Refused("\"f\": type is \"floating\""),
        ),
        (
            "continuous",
            six.replace("revolute", "continuous"),
            Read("base_link", "link6", 6),
        ),
        (
            "twenty joints",
            arm("", "base_link", 20),
            Read("base_link", "link20", 20),
        ),
        ("21 joints", arm("", "base_link", 21), Refused("21 turning joints")),
        ("one joint", "j revolute a b".to_owned(), Read("a", "b", 1)),
        ("no joint", "j fixed a b".to_owned(), Refused("no joint moves an arm")),
        (
            "tool0 before a sensor and a gripper",
            format!(
                "{six} t fixed link6 tool0; ft fixed tool0 ft_sensor; g fixed ft_sensor gripper; {}",
                fingers("finger", "gripper", 2, 1)
            ),
            Read("base_link", "tool0", 6),
        ),
        (
            "a name space",
            arm("robot1/", "robot1/base", 6) + "t fixed robot1/link6 robot1/tool0",
            Read("robot1/base", "robot1/tool0", 6),
        ),
        (
            "flange",
            format!("{six} f fixed link6 flange; t fixed flange camera_mount;"),
            Read("base_link", "flange", 6),
        ),
        (
            "a suction cup",
            format!("{six} s fixed link6 suction_cup;"),
            Read("base_link", "link6", 6),
        ),
        (
            "a parallel gripper",
            format!("{six} h fixed link6 hand; f1 prismatic hand finger_left; f2 prismatic hand finger_right f1;"),
            Read("base_link", "link6", 6),
        ),
        (
            "a gripper of one moving jaw",
            format!("{six} jaw revolute link6 moving_jaw;"),
            Read("base_link", "link6", 6),
        ),
        (
            "a coupled gripper",
            format!(
                "{six} b fixed link6 robotiq_arg2f_base_link; finger_joint revolute robotiq_arg2f_base_link left_outer_knuckle; \
            left_inner_knuckle_joint revolute robotiq_arg2f_base_link left_inner_knuckle finger_joint; left_inner_finger_joint revolute left_outer_knuckle left_inner_finger finger_joint; \
            right_outer_knuckle_joint revolute robotiq_arg2f_base_link right_outer_knuckle finger_joint;"
            ),
            Read("base_link", "robotiq_arg2f_base_link", 6),
        ),
        (
            "a finger on a joint named after the arm",
            format!("{six} arm_f1x revolute link6 arm_link_fngr;"),
            Refused("link6, arm_link_fngr"),
        ),
        (
            "three unnamed fingers",
            format!("{six} {}", fingers("f", "link6", 3, 2)),
            Read("base_link", "link6", 6),
        ),
        (
            "a hand of four fingers of four joints",
            format!("{six} p fixed link6 palm; {}", fingers("finger", "palm", 4, 4)),
            Read("base_link", "palm", 6),
        ),
        (
            "a camera on a pan-tilt at the wrist",
            format!("{six} head_pan revolute link6 head_pan; cam fixed head_pan camera;"),
            Read("base_link", "link6", 6),
        ),
        (
            "a disconnected link",
            format!("{six} x fixed table camera_stand;"),
            Read("base_link", "link6", 6),
        ),
        (
            "a disconnected tree before the arm",
            format!("x fixed table camera_stand; {six}"),
            Read("base_link", "link6", 6),
        ),
        (
            "a moving tree before the arm",
            format!("door revolute frame panel; {six} t fixed link6 tool0;"),
            Read("base_link", "tool0", 6),
        ),
        (
            "two disconnected arms",
            format!("{} {}", arm("a", "a_base", 6), arm("b", "b_base", 6)),
            Refused("alink6, blink6"),
        ),
        (
            "a loop",
            "a revolute x y; b revolute y z; c revolute z x".to_owned(),
            Refused("form a loop"),
        ),
        (
            "a loop beside the arm",
            format!("{six} a revolute x y; b revolute y z; c revolute z x"),
            Refused("form a loop"),
        ),
        (
            "two parents",
            format!("{six} second revolute base_link link3;"),
            Refused("a child link is \"link3\": stands twice"),
        ),
        (
            "a joint's name twice",
            six.replace("joint2", "joint1"),
            Refused("a joint's name is \"joint1\": stands twice"),
        ),
        (
            "a joint onto itself",
            "j revolute a a".to_owned(),
            Refused("form a loop"),
        ),
        (
            "a mimic joint on the way",
            format!(
                "{} rod revolute link3 rodlink joint2; {}",
                arm("", "base_link", 3),
                arm("b", "rodlink", 3)
            ),
            Read("base_link", "blink3", 7),
        ),
        (
            "a mimic of nobody, on the way",
            format!(
                "{} rod revolute link3 rodlink nobody; {}",
                arm("", "base_link", 3),
                arm("b", "rodlink", 3)
            ),
            Refused("mimic is \"nobody\""),
        ),
        (
            "a mimic of nobody, in the gripper",
            format!("{six} finger revolute link6 finger_link nobody;"),
            Read("base_link", "link6", 6),
        ),
        (
            "two that mimic each other",
            "a revolute x y b; b revolute y z a; c revolute z w; d revolute w v".to_owned(),
            Refused("mimic is"),
        ),
        (
            "types in capitals",
            six.replace("revolute", "Revolute"),
            Refused("type is \"Revolute\""),
        ),
        (
            "a type that does not exist",
            six.replacen("joint4 revolute", "joint4 hinge", 1),
            Refused("\"joint4\": type is \"hinge\""),
        ),
        (
            "a ball joint beside the arm",
            format!("{six} b ball base_link cable;"),
            Read("base_link", "link6", 6),
        ),
        (
            "camel case",
            six.replace("joint", "Joint_")
                .replace("link", "Link_")
                .replace("base_Link_", "Base"),
            Read("Base", "Link_6", 6),
        ),
        (
            "names of one letter",
            "1 revolute a b; 2 revolute b c; 3 revolute c d; 4 revolute d e".to_owned(),
            Read("a", "e", 4),
        ),
        (
            "other scripts",
            six.replace("link", "関節").replace("joint", "Gelenk_ä"),
            Read("base_関節", "関節6", 6),
        ),
    ]
}
