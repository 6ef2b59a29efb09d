//! Where arms of the field end, from small files with their joints and links.

use super::super::*;

/// A URDF of `joint type parent child`, one joint a line, `;` between.
pub(super) fn tree(joints: &str) -> String {
    let mut links: Vec<&str> = Vec::new();
    let mut out = "<robot name=\"small\">\n".to_owned();
    for (k, line) in joints.split(';').map(str::trim).filter(|l| !l.is_empty()).enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, kind, parent, child, rest @ ..] = words.as_slice() else {
            panic!("{line}")
        };
        for link in [parent, child] {
            if !links.contains(link) {
                links.push(link);
                out += &format!("<link name=\"{link}\"/>\n");
            }
        }
        let mimic = rest.first().map_or(String::new(), |leader| {
            format!("<mimic joint=\"{leader}\" multiplier=\"-1\"/>")
        });
        let axis = ["0 0 1", "0 1 0", "1 0 0"][k % 3];
        out += &format!(
            "<joint name=\"{name}\" type=\"{kind}\"><origin xyz=\"0.01 0.02 0.1\" rpy=\"0 0 0.1\"/><parent \
             link=\"{parent}\"/><child link=\"{child}\"/><axis xyz=\"{axis}\"/>{mimic}</joint>\n"
        );
    }
    out + "</robot>\n"
}

/// Joints `name1..` in a row from `from`, with links `link1..`.
pub(super) fn row(prefix: &str, from: &str, count: usize) -> String {
    let mut parent = from.to_owned();
    let mut out = String::new();
    for k in 1..=count {
        out += &format!("{prefix}joint{k} revolute {parent} {prefix}link{k};");
        parent = format!("{prefix}link{k}");
    }
    out
}

fn tip(text: &str) -> Result<String, String> {
    let model = urdf_in::load_path("r.urdf", text, None, None).map_err(|e| e.to_string())?;
    Ok(model.frame_names.1)
}

