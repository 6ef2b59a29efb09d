//! `spherecal check`: contacts by a simulated hand at both robot sides, and from tables.

use std::net::UdpSocket;
use std::path::Path;

use serde_json::Value;
use spherecal::identify::workspace;
use spherecal::model::robots::RobotModel;
use spherecal::model::robots::toml_file::write as write_toml;

use crate::collect::{
    IIWA_START, PANDA_START, SAGGING, STIFF, TOOL, TrueArm, UR_SAGGING, UR_START, chain, distance_mm, guided, nominal,
    write, wrong,
};
use crate::support::{Server, spherecal, text};

/// Runs the command; returns the exit code, its document and what it said.
fn check(folder: &Path, arguments: &[&str]) -> (Option<i32>, Value, String) {
    let mut all = vec!["check", "--json"];
    all.extend_from_slice(arguments);
    let output = spherecal(folder, &all);
    let said = text(&output.stderr);
    (
        output.status.code(),
        serde_json::from_slice(&output.stdout).unwrap_or_default(),
        said,
    )
}

/// Guides a dozen contacts at `link`, and checks the nominal robot with them. Returns the table.
/// `told` is the robot as the command names it.
fn guide_and_check<const N: usize>(folder: &Path, link: &str, name: &str, told: &str, arm: &TrueArm<N>) -> String {
    // The robot as it computes itself: nominal, and far off.
    let (code, found, said) = check(folder, &["--link", link, "--tool-mm", TOOL, "--auto", "--wait-s", "60"]);
    assert_eq!(code, Some(3), "{said}");
    assert_eq!(
        (found["robot"].as_str(), found["answer"].as_str()),
        (Some(told), Some("does_not_hold"))
    );
    let (robot, table) = (nominal(name), found["file"].as_str().expect("a table"));
    let everywhere = workspace(&robot.robot, &robot.tool_in_table());
    let believed = chain(&robot);
    let real = distance_mm(arm, |q| believed.pose(q).position, &everywhere);
    let stated = found["check"]["error_mm"]["mean"].as_f64().expect("an error");
    eprintln!("{name}: {real:.2} mm, stated {stated:.2} mm");
    assert!(
        real > 3.0 && (0.8..1.2).contains(&(stated / real)),
        "{real} mm, stated {stated} mm"
    );
    // The same table again is not taken for new contacts.
    let (code, _, said) = check(folder, &["--link", link, "--tool-mm", TOOL, "--auto"]);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("complete already"), "{said}");
    table.to_owned()
}

/// Checks a calibration that is right, and one of the arm before its second joint moved by 3 mrad.
fn check_calibrations(folder: &Path, table: &str, truth: &RobotModel) {
    let mut moved = truth.clone();
    moved.robot.joints[1].mdh.theta += 3e-3;
    for (model, file, expected) in [
        (truth, "right.toml", (Some(0), Some("holds"))),
        (&moved, "moved.toml", (Some(3), Some("does_not_hold"))),
    ] {
        std::fs::write(folder.join(file), write_toml(model, &[])).expect("a file");
        let (code, found, said) = check(folder, &["--data", table, "--robot", file]);
        assert_eq!((code, found["answer"].as_str()), expected, "{file}: {said} {found}");
    }
}

// Fails if the stated error of an FR3 whose joints give way under gravity is more than 20 % from the true one.
#[test]
#[ignore = "long: 40 s of real time"]
fn long_a_dozen_contacts_check_an_fr3() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = TrueArm::new(&wrong(&nominal("fr3")), SAGGING);
    let file = folder.path().join("hand.csv");
    write(&file, &guided(&truth, &PANDA_START, 1, 12));
    let hand = file.display().to_string();
    let robot = Server::start(&["plant", "--fci", "--version", "10", "--listen", "0", "--guide", &hand]);
    guide_and_check(folder.path(), &robot.peer, "fr3", "fr3", &truth);
}

// Fails if the same does not hold for an LBR behind a KUKA cabinet, a calibration that is right is refused, or one that is
// not is accepted.
#[test]
#[ignore = "long: 40 s of real time"]
fn long_a_dozen_contacts_check_an_iiwa() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = wrong(&nominal("iiwa7"));
    let arm = TrueArm::new(&truth, STIFF);
    let file = folder.path().join("hand.csv");
    write(&file, &guided(&arm, &IIWA_START, 1, 12));
    let probe = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let client = probe.local_addr().expect("an address").to_string();
    drop(probe);
    let hand = file.display().to_string();
    let robot = Server::start(&["plant", "--fri", &client, "--guide", &hand]);
    let table = guide_and_check(folder.path(), &robot.peer, "iiwa7", "iiwa7", &arm);
    check_calibrations(folder.path(), &table, &truth);
}

// Fails if the same does not hold for a UR5e, which is checked as its controller computes it.
#[test]
#[ignore = "long: 40 s of real time"]
fn long_a_dozen_contacts_check_a_ur5e() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = TrueArm::new(&wrong(&nominal("ur5e")), UR_SAGGING);
    let file = folder.path().join("hand.csv");
    write(&file, &guided(&truth, &UR_START, 1, 12));
    let hand = file.display().to_string();
    let robot = Server::start(&["plant", "--ur", "0", "--guide", &hand]);
    guide_and_check(folder.path(), &robot.peer, "ur5e", "check.robot.toml", &truth);
}

// Fails if contacts that cannot tell anything are answered, or the refusal does not say what to give.
#[test]
fn what_cannot_be_checked_is_refused_with_the_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let few = "place,sphere,q1,q2,q3,q4,q5,q6,q7\n1,1,0,-0.3,0,-2.2,0,1.9,0.7\n1,1,0.1,-0.3,0,-2.2,0,1.9,0.7\n";
    std::fs::write(folder.join("few.csv"), few).expect("a table");
    let points = "x_mm,y_mm,z_mm,q1,q2,q3,q4,q5,q6,q7\n1,1,1,0,-0.3,0,-2.2,0,1.9,0.7\n";
    std::fs::write(folder.join("points.csv"), points).expect("a table");
    for (arguments, words) in [
        (&["--robot", "panda"][..], "--link"),
        (&["--data", "few.csv"], "--robot"),
        (
            &["--data", "few.csv", "--robot", "panda", "--tool-mm", TOOL],
            "at least 8",
        ),
        (&["--data", "points.csv", "--robot", "panda"], "contacts with spheres"),
        (&["--data", "few.csv", "--robot", "panda", "--within-mm", "0"], "0.01"),
        (&["--link", "sim"], "give franka:HOST"),
    ] {
        let (code, _, said) = check(folder, arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
}
