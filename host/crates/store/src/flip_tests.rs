//! Flips single bits of a finished database: each that changes a row must be seen, and recovery must
//! keep everything else.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use spherecal_model::LaserShot;
use spherecal_shared::protocol::host::{Contact, Event, Phase, PhaseChange, Recording};
use sqlx::{ConnectOptions as _, Connection as _, Row as _};

use super::tests::{new_run, placed, recording};
use super::*;

/// A new database with a run and a session: the store and their numbers.
pub(super) fn begun(path: &Path) -> (SqlStore, i64, i64) {
    let mut store = SqlStore::create_or_open(path).expect("made");
    let run = store.create_run(&new_run()).expect("a run");
    let session = store.begin_session(run, "now").expect("a session");
    (store, run, session)
}

/// A finished database with every kind of row, closed.
pub(super) fn finished(folder: &Path) -> (PathBuf, Vec<Recording>) {
    let path = folder.join("calibration.db");
    let (mut store, run, session) = begun(&path);
    store.put_handshake(run, session, 1, 77).expect("stored");
    let recordings: Vec<Recording> = (0..20)
        .map(|pose| recording(pose, 0.1 + f64::from(pose) / 3.0))
        .collect();
    for (r, k) in recordings.iter().zip(0i64..) {
        let phase = Event::Phase(PhaseChange {
            phase: Phase::Recording,
            from: Phase::Idle,
            time_us: 1000,
            tick: 7,
        });
        let contact = Event::Contact(Contact {
            sphere: 1,
            time_us: 5,
            force_n: 3.1,
            peak_n: 4.2,
            tare_n: [0.1, 0.2, 0.3],
            tcp_m: [0.4, 0.5, 0.6],
            travel_m: 0.01,
            latency_ticks: 1,
            early_crossings: 0,
        });
        let arrival = Event::Recording(r.clone());
        let batch = [
            placed(session, 3 * k + 1, &phase),
            placed(session, 3 * k + 2, &contact),
            placed(session, 3 * k + 3, &arrival),
        ];
        store.append(run, &batch).expect("stored");
    }
    let shots: Vec<LaserShot> = (0..30)
        .map(|k| LaserShot {
            purpose: "validate".to_owned(),
            q: vec![f64::from(k) * 0.1; 7],
            point_m: [f64::from(k), 0.2, 0.3],
        })
        .collect();
    store.put_laser(run, &shots).expect("stored");
    let traces = "0.123456789,".repeat(2000);
    store
        .put_result(run, "contact_traces", &format!("[{traces}0]"))
        .expect("stored");
    store
        .put_result(run, history::FINGERPRINT, "{\"points_m\":[],\"sigma_mm\":0.05}")
        .expect("stored");
    store.end_session(run, session, &SessionEnd::default()).expect("stored");
    store.set_state(run, "complete").expect("stored");
    drop(store);
    (path, recordings)
}

/// The rows of every table of a run as SQLite gives them; `None` if it fails.
async fn rows_of(path: &Path) -> Option<BTreeSet<String>> {
    let mut connection = sqlx::sqlite::SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
        .connect()
        .await
        .ok()?;
    let mut all = BTreeSet::new();
    for table in seal::SEALED
        .iter()
        .map(|t| t.name)
        .chain(["recording_joints", "digests"])
    {
        let columns: Vec<String> = sqlx::query_scalar(sqlx::AssertSqlSafe(format!(
            "SELECT CAST(name AS BLOB) FROM pragma_table_info('{table}')"
        )))
        .fetch_all(&mut connection)
        .await
        .ok()?
        .into_iter()
        .map(|name: Vec<u8>| String::from_utf8_lossy(&name).into_owned())
        .collect();
        let words: Vec<String> = columns.iter().map(|name| format!("quote({name})")).collect();
        let statement = format!(
            "SELECT CAST({} AS BLOB) FROM {table} NOT INDEXED",
            words.join(" || '|' || ")
        );
        let rows = sqlx::query(sqlx::AssertSqlSafe(statement))
            .fetch_all(&mut connection)
            .await
            .ok()?;
        all.extend(rows.iter().map(|row| {
            let words: Vec<u8> = row.try_get_unchecked(0).unwrap_or_default();
            format!("{table} {}", String::from_utf8_lossy(&words))
        }));
    }
    let _ = connection.close().await;
    Some(all)
}