/// The arms of the field, with the tip that a person would name.
const ARMS: [(&str, &str, &str); 13] = [
    (
        "SO-100",
        "Rotation revolute Base Rotation_Pitch; Pitch revolute Rotation_Pitch Upper_Arm; Elbow revolute Upper_Arm Lower_Arm; \
         Wrist_Pitch revolute Lower_Arm Wrist_Pitch_Roll; Wrist_Roll revolute Wrist_Pitch_Roll Fixed_Jaw; \
         Jaw revolute Fixed_Jaw Moving_Jaw",
        "Fixed_Jaw",
    ),
    (
        "SO-101",
        "shoulder_pan revolute base_link shoulder_link; shoulder_lift revolute shoulder_link upper_arm_link; \
         elbow_flex revolute upper_arm_link lower_arm_link; wrist_flex revolute lower_arm_link wrist_link; \
         wrist_roll revolute wrist_link gripper_link; gripper revolute gripper_link moving_jaw_so101_v1_link; \
         gripper_frame_joint fixed gripper_link gripper_frame_link",
        "gripper_link",
    ),
    (
        "Koch",
        "joint_1 revolute base_link link_1; joint_2 revolute link_1 link_2; joint_3 revolute link_2 link_3; \
         joint_4 revolute link_3 link_4; joint_5 revolute link_4 link_5; joint_gripper revolute link_5 gripper_moving",
        "link_5",
    ),
    (
        "Interbotix vx300s",
        "waist revolute base_link shoulder_link; shoulder revolute shoulder_link upper_arm_link; \
         elbow revolute upper_arm_link upper_forearm_link; forearm_roll revolute upper_forearm_link lower_forearm_link; \
         wrist_angle revolute lower_forearm_link wrist_link; wrist_rotate revolute wrist_link gripper_link; \
         ee_arm fixed gripper_link ee_arm_link; gripper continuous ee_arm_link gripper_prop_link; \
         gripper_bar fixed ee_arm_link gripper_bar_link; ee_bar fixed gripper_bar_link fingers_link; \
         left_finger prismatic fingers_link left_finger_link; right_finger prismatic fingers_link right_finger_link; \
         ee_gripper fixed fingers_link ee_gripper_link",
        "ee_arm_link",
    ),
    (
        "Stretch",
        "joint_right_wheel continuous base_link link_right_wheel; joint_left_wheel continuous base_link link_left_wheel; \
         joint_mast fixed base_link link_mast; joint_lift prismatic link_mast link_lift; joint_arm_l4 fixed link_lift link_arm_l4; \
         joint_arm_l3 prismatic link_arm_l4 link_arm_l3; joint_arm_l2 prismatic link_arm_l3 link_arm_l2; \
         joint_arm_l1 prismatic link_arm_l2 link_arm_l1; joint_arm_l0 prismatic link_arm_l1 link_arm_l0; \
         joint_wrist_yaw revolute link_arm_l0 link_wrist_yaw; joint_gripper fixed link_wrist_yaw link_gripper; \
         joint_gripper_finger_left revolute link_gripper link_finger_left; \
         joint_gripper_finger_right revolute link_gripper link_finger_right; joint_head fixed link_mast link_head; \
         joint_head_pan revolute link_head link_head_pan; joint_head_tilt revolute link_head_pan link_head_tilt; \
         camera_joint fixed link_head_tilt camera_link",
        "link_wrist_yaw",
    ),
    (
        "Kinova Gen3",
        "joint_1 continuous base_link shoulder_link; joint_2 revolute shoulder_link half_arm_1_link; \
         joint_3 continuous half_arm_1_link half_arm_2_link; joint_4 revolute half_arm_2_link forearm_link; \
         joint_5 continuous forearm_link spherical_wrist_1_link; joint_6 revolute spherical_wrist_1_link spherical_wrist_2_link; \
         joint_7 continuous spherical_wrist_2_link bracelet_link; end_effector fixed bracelet_link end_effector_link; \
         robotiq_85_base_joint fixed end_effector_link robotiq_85_base_link; \
         robotiq_85_left_knuckle_joint revolute robotiq_85_base_link robotiq_85_left_knuckle_link; \
         robotiq_85_left_finger_joint fixed robotiq_85_left_knuckle_link robotiq_85_left_finger_link; \
         robotiq_85_right_knuckle_joint revolute robotiq_85_base_link robotiq_85_right_knuckle_link robotiq_85_left_knuckle_joint; \
         camera_module fixed bracelet_link camera_link",
        "end_effector_link",
    ),
    (
        "Kinova j2s7s300",
        "j2s7s300_joint_base fixed root link_base; joint_1 continuous link_base link_1; joint_2 revolute link_1 link_2; \
         joint_3 continuous link_2 link_3; joint_4 revolute link_3 link_4; joint_5 continuous link_4 link_5; \
         joint_6 revolute link_5 link_6; joint_7 continuous link_6 link_7; joint_end_effector fixed link_7 end_effector; \
         joint_finger_1 revolute link_7 link_finger_1; joint_finger_tip_1 revolute link_finger_1 link_finger_tip_1; \
         joint_finger_2 revolute link_7 link_finger_2; joint_finger_3 revolute link_7 link_finger_3",
        "end_effector",
    ),
    (
        "UR",
        "base_link-base_link_inertia fixed base_link base_link_inertia; shoulder_pan_joint revolute base_link_inertia shoulder_link; \
         shoulder_lift_joint revolute shoulder_link upper_arm_link; elbow_joint revolute upper_arm_link forearm_link; \
         wrist_1_joint revolute forearm_link wrist_1_link; wrist_2_joint revolute wrist_1_link wrist_2_link; \
         wrist_3_joint revolute wrist_2_link wrist_3_link; base_link-base_fixed_joint fixed base_link base; \
         wrist_3_link-ft_frame fixed wrist_3_link ft_frame; wrist_3-flange fixed wrist_3_link flange; flange-tool0 fixed flange tool0",
        "tool0",
    ),
    (
        "Franka with its hand",
        "panda_joint1 revolute panda_link0 panda_link1; panda_joint2 revolute panda_link1 panda_link2; \
         panda_joint3 revolute panda_link2 panda_link3; panda_joint4 revolute panda_link3 panda_link4; \
         panda_joint5 revolute panda_link4 panda_link5; panda_joint6 revolute panda_link5 panda_link6; \
         panda_joint7 revolute panda_link6 panda_link7; panda_joint8 fixed panda_link7 panda_link8; \
         panda_hand_joint fixed panda_link8 panda_hand; panda_hand_tcp_joint fixed panda_hand panda_hand_tcp; \
         panda_finger_joint1 prismatic panda_hand panda_leftfinger; \
         panda_finger_joint2 prismatic panda_hand panda_rightfinger panda_finger_joint1",
        "panda_link8",
    ),
    (
        "Fetch",
        "r_wheel_joint continuous base_link r_wheel_link; torso_lift_joint prismatic base_link torso_lift_link; \
         head_pan_joint revolute torso_lift_link head_pan_link; head_tilt_joint revolute head_pan_link head_tilt_link; \
         shoulder_pan_joint revolute torso_lift_link shoulder_pan_link; shoulder_lift_joint revolute shoulder_pan_link shoulder_lift_link; \
         upperarm_roll_joint continuous shoulder_lift_link upperarm_roll_link; elbow_flex_joint revolute upperarm_roll_link elbow_flex_link; \
         forearm_roll_joint continuous elbow_flex_link forearm_roll_link; wrist_flex_joint revolute forearm_roll_link wrist_flex_link; \
         wrist_roll_joint continuous wrist_flex_link wrist_roll_link; gripper_axis fixed wrist_roll_link gripper_link; \
         r_gripper_finger_joint prismatic gripper_link r_gripper_finger_link; \
         l_gripper_finger_joint prismatic gripper_link l_gripper_finger_link; bellows_joint fixed torso_lift_link bellows_link",
        "wrist_roll_link",
    ),
    (
        "a gripper without names",
        "j1 revolute a b; j2 revolute b c; j3 revolute c d; j4 revolute d e; j5 revolute e f; j6 fixed f g; j7 prismatic g h; \
         j8 prismatic g i j7",
        "g",
    ),
    (
        "SCARA",
        "joint1 revolute base link1; joint2 revolute link1 link2; joint3 prismatic link2 link3; joint4 revolute link3 link4",
        "link4",
    ),
    (
        "an arm on a floating body with lidar",
        "float floating world body; lidar_joint continuous body lidar; j1 revolute body b; j2 revolute b c; j3 revolute c d; \
         j4 revolute d e; tcp_joint fixed e my_tcp",
        "my_tcp",
    ),
];

