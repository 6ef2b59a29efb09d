use super::fleet::statements;
use super::*;
use spherecal_model::{LaserShot, paper_plate};
use spherecal_shared::protocol::host::{Event, Fault, FaultReport, Phase, PhaseChange, Recording, SignalStatistics};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
use sqlx::{AssertSqlSafe, Row as _};

pub(super) fn new_run() -> NewRun {
    NewRun {
        created_utc: "2026-01-02T03:04:05Z".to_owned(),
        seed: u64::MAX - 3,
        link: "sim".to_owned(),
        robot: iiwa7(),
        tool: iiwa7_tool(),
        config_toml: "seed = 1\n".to_owned(),
        plan_json: "{}".to_owned(),
        program: "test".to_owned(),
        spheres: paper_plate(),
        poses: (0..1200)
            .map(|pose| StoredPose {
                sphere: 1,
                pose,
                orientation: [1.0, 0.0, 0.0, 0.0],
                elbow_rad: (pose % 2 == 0).then_some(0.1),
            })
            .collect(),
        arm: "A-17".to_owned(),
    }
}

pub(super) fn recording(pose: u32, odd: f64) -> Recording {
    let signal = |k: usize| SignalStatistics {
        mean: odd / (k as f64 + 3.0),
        std: 1e-300 / (k as f64 + 1.0),
        // SQLite drops the sign of a zero. That must not count as damage.
        min: if k == 2 { -0.0 } else { -0.1 - 1e-17 },
        max: std::f64::consts::PI,
    };
    Recording {
        sphere: 1,
        pose,
        start_us: 5_000_000_000,
        end_us: 5_000_999_000,
        count: 1000,
        gaps: 0,
        q: (0..7).map(signal).collect(),
        tau: (0..7).map(signal).collect(),
        tcp_spread_m: 1e-6 / 3.0,
        force_n: [0.1, 0.2, 0.3],
    }
}

pub(super) fn placed(session: i64, event: i64, body: &Event) -> Placed<'_> {
    Placed { session, event, body }
}

// Fails if any bit of a recording changes on its way through the file, if a repeat is stored again,
// or if the order is lost.
#[test]
fn recordings_survive_to_the_bit_and_come_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("deep/er/calibration.db");
    let recordings: Vec<_> = [(7, 1.0), (3, 0.7), (5, -1.0 / 3.0)]
        .map(|(pose, odd)| recording(pose, odd))
        .into();
    {
        let mut store = SqlStore::create_or_open(&path).expect("made");
        let run = store.create_run(&new_run()).expect("a run");
        let session = store.begin_session(run, "now").expect("a session");
        for (r, k) in recordings.iter().zip(1..) {
            let event = Event::Recording(r.clone());
            let batch = [placed(session, k, &event)];
            store.append(run, &batch).expect("stored");
            store.append(run, &batch).expect("a repeat is no error");
        }
        // Dropped without a word, as by a kill.
    }
    let mut store = SqlStore::open(&path).expect("opened again");
    let info = store.require_last_run().expect("the run");
    assert_eq!(
        (info.run, info.about.seed, info.state.as_str()),
        (1, u64::MAX - 3, "running")
    );
    assert_eq!((info.about.robot, info.about.tool), (iiwa7(), iiwa7_tool()));
    assert_eq!(store.recordings(1).expect("read"), recordings);
    let read = store.read_run(1).expect("read");
    assert_eq!(
        read.recorded().into_iter().collect::<Vec<_>>(),
        [(1, 3), (1, 5), (1, 7)]
    );
    assert_eq!((read.spheres, read.recordings), (paper_plate(), recordings));
}

#[test]
fn faults_phases_shots_and_results_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = SqlStore::create_or_open(&folder.path().join("c.db")).expect("made");
    let run = store.create_run(&new_run()).expect("a run");
    let session = store.begin_session(run, "now").expect("a session");
    let fault = FaultReport {
        fault: Fault::NotFinite,
        phase: Phase::Recording,
        time_us: 1,
        tick: 2,
        joint: 3,
        value: f64::NAN,
        limit: f64::INFINITY,
    };
    let phase = PhaseChange {
        phase: Phase::HandGuiding,
        from: Phase::Idle,
        time_us: 9,
        tick: 8,
    };
    let (fault, change) = (Event::Fault(fault), Event::Phase(phase));
    let batch = [placed(session, 1, &fault), placed(session, 2, &change)];
    store.append(run, &batch).expect("stored");
    let read = store.faults(run).expect("read");
    assert_eq!(
        (read.len(), read[0].fault, read[0].limit),
        (1, Fault::NotFinite, f64::INFINITY)
    );
    assert!(read[0].value.is_nan());
    assert_eq!(store.phases(run).expect("read"), [phase]);
    let shots: Vec<_> = (0..700)
        .map(|k| LaserShot {
            purpose: if k < 300 { "calibrate" } else { "validate" }.to_owned(),
            q: vec![f64::from(k) / 7.0; 7],
            point_m: [f64::from(k) / 3.0, 0.1, -0.2],
        })
        .collect();
    store.put_laser(run, &shots).expect("stored");
    store.put_laser(run, &shots).expect("replaced");
    assert_eq!(store.laser(run).expect("read"), shots);
    store.put_result(run, "summary", "{}").expect("stored");
    store.put_result(run, "summary", "{\"a\":1}").expect("replaced");
    assert_eq!(
        store.result(run, "summary").expect("read").as_deref(),
        Some("{\"a\":1}")
    );
    store.reject_pose(run, 1, 4, "fell off").expect("stored");
    assert!(store.read_run(run).expect("read").rejected.contains(&(1, 4)));
}

