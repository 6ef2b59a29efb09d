//! What must hold of every robot file: the table's forward kinematics are the
//! file's own, whatever its axes.
#![allow(clippy::approx_constant)] // URDF files write 1.5708.
mod limbs;
mod oddities;
mod origins;
mod refused;
mod standard;
mod tips;
mod ur_parameters;

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

// Fails if a calibrated file that is calibrated again has two tools, keeps the tool of the first time, or if its tool is
// taken for the flange of an arm that has no other end.
#[test]
fn a_calibrated_file_is_calibrated_again() {
    let bare = "<robot name=\"two\"><link name=\"a\"/><link name=\"b\"/><link name=\"c\"/>\
                <joint name=\"j1\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/><axis xyz=\"0 0 1\"/>\
                <limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/></joint>\
                <joint name=\"j2\" type=\"revolute\"><parent link=\"b\"/><child link=\"c\"/><origin xyz=\"0.3 0 0\"/>\
                <axis xyz=\"0 1 0\"/><limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/></joint></robot>";
    let iiwa = data("iiwa7.urdf");
    for text in [bare, &iiwa] {
        let first = load_urdf_text("first.urdf", text, None).unwrap();
        let once = write_urdf_with_tcp(&first, &first.rows(), &[], &[0.0, 0.0, 0.1]);
        let second = load_urdf_text("second.urdf", &once, None).unwrap();
        assert_eq!(second.frame_names, first.frame_names);
        let twice = write_urdf_with_tcp(&second, &second.rows(), &[], &[0.0, 0.0, 0.2]);
        load_urdf_text("third.urdf", &twice, None).unwrap();
        assert_eq!(twice.matches("_tcp\"/>").count(), once.matches("_tcp\"/>").count());
        assert!(twice.contains("0 0 0.2") && !twice.contains("0 0 0.1\""), "{twice}");
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
        ("ur3e", "ur3e"),
        ("ur16e", "ur16e"),
        ("ur20", "ur20"),
        ("ur30", "ur30"),
        ("ur3", "ur3"),
        ("ur5", "ur5"),
        ("ur10", "ur10"),
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
        let chain = again.chain(None, None).unwrap();
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
