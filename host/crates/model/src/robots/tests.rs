//! What must hold of every robot file: the table's forward kinematics are the
//! file's own, whatever its axes.
#![allow(clippy::approx_constant)] // URDF files write 1.5708.

use proptest::prelude::*;
use spherecal_shared::robot::Pose;

use super::frames::{compose, distance, rot_axis};
use super::urdf::{JointMotion, Urdf};
use super::*;

/// The file's own forward kinematics, joint by joint, independent of the table.
fn urdf_flange(urdf: &Urdf, path: &[usize], q: &[f64]) -> Pose<f64> {
    let mut angles = q.iter();
    path.iter().fold(Pose::identity(), |frame, &i| {
        let joint = &urdf.joints[i];
        let at = compose(&frame, &joint.origin);
        if joint.motion != JointMotion::Turns {
            return at;
        }
        let turn = Pose {
            rotation: rot_axis(&joint.axis, *angles.next().unwrap()),
            position: nalgebra::Vector3::zeros(),
        };
        compose(&at, &turn)
    })
}

fn check_kinematics(text: &str, q: &[f64], tolerance: f64) -> RobotModel {
    let model = load_urdf_text("test.urdf", text, None).unwrap();
    let Origin::Urdf(source) = &model.origin else {
        panic!("not a URDF")
    };
    let expected = urdf_flange(&source.0, &source.1.path, q);
    let off = distance(&model.flange_at(q), &expected);
    assert!(off < tolerance, "off by {off:e}");
    model
}

