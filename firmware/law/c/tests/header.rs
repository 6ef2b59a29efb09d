//! The header, and a program of C++ that runs a loop.

use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

// Fails if the header is another than the library: with SPHERECAL_BLESS=1 it is written.
#[test]
fn the_header_is_that_of_the_library() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(here.join("cbindgen.toml")).expect("a configuration");
    let bindings = cbindgen::Builder::new()
        .with_src(here.join("src/types.rs"))
        .with_src(here.join("src/lib.rs"))
        .with_config(config)
        .generate()
        .expect("sources that cbindgen reads");
    let mut header = Vec::new();
    bindings.write(&mut header);
    let header = String::from_utf8(header).expect("text");
    let file = here.join("include/spherecal_law.h");
    if std::env::var_os("SPHERECAL_BLESS").is_some() {
        std::fs::write(&file, &header).expect("written");
    }
    let written = std::fs::read_to_string(&file).expect("the header");
    assert!(
        written == header,
        "include/spherecal_law.h is old: run this test with SPHERECAL_BLESS=1"
    );
}

/// Builds the static library and says where it is, and what it needs besides.
fn library(target: &Path) -> PathBuf {
    let cargo = Command::new(env!("CARGO"))
        .args([
            "build",
            "-p",
            "spherecal-law-c",
            "--message-format=json",
            "--target-dir",
        ])
        .arg(target)
        .current_dir(root())
        .output()
        .expect("cargo");
    assert!(cargo.status.success(), "{}", String::from_utf8_lossy(&cargo.stderr));
    let lines = String::from_utf8(cargo.stdout).expect("text");
    lines
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter_map(|message| message["filenames"].as_array().cloned())
        .flatten()
        .filter_map(|name| name.as_str().map(PathBuf::from))
        .find(|name| name.file_name().is_some_and(|name| name == "libspherecal_law_c.a"))
        .expect("the static library")
}

// Fails if the example does not compile without warnings, is not linked with the library, or its loop holds its simulated arm with
// another stiffness than the one that was set, feels another force, or takes what is not possible.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_loop_runs_in_cpp() {
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".into());
    if Command::new(&compiler).arg("--version").output().is_err() {
        println!("skipped: there is no compiler of C++ ({compiler}); set CXX");
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let (root, program) = (root(), folder.path().join("hold"));
    // Where the tests of this workspace are built: what is built already is not built again.
    let target = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .parent()
        .expect("the target folder");
    let built = Command::new(&compiler)
        .args(["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I"])
        .arg(root.join("firmware/law/c/include"))
        .arg(root.join("examples/cpp/hold.cpp"))
        .arg(library(target))
        .args(["-lpthread", "-ldl", "-lm", "-o"])
        .arg(&program)
        .output()
        .expect("the compiler");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let run = Command::new(&program).output().expect("the program");
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success(), "{said}{}", String::from_utf8_lossy(&run.stderr));
    assert_eq!(said.matches("held").count(), 2, "{said}");
}