// Fails if a database of a newer version, or another kind of file, is opened or changed by one
// byte.
#[test]
fn what_is_not_ours_is_refused_and_not_touched() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    drop(SqlStore::create_or_open(&path).expect("made"));
    let mut bytes = std::fs::read(&path).expect("read");
    bytes[60..64].copy_from_slice(&99u32.to_be_bytes());
    std::fs::write(&path, &bytes).expect("written");
    let refusal = SqlStore::create_or_open(&path).err().expect("refused");
    assert!(matches!(refusal, StoreError::Version { found: 99, .. }), "{refusal}");
    assert!(refusal.is_input());
    let text = refusal.to_string();
    assert!(text.contains("version 99") && text.contains("--out"), "{text}");
    assert_eq!(std::fs::read(&path).expect("read"), bytes, "not one byte changed");

    bytes[68..72].copy_from_slice(&7u32.to_be_bytes());
    std::fs::write(&path, &bytes).expect("written");
    assert!(matches!(SqlStore::open(&path).err(), Some(StoreError::NotOurs { .. })));
    std::fs::write(&path, "a letter, not a database").expect("written");
    assert!(matches!(SqlStore::open(&path).err(), Some(StoreError::NotOurs { .. })));
    assert_eq!(std::fs::read(&path).expect("read"), b"a letter, not a database");
    assert!(matches!(
        SqlStore::open(&folder.path().join("none.db")).err(),
        Some(StoreError::Missing { .. })
    ));
}

// Fails if a database of the first schema is refused, loses a run in the migration, or is not
// migrated permanently.
#[test]
fn an_older_schema_is_brought_up_to_date() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    let mut store = SqlStore::create_or_open(&path).expect("made");
    let run = store.create_run(&new_run()).expect("a run");
    for statement in [
        "DROP INDEX results_by_name",
        "DROP INDEX runs_of_arm",
        "DROP INDEX runs_overview",
        "ALTER TABLE runs DROP COLUMN arm",
        "DROP TABLE greetings",
        "DROP TABLE digests",
        "DROP TABLE spares",
        "DELETE FROM _sqlx_migrations WHERE version > 1",
        "PRAGMA user_version = 1",
    ] {
        store
            .block(async |connection| sqlx::query(statement).execute(connection).await.map(|_| ()))
            .expect(statement);
    }
    drop(store);
    for _ in 0..2 {
        let mut store = SqlStore::open(&path).expect("brought up to date");
        let info = store.require_last_run().expect("the run");
        assert_eq!((info.run, info.about.arm.as_str()), (run, ""));
    }
    let bytes = std::fs::read(&path).expect("read");
    assert_eq!(
        bytes[60..64],
        u32::try_from(SCHEMA_VERSION).expect("small").to_be_bytes()
    );
    let mut store = SqlStore::open(&path).expect("opened");
    assert!(
        store.damage().expect("readable").is_empty(),
        "the migration seals every row"
    );
}

// Fails if an overview of all runs reads their rows, each of which has a plan of many pages, or if the past of one arm reads those
// of others.
#[test]
fn an_overview_reads_indexes_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = SqlStore::create_or_open(&folder.path().join("calibration.db")).expect("made");
    for (one_arm, means) in [
        (false, "SCAN runs USING COVERING INDEX runs_overview"),
        (true, "runs_of_arm (arm=?)"),
    ] {
        let statement = statements(one_arm).into_iter().next().expect("that of the runs");
        let explain = format!("EXPLAIN QUERY PLAN {}", statement.replace("$1", "'arm'"));
        let plan = store
            .block(async |c| sqlx::query(AssertSqlSafe(explain)).fetch_all(c).await)
            .expect("a plan");
        let plan: Vec<String> = plan.iter().map(|row| row.get("detail")).collect();
        assert!(plan.len() == 1 && plan[0].contains(means), "{plan:?}");
    }
}

// Fails if a database whose rows are sealed is sealed anew when it gets its indexes: damage from before would
// then count as sound.
#[test]
fn a_migration_seals_no_damage() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.db");
    let mut store = SqlStore::create_or_open(&path).expect("made");
    let run = store.create_run(&new_run()).expect("a run");
    store.put_result(run, "summary", "{}").expect("stored");
    for statement in [
        "UPDATE results SET json = '[]'",
        "DROP INDEX results_by_name",
        "DROP INDEX runs_of_arm",
        "DROP INDEX runs_overview",
        "CREATE INDEX runs_by_arm ON runs (robot, arm, created_utc)",
        "DELETE FROM _sqlx_migrations WHERE version > 4",
        "PRAGMA user_version = 4",
    ] {
        store
            .block(async |connection| sqlx::query(statement).execute(connection).await.map(|_| ()))
            .expect(statement);
    }
    drop(store);
    let mut store = SqlStore::open(&path).expect("brought up to date");
    assert_eq!(store.damage().expect("readable").len(), 1);
}