/// What so many flips came to.
#[derive(Debug, Default)]
struct Tally {
    flips: usize,
    changed: usize,
    seen: usize,
    recoveries_of_all: usize,
    recordings_lost: usize,
}

fn flip(count: usize, seed: u64) -> Tally {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = finished(folder.path());
    let runtime = open::runtime(&path).expect("a runtime");
    let whole = std::fs::read(&path).expect("read");
    let rows = runtime.block_on(rows_of(&path)).expect("readable");
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut tally = Tally::default();
    for number in 0..count {
        let mut bytes = whole.clone();
        let bit = rng.random_range(0..bytes.len() * 8);
        bytes[bit / 8] ^= 1 << (bit % 8);
        let damaged = folder.path().join(format!("damaged-{number}.db"));
        std::fs::write(&damaged, &bytes).expect("written");
        let read = runtime.block_on(rows_of(&damaged));
        let changed = read.as_ref() != Some(&rows);
        let found = SqlStore::open(&damaged).and_then(|mut store| store.damage());
        let seen = !matches!(&found, Ok(found) if found.is_empty());
        tally.flips += 1;
        tally.changed += usize::from(changed);
        tally.seen += usize::from(seen);
        assert!(seen || !changed, "bit {bit} changed a row in silence");
        if !seen {
            continue;
        }
        let _ = std::fs::write(&damaged, &bytes);
        let new = folder.path().join(format!("new-{number}.db"));
        let report = recover(&damaged, &new).unwrap_or_else(|error| panic!("bit {bit}: {error}"));
        let mut store = SqlStore::open(&new).unwrap_or_else(|error| panic!("bit {bit}: {error}"));
        let damage = store.damage().expect("readable");
        assert!(damage.is_empty(), "bit {bit}: the new file is damaged: {damage:?}");
        let kept = store.recordings(1).unwrap_or_else(|error| panic!("bit {bit}: {error}"));
        assert!(
            kept.iter().all(|r| recordings.contains(r)),
            "bit {bit}: not what was written"
        );
        assert_eq!(
            store.info_of(1).expect("readable").expect("the run").about.seed,
            new_run().seed
        );
        // A flip lies in one row at most; a damaged page's header may cost the rows of the page.
        let lost = recordings.len() - kept.len();
        let own = read.is_some_and(|read| {
            rows.difference(&read)
                .all(|row| !row.starts_with("recordings ") && !row.starts_with("recording_joints "))
        });
        if lost > 0 {
            println!(
                "bit {bit} (page {}, byte {}): {lost} lost; {own}; {report:?}",
                bit / 8 / 4096,
                bit / 8 % 4096
            );
        }
        assert!(!own || lost == 0, "bit {bit}: {lost} undamaged recordings are lost");
        tally.recordings_lost += lost;
        tally.recoveries_of_all += usize::from(lost == 0);
        let _ = std::fs::remove_file(&damaged);
        let _ = std::fs::remove_file(&new);
    }
    tally
}

// Fails if a flipped bit changes a row of any table without being seen, if recovery loses a recording
// that the bit does not lie in, or if it writes a file that is refused.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_every_flipped_bit_that_changes_a_row_is_seen() {
    let count = std::env::var("SPHERECAL_FLIPS").map_or(40, |text| text.parse().expect("a number"));
    let tally = flip(count, 1);
    println!("{tally:?}");
    assert!(tally.changed * 10 > tally.flips, "{tally:?}");
}

