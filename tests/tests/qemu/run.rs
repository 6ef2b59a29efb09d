//! The whole job with the controller in QEMU, from the command line.

use std::path::Path;
use std::process::Command;

use spherecal_tests::qemu::image;

/// The program with all its features, built from the sources as they are now.
///
/// The build is that of the test `cli`, of the whole workspace: a build of the
/// program alone would leave its features out, and compile for minutes.
fn program() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut build = Command::new(env!("CARGO"));
    build
        .args(["test", "--workspace", "--no-run", "--quiet", "--test", "cli"])
        .args(["--message-format", "json"])
        .current_dir(root);
    // Build scripts of dependencies look at these variables, which Cargo sets for a test: with them, much is built anew.
    for (name, _) in std::env::vars_os() {
        if name
            .to_str()
            .is_some_and(|name| name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_"))
        {
            build.env_remove(name);
        }
    }
    let built = build.output().expect("Cargo runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let text = String::from_utf8(built.stdout).expect("text");
    text.lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter(|artifact| artifact["target"]["kind"] == serde_json::json!(["bin"]))
        .filter(|artifact| artifact["target"]["name"] == "spherecal")
        .find_map(|artifact| artifact["executable"].as_str().map(str::to_owned))
        .expect("an executable")
}

// Fails if a calibration over `--link qemu` (30 poses on three spheres) does not
// end calibrated, differs from the one in this process, or leaves no decoded
// log that is named where people look.
#[test]
#[ignore = "long: minutes of robot time in QEMU"]
fn long_a_calibration_in_qemu_ends_calibrated_and_leaves_its_log() {
    let Some(image) = image() else { return };
    let program = program();
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("cell.toml");
    std::fs::write(&config, "[plan]\nposes = 30\n").expect("written");
    let run = |link: &str| {
        let out = folder.path().join(link);
        let done = Command::new(&program)
            .args(["run", "--link", link, "--config"])
            .arg(&config)
            .arg("--out")
            .arg(&out)
            .env("SPHERECAL_QEMU_IMAGE", &image)
            .output()
            .expect("it runs");
        let said = String::from_utf8_lossy(&done.stdout).into_owned();
        let errors = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(0), "{said}\n{errors}");
        let read = |name: &str| std::fs::read_to_string(out.join(name));
        let summary = read("summary.json").expect("a summary");
        let summary: serde_json::Value = serde_json::from_str(&summary).expect("JSON");
        (
            said,
            summary,
            read("controller.log"),
            read("report.html").expect("a report"),
        )
    };
    let (_, here, none, _) = run("sim");
    assert!(none.is_err(), "no controller.log without a controller elsewhere");
    let (said, there, log, report) = run("qemu");
    for name in ["recordings_sha256", "poses"] {
        assert!(!here[name].is_null(), "{here}");
        assert_eq!(here[name], there[name], "{name}");
    }
    assert_eq!(there["poses"]["recorded"], 30, "{there}");
    assert!(said.contains("controller.log"), "{said}");
    assert!(report.contains("controller.log"), "the report names the log");
    let log = log.expect("a decoded log");
    assert!(
        log.contains("scenario Pipe") && log.contains("phase Recording after Turning"),
        "{log}"
    );
    assert!(!log.contains("could not be decoded"), "{log}");
}
