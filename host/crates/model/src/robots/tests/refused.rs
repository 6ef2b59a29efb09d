//! Descriptions that are refused.

use super::super::*;
use super::data;

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

// Fails if a mass or a moment of inertia below zero is read in silence, or without its field.
#[test]
fn negative_masses_of_a_urdf_are_named() {
    let urdf = data("ur5e.urdf");
    for (tag, attribute) in [("<mass value=\"", "mass value"), ("ixx=\"", "inertia ixx")] {
        let changed = urdf.replacen(tag, &format!("{tag}-"), 2);
        assert_ne!(changed, urdf, "{tag}");
        let message = load_urdf_text("r.urdf", &changed, None).unwrap_err().to_string();
        assert!(
            message.contains(attribute) && message.contains("not negative"),
            "{message}"
        );
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