fn data(name: &str) -> String {
    std::fs::read_to_string(format!("{}/../../../tests/data/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

#[test]
fn the_iiwas_of_the_field_keep_their_kinematics() {
    for (name, q) in [
        ("iiwa7.urdf", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]),
        ("iiwa14.urdf", [-1.0, 0.5, 2.0, -1.4, 0.3, 0.9, -3.0]),
    ] {
        let model = check_kinematics(&data(name), &q, 1e-12);
        assert_eq!(model.robot.dof(), 7);
        assert!(distance(&model.base, &Pose::identity()) < 1e-15);
    }
}

/// A serial chain with random origins and axes, some parallel, some at right
/// angles, some with fixed joints between.
fn random_urdf() -> impl Strategy<Value = (String, Vec<f64>)> {
    let right = prop_oneof![
        Just(0.0),
        Just(std::f64::consts::FRAC_PI_2),
        Just(-std::f64::consts::FRAC_PI_2),
        Just(1.5708),
        -3.0..3.0_f64
    ];
    let length = prop_oneof![Just(0.0), -0.5..0.5_f64];
    let axis = prop_oneof![
        Just("0 0 1".to_owned()),
        Just("0 1 0".to_owned()),
        Just("-1 0 0".to_owned()),
        Just("0.001 0 1".to_owned()),
        Just("1 2 -0.5".to_owned())
    ];
    let joint = (
        length.clone(),
        length.clone(),
        length,
        right.clone(),
        right.clone(),
        right,
        axis,
        any::<bool>(),
    );
    (proptest::collection::vec(joint, 1..=8), proptest::collection::vec(-3.0..3.0_f64, 8)).prop_map(|(joints, q)| {
        let n = joints.len();
        let mut text = "<robot name=\"random\"><link name=\"l0\"/>".to_owned();
        let mut parent = "l0".to_owned();
        for (k, (x, y, z, r, p, w, axis, fixed)) in joints.into_iter().enumerate() {
            let origin = format!("<origin xyz=\"{x:?} {y:?} {z:?}\" rpy=\"{r:?} {p:?} {w:?}\"/>");
            if fixed {
                text += &format!("<link name=\"f{k}\"/><joint name=\"f{k}\" type=\"fixed\">{origin}<parent link=\"{parent}\"/><child link=\"f{k}\"/></joint>");
                parent = format!("f{k}");
            }
            let child = format!("m{k}");
            text += &format!("<link name=\"{child}\"><inertial><origin xyz=\"0.01 {x:?} 0\" rpy=\"0 {r:?} 0\"/><mass value=\"2\"/><inertia ixx=\"0.02\" iyy=\"0.03\" izz=\"0.01\" ixy=\"0.001\" ixz=\"0\" iyz=\"0\"/></inertial></link><joint name=\"{child}\" type=\"revolute\">{origin}<parent link=\"{parent}\"/><child link=\"{child}\"/><axis xyz=\"{axis}\"/><limit lower=\"-3\" upper=\"3\" velocity=\"2\" effort=\"50\"/></joint>");
            parent = child;
        }
        text += "<link name=\"tool0\"/><joint name=\"t\" type=\"fixed\"><origin xyz=\"0.01 0.02 0.03\" rpy=\"0.1 0.2 0.3\"/>";
        text += &format!("<parent link=\"{parent}\"/><child link=\"tool0\"/></joint></robot>");
        (text, q[..n].to_vec())
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Fails if any arrangement of axes loses the file's kinematics.
    #[test]
    fn any_chain_of_revolute_joints_converts_exactly((text, q) in random_urdf()) {
        // Lengths of a table with near-parallel axes reach tens of metres: the tolerance is relative to them.
        let Ok(model) = load_urdf_text("test.urdf", &text, None) else { return Ok(()) };
        let reach: f64 = model.rows().iter().map(|r| r.a.abs() + r.d.abs()).sum::<f64>().max(1.0);
        check_kinematics(&text, &q, 1e-12 * reach);
        // Written and read again, the table is the same to the last bit.
        let again = toml_file::load("test.toml", &toml_file::write(&model, &[])).unwrap();
        prop_assert_eq!(&again.robot, &model.robot);
        prop_assert!(distance(&again.flange_at(&q), &model.flange_at(&q)) < 1e-14 * reach);
    }

    /// Any text is read or refused, never a panic.
    #[test]
    fn no_text_breaks_a_reader(text in "\\PC*", tag in "[a-z<>/=\" ]*") {
        let _ = load_urdf_text("x.urdf", &text, None);
        let _ = load_urdf_text("x.urdf", &format!("<robot name='x'><link name='a'/>{tag}</robot>"), None);
        let _ = toml_file::load("x.toml", &text);
        let _ = kinematics_yaml::load("x.yaml", &text);
        let _ = kinematics_yaml::load("x.yaml", &format!("kinematics:\n  a:\n    x: 1\n{tag}"));
    }
}

/// Fails if a built-in table and the published URDF differ in any length,
/// angle, mass, inertia or limit.
#[test]
fn built_in_tables_are_the_published_robots() {
    for (name, file) in [
        ("iiwa14", "iiwa14_lbr"),
        ("panda", "panda"),
        ("fr3", "fr3"),
        ("ur5e", "ur5e"),
        ("ur10e", "ur10e"),
        ("irb120", "irb120"),
    ] {
        let table = load(name).unwrap();
        let file = load_urdf_text(file, &data(&format!("{file}.urdf")), None).unwrap();
        assert!(distance(&file.base, &Pose::identity()) < 1e-12, "{name}");
        assert!(distance(&file.flange, &Pose::identity()) < 1e-12, "{name}");
        assert_eq!(table.robot.dof(), file.robot.dof());
        for (a, b) in table.robot.joints.iter().zip(&file.robot.joints) {
            let (m, n) = (&a.mdh, &b.mdh);
            for (x, y) in [
                (m.a, n.a),
                (m.d, n.d),
                (m.alpha, n.alpha),
                (m.beta, n.beta),
                (m.theta, n.theta),
            ] {
                // 180 and −180 degrees are the same angle.
                assert!(
                    (x - y).abs() < 1e-11 || ((x - y).abs() - std::f64::consts::TAU).abs() < 1e-11,
                    "{name}"
                );
            }
            assert!((a.link.mass_kg - b.link.mass_kg).abs() < 1e-12);
            assert!((a.link.com() - b.link.com()).amax() < 1e-11, "{name}");
            assert!((a.link.matrix() - b.link.matrix()).amax() < 1e-13, "{name}");
            assert_eq!(a.limits, b.limits, "{name}");
        }
    }
    for name in BUILT_IN {
        assert!(load(name).unwrap().robot.check().is_ok(), "{name}");
    }
}

/// The masses of the file end in the right links: gravity torque and mass
/// matrix of the URDF's iiwa 7 are those of the built-in one.
#[test]
fn inertias_of_the_urdf_are_those_of_the_table() {
    use spherecal_shared::robot::{Arm, Dynamics};
    let bare = Tool::default();
    let file = load_urdf_text("iiwa7", &data("iiwa7.urdf"), None).unwrap();
    let a = Arm::<f64, 7>::new(&file.robot, &bare).unwrap();
    let b = Arm::<f64, 7>::new(&load("iiwa7").unwrap().robot, &bare).unwrap();
    let q = [0.3, -0.7, 1.1, -1.3, 0.2, 0.9, -0.4];
    let gravity = |arm: &Arm<f64, 7>| arm.bodies(&arm.frames(&q)).gravity();
    assert!((gravity(&a) - gravity(&b)).amax() < 1e-9);
    let mass = |arm: &Arm<f64, 7>| arm.bodies(&arm.frames(&q)).mass_matrix();
    assert!((mass(&a) - mass(&b)).amax() < 1e-9);
}

/// A table with every parameter of every row changed.
fn disturbed(model: &RobotModel, size: f64) -> Vec<spherecal_shared::robot::MdhRow<f64>> {
    let mut rows = model.rows();
    for (k, r) in rows.iter_mut().enumerate() {
        let s = |n: usize| ((k * 5 + n) as f64 * 1.7).sin() * size;
        r.alpha += s(0);
        r.a += s(1);
        r.beta += s(2);
        r.theta += s(3);
        r.d += s(4);
    }
    rows
}

/// Fails if the calibrated URDF, read back and computed joint by joint, differs
/// from the calibrated table, or loses anything else of the input.
#[test]
fn a_calibrated_urdf_moves_as_the_calibrated_table() {
    let q = [0.3, -0.7, 1.1, -1.3, 0.2, 0.9, -0.4];
    for name in ["iiwa7.urdf", "iiwa14.urdf", "ur5e.urdf", "panda.urdf", "irb120.urdf"] {
        let text = data(name).replace("<robot ", "<!-- kept --><robot extra=\"1\" ");
        let model = load_urdf_text(name, &text, None).unwrap();
        let q = &q[..model.robot.dof()];
        assert_eq!(
            write_urdf(&model, &model.rows(), &[]),
            text,
            "{name}: nominal in, nominal out"
        );
        let rows = disturbed(&model, 3e-3);
        let out = write_urdf(&model, &rows, &["calibrated -- on <Monday>".to_owned()]);
        assert!(out.contains("<!-- kept -->") && out.contains("extra=\"1\""));
        let again = Urdf::parse(name, &out).unwrap();
        let chain = again.chain(None).unwrap();
        let off = distance(&urdf_flange(&again, &chain.path, q), &model.flange_with(&rows, q));
        assert!(off < 1e-12, "{name}: off by {off:e}");
    }
}

/// The same for robots that no URDF came with: one is made.
#[test]
fn a_made_urdf_moves_as_the_table() {
    let q = [0.3, -0.7, 1.1, -1.3, 0.2, 0.9, -0.4];
    for name in BUILT_IN {
        let model = load(name).unwrap();
        let rows = disturbed(&model, 3e-3);
        let made = load_urdf_text("made.urdf", &write_urdf(&model, &rows, &[]), None).unwrap();
        let q = &q[..model.robot.dof()];
        let off = distance(&made.flange_at(q), &model.flange_with(&rows, q));
        assert!(off < 1e-12, "{name}: off by {off:e}");
        assert_eq!(made.frame_names, model.frame_names);
        let mass = |m: &RobotModel| m.robot.joints.iter().map(|j| j.link.mass_kg).sum::<f64>();
        assert!((mass(&made) - mass(&model)).abs() < 1e-12);
    }
}

/// Fails if the joint origins, read back as a robot, move otherwise than the table
/// that they were written from; or if the vendor's keys are not there.
#[test]
fn joint_origins_go_round_in_the_vendors_forms() {
    let q = [0.3, -0.7, 1.1, -1.3, 0.2, 0.9, -0.4];
    for (name, keys) in [
        (
            "ur5e",
            &[
                "kinematics:",
                "  shoulder:",
                "  wrist_3:",
                "    roll: 1.57",
                "  hash: calib_",
            ][..],
        ),
        ("ur10e", &["  upper_arm:", "  forearm:", "  wrist_1:", "  wrist_2:"]),
        ("panda", &["joint1:", "  kinematic:", "    z: 0.333", "joint8:"]),
        ("fr3", &["joint7:"]),
        ("iiwa14", &["kinematics:", "  joint_1:", "  joint_7:"]),
        ("ur5e.urdf", &["  shoulder:", "  wrist_3:"]),
        ("panda.urdf", &["joint1:", "joint8:"]),
        ("iiwa7.urdf", &["  lbr_A1:", "  lbr_A7:"]),
        ("irb120.urdf", &["  joint_6:"]),
    ] {
        let model = match name.strip_suffix(".urdf") {
            Some(_) => load_urdf_text(name, &data(name), None).unwrap(),
            None => load(name).unwrap(),
        };
        let q = &q[..model.robot.dof()];
        for rows in [model.rows(), disturbed(&model, 3e-3)] {
            let yaml = write_kinematics_yaml(&model, &rows, &["of \u{1b}[2J\nMonday".to_owned()]);
            assert!(yaml.starts_with("# of \\u001b[2J\n# Monday\n"), "{yaml}");
            for key in keys.iter().filter(|k| !k.contains('.') || rows == model.rows()) {
                assert!(yaml.lines().any(|l| l.starts_with(key)), "{name}: {key} not in {yaml}");
            }
            let again = kinematics_yaml::load("again.yaml", &yaml).unwrap();
            // The last frames are compared where both files have the same one.
            let (a, b) = (again.flange_at(q), model.flange_with(&rows, q));
            let fixed = compose(&super::frames::inverse(&a), &b);
            let other: Vec<f64> = q.iter().map(|q| 1.3 - q).collect();
            let (a, b) = (again.flange_at(&other), model.flange_with(&rows, &other));
            let off = distance(&compose(&a, &fixed), &b);
            assert!(off < 1e-11, "{name}: off by {off:e}");
            if keys[0] != "kinematics:" || name == "ur5e" {
                assert!(
                    name.contains(".urdf") || distance(&fixed, &Pose::identity()) < 1e-11,
                    "{name}: {fixed:?}"
                );
            }
        }
    }
}

/// Fails if a built-in robot and the URDF by its vendor give other joint origins.
#[test]
fn built_in_and_vendors_files_give_the_same_origins() {
    for name in ["ur5e", "ur10e", "panda", "fr3"] {
        let table = load(name).unwrap();
        let file = load_urdf_text(name, &data(&format!("{name}.urdf")), None).unwrap();
        assert_eq!(table.joint_names, file.joint_names, "{name}");
        let rows = disturbed(&table, 2e-3);
        let (a, b) = (
            numbers(&write_kinematics_yaml(&table, &rows, &[])),
            numbers(&write_kinematics_yaml(&file, &rows, &[])),
        );
        assert!(a.len() >= 36 && a.len() == b.len());
        for (x, y) in a.chunks(6).zip(b.chunks(6)) {
            let frame = |n: &[f64]| Pose {
                rotation: super::frames::from_rpy([n[3], n[4], n[5]]),
                position: nalgebra::Vector3::new(n[0], n[1], n[2]),
            };
            assert!(distance(&frame(x), &frame(y)) < 1e-10, "{name}: {x:?} {y:?}");
        }
        // What came home as TOML is still known by its name.
        let mut calibrated = table.clone();
        for (joint, row) in calibrated.robot.joints.iter_mut().zip(&rows) {
            joint.mdh = *row;
        }
        let again = toml_file::load("c.toml", &toml_file::write(&calibrated, &[])).unwrap();
        assert_eq!(again.joint_names, table.joint_names);
        assert_eq!(
            write_kinematics_yaml(&again, &again.rows(), &[]),
            write_kinematics_yaml(&table, &rows, &[])
        );
        assert_eq!(
            write_offsets_yaml(&again, &again.rows(), &[]),
            write_offsets_yaml(&table, &rows, &[])
        );
    }
}

/// The numbers of a YAML file of joint origins, six per joint.
fn numbers(yaml: &str) -> Vec<f64> {
    let lines = yaml.lines().filter(|l| l.starts_with("    "));
    lines.map(|l| l.rsplit_once(' ').unwrap().1.parse().unwrap()).collect()
}

/// Fails if nominal numbers plus the offsets are not the calibrated ones.
#[test]
fn offsets_add_up() {
    let file = load_urdf_text("ur5e.urdf", &data("ur5e.urdf"), None).unwrap();
    for model in [file, load("ur10e").unwrap(), load("fr3").unwrap()] {
        let rows = disturbed(&model, 2e-3);
        let offsets = write_offsets_yaml(&model, &rows, &[]);
        assert!(
            offsets.contains(&format!("  {}:\n    x: ", model.joint_names[0])),
            "{offsets}"
        );
        let nominal = numbers(&write_kinematics_yaml(&model, &model.rows(), &[]));
        let calibrated = numbers(&write_kinematics_yaml(&model, &rows, &[]));
        for ((offset, was), is) in numbers(&offsets).iter().zip(&nominal).zip(&calibrated) {
            assert!((was + offset - is).abs() < 1e-15);
            // Small corrections stay small: the angles are those that the file is written with.
            assert!(offset.abs() < 0.02, "{offsets}");
        }
        assert!(
            numbers(&write_offsets_yaml(&model, &model.rows(), &[]))
                .iter()
                .all(|o| o.abs() < 1e-12)
        );
    }
}

#[test]
fn joint_origins_that_cannot_be_used_are_named() {
    let good = write_kinematics_yaml(&load("ur5e").unwrap(), &load("ur5e").unwrap().rows(), &[]);
    for (text, words) in [
        (
            good.replacen("    x: 0\n", "", 1),
            "shoulder: x is \"\": give all six numbers",
        ),
        (
            good.replacen("    x: 0\n", "    x: ${pi}\n", 1),
            "shoulder: x is \"${pi}\": write a finite number",
        ),
        (good.replacen("    x: 0\n", "    x: .nan\n", 1), "write a finite number"),
        (good.replacen("    x: 0\n", "    x: 0\n    w: 0\n", 1), "shoulder: w is"),
        (good.replacen("    x: 0\n", "    x: 0\n    x: 0\n", 1), "stands twice"),
        (good.replacen("    x: 0\n", "    x: [0, 1]\n", 1), "holds a list"),
        (good.replacen("    x: 0\n", "    x: *a\n", 1), "is not YAML"),
        (good.replacen("    x: 0\n", "    x: !money 5\n", 1), "tag"),
        (String::new(), "joints is \"none\""),
        ("- 1\n".to_owned(), "holds a list"),
        ("a: {b: {c: {d: {e: {f: 1}}}}}\n".to_owned(), "nested deeper"),
        ("kinematics: {a: 1}\n".to_owned(), "key is \"kinematics: a\""),
        ("kinematics: {a: {x: 1}\n".to_owned(), "is not YAML"),
    ] {
        let message = kinematics_yaml::load("k.yaml", &text).unwrap_err().to_string();
        assert!(message.contains(words), "{message:?} lacks {words:?}");
    }
    let degrees = good.replacen("    yaw: 0\n", "    yaw: !degrees 90\n", 1);
    let turned = kinematics_yaml::load("k.yaml", &degrees).unwrap();
    let nominal = kinematics_yaml::load("k.yaml", &good).unwrap();
    let off = turned.flange_at(&[0.0; 6]).position
        - nominal
            .flange_at(&[std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0, 0.0, 0.0])
            .position;
    assert!(off.amax() < 1e-12);
}

/// Fails if a file that no robot needs costs more than it is worth: each of these
/// took seconds to minutes, or all memory.
#[test]
fn hostile_descriptions_are_refused_at_once() {
    let attributes: String = (0..100_000).map(|k| format!(" a{k}=\"1\"")).collect();
    let entities = "<!DOCTYPE r [<!ENTITY a \"xxxxxxxxxx\"><!ENTITY b \"&a;&a;&a;&a;\">]><robot name=\"&b;\"/>";
    let joints: String = (0..3000)
        .map(|k| format!("<joint name='j{k}' type='fixed'><parent link='a'/><child link='b{k}'/></joint>"))
        .collect();
    for (text, words) in [
        (format!("<robot{attributes}/>"), "more than 64 attributes"),
        ("<a>".repeat(100_000), "more than 64 elements within each other"),
        (entities.to_owned(), "document type"),
        (
            format!("<robot name='r'><link name='a'/>{joints}</robot>"),
            "3000 joints",
        ),
        (
            format!("<robot name='r'>{}</robot>", "<link/>".repeat(300_000)),
            "elements",
        ),
        (
            "<robot><link name='a'/><link name='a'/></robot>".to_owned(),
            "a link's name is \"a\": stands twice",
        ),
        ("<robot>".to_owned(), "line 1: is not well-formed XML"),
        ("<sdf/>".to_owned(), "a URDF starts with <robot"),
    ] {
        let message = load_urdf_text("r.urdf", &text, None).unwrap_err().to_string();
        assert!(message.contains(words), "{message:?} lacks {words:?}");
    }
    for text in [
        "[".repeat(500_000),
        "{".repeat(500_000),
        "a: ".repeat(300_000),
        "- ".repeat(500_000),
    ] {
        assert!(kinematics_yaml::load("k.yaml", &text).is_err());
    }
    for text in [
        "a.".repeat(300_000) + "b = 1",
        "x = ".to_owned() + &"[".repeat(500_000),
        (0..60_000).map(|k| format!("k{k} = 1\n")).collect(),
        (0..60_000).map(|k| format!("[t{k}]\n")).collect(),
    ] {
        assert!(toml_file::load("r.toml", &text).is_err());
    }
}

#[test]
fn numbers_of_a_urdf_in_the_wrong_unit_are_named() {
    let urdf = data("ur5e.urdf");
    for (from, to, words) in [
        (
            "0 0 0.1625",
            "0 0 162.5",
            "joint \"shoulder_pan_joint\": origin xyz is \"0 0 162.5\": write numbers of at most 100",
        ),
        (
            "1.5707963267948966 0 0",
            "90 0 0",
            "origin rpy is \"90 0 0\": write numbers of at most 7",
        ),
        ("0 0 0.1625", "0 0", "write three numbers"),
        ("0 0 0.1625", "0 0 ${d1}", "xacro"),
        ("0 0 0.1625", "0 0 \u{9b}2J", "\\u009b2J"),
    ] {
        assert!(urdf.contains(from));
        let message = load_urdf_text("r.urdf", &urdf.replacen(from, to, 1), None)
            .unwrap_err()
            .to_string();
        assert!(message.contains(words), "{message:?} lacks {words:?}");
    }
}

#[test]
fn joints_keep_their_names() {
    let file = load_urdf_text("ur5e.urdf", &data("ur5e.urdf"), None).unwrap();
    assert_eq!(file.joint_names[2], "elbow_joint");
    let text = toml_file::write(&file, &[]);
    assert_eq!(toml_file::load("t.toml", &text).unwrap().joint_names, file.joint_names);
    let twice = text.replace("elbow_joint", "Wrist_1_joint");
    assert!(
        toml_file::load("t.toml", &twice)
            .unwrap_err()
            .to_string()
            .contains("stands twice")
    );
    let unnamed = text.replacen("name = \"elbow_joint\"\n", "", 1);
    assert!(
        toml_file::load("t.toml", &unnamed)
            .unwrap_err()
            .to_string()
            .contains("every joint or none")
    );
}

// Fails if tolerances are lost on the way through a file, in either unit, or if an impossible or doubled one is taken.
#[test]
fn tolerances_of_a_robot_are_kept() {
    let plain = toml_file::write(&built_in("panda").unwrap(), &[]);
    assert_eq!(
        toml_file::load("t.toml", &plain).unwrap().tolerances,
        Tolerances::default()
    );
    let stated = format!("{plain}\n[tolerances]\nlength_mm = 1.5\noffset_mrad = 20\n");
    let model = toml_file::load("t.toml", &stated).unwrap();
    let expected = Tolerances {
        length_m: Some(1.5e-3),
        twist_rad: None,
        offset_rad: Some(20e-3),
    };
    assert_eq!(model.tolerances, expected);
    let again = toml_file::load("t.toml", &toml_file::write(&model, &[])).unwrap();
    assert_eq!(again.tolerances, expected);
    for (line, words) in [
        ("length_mm = 0", "tolerances.length"),
        ("twist_rad = 3.0", "100 mrad"),
        ("offset_rad = 0.02\noffset_mrad = 20", "given twice"),
        ("angle_rad = 0.02", "angle_rad"),
    ] {
        let text = format!("{plain}\n[tolerances]\n{line}\n");
        let refused = toml_file::load("t.toml", &text).unwrap_err().to_string();
        assert!(refused.contains(words), "{refused}");
    }
}

// Fails if a robot is read from what is not a regular file.
#[cfg(unix)]
#[test]
fn only_regular_files_hold_robots() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("robot.toml");
    std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
    for (spec, words) in [
        (link.display().to_string(), "is a device"),
        ("/dev/zero".to_owned(), "does not say what it is"),
        (format!("{}.urdf", folder.path().display()), "no such file"),
        ("nobody".to_owned(), "neither built in nor a file"),
        ("no\u{1b}body".to_owned(), "no\\u001bbody"),
    ] {
        let message = load(&spec).unwrap_err().to_string();
        assert!(message.contains(words), "{message:?} lacks {words:?}");
    }
}
