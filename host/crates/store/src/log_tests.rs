//! The write-ahead log: what it holds, what its damage or loss costs, and who says so.

use std::path::{Path, PathBuf};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use spherecal_shared::protocol::host::{Event, Recording};
use sqlx::ConnectOptions as _;

use super::flip_tests::begun;
use super::tests::{placed, recording};
use super::*;

// Fails if the loss or damage of the write-ahead log costs anything that was acknowledged.
#[test]
fn the_log_holds_nothing_that_was_acknowledged() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    let (mut store, run, session) = begun(&path);
    for k in 0..12u32 {
        let arrival = Event::Recording(recording(k, 0.3));
        store
            .append(run, &[placed(session, i64::from(k), &arrival)])
            .expect("stored");
        // What a kill leaves, without the log.
        let copy = folder.path().join(format!("copy-{k}.db"));
        std::fs::copy(&path, &copy).expect("copied");
        let mut killed = SqlStore::open(&copy).expect("opened");
        assert_eq!(killed.recordings(run).expect("read").len(), k as usize + 1);
        assert!(killed.damage().expect("readable").is_empty());
    }
}

// Fails if a bit flipped in a log that holds commits changes what was written, costs a recording that it does not
// lie in, or costs something that was acknowledged and is called whole. Only a reader, or a kill
// between the commit and its way into the file, leaves such a log.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_flip_in_the_log_changes_nothing_that_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    let (mut store, run, session) = begun(&path);
    let recordings: Vec<Recording> = (0..9).map(|k| recording(k, 0.3 + f64::from(k))).collect();
    let runtime = open::runtime(&path).expect("a runtime");
    let mut reader = None;
    for (r, k) in recordings.iter().zip(0usize..) {
        if k == 3 {
            // From here on, the log keeps what is committed.
            reader = Some(runtime.block_on(async {
                let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&path);
                let mut connection = options.connect().await.expect("connected");
                for statement in ["BEGIN", "SELECT count(*) FROM recordings"] {
                    sqlx::raw_sql(statement).execute(&mut connection).await.expect("read");
                }
                connection
            }));
        }
        let arrival = Event::Recording(r.clone());
        store
            .append(run, &[placed(session, k as i64, &arrival)])
            .expect("stored");
    }
    let log_of = |path: &Path| PathBuf::from(format!("{}-wal", path.display()));
    let (file, log) = (
        std::fs::read(&path).expect("read"),
        std::fs::read(log_of(&path)).expect("read"),
    );
    let statement = std::fs::read(acknowledged::statement_of(&path)).expect("stated");
    drop(reader);
    assert!(log.len() > 6 * 4096, "the log holds six commits: {}", log.len());
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut refused, mut lost_of_all) = (0, 0);
    let count = std::env::var("SPHERECAL_FLIPS").map_or(40, |text| text.parse().expect("a number"));
    for number in 0..count {
        let copy = folder.path().join(format!("copy-{number}.db"));
        let mut bytes = log.clone();
        let bit = rng.random_range(0..bytes.len() * 8);
        bytes[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&copy, &file).expect("written");
        std::fs::write(log_of(&copy), &bytes).expect("written");
        std::fs::write(acknowledged::statement_of(&copy), &statement).expect("written");
        let opened = SqlStore::open(&copy);
        if let Ok(mut killed) = opened {
            let damage = killed.damage().expect("readable");
            // No sound frame follows the damage: SQLite reads all that there is.
            let read = killed
                .recordings(run)
                .unwrap_or_else(|error| panic!("bit {bit}: {error}"));
            assert!(
                read.len() >= recordings.len() - 1 && recordings.starts_with(&read),
                "bit {bit}: {}",
                read.len()
            );
            let lost = recordings.len() - read.len();
            let seen = damage.len() == 1 && damage[0].what.contains(&format!("the other {lost} "));
            assert!(
                if lost == 0 { damage.is_empty() } else { seen },
                "bit {bit}: {damage:?}"
            );
        } else {
            refused += 1;
            assert_eq!(std::fs::read(log_of(&copy)).expect("left"), bytes, "bit {bit}");
        }
        let new = folder.path().join("new.db");
        let report = recover(&copy, &new).unwrap_or_else(|error| panic!("bit {bit}: {error}"));
        let mut saved = SqlStore::open(&new).expect("sound");
        assert!(saved.damage().expect("read").is_empty(), "bit {bit}");
        let read = saved.recordings(run).expect("read");
        let lost = recordings.len() - read.len();
        assert!(
            lost <= 2 && read.iter().all(|r| recordings.contains(r)),
            "bit {bit}: {lost} lost, {report:?} {:?}",
            read.iter().map(|r| r.pose).collect::<Vec<_>>()
        );
        assert_eq!(
            report.acknowledged_missing.values().sum::<i64>(),
            lost as i64,
            "bit {bit}"
        );
        lost_of_all += lost;
        for path in [log_of(&copy), acknowledged::statement_of(&copy), copy, new] {
            let _ = std::fs::remove_file(path);
        }
    }
    println!("{count} flips: {refused} logs refused, {lost_of_all} recordings lost");
    assert!(refused * 2 > count, "the flips hit: {refused} of {count}");
}

// Fails if the statement of what was acknowledged outlives its need, if a later batch hides a loss, or
// if what is measured again is still called lost.
#[test]
fn the_loss_of_a_log_that_a_reader_held_is_seen_until_it_is_made_good() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    let statement = acknowledged::statement_of(&path);
    let (mut store, run, session) = begun(&path);
    let put = |store: &mut SqlStore, k: u32| {
        let arrival = Event::Recording(recording(k, 0.3));
        store
            .append(run, &[placed(session, i64::from(k), &arrival)])
            .expect("stored");
    };
    let mut reader = SqlStore::open(&path).expect("opened");
    put(&mut store, 0);
    assert!(!statement.exists(), "nobody reads");
    reader
        .snapshot(|reader| {
            reader.recordings(run)?;
            put(&mut store, 1);
            put(&mut store, 2);
            assert!(statement.exists(), "a reader holds the log");
            // What a kill leaves, without the log.
            std::fs::copy(&path, folder.path().join("lost.db")).expect("copied");
            std::fs::copy(&statement, folder.path().join("lost.db-acknowledged")).expect("copied");
            Ok(())
        })
        .expect("read");
    assert!(store.damage().expect("read").is_empty());
    drop(store);
    assert!(!statement.exists(), "the log is empty");

    let path = folder.path().join("lost.db");
    let statement = acknowledged::statement_of(&path);
    for there in 1..3 {
        let mut store = SqlStore::open(&path).expect("opened");
        let damage = store.damage().expect("read");
        let expected = format!("3 recordings were acknowledged and {there} are there");
        assert!(damage.len() == 1 && damage[0].what.starts_with(&expected), "{damage:?}");
        put(&mut store, there);
        assert_eq!(statement.exists(), there < 2);
    }
    let mut store = SqlStore::open(&path).expect("opened");
    assert!(store.damage().expect("read").is_empty());
    // A statement that is none is told, not passed over.
    std::fs::write(&statement, "{").expect("written");
    let damage = store.damage().expect("read");
    assert!(
        damage.len() == 1 && damage[0].what.contains("cannot be read"),
        "{damage:?}"
    );
}
