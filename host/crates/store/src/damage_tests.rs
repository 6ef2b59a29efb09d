//! Tests with old files, truncated files, flipped bits, a held lock and a full disk.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use spherecal_shared::protocol::host::{Event, Recording};

use super::tests::{new_run, placed, recording};
use super::*;

const OLD: &[u8] = include_bytes!("../tests/data/schema_1.db");

/// Sphere and first joint angle (rad) of the recordings in it, as SQLite's own shell prints them.
const FIRST_ANGLES: [(u32, f64); 3] = [
    (1, 0.002175129330181649),
    (2, 0.3381444825983628),
    (3, -0.418907700726209),
];

/// A database with forty recordings, closed.
fn database(folder: &Path) -> (PathBuf, Vec<Recording>) {
    let path = folder.join("calibration.db");
    let mut store = SqlStore::create_or_open(&path).expect("made");
    let run = store.create_run(&new_run()).expect("a run");
    let session = store.begin_session(run, "now").expect("a session");
    let recordings: Vec<Recording> = (0..40)
        .map(|pose| recording(pose, 0.1 + f64::from(pose) / 3.0))
        .collect();
    for (r, k) in recordings.iter().zip(1..) {
        let arrival = Event::Recording(r.clone());
        let number = i64::from(k);
        store.append(run, &[placed(session, number, &arrival)]).expect("stored");
    }
    drop(store);
    (path, recordings)
}

fn read(path: &Path) -> Result<Vec<Recording>, StoreError> {
    let mut store = SqlStore::open(path)?;
    let info = store.require_last_run()?;
    Ok(CalibrationStore::read_run(&mut store, info.run)?.recordings)
}

// Fails if a database of the first schema is refused, loses or changes data, or cannot be written
// to afterwards.
#[test]
fn an_older_schema_is_brought_forward() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    std::fs::write(&path, OLD).expect("written");
    assert_eq!(OLD[60..64], 1u32.to_be_bytes(), "the fixture has schema 1");
    for _ in 0..2 {
        let mut store = SqlStore::open(&path).expect("opened");
        let info = store.require_last_run().expect("the run");
        let recordings = store.recordings(info.run).expect("read");
        let first: Vec<_> = recordings.iter().map(|r| (r.sphere, r.q[0].mean)).collect();
        assert_eq!(first, FIRST_ANGLES);
        assert!(store.handshakes(info.run).expect("the new table").is_empty());
    }
    let mut store = SqlStore::open(&path).expect("opened");
    let session = store.begin_session(1, "now").expect("a session");
    assert_eq!(session, 2);
    let arrival = Event::Recording(recording(900, 0.5));
    let number = i64::from(1);
    store.append(1, &[placed(session, number, &arrival)]).expect("stored");
    store.put_handshake(1, session, 1, 77).expect("stored");
    assert_eq!(store.recordings(1).expect("read").len(), 4);
    drop(store);
    let bytes = std::fs::read(&path).expect("read");
    assert_eq!(
        bytes[60..64],
        u32::try_from(SCHEMA_VERSION).expect("small").to_be_bytes()
    );
}

// Fails if a flipped bit anywhere in the file silently changes a recording, the plate or the
// configuration, or if a refused file is written to.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_no_flipped_bit_changes_a_recording_in_silence() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let whole = std::fs::read(&path).expect("read");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut refused, mut same) = (0, 0);
    let damaged = folder.path().join("damaged.db");
    for _ in 0..400 {
        let mut bytes = whole.clone();
        let bit = rng.random_range(0..bytes.len() * 8);
        bytes[bit / 8] ^= 1 << (bit % 8);
        for end in ["-wal", "-shm"] {
            let _ = std::fs::remove_file(folder.path().join(format!("damaged.db{end}")));
        }
        std::fs::write(&damaged, &bytes).expect("written");
        let opened = SqlStore::open(&damaged).map(drop);
        if opened.is_err() {
            assert_eq!(
                std::fs::read(&damaged).expect("read"),
                bytes,
                "a refused file is written to"
            );
        }
        match opened.and_then(|()| read(&damaged)) {
            Ok(read) => {
                same += 1;
                assert!(read == recordings, "bit {bit} changed a recording in silence");
            }
            Err(_) => refused += 1,
        }
    }
    println!("{refused} refused, {same} in places that hold nothing");
    assert!(refused > 50, "only {refused} of 400 were seen");
}

