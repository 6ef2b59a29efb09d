//! Robots and files as people have them, generated: each is read with the tip that a person would name, or refused with one
//! clear line.

use super::super::*;
use super::tips::{row, tree};

/// What is expected of a file.
#[derive(Clone, Copy, Debug)]
enum Outcome {
    /// Its root, its tip, and the number of its joints that turn.
    Read(&'static str, &'static str, usize),
    /// What the refusal says.
    Refused(&'static str),
}
use Outcome::{Read, Refused};

/// Reads a file as `identify` does.
fn read(text: &str) -> Result<RobotModel, String> {
    let model = urdf_in::load_path("odd.urdf", text, None, None).map_err(|e| e.to_string())?;
    model.joint_path().map_err(|e| e.to_string())?;
    Ok(model)
}

/// Checks a file; what is wrong goes to `wrong`, so that one run shows all.
fn check(name: &str, text: &str, expected: Outcome, wrong: &mut Vec<String>) {
    let found = read(text);
    let right = match (&found, expected) {
        (Ok(model), Read(root, tip, joints)) => {
            (
                model.frame_names.0.as_str(),
                model.frame_names.1.as_str(),
                model.robot.dof(),
            ) == (root, tip, joints)
                && model.chain_words().is_some_and(|words| !words.contains('\n'))
        }
        (Err(message), Refused(words)) => {
            message.starts_with("odd.urdf: ")
                && message.contains(words)
                && !message.contains('\n')
                && message.len() < 700
        }
        _ => false,
    };
    if !right {
        let found = found.map(|m| (m.frame_names, m.robot.dof()));
        wrong.push(format!("{name}: {expected:?}, found {found:?}"));
    }
}

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
fn robots() -> Vec<(&'static str, String, Outcome)> {
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
        ("eight joints", arm("", "base_link", 8), Read("base_link", "link8", 8)),
        ("nine joints", arm("", "base_link", 9), Refused("9 turning joints")),
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

/// A change of a file's text: its name, the change, what a refusal says; `None` where the file is read as before.
type Change = (&'static str, fn(&str) -> String, Option<&'static str>);

/// Behind the start tag of the robot.
fn inside(text: &str, more: &str) -> String {
    text.replacen("<link", &format!("{more}<link"), 1)
}

const CHANGES: [Change; 40] = [
    (
        "comments",
        |t| {
            format!(
                "<!-- <joint/> -->{}",
                inside(t, "<!-- <joint name=\"x\" type=\"revolute\"/> -->")
            )
        },
        None,
    ),
    (
        "a declaration",
        |t| format!("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n{t}"),
        None,
    ),
    ("a byte order mark", |t| format!("\u{feff}{t}"), None),
    ("lines of Windows", |t| t.replace('\n', "\r\n"), None),
    ("no line ends", |t| t.replace('\n', ""), None),
    ("quotes", |t| t.replace('"', "'"), None),
    (
        "tabs in numbers",
        |t| t.replace("0.01 0.02 0.1", "\t0.01\t0.02 \n 0.1 "),
        None,
    ),
    (
        "a declared name space",
        |t| t.replacen("<robot", "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\"", 1),
        None,
    ),
    (
        "leftovers of xacro",
        |t| inside(t, "<xacro:property name=\"pi\" value=\"3.14\"/>"),
        None,
    ),
    (
        "$(find) in a mesh",
        |t| {
            t.replacen("<link name=", "<link name=\"m\"><visual><geometry><mesh filename=\"$(find a)/b.stl\"/></geometry></visual></link><link name=", 1)
        },
        None,
    ),
    (
        "a number of xacro",
        |t| t.replacen("0.01 0.02 0.1", "0 0 ${d1}", 1),
        Some("xacro FILE.xacro > FILE.urdf"),
    ),
    (
        "a macro without robot",
        |t| {
            t.replace("link name", "xacro:arm name")
                .replace("<joint", "<xacro:joint")
                .replace("</joint", "</xacro:joint")
        },
        Some("xacro"),
    ),
    (
        "a document type",
        |t| format!("<!DOCTYPE robot>{t}"),
        Some("document type"),
    ),
    (
        "cut short",
        |t| t[..t.len() * 2 / 3].to_owned(),
        Some("not well-formed XML"),
    ),
    ("a stray &", |t| inside(t, "R&D"), Some("not well-formed XML")),
    ("empty", |_| String::new(), Some("a URDF starts with <robot")),
    ("blanks", |_| " \n".to_owned(), Some("a URDF starts with <robot")),
    ("SDF", |t| t.replace("robot", "sdf"), Some("the root element is <sdf>")),
    (
        "transmissions",
        |t| {
            inside(
                t,
                "<transmission name=\"t\"><joint name=\"x\"/><actuator name=\"m\"/></transmission>",
            )
        },
        None,
    ),
    (
        "ros2_control",
        |t| {
            inside(
                t,
                "<ros2_control name=\"c\" type=\"system\"><joint name=\"x\"><command_interface name=\"position\"/></joint></ros2_control>",
            )
        },
        None,
    ),
    (
        "gazebo",
        |t| {
            inside(
                t,
                "<gazebo reference=\"l\"><joint name=\"x\"/><link name=\"y\"/></gazebo>",
            )
        },
        None,
    ),
    (
        "materials",
        |t| inside(t, "<material name=\"m\"><color rgba=\"1 0 0 1\"/></material>"),
        None,
    ),
    (
        "an empty inertial",
        |t| t.replacen("\"/>", "\"><inertial/></link>", 1),
        None,
    ),
    (
        "a mass of zero",
        |t| t.replacen("\"/>", "\"><inertial><mass value=\"0\"/></inertial></link>", 1),
        None,
    ),
    (
        "an inertia without a mass",
        |t| {
            t.replacen(
                "\"/>",
                "\"><inertial><inertia ixx=\"1\" iyy=\"1\" izz=\"1\"/></inertial></link>",
                1,
            )
        },
        None,
    ),
    (
        "a mass that is no number",
        |t| t.replacen("\"/>", "\"><inertial><mass value=\"heavy\"/></inertial></link>", 1),
        Some("mass value is \"heavy\""),
    ),
    (
        "links that nothing names",
        |t| inside(t, "<link name=\"unused\"/>"),
        None,
    ),
    (
        "links that are not listed",
        |t| t.replacen("<link name=\"link3\"/>", "", 1),
        None,
    ),
    (
        "a link's name twice",
        |t| inside(t, "<link name=\"twice\"/><link name=\"twice\"/>"),
        Some("a link's name is \"twice\": stands twice"),
    ),
    ("no axis", |t| t.replacen("<axis xyz=\"0 0 1\"/>", "", 1), None),
    (
        "a long axis",
        |t| t.replace("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 -2\"/>"),
        None,
    ),
    (
        "an axis without length",
        |t| t.replacen("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", 1),
        Some("axis xyz is \"0 0 0\""),
    ),
    (
        "no origin",
        |t| t.replacen("<origin xyz=\"0.01 0.02 0.1\" rpy=\"0 0 0.1\"/>", "", 1),
        None,
    ),
    ("numbers of C", |t| t.replace("0.01 0.02 0.1", "+.01 2.e-2 1E-1"), None),
    (
        "commas in numbers",
        |t| t.replacen("0.01 0.02 0.1", "0.01, 0.02, 0.1", 1),
        Some("separated by spaces"),
    ),
    (
        "two numbers",
        |t| t.replacen("0.01 0.02 0.1", "0.01 0.02", 1),
        Some("three numbers"),
    ),
    (
        "a length in mm",
        |t| t.replacen("0.01 0.02 0.1", "10 20 1000", 1),
        Some("lengths are in m"),
    ),
    (
        "an angle in degrees",
        |t| t.replacen("0 0 0.1\"", "0 0 90\"", 1),
        Some("angles in rad"),
    ),
    (
        "infinite limits",
        |t| t.replace("<axis", "<limit lower=\"-inf\" upper=\"inf\" velocity=\"inf\"/><axis"),
        None,
    ),
    (
        "calibration, dynamics and safety",
        |t| {
            t.replace(
                "<axis",
                "<calibration rising=\"0\"/><dynamics damping=\"1\"/><safety_controller k_velocity=\"1\"/><axis",
            )
        },
        None,
    ),
];

// Fails if a robot of the field gets another root, tip or number of joints than a person would name, or is refused without
// the reason.
#[test]
fn robots_of_the_field_are_read_or_refused_in_one_line() {
    let mut wrong = Vec::new();
    for (name, joints, expected) in robots() {
        check(name, &tree(&joints), expected, &mut wrong);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

// Fails if a change of the text that says nothing about the joints moves the tip of an arm, if one that makes the file useless
// is read, or if the file is not written back as it was.
#[test]
fn odd_texts_are_read_or_refused_in_one_line() {
    let mut wrong = Vec::new();
    for (robot, joints, expected) in robots() {
        let Read(..) = expected else { continue };
        // The changes are of the first joint: it turns about z.
        if !joints.starts_with("joint1") {
            continue;
        }
        for (name, change, refusal) in CHANGES {
            let text = change(&tree(&joints));
            let expected = refusal.map_or(expected, Refused);
            check(&format!("{robot}, {name}"), &text, expected, &mut wrong);
            if let Ok(model) = read(&text)
                && write_urdf(&model, &model.rows(), &[]) != text
            {
                wrong.push(format!("{robot}, {name}: it is written back otherwise"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