// Fails if an arm ends at a jaw, a finger, a propeller, a camera or a head, or is cut at a joint that slides.
#[test]
fn arms_of_the_field_end_where_people_say() {
    for (name, joints, expected) in ARMS {
        assert_eq!(tip(&tree(joints)), Ok(expected.to_owned()), "{name}");
    }
    let floating = urdf_in::load_path("r.urdf", &tree(ARMS[12].1), None, None).unwrap();
    assert_eq!(floating.frame_names.0, "body");
}

// Fails if one of several arms is taken without being asked for, or the question does not name them.
#[test]
fn a_tip_that_is_not_clear_is_asked_for() {
    let two = format!(
        "torso prismatic base body; {} {} head_pan revolute body head; lf fixed left_link6 left_flange",
        row("left_", "body", 6),
        row("right_", "body", 6)
    );
    let asked = tip(&tree(&two)).unwrap_err();
    for word in [
        "several could be meant",
        "left_flange",
        "right_link6",
        "r.urdf#BASE:LINK",
    ] {
        assert!(asked.contains(word), "{asked}");
    }
    assert!(!asked.contains("head"), "{asked}");
    // A wrist or a jaw: the joint's name says neither.
    let koch = format!("{} joint6 revolute link5 gripper", row("", "base", 5));
    let asked = tip(&tree(&koch)).unwrap_err();
    assert!(asked.contains("link5, gripper"), "{asked}");
    let named = |ends| urdf_in::load_path("r.urdf", &tree(&two), Some(ends), None);
    let model = named("body:left_flange").unwrap();
    assert_eq!(model.frame_names, ("body".to_owned(), "left_flange".to_owned()));
    assert_eq!(model.joint_names.len(), 6);
    let all: Vec<String> = ["torso", "right_joint1", "head_pan"].map(str::to_owned).into();
    let (others, carriers) = model.other_joints().unwrap();
    assert!(
        all.iter().all(|name| others.contains(name)) && others.len() == 8,
        "{others:?}"
    );
    assert_eq!(carriers, ["torso"]);
    // The way from the root holds the torso: no plain arm.
    let whole = named("left_flange").unwrap();
    assert_eq!(whole.joint_path().unwrap().columns[..2], ["torso", "left_joint1"]);
    let refused = whole.plain().unwrap_err().to_string();
    assert!(refused.contains("joint \"torso\": type is \"prismatic\""), "{refused}");
    for (ends, words) in [
        ("nowhere", "tip link is \"nowhere\": name one of the file's links"),
        ("nowhere:left_flange", "base link is \"nowhere\""),
        ("left_flange:left_flange", "no joint leads from it to left_flange"),
    ] {
        let refused = named(ends).unwrap_err().to_string();
        assert!(refused.contains(words), "{refused}");
    }
}

