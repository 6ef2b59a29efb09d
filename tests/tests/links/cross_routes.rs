//! The two ways to build for the Cortex-M7, rehearsed: what `scripts/cross.sh`
//! would run on a machine that has the one toolchain or the other.

use std::path::Path;
use std::process::{Command, Output};

fn cross(arguments: &[&str]) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/cross.sh");
    Command::new(script).args(arguments).output().expect("a shell")
}

fn rehearsed(route: &str, arguments: &[&str]) -> String {
    let done = cross(&[&["--dry-run", "--route", route], arguments].concat());
    let errors = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{errors}");
    assert!(
        errors.contains(&format!("route {route}")),
        "it says which route: {errors}"
    );
    String::from_utf8(done.stdout).expect("text")
}

// Fails if a route forgets a board, the lock file, or what a compiler without
// the target's library needs.
#[test]
fn both_routes_build_both_boards() {
    let (rustup, debian) = (rehearsed("rustup", &["build"]), rehearsed("debian", &["build"]));
    for text in [&rustup, &debian] {
        for board in ["mps2-an500", "nucleo-h743zi"] {
            let build = format!("cargo build --release --locked --package {board}");
            assert!(text.contains(&build), "{text}");
        }
        assert!(text.contains("--package nucleo-h743zi --features uart-drive"), "{text}");
    }
    for needed in [
        "RUSTC=/usr/bin/rustc",
        "RUSTC_BOOTSTRAP=1",
        "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER=",
        "CARGO_UNSTABLE_BUILD_STD=core",
    ] {
        assert!(debian.contains(needed), "{needed}: {debian}");
        assert!(!rustup.contains(needed), "{needed}: {rustup}");
    }
    let proof = rehearsed("debian", &["prove"]);
    assert!(proof.contains("--features panic-free --bin control"), "{proof}");
}

// Fails if a route or a command that does not exist is taken for another.
#[test]
fn what_does_not_exist_is_refused() {
    for arguments in [&["--route", "conda", "check"][..], &["fly"], &["build", "arduino"]] {
        let done = cross(arguments);
        let said = String::from_utf8_lossy(&done.stderr);
        // 3: this machine has neither toolchain, which is said first.
        let expected = if said.contains("no Cortex-M7 toolchain") { 3 } else { 2 };
        assert_eq!(done.status.code(), Some(expected), "{arguments:?}: {said}");
    }
}

// Fails if the controller is not built for a core without a double-precision FPU,
// or if the skeleton of a board is not checked.
#[test]
fn portable_builds_for_small_cores() {
    for route in ["rustup", "debian"] {
        let text = rehearsed(route, &["portable"]);
        for core in ["thumbv7em-none-eabi", "thumbv7m-none-eabi"] {
            let build = format!("--package spherecal-firmware --target {core}\n");
            assert!(text.contains(&build), "{text}");
        }
        assert!(text.contains("--example skeleton"), "{text}");
    }
}
