//! Files of joint origins: they go round, and their mistakes are named.

use super::super::frames::distance;
use super::super::*;
use super::{data, disturbed};

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
            let off = distance(&again.flange_at(q), &model.flange_with(&rows, q));
            assert!(off < 1e-9, "{name}: off by {off:e}");
        }
    }
}

/// Fails if a built-in robot and the URDF by its vendor give other joint origins.
#[test]
fn built_in_and_vendors_files_give_the_same_origins() {
    for name in [
        "ur5e", "ur10e", "ur3e", "ur16e", "ur20", "ur30", "ur3", "ur5", "ur10", "panda", "fr3",
    ] {
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

// Fails if the offset or the turn of a flange is lost on the way through joint origins, in any form.
#[test]
fn a_flange_keeps_its_offset_and_turn() {
    let q = [0.3, -0.7, 1.1, -1.3, 0.2, 0.9, -0.4];
    for name in ["ur5e.urdf", "panda.urdf", "irb120.urdf", "iiwa7.urdf"] {
        let text = data(name).replacen(
            "</robot>",
            "<link name=\"my_tool0\"/><joint name=\"mine\" type=\"fixed\"><origin xyz=\"0.01 -0.02 0.13\" rpy=\"0.1 0.2 \
             -0.7\"/><parent link=\"TIP\"/><child link=\"my_tool0\"/></joint></robot>",
            1,
        );
        let tip = load_urdf_text(name, &data(name), None).unwrap().frame_names.1;
        let model = load_urdf_text(name, &text.replace("TIP", &tip), Some("my_tool0")).unwrap();
        let mut table = toml_file::load("t.toml", &toml_file::write(&model, &[])).unwrap();
        for model in [&model, &table] {
            let again = kinematics_yaml::load("a.yaml", &write_kinematics_yaml(model, &model.rows(), &[])).unwrap();
            let q = &q[..model.robot.dof()];
            let off = distance(&again.flange_at(q), &model.flange_at(q));
            assert!(off < 1e-9, "{name}: off by {off:e}");
        }
        // The same of a built-in robot that carries a flange of its own.
        if let Some(built) = built_in(name.trim_end_matches(".urdf")) {
            table.robot = built.robot;
            table.base = Pose::identity();
            let q = &q[..table.robot.dof()];
            let again = kinematics_yaml::load("a.yaml", &write_kinematics_yaml(&table, &table.rows(), &[])).unwrap();
            assert!(distance(&again.flange_at(q), &table.flange_at(q)) < 1e-9, "{name}");
        }
    }
}