// Fails if the SRDF beside a file does not decide, or one that does not fit the file breaks it.
#[test]
fn the_srdf_beside_a_file_decides() {
    let two = format!("{} {}", row("a_", "base", 6), row("b_", "base", 6));
    let srdf = |text: &str| urdf::Srdf::parse("r.srdf", text);
    let chain = srdf(
        "<robot name=\"r\"><group name=\"manipulator\"><chain base_link=\"base\" tip_link=\"b_link5\"/></group>\
         <group name=\"gripper\"><chain base_link=\"b_link5\" tip_link=\"b_link6\"/></group></robot>",
    );
    let effector =
        srdf("<robot name=\"r\"><end_effector name=\"hand\" parent_link=\"a_link6\" group=\"hand\"/></robot>");
    let foreign = srdf("<robot name=\"r\"><group name=\"arm\"><chain tip_link=\"elsewhere\"/></group></robot>");
    let load = |srdf: &urdf::Srdf| urdf_in::load_path("r.urdf", &tree(&two), None, Some(srdf)).map(|m| m.frame_names.1);
    assert_eq!(load(&chain.unwrap()).unwrap(), "b_link5");
    assert_eq!(load(&effector.unwrap()).unwrap(), "a_link6");
    assert!(
        load(&foreign.unwrap())
            .unwrap_err()
            .to_string()
            .contains("a_link6, b_link6")
    );
    assert!(srdf("<robot").is_err());
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("arm.urdf");
    std::fs::write(&file, tree(&two)).unwrap();
    std::fs::write(
        folder.path().join("arm.srdf"),
        "<robot><group name=\"arm\"><chain tip_link=\"a_link4\"/></group></robot>",
    )
    .unwrap();
    assert_eq!(load_path(&file.display().to_string()).unwrap().frame_names.1, "a_link4");
}

// Fails if a mimic joint of a parallelogram gets a column of its own, or moves otherwise than its law says.
#[test]
fn a_parallelogram_follows_its_leader() {
    let text = tree(
        "q1 revolute base a; q2 revolute a b; q3 revolute a rod; rod2 revolute b c q2; q4 revolute c d; q5 revolute d tool0",
    );
    let model = urdf_in::load_path("r.urdf", &text, None, None).unwrap();
    let path = model.joint_path().unwrap();
    assert_eq!(path.columns, ["q1", "q2", "q4", "q5"]);
    assert_eq!(path.positions(&[0.1, 0.2, 0.3, 0.4]), [0.1, 0.2, -0.2, 0.3, 0.4]);
    assert_eq!(model.robot.dof(), 5);
    let q = path.positions(&[0.1, 0.2, 0.3, 0.4]);
    assert!(frames::distance(&path.frames(&q).tip, &model.flange_at(&path.table_angles(&q))) < 1e-12);
}

// Fails if odd limits, a prefix without a declaration or bytes of ISO-8859-1 refuse a file, or are not said once.
#[test]
fn odd_files_are_read_and_said_once() {
    let plain = data_arm();
    for (from, to, words) in [
        ("lower=\"-3\"", "lower=\"-1e16\"", "lower is -1e16"),
        ("upper=\"3\"", "upper=\"inf\"", "upper is inf"),
        (
            "lower=\"-3\" upper=\"3\"",
            "lower=\"0\" upper=\"0\"",
            "lower is 0 and upper is 0",
        ),
        ("velocity=\"2\"", "velocity=\"10000\"", "velocity is 10000"),
        ("effort=\"50\"", "effort=\"1e9\"", "effort is 1e9"),
    ] {
        let model = load_urdf_text("r.urdf", &plain.replacen(from, to, 1), None).unwrap();
        assert_eq!(model.notes.len(), 1, "{:?}", model.notes);
        assert!(model.notes[0].contains(words), "{:?}", model.notes);
        let l = &model.robot.joints[0].limits;
        assert!(l.min_rad < l.max_rad && l.velocity_rad_s > 0.0 && l.torque_nm > 0.0);
    }
    let prefixed = plain.replacen(
        "</robot>",
        "<gazebo><ignition:plugin sim:name=\"gazebo: not declared\"/></gazebo></robot>",
        1,
    );
    let model = load_urdf_text("r.urdf", &prefixed, None).unwrap();
    assert!(
        model.notes[0].contains("prefix ignition, sim is not declared")
            || model.notes[0].contains("prefix sim, ignition"),
        "{:?}",
        model.notes
    );
    // The file is written back with its own prefixes.
    assert_eq!(write_urdf(&model, &model.rows(), &[]), prefixed);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("latin.urdf");
    let text = format!("<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\n<!-- M\u{fc}ller -->{plain}");
    std::fs::write(&file, text.chars().map(|c| c as u8).collect::<Vec<u8>>()).unwrap();
    let model = load(&file.display().to_string()).unwrap();
    let out = write_urdf(&model, &model.rows(), &[]);
    assert_eq!(out, text.replace("ISO-8859-1", "UTF-8"));
}

fn data_arm() -> String {
    tree(&format!("{} t fixed link6 tool0", row("", "base", 6))).replacen(
        "<axis",
        "<limit lower=\"-3\" upper=\"3\" velocity=\"2\" effort=\"50\"/><axis",
        1,
    )
}