// Fails if a bit flipped in SQLite's own text of the tables costs a row: the text is known.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_flip_in_the_list_of_tables_costs_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = finished(folder.path());
    let whole = std::fs::read(&path).expect("read");
    let places: Vec<usize> = (0..whole.len() - 13)
        .filter(|k| whole[*k..].starts_with(b"CREATE TABLE "))
        .collect();
    assert!(places.len() >= 13, "{}", places.len());
    for (number, place) in places.into_iter().enumerate() {
        // In the name of the table, and in that of a column.
        for (offset, bit) in [(15, 1), (13 + 22, 4)] {
            let mut bytes = whole.clone();
            bytes[place + offset] ^= 1 << bit;
            let damaged = folder.path().join(format!("damaged-{number}-{offset}.db"));
            std::fs::write(&damaged, &bytes).expect("written");
            let new = folder.path().join(format!("new-{number}-{offset}.db"));
            let report = recover(&damaged, &new).unwrap_or_else(|error| panic!("{place} + {offset}: {error}"));
            let mut store = SqlStore::open(&new).expect("sound");
            assert!(store.damage().expect("readable").is_empty());
            assert_eq!(store.recordings(1).expect("readable"), recordings, "{place} + {offset}");
            let lost: u64 = report.tables.values().map(|saved| saved.lost).sum();
            assert_eq!(lost, 0, "{place} + {offset}: {report:?}");
            assert_eq!(
                (report.tables["contacts"].read, report.tables["laser_shots"].read),
                (20, 30),
                "{place} + {offset}: {report:?}"
            );
        }
    }
}

// Fails if a database that was removed or replaced during a run is written to as if it were there.
#[cfg(unix)]
#[test]
fn a_file_that_was_removed_is_noticed() {
    for replaced in [false, true] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("calibration.db");
        let mut store = SqlStore::create_or_open(&path).expect("made");
        let run = store.create_run(&new_run()).expect("a run");
        std::fs::rename(&path, folder.path().join("away.db")).expect("moved");
        if replaced {
            std::fs::write(&path, "another").expect("written");
        }
        let arrival = Event::Recording(recording(1, 0.3));
        let error = store.append(run, &[placed(1, 1, &arrival)]).expect_err("noticed");
        assert!(matches!(error, StoreError::Gone { .. }) && !error.is_input(), "{error}");
    }
}

// Fails if one changed byte of a result, an event or a session is read as it is.
#[test]
fn a_changed_row_is_refused_by_its_reader() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, _) = finished(folder.path());
    let whole = std::fs::read(&path).expect("read");
    for (statement, subject) in [
        (
            "UPDATE results SET json = '{}' WHERE name = 'fingerprint'",
            "fingerprint",
        ),
        ("UPDATE contacts SET force_n = 9.5 WHERE event = 5", "contacts 1 5"),
        ("UPDATE sessions SET ticks = 9", "sessions 1"),
        ("DELETE FROM phases WHERE event = 4", "phases 1 4"),
        ("UPDATE poses SET rejected = 'x' WHERE pose = 3", "poses 1 3"),
        ("DELETE FROM digests WHERE subject = 'contacts 1 8'", "contacts 1 8"),
    ] {
        std::fs::write(&path, &whole).expect("written");
        let mut store = SqlStore::open(&path).expect("opened");
        store
            .block(async |c| sqlx::query(statement).execute(c).await.map(|_| ()))
            .expect(statement);
        let damage = store.damage().expect("readable");
        assert!(
            damage.len() == 1 && damage[0].what.contains(subject),
            "{statement}: {damage:?}"
        );
        let refused = if statement.contains("results") {
            store.result(1, history::FINGERPRINT).err()
        } else {
            CalibrationStore::read_run(&mut store, 1).err()
        };
        assert!(
            matches!(refused, Some(StoreError::Damaged { .. })),
            "{statement}: {refused:?}"
        );
    }
}
