//! Damage, recovery and what goes on from there: the order of what is made again, older and newer schemas, and logs.

use std::path::Path;

use spherecal_shared::protocol::host::{Event, Recording};
use sqlx::{AssertSqlSafe, ConnectOptions as _, Connection as _};

use super::flip_tests::finished;
use super::tests::{placed, recording};
use super::*;

/// Changes a file behind the program's back.
fn change(path: &Path, statements: &[&str]) {
    let runtime = open::runtime(path).expect("a runtime");
    runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(path);
        let mut connection = options.connect().await.expect("opened");
        for statement in statements {
            let done = sqlx::raw_sql(AssertSqlSafe((*statement).to_owned()))
                .execute(&mut connection)
                .await;
            done.unwrap_or_else(|error| panic!("{statement}: {error}"));
        }
        connection.close().await.expect("closed");
    });
}

/// The recordings of a file, after `store check`.
fn checked(path: &Path) -> Vec<Recording> {
    let mut store = SqlStore::open(path).expect("sound");
    let damage = store.damage().expect("readable");
    assert!(damage.is_empty(), "{damage:?}");
    store.recordings(1).expect("readable")
}

// Fails if a recording that is lost and made again does not come to its place among the others, whether the run is
// repeated from its start or goes on, or if `store check` calls the result damaged.
#[test]
fn a_recording_that_is_made_again_comes_to_its_place() {
    for lost in [0usize, 7, 13, 19] {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, recordings) = finished(folder.path());
        for table in ["recording_joints", "recordings"] {
            change(&path, &[&format!("DELETE FROM {table} WHERE pose = {lost}")]);
        }
        let new = folder.path().join("new.db");
        let report = recover(&path, &new).expect("recovered");
        assert_eq!(report.tables["recordings"].read, 19);
        assert_eq!(checked(&new).len(), 19);
        let mut store = SqlStore::open(&new).expect("opened");
        assert_eq!(store.info_of(1).expect("read").expect("the run").state, "running");
        // The run is repeated from its start, under the numbers that its events had.
        for (r, k) in recordings.iter().zip(0i64..) {
            let arrival = Event::Recording(r.clone());
            store.rewrite(1, &[placed(1, 3 * k + 3, &arrival)]).expect("stored");
        }
        drop(store);
        assert_eq!(checked(&new), recordings, "{lost}");
        // The arm lives on: what is made later comes later.
        let other = folder.path().join("other.db");
        recover(&path, &other).expect("recovered");
        let mut store = SqlStore::open(&other).expect("opened");
        let session = store.begin_session(1, "now").expect("a session");
        let arrival = Event::Recording(recordings[lost].clone());
        store.append(1, &[placed(session, 1, &arrival)]).expect("stored");
        drop(store);
        let mut expected = recordings;
        let again = expected.remove(lost);
        expected.push(again);
        assert_eq!(checked(&other), expected, "{lost}");
    }
}

// Fails if a lost digest costs a recording for which another digest vouches.
#[test]
fn a_lost_digest_costs_no_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = finished(folder.path());
    let whole = std::fs::read(&path).expect("read");
    for r in &recordings {
        for table in ["recording", "recordings"] {
            std::fs::write(&path, &whole).expect("written");
            let subject = format!("{table} {} {}", r.sphere, r.pose);
            change(&path, &[&format!("DELETE FROM digests WHERE subject = '{subject}'")]);
            let new = folder.path().join("new.db");
            let recovered = recover(&path, &new).expect("recovered");
            assert_eq!(
                (recovered.recordings_left_out, checked(&new)),
                (Vec::new(), recordings.clone()),
                "{subject}"
            );
            std::fs::remove_file(new).expect("removed");
        }
    }
}

// Fails if a run whose database has positions of an earlier version is ordered otherwise when it is repeated.
#[test]
fn positions_of_an_earlier_version_are_replaced_by_a_repetition() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, recordings) = finished(folder.path());
    let mut store = SqlStore::open(&path).expect("opened");
    store
        .write(async |t| {
            sqlx::query("DELETE FROM recording_joints WHERE pose = 7 AND run = $1")
                .bind(1i64)
                .execute(&mut *t)
                .await?;
            sqlx::query("DELETE FROM recordings WHERE pose = 7")
                .execute(&mut *t)
                .await?;
            sqlx::query("DELETE FROM digests WHERE subject = 'recording 1 7' OR subject = 'recordings 1 7'")
                .execute(&mut *t)
                .await?;
            sqlx::query("UPDATE recordings SET position = pose")
                .execute(&mut *t)
                .await?;
            seal::seal(t, &seal::RECORDINGS, 1, &[]).await
        })
        .expect("as an earlier version left it");
    for (r, k) in recordings.iter().zip(0i64..) {
        let arrival = Event::Recording(r.clone());
        store.rewrite(1, &[placed(1, 3 * k + 3, &arrival)]).expect("stored");
    }
    drop(store);
    assert_eq!(checked(&path), recordings);
}

