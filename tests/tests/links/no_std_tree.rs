//! What the controller is made of: crates without the standard library, and
//! none that knows a piece of hardware.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Every crate below firmware and shared, as the boards use them, and what it
/// is there for. A new one belongs here only if it runs without an operating
/// system, allocates nothing and knows no hardware.
const ALLOWED: [(&str, &str); 36] = [
    ("approx", "nalgebra's comparisons"),
    ("bitflags", "defmt's encodings"),
    ("byteorder", "heapless's hashes"),
    ("cfg-if", "embassy-sync's choice of an executor"),
    ("cobs", "frames"),
    ("crc", "frames"),
    ("crc-catalog", "crc's polynomials"),
    ("critical-section", "the lock that a board provides"),
    ("defmt", "log statements"),
    ("embassy-sync", "signals and pipes between tasks"),
    ("embassy-time", "instants and tickers"),
    ("embassy-time-driver", "the clock that a board provides"),
    ("embedded-hal", "embassy-time's delays, as traits"),
    ("embedded-hal-async", "embassy-time's delays, as traits"),
    ("embedded-io", "embassy-sync's pipes, as traits"),
    ("embedded-io-async", "embassy-sync's pipes, as traits"),
    ("futures-core", "embassy's streams, as traits"),
    ("futures-sink", "embassy's channels, as traits"),
    ("hash32", "heapless's maps"),
    ("heapless", "collections of a fixed capacity"),
    ("libm", "trigonometry, the same on every target"),
    ("nalgebra", "vectors and matrices of a fixed size"),
    ("nb", "embedded-hal's old traits"),
    ("num-complex", "nalgebra's traits"),
    ("num-integer", "nalgebra's traits"),
    ("num-rational", "nalgebra's traits"),
    ("num-traits", "nalgebra's traits"),
    ("postcard", "messages to bytes"),
    ("postcard-schema", "keys of the messages' layouts"),
    ("serde", "messages to bytes"),
    ("serde_core", "messages to bytes"),
    ("simba", "nalgebra's scalars"),
    ("stable_deref_trait", "heapless's pools"),
    ("thiserror", "errors in words"),
    ("typenum", "nalgebra's sizes"),
    ("void", "nb's old traits"),
];

fn cargo(arguments: &[&str]) -> String {
    let done = Command::new(env!("CARGO"))
        .args(arguments)
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(".."))
        .output()
        .expect("Cargo runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    String::from_utf8(done.stdout).expect("text")
}

/// Name, version and features of every crate that is linked into the controller.
fn tree() -> BTreeSet<(String, String, String)> {
    let text = cargo(&[
        "tree",
        "--package",
        "spherecal-firmware",
        "--no-default-features",
        "--features",
        "defmt",
        "--edges",
        "normal,no-proc-macro",
        "--prefix",
        "none",
        "--format",
        "{p}|{f}",
    ]);
    let part = |line: &str| {
        let (package, features) = line.split_once('|')?;
        let mut words = package.split_whitespace();
        let (name, version) = (words.next()?, words.next()?);
        let features = features.trim_end_matches("(*)").trim();
        Some((
            name.to_owned(),
            version.trim_start_matches('v').to_owned(),
            features.to_owned(),
        ))
    };
    text.lines()
        .filter(|l| !l.is_empty())
        .map(|l| part(l).expect("name, version, features"))
        .collect()
}

/// Where the source of each crate is, by name and version.
fn sources() -> BTreeMap<(String, String), PathBuf> {
    let text = cargo(&["metadata", "--format-version", "1", "--all-features"]);
    let metadata: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let packages = metadata["packages"].as_array().expect("packages");
    let library = |package: &serde_json::Value| {
        let targets = package["targets"].as_array()?;
        let library = targets.iter().find(|target| {
            let kinds = target["kind"].as_array().cloned().unwrap_or_default();
            kinds.iter().any(|kind| kind == "lib" || kind == "rlib")
        })?;
        let key = (
            package["name"].as_str()?.to_owned(),
            package["version"].as_str()?.to_owned(),
        );
        Some((key, library["src_path"].as_str()?.into()))
    };
    packages.iter().filter_map(library).collect()
}

// Fails if a crate with the standard library, with a feature that brings it, or
// one that nobody has looked at comes into the controller.
#[test]
fn the_controller_is_made_of_crates_without_the_standard_library() {
    let (tree, sources) = (tree(), sources());
    let (mut unknown, mut faults) = (Vec::new(), Vec::new());
    for (name, version, features) in &tree {
        if !name.starts_with("spherecal-") && !ALLOWED.iter().any(|(allowed, _)| allowed == name) {
            unknown.push(name);
        }
        if features
            .split(',')
            .any(|feature| ["std", "alloc", "use-std"].contains(&feature))
        {
            faults.push(format!("{name} has the features {features}"));
        }
        let Some(source) = sources.get(&(name.clone(), version.clone())) else {
            panic!("no library of {name} {version}");
        };
        let text = std::fs::read_to_string(source).expect("its source");
        let plain: String = text.split_whitespace().collect();
        if !(plain.contains("#![no_std]") || plain.contains("#![cfg_attr(") && plain.contains("no_std)]")) {
            faults.push(format!("{name} is not no_std: {}", source.display()));
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
    assert!(
        unknown.is_empty(),
        "look at these, and add them with what they are for: {unknown:?}"
    );
    let gone: Vec<_> = ALLOWED
        .iter()
        .filter(|(name, _)| !tree.iter().any(|t| t.0 == *name))
        .collect();
    assert!(gone.is_empty(), "no longer there: {gone:?}");
}

// Fails if a crate of a processor, a chip or a board comes into the workspace
// that a PC builds.
#[test]
fn the_pc_builds_no_hardware_crates() {
    let text = cargo(&[
        "tree",
        "--workspace",
        "--edges",
        "normal,build,dev",
        "--prefix",
        "none",
        "--format",
        "{p}",
    ]);
    let hardware = [
        "cortex-m",
        "embassy-stm32",
        "stm32",
        "embassy-executor ",
        "defmt-rtt",
        "defmt-semihosting",
    ];
    let found: BTreeSet<_> = text
        .lines()
        .filter(|line| hardware.iter().any(|name| line.starts_with(name)))
        .collect();
    assert!(found.is_empty(), "{found:?}");
}
