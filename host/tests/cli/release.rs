//! What a release consists of, as far as it can be tested without building it: the script's commands,
//! the bill of materials, the image's recipe.

use std::collections::BTreeSet;
use std::process::{Command, Output};

use serde_json::Value;

use crate::docs::root;
use crate::support::text;

fn script(name: &str, arguments: &[&str]) -> Option<Output> {
    let path = root().join("scripts").join(name);
    if name == "sbom" && Command::new("python3").arg("--version").output().is_err() {
        assert!(
            std::env::var_os("SPHERECAL_REQUIRE_PYTHON").is_none(),
            "python3 is missing"
        );
        eprintln!("left out: python3 is missing");
        return None;
    }
    Some(Command::new(path).args(arguments).output().expect("the script starts"))
}

// Fails if a dry run does not name a program for each target, the wheel, the bill of materials and the
// checksums, if it changes a file, or if a wrong option is not refused with exit code 2.
#[test]
fn a_dry_run_shows_the_whole_release() {
    let out = root().join("target/no-release");
    let where_to = out.display().to_string();
    let output = script(
        "release",
        &["--dry-run", "--install", "--container", "--out", &where_to],
    )
    .expect("a script");
    let said = text(&output.stdout);
    assert!(output.status.success(), "{said}{}", text(&output.stderr));
    for target in ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"] {
        for part in [
            format!("--profile dist -p spherecal --all-features --locked --target {target}"),
            format!("spherecal-{}-{target}.tar.gz", env!("CARGO_PKG_VERSION")),
            format!("scripts/sbom {target} > "),
        ] {
            assert!(said.contains(&part), "{part}: {said}");
        }
    }
    for part in [
        "scripts/python.sh wheel",
        "SHA256SUMS",
        "--file Containerfile",
        "completions fish",
        " man --out ",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(said.lines().all(|line| line.starts_with("+ ")), "{said}");
    assert!(!out.exists());
    for wrong in [&["--target", "sparc"][..], &["--fast"], &["--out"]] {
        let output = script("release", wrong).expect("a script");
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
    }
}

// Fails if the bill of materials leaves out a package of the program, lists one of the tests, names one
// twice, or says another version, licence or checksum than Cargo does.
#[test]
fn the_bill_of_materials_is_that_of_the_program() {
    let Some(output) = script("sbom", &["x86_64-unknown-linux-gnu"]) else {
        return;
    };
    assert!(output.status.success(), "{}", text(&output.stderr));
    let bill: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(
        (&bill["bomFormat"], &bill["specVersion"]),
        (&"CycloneDX".into(), &"1.5".into())
    );
    assert_eq!(bill["metadata"]["component"]["name"], "spherecal");
    let components = bill["components"].as_array().expect("components");
    let field = |c: &Value, name: &str| c[name].as_str().unwrap_or_default().to_owned();
    let shipped: BTreeSet<String> = components
        .iter()
        .filter(|c| c["scope"] == "required")
        .map(|c| field(c, "name"))
        .collect();
    for name in [
        "spherecal-identify",
        "spherecal-shared",
        "nalgebra",
        "sqlx",
        "tonic",
        "parquet",
        "libsqlite3-sys",
    ] {
        assert!(shipped.contains(name), "{name}");
    }
    for name in ["criterion", "proptest", "rcgen", "spherecal-tests", "cc", "prost-build"] {
        assert!(!shipped.contains(name), "{name}");
    }
    let references: BTreeSet<String> = components.iter().map(|c| field(c, "bom-ref")).collect();
    assert_eq!(references.len(), components.len(), "a package is named twice");
    let lock = std::fs::read_to_string(root().join("Cargo.lock")).expect("the lock file");
    for c in components {
        let (name, version) = (field(c, "name"), field(c, "version"));
        assert!(c["licenses"][0]["expression"].is_string(), "{name}");
        let entry = format!("name = \"{name}\"\nversion = \"{version}\"\n");
        let at = lock
            .find(&entry)
            .unwrap_or_else(|| panic!("{entry} is not in Cargo.lock"));
        let own = lock[at..].split("\n\n").next().unwrap_or_default();
        match c["hashes"][0]["content"].as_str() {
            Some(sum) => assert!(own.contains(&format!("checksum = \"{sum}\"")), "{name}"),
            None => assert!(name.starts_with("spherecal"), "{name} has no checksum"),
        }
    }
    let main = field(&bill["metadata"]["component"], "bom-ref");
    for edge in bill["dependencies"].as_array().expect("dependencies") {
        let ends = edge["dependsOn"].as_array().expect("a list");
        for end in ends.iter().chain([&edge["ref"]]) {
            let end = end.as_str().unwrap_or_default();
            assert!(references.contains(end) || end == main, "{end}");
        }
    }
}

// Fails if the recipe of the image names a stage or a file that is not there, builds with an older
// compiler than the sources need or other features than a release has, or runs as root.
#[test]
fn the_recipe_of_the_image_is_whole() {
    let text = std::fs::read_to_string(root().join("Containerfile")).expect("the recipe");
    let joined = text.replace("\\\n", " ");
    let lines: Vec<Vec<&str>> = joined
        .lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(|line| line.split_whitespace().collect())
        .collect();
    let known = ["FROM", "RUN", "WORKDIR", "COPY", "ARG", "USER", "ENTRYPOINT", "CMD"];
    assert!(lines.iter().all(|words| known.contains(&words[0])), "{lines:?}");
    let stages: Vec<&str> = lines
        .iter()
        .filter(|w| w[0] == "FROM")
        .filter_map(|w| w.get(3).copied())
        .collect();
    assert_eq!(stages, ["build"]);
    for words in lines.iter().filter(|w| w[0] == "COPY") {
        match words[1].strip_prefix("--from=") {
            Some(stage) => {
                assert!(stages.contains(&stage), "{stage}");
                let programs = ["/source/target/dist/spherecal", "/source/target/dist/spherecal-lab"];
                assert_eq!(words[2..words.len() - 1], programs);
            }
            None => {
                for file in &words[1..words.len() - 1] {
                    assert!(root().join(file).exists(), "{file}");
                }
            }
        }
    }
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).expect("the manifest");
    let smallest = manifest
        .lines()
        .find_map(|l| l.strip_prefix("rust-version = "))
        .expect("a version");
    let image = text
        .split("library/rust:")
        .nth(1)
        .and_then(|rest| rest.split('-').next())
        .expect("an image");
    assert_eq!(image, smallest.trim_matches('"'));
    assert!(
        text.contains("cargo build --profile dist --package spherecal --package spherecal-lab --all-features --locked")
    );
    let user = lines.iter().rfind(|w| w[0] == "USER").expect("a user");
    assert_ne!(user[1], "root");
    // The pods of the examples override the entry point by a shell, which this base has.
    assert!(text.contains("FROM docker.io/library/debian:bookworm-slim"));
}
