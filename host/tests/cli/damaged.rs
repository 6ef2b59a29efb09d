//! Damaged folders and files, and addresses in their place, through the program.

use std::io::{BufRead as _, BufReader};
use std::path::Path;

use crate::support::{spherecal, start, text};

/// Flips one bit behind each place where these bytes stand.
fn flip(path: &Path, words: &[u8], bit: u8) {
    let mut bytes = std::fs::read(path).expect("readable");
    let places: Vec<usize> = (0..bytes.len() - words.len())
        .filter(|k| bytes[*k..].starts_with(words))
        .collect();
    let last = *places.last().expect("the words are there");
    bytes[last + words.len()] ^= 1 << bit;
    std::fs::write(path, bytes).expect("written");
}

// Fails if damaged settings, results or telemetry are not seen, if a run is measured into a damaged
// file, if recovery loses a recording or writes a file that is refused, or if a torn telemetry file
// keeps a run from being exported.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_damaged_folder_is_refused_and_recovered() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let run = spherecal(at, &["run", "--poses", "6", "--out", "a"]);
    assert!(matches!(run.status.code(), Some(0 | 3)), "{}", text(&run.stderr));
    let check = |file: &str| spherecal(at, &["store", "check", file]);
    let whole = check("a/calibration.db");
    assert!(whole.status.success(), "{}", text(&whole.stderr));
    let database = at.join("a/calibration.db");
    let good = std::fs::read(&database).expect("readable");

    // One digit of the fingerprint.
    flip(&database, b"{\"points_m\":[[", 0);
    let refused = check("a/calibration.db");
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        text(&refused.stdout).contains("results fingerprint"),
        "{}",
        text(&refused.stdout)
    );
    let trend = spherecal(at, &["trend", "--out", "a"]);
    assert_eq!(trend.status.code(), Some(2), "{}", text(&trend.stdout));
    std::fs::write(&database, &good).expect("written");

    // A bit of the plan, so that it is no longer text.
    flip(&database, b"\"sphere_id\":", 7);
    assert_eq!(check("a/calibration.db").status.code(), Some(2));
    let new = spherecal(at, &["run", "--poses", "6", "--out", "a"]);
    assert_eq!(new.status.code(), Some(2), "{}", text(&new.stderr));
    assert!(text(&new.stderr).contains("store recover"), "{}", text(&new.stderr));
    std::fs::create_dir(at.join("b")).expect("made");
    let recovered = spherecal(at, &["store", "recover", "a/calibration.db", "b/calibration.db"]);
    assert!(recovered.status.success(), "{}", text(&recovered.stderr));
    assert!(
        text(&recovered.stdout).contains(": 6 recordings"),
        "{}",
        text(&recovered.stdout)
    );
    let again = check("b/calibration.db");
    assert!(again.status.success(), "{}", text(&again.stderr));
    for command in [
        ["validate", "--out", "b"].as_slice(),
        &["run", "--resume", "--out", "b"],
    ] {
        let output = spherecal(at, command);
        assert!(
            matches!(output.status.code(), Some(0 | 3)),
            "{command:?}: {}",
            text(&output.stderr)
        );
    }

    // A telemetry file whose program was killed, and then one with a flipped bit.
    std::fs::write(&database, &good).expect("written");
    let telemetry = at.join("a/telemetry-run-1.mcap");
    let bytes = std::fs::read(&telemetry).expect("readable");
    std::fs::write(&telemetry, &bytes[..bytes.len() / 2]).expect("written");
    let export = spherecal(at, &["export", "--csv", "--out", "a"]);
    assert!(export.status.success(), "{}", text(&export.stderr));
    assert!(
        text(&export.stderr).contains("middle of a record"),
        "{}",
        text(&export.stderr)
    );
    assert!(at.join("a/tables/telemetry.csv").exists());
    let mut damaged = bytes;
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x40;
    std::fs::write(&telemetry, damaged).expect("written");
    let export = spherecal(at, &["export", "--csv", "--out", "a"]);
    assert_eq!(export.status.code(), Some(2), "{}", text(&export.stderr));
}

// Fails if a password is printed where a server's address stands in the place of a file.
#[test]
fn a_server_in_the_place_of_a_file_keeps_its_password() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = "postgres://robot:geheim@db/fleet";
    for arguments in [
        ["store", "check", server].as_slice(),
        &["store", "recover", server, "new.db"],
        &["store", "recover", "old.db", server],
    ] {
        let output = spherecal(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(2));
        let words = text(&output.stderr) + &text(&output.stdout);
        assert!(words.contains("postgres://robot@db/fleet is a server"), "{words}");
        assert!(!words.contains("geheim"), "{words}");
    }
}

// Fails if a simulated drive opens to the network without a warning, or warns on this machine alone.
#[test]
fn a_drive_that_others_can_reach_is_warned_of() {
    for (address, open) in [("0.0.0.0:0", true), ("0", false)] {
        let mut child = start(Path::new("."), &["plant", "--listen", address]);
        let mut line = String::new();
        let mut output = BufReader::new(child.stdout.take().expect("piped"));
        output.read_line(&mut line).expect("one line");
        assert!(line.contains("drive link"), "{line}");
        child.kill().expect("ended");
        let ended = child.wait_with_output().expect("ended");
        let warned = text(&ended.stderr).contains("without a token");
        assert_eq!(warned, open, "{address}: {}", text(&ended.stderr));
    }
}