// Fails if recovery drops the columns and tables of a newer schema, or writes a file.
#[test]
fn a_newer_schema_is_refused_by_recovery_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, _) = finished(folder.path());
    let column = "ALTER TABLE recordings ADD COLUMN warmth_c DOUBLE PRECISION NOT NULL DEFAULT 21.0";
    let table = "CREATE TABLE moods (run BIGINT PRIMARY KEY, mood TEXT NOT NULL)";
    let whole = std::fs::read(&path).expect("read");
    for mark in [
        "PRAGMA user_version = 7",
        "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
         VALUES (7, 'newer', 1, x'00', 1)",
    ] {
        std::fs::write(&path, &whole).expect("written");
        change(&path, &[column, table, mark]);
        let before = std::fs::read(&path).expect("read");
        let new = folder.path().join("new.db");
        let refusal = recover(&path, &new).expect_err("refused");
        assert!(matches!(refusal, StoreError::Version { found: 7, .. }), "{refusal}");
        assert!(!new.exists());
        assert_eq!(std::fs::read(&path).expect("read"), before);
    }
    // A damaged mark is damage: the tables are those that this program knows.
    std::fs::write(&path, &whole).expect("written");
    change(&path, &["PRAGMA user_version = 8"]);
    let new = folder.path().join("new.db");
    recover(&path, &new).expect("recovered");
    assert_eq!(checked(&new).len(), 20);
}

// Fails if recovery of a file of an older schema loses its runs, whose table has a column less.
#[test]
fn a_file_of_the_first_schema_is_recovered_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("old.db");
    std::fs::write(&path, include_bytes!("../tests/data/schema_1.db")).expect("written");
    let new = folder.path().join("new.db");
    let report = recover(&path, &new).expect("recovered");
    let kept = checked(&new);
    std::fs::remove_file(&new).expect("removed");
    assert_eq!(kept.len(), 3, "{report:?}");
    let lost: u64 = report.tables.values().map(|saved| saved.lost).sum();
    assert_eq!(lost, 0, "{report:?}");
    assert_eq!(kept, checked(&path), "as the file is read when it is brought forward");
}

// Fails if a first run on a robot becomes a calibration that is to be continued.
#[test]
fn a_commissioning_stays_one() {
    for damage in ["UPDATE sessions SET ticks = 9", "UPDATE runs SET seed = 5"] {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, _) = finished(folder.path());
        let mut store = SqlStore::open(&path).expect("opened");
        store.put_result(1, "commissioning", "{}").expect("stored");
        store.set_state(1, RunInfo::COMMISSIONED).expect("set");
        drop(store);
        change(&path, &[damage]);
        let new = folder.path().join("new.db");
        recover(&path, &new).expect("recovered");
        let mut store = SqlStore::open(&new).expect("opened");
        let info = store.info_of(1).expect("read").expect("the run");
        assert_eq!(info.state, RunInfo::COMMISSIONED, "{damage}");
    }
}

// Fails if a lost or changed pose of the plan is not restored, or if a run that lacks one counts as complete.
#[test]
fn poses_are_restored_from_their_second_copy() {
    for damage in [
        "DELETE FROM poses WHERE pose = 900",
        "UPDATE poses SET elbow_rad = 0.7 WHERE pose = 12",
        "DELETE FROM poses",
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, _) = finished(folder.path());
        let poses = |path: &Path| {
            let mut store = SqlStore::open(path).expect("opened");
            let rows = store.block(async |c| {
                sqlx::query_as::<_, (i64, i64, i64, f64, Option<f64>)>(
                    "SELECT sphere, pose, position, qw, elbow_rad FROM poses ORDER BY position",
                )
                .fetch_all(c)
                .await
            });
            rows.expect("read")
        };
        let expected = poses(&path);
        assert_eq!(expected.len(), 1200);
        change(&path, &[damage]);
        let new = folder.path().join("new.db");
        recover(&path, &new).expect("recovered");
        assert_eq!(checked(&new).len(), 20);
        assert_eq!(poses(&new), expected, "{damage}");
    }
}

