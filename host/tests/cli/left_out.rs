//! Programs that were built without a feature.

use crate::support::{spherecal, text};

// Fails if an option or a command that a feature brings is taken by a program
// without that feature, if it is not said which one, or if anything is done before.
#[test]
fn what_was_left_out_names_its_feature() {
    let cases: [(&[&str], &str, bool); 8] = [
        (&["run", "--dashboard"], "dashboard", cfg!(feature = "dashboard")),
        (
            &["run", "--link", "grpc:127.0.0.1:1"],
            "services",
            cfg!(feature = "services"),
        ),
        (
            &["run", "--tracker", "grpc:127.0.0.1:1"],
            "services",
            cfg!(feature = "services"),
        ),
        (
            &["run", "--publish", "grpc:127.0.0.1:1"],
            "services",
            cfg!(feature = "services"),
        ),
        (
            &["history", "--store", "grpc:127.0.0.1:1"],
            "services",
            cfg!(feature = "services"),
        ),
        (&["serve", "--service", "robot"], "services", cfg!(feature = "services")),
        (
            &["history", "--store", "postgres://u@127.0.0.1:1/d"],
            "postgres",
            cfg!(feature = "postgres"),
        ),
        (&["export", "--parquet"], "parquet", cfg!(feature = "parquet")),
    ];
    for (arguments, feature, is_there) in cases {
        if is_there {
            continue;
        }
        let folder = tempfile::tempdir().expect("a folder");
        let output = spherecal(folder.path(), arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(&format!("--features {feature}")), "{arguments:?}: {said}");
        let left = std::fs::read_dir(folder.path()).expect("a folder").count();
        assert_eq!(left, 0, "{arguments:?} has left something behind");
    }
}