// Fails if a column type that is not text reaches the driver, whose thread then ends and leaves the
// reader waiting for ever; or if such a file cannot be recovered completely.
#[test]
fn a_schema_that_is_no_text_is_seen_and_saved() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let mut bytes = std::fs::read(&path).expect("read");
    let types: Vec<usize> = (0..bytes.len() - 8)
        .filter(|i| &bytes[*i..i + 7] == b"DOUBLE ")
        .collect();
    assert!(!types.is_empty(), "the schema has columns of this type");
    for at in types {
        bytes[at] = 0xff;
    }
    std::fs::write(&path, &bytes).expect("written");
    let refusal = SqlStore::open(&path).map(drop).expect_err("refused");
    assert!(matches!(refusal, StoreError::Damaged { .. }), "{refusal}");
    assert_eq!(recovered(&path, &recordings).0, recordings.len());
}

/// Recovers a file, and checks that the result is a bit-identical subset of what was stored.
fn recovered(damaged: &Path, recordings: &[Recording]) -> (usize, Recovered) {
    let before = std::fs::read(damaged).expect("read");
    let new = damaged.with_extension("saved.db");
    let _ = std::fs::remove_file(&new);
    let report = recover(damaged, &new).expect("recovered");
    assert_eq!(
        std::fs::read(damaged).expect("read"),
        before,
        "the damaged file is written to"
    );
    let saved = read(&new).expect("what was saved is whole");
    assert!(saved.iter().all(|r| recordings.contains(r)), "not what was stored");
    let again = recover(damaged, &new).expect_err("never over a file that is there");
    assert!(matches!(again, StoreError::Exists { .. }), "{again}");
    (saved.len(), report)
}

// Fails if a truncated file is taken for a complete one, or if its readable data are not saved.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_cut_file_is_seen_and_what_is_left_is_saved() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let whole = std::fs::read(&path).expect("read");
    let damaged = folder.path().join("damaged.db");
    let mut saved = Vec::new();
    for hundredth in [99, 95, 90] {
        std::fs::write(&damaged, &whole[..whole.len() * hundredth / 100]).expect("written");
        let refusal = SqlStore::open(&damaged).err().expect("refused");
        assert!(matches!(refusal, StoreError::Damaged { .. }), "{refusal}");
        assert!(refusal.to_string().contains("store recover"), "{refusal}");
        saved.push(recovered(&damaged, &recordings).0);
    }
    println!("recordings saved of a file cut to 99, 95 and 90 %: {saved:?}");
    assert!(saved[0] > 0);
}

// Fails if a file without its first page, which lists the tables, is not recovered.
#[test]
fn a_lost_first_page_costs_little() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let mut bytes = std::fs::read(&path).expect("read");
    bytes[..4096].fill(0x5a);
    std::fs::write(&path, &bytes).expect("written");
    assert!(matches!(SqlStore::open(&path).err(), Some(StoreError::NotOurs { .. })));
    let (saved, report) = recovered(&path, &recordings);
    assert!(report.schema_replaced);
    assert_eq!(saved, recordings.len());
}

// Fails if a plan that lacks its end is saved because its digest is lost, too, though its second copy is whole; or if a
// run is saved that has neither.
#[test]
fn settings_that_cannot_be_read_are_those_of_the_second_copy_or_lost() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let execute = |statement: &'static str| {
        let mut store = SqlStore::create_or_open(&path).expect("opened");
        store
            .block(async |c| sqlx::query(statement).execute(c).await.map(|_| ()))
            .expect("changed");
    };
    execute("UPDATE runs SET plan_json = '{\"a'");
    execute("DELETE FROM digests");
    let (saved, report) = recovered(&path, &recordings);
    assert_eq!((saved, report.settings_restored), (recordings.len(), vec![1]));
    assert!(report.settings_lost.is_empty());
    execute("UPDATE spares SET value = '{\"a' WHERE name = 'plan_json'");
    let report = recover(&path, &folder.path().join("lost.db")).expect("recovered");
    assert_eq!((report.settings_lost, report.tables["runs"].read), (vec![1], 0));
}