// Fails if a digest of a changed row is replaced by one that vouches for it when the file's mark says that it is
// of an older schema.
#[test]
fn a_changed_row_of_an_older_mark_is_not_sealed() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, _) = finished(folder.path());
    change(
        &path,
        &[
            "UPDATE contacts SET force_n = 9.5 WHERE event = 5",
            "PRAGMA user_version = 1",
        ],
    );
    let mut store = SqlStore::open(&path).expect("opened");
    let damage = store.damage().expect("readable");
    assert!(
        damage.len() == 1 && damage[0].what.contains("contacts 1 5"),
        "{damage:?}"
    );
}

// Fails if a program that opens a database overwrites the sound frames behind a damaged one of its log, if
// `store recover` does not read them, or if a log is refused that a power cut has torn at its end.
#[test]
fn sound_frames_behind_a_damaged_one_are_salvaged() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    let (mut store, run, session) = super::flip_tests::begun(&path);
    let recordings: Vec<Recording> = (0..9).map(|k| recording(k, 0.3 + f64::from(k))).collect();
    let runtime = open::runtime(&path).expect("a runtime");
    let put = |store: &mut SqlStore, k: usize| {
        let arrival = Event::Recording(recordings[k].clone());
        store
            .append(run, &[placed(session, k as i64, &arrival)])
            .expect("stored");
    };
    put(&mut store, 0);
    let reader = runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&path);
        let mut connection = options.connect().await.expect("connected");
        for statement in ["BEGIN", "SELECT count(*) FROM recordings"] {
            sqlx::raw_sql(statement).execute(&mut connection).await.expect("read");
        }
        connection
    });
    let mut ends = Vec::new();
    for k in 1..9 {
        put(&mut store, k);
        ends.push(std::fs::metadata(log::log_of(&path)).expect("there").len() as usize);
    }
    let (file, frames) = (
        std::fs::read(&path).expect("read"),
        std::fs::read(log::log_of(&path)).expect("read"),
    );
    let statement = std::fs::read(acknowledged::statement_of(&path)).expect("stated");
    drop(reader);
    drop(store);
    assert_eq!(ends.last(), Some(&frames.len()));
    // Of the header: magic, page size, salts, checksum. Then in each part of frames of the second transaction.
    let second = ends[0];
    let places = [0, 3, 10, 17, 25]
        .into_iter()
        .chain([1, 6, 9, 20, 300].map(|at| second + at));
    for (number, place) in places.enumerate() {
        let copy = folder.path().join(format!("copy-{number}.db"));
        let mut bytes = frames.clone();
        bytes[place] ^= 0x10;
        std::fs::write(&copy, &file).expect("written");
        std::fs::write(log::log_of(&copy), &bytes).expect("written");
        std::fs::write(acknowledged::statement_of(&copy), &statement).expect("written");
        let refusal = SqlStore::open(&copy).map(drop).expect_err("refused");
        assert!(refusal.to_string().contains("store recover"), "{place}: {refusal}");
        assert_eq!(std::fs::read(log::log_of(&copy)).expect("left"), bytes, "{place}");
        let new = folder.path().join(format!("new-{number}.db"));
        let report = recover(&copy, &new).expect("recovered");
        assert!(report.log_frames_salvaged > 10, "{place}: {report:?}");
        let kept = checked(&new);
        assert!(kept.iter().all(|r| recordings.contains(r)), "{place}");
        // The later transactions wrote the damaged page again, but for at most one that was full.
        assert!(kept.len() >= 8, "{place}: {} of 9", kept.len());
        let missing: i64 = report.acknowledged_missing.values().sum();
        assert_eq!(missing, 9 - kept.len() as i64, "{place}");
    }
    // What a power cut leaves: the last transaction is torn, and nothing was acknowledged of it.
    let copy = folder.path().join("torn.db");
    let mut bytes = frames;
    bytes[ends[6] + 100] ^= 0x10;
    std::fs::write(&copy, &file).expect("written");
    std::fs::write(log::log_of(&copy), &bytes).expect("written");
    assert_eq!(checked(&copy).len(), 8);
}
