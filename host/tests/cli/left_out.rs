//! Programs that were built without a feature.

use std::path::PathBuf;
use std::process::Command;

use crate::support::{PROGRAM, text};

/// What is asked for, and the feature that brings it.
const ASKED: [(&[&str], &str); 14] = [
    (&["run", "--link", "grpc:127.0.0.1:1"], "services"),
    (&["teach", "--link", "grpc:127.0.0.1:1"], "services"),
    (&["stability", "--link", "grpcs:127.0.0.1:1"], "services"),
    (&["run", "--tracker", "grpc:127.0.0.1:1"], "services"),
    (&["run", "--publish", "grpc:127.0.0.1:1"], "services"),
    (&["run", "--store", "grpc:127.0.0.1:1"], "services"),
    (
        &["run", "--serve", "0", "--tls-cert", "a.pem", "--tls-key", "b.pem"],
        "services",
    ),
    (&["history", "--store", "grpc:127.0.0.1:1"], "services"),
    (&["serve", "--service", "robot"], "services"),
    (&["serve", "--tls-cert", "a.pem", "--tls-key", "b.pem"], "services"),
    (&["run", "--store", "postgres://u@127.0.0.1:1/d"], "postgres"),
    (&["history", "--store", "postgres://u@127.0.0.1:1/d"], "postgres"),
    (&["export", "--parquet"], "parquet"),
    (&["export", "--format", "parquet"], "parquet"),
];

/// Whether the program of these tests was built with a feature.
fn is_built(feature: &str) -> bool {
    match feature {
        "services" => cfg!(feature = "services"),
        "postgres" => cfg!(feature = "postgres"),
        "parquet" => cfg!(feature = "parquet"),
        other => panic!("no feature {other}"),
    }
}

// The gate builds these tests with all features. It names the program that was
// built with the default ones in SPHERECAL_DEFAULT_PROGRAM.
// Fails if an option or a command that a feature brings is taken by a program
// without that feature, if the error does not name the feature, if the exit code
// is not 2, or if anything was written before.
#[test]
fn what_was_left_out_names_its_feature() {
    let default = std::env::var_os("SPHERECAL_DEFAULT_PROGRAM").map(PathBuf::from);
    let program = default.clone().unwrap_or_else(|| PROGRAM.into());
    for (arguments, feature) in ASKED {
        if default.is_none() && is_built(feature) {
            continue;
        }
        let folder = tempfile::tempdir().expect("a folder");
        let output = Command::new(&program)
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .expect("the program starts");
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(&format!("--features {feature}")), "{arguments:?}: {said}");
        let left = std::fs::read_dir(folder.path()).expect("a folder").count();
        assert_eq!(left, 0, "{arguments:?} has left something behind");
    }
}