// Fails if a recording with a flipped bit is saved as valid.
#[test]
fn what_is_not_what_was_written_is_left_out() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let mut bytes = std::fs::read(&path).expect("read");
    // The mean of pose 7, as SQLite writes it.
    let wanted = recordings[7].q[0].mean.to_be_bytes();
    // At every position: a page that was split also keeps the rows that were moved.
    let places: Vec<usize> = (0..bytes.len() - 7).filter(|k| bytes[*k..*k + 8] == wanted).collect();
    assert!(!places.is_empty(), "it is there");
    for at in places {
        bytes[at + 7] ^= 1;
    }
    std::fs::write(&path, &bytes).expect("written");
    let refusal = read(&path).expect_err("seen when it is read");
    assert!(refusal.to_string().contains("pose 7 (sphere 1)"), "{refusal}");
    let (saved, report) = recovered(&path, &recordings);
    assert_eq!(report.recordings_left_out, [(1, 1, 7)]);
    assert_eq!(saved, recordings.len() - 1);
}

// Fails if the program waits for ever for a database that another program has locked, if the error
// does not say so, or if stored data are lost.
#[test]
fn a_held_lock_is_told_and_costs_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let mut other = SqlStore::open(&path).expect("opened");
    other
        .block(async |c| sqlx::query("BEGIN IMMEDIATE").execute(c).await.map(|_| ()))
        .expect("held");
    let mut store = SqlStore::open(&path).expect("reading is free");
    let late = Event::Recording(recording(99, 0.3));
    let number = i64::from(99);
    let error = store.append(1, &[placed(1, number, &late)]).expect_err("held");
    assert!(matches!(error, StoreError::Locked { .. }), "{error}");
    assert!(error.to_string().contains("--resume") && !error.is_input(), "{error}");
    other
        .block(async |c| sqlx::query("ROLLBACK").execute(c).await.map(|_| ()))
        .expect("let go");
    store.append(1, &[placed(1, number, &late)]).expect("stored now");
    assert_eq!(store.recordings(1).expect("read").len(), recordings.len() + 1);
    let claim = SqlStore::claim(&path).expect("free");
    assert!(matches!(SqlStore::claim(&path), Err(StoreError::Locked { .. })));
    drop(claim);
    SqlStore::claim(&path).expect("free again");
}

/// Limits the database to so many pages, or to the pages that it has.
fn room(store: &mut SqlStore, pages: u32) {
    let statement = format!("PRAGMA max_page_count = {pages}");
    store
        .block(async |c| sqlx::query(sqlx::AssertSqlSafe(statement)).execute(c).await.map(|_| ()))
        .expect("set");
}

// Fails if a full disk loses stored data, is not named in the error, or spoils the database after
// space is free again.
#[test]
fn a_full_disk_is_told_and_costs_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = database(folder.path());
    let mut store = SqlStore::open(&path).expect("opened");
    room(&mut store, 1);
    let mut refused = 0;
    for pose in 100..400 {
        let late = Event::Recording(recording(pose, 0.3));
        let number = i64::from(pose);
        if let Err(error) = store.append(1, &[placed(1, number, &late)]) {
            assert!(matches!(error, StoreError::Full { .. }), "{error}");
            assert!(error.to_string().contains("free space"), "{error}");
            refused += 1;
        }
    }
    assert!(refused > 0, "the disk was never full");
    let stored = store.recordings(1).expect("read").len();
    assert_eq!(
        stored,
        recordings.len() + 300 - refused,
        "a refused one is not half there"
    );
    room(&mut store, 1_000_000);
    let late = Event::Recording(recording(500, 0.3));
    let number = i64::from(500);
    store.append(1, &[placed(1, number, &late)]).expect("stored now");
    drop(store);
    assert_eq!(read(&path).expect("whole").len(), stored + 1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    // Fails if a file of arbitrary bytes is opened, hangs the program or ends it.
    #[test]
    fn any_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 1..5000), signed: bool) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("calibration.db");
        let mut bytes = bytes;
        if signed {
            bytes.splice(0..bytes.len().min(16), *b"SQLite format 3\0");
        }
        std::fs::write(&path, &bytes).expect("written");
        prop_assert!(SqlStore::open(&path).is_err());
        let _ = recover(&path, &folder.path().join("new.db"));
        prop_assert_eq!(std::fs::read(&path).expect("read"), bytes);
    }
}
