//! Every damage walked to its end: check, recover, check, resume, and the database of a run that nothing disturbed.
//!
//! `SPHERECAL_CIRCLES=1000 cargo test -p spherecal --test cli circles -- --ignored` walks as many as are asked.

#![cfg(unix)]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use sqlx::{AssertSqlSafe, ConnectOptions as _, Connection as _};

use crate::kills::{compared, finished, has_run, measure, recorded};
use crate::support::{spherecal, text};

/// Tables whose rows are lost.
const TABLES: [&str; 15] = [
    "runs",
    "spares",
    "sessions",
    "greetings",
    "spheres",
    "poses",
    "recordings",
    "recording_joints",
    "contacts",
    "couplings",
    "phases",
    "faults",
    "laser_shots",
    "results",
    "digests",
];

/// Executes statements on a database; whether all of them could be.
fn execute(path: &Path, statements: &[String]) -> bool {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new()
            .filename(path)
            .foreign_keys(false);
        let mut connection = options.connect().await.expect("opened");
        let mut all = true;
        for statement in statements {
            let done = sqlx::raw_sql(AssertSqlSafe(statement.clone()))
                .execute(&mut connection)
                .await;
            all &= done.is_ok();
        }
        connection.close().await.expect("closed");
        all
    })
}

/// A folder of a run before it is damaged.
struct Base {
    folder: PathBuf,
    /// What it has stored.
    recorded: Vec<String>,
    /// Rows of its telemetry, as they are exported.
    telemetry: BTreeSet<String>,
    /// Whether a reader kept its log from being emptied when the program was killed.
    logged: bool,
}

impl Base {
    /// What a copy of `folder` has. Reading it must not empty its log.
    fn of(folder: PathBuf, scratch: &Path) -> Self {
        let copy = scratch.join("copy");
        copied(&folder, &copy);
        let base = Self {
            recorded: recorded(&copy.join(DATABASE)),
            telemetry: exported(&copy).expect("a killed run is exported"),
            logged: std::fs::metadata(folder.join(LOG)).is_ok_and(|log| log.len() > 0),
            folder,
        };
        std::fs::remove_dir_all(copy).expect("removed");
        base
    }
}

const DATABASE: &str = "calibration.db";
const LOG: &str = "calibration.db-wal";

fn copied(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("made");
    for entry in std::fs::read_dir(from).expect("readable") {
        let entry = entry.expect("readable");
        // SQLite's index of the log is made anew where it is not there.
        let name = entry.file_name();
        if entry.file_type().expect("known").is_file() && !name.to_string_lossy().ends_with("-shm") {
            std::fs::copy(entry.path(), to.join(name)).expect("copied");
        }
    }
}

/// The rows of the telemetry of a run, or why they are refused.
fn exported(folder: &Path) -> Result<BTreeSet<String>, String> {
    let export = spherecal(folder, &["export", "--csv", "--out", "."]);
    let said = text(&export.stderr);
    assert!(!said.contains("panicked"), "{said}");
    if !export.status.success() {
        assert_eq!(export.status.code(), Some(2), "{said}");
        return Err(said);
    }
    let table = std::fs::read_to_string(folder.join("tables/telemetry.csv")).unwrap_or_default();
    Ok(table.lines().map(str::to_owned).collect())
}

/// A reader that keeps the log of a database from being emptied.
fn reader(database: &Path) -> (tokio::runtime::Runtime, Option<sqlx::SqliteConnection>) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    let connection = runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(database);
        let mut connection = options.connect().await.ok()?;
        for statement in ["BEGIN", "SELECT count(*) FROM recordings"] {
            sqlx::raw_sql(statement).execute(&mut connection).await.ok()?;
        }
        Some(connection)
    });
    (runtime, connection)
}

/// Folders of runs whose program was killed (SIGKILL) at random instants, every other one beside a reader.
fn killed(folder: &Path, took: Duration, count: usize, rng: &mut ChaCha8Rng) -> Vec<Base> {
    let mut bases = Vec::new();
    while bases.len() < count {
        let out = folder.join(format!("killed-{}", bases.len()));
        let _ = std::fs::remove_dir_all(&out);
        let mut child = measure(folder, &out, "sim", false);
        let begun = Instant::now();
        let end = took.mul_f64(rng.random_range(0.3..0.95));
        let database = out.join(DATABASE);
        while !database.exists() && begun.elapsed() < end {
            std::thread::sleep(Duration::from_millis(2));
        }
        let beside = (bases.len() % 2 == 0 && database.exists()).then(|| reader(&database));
        std::thread::sleep(end.saturating_sub(begun.elapsed()));
        child.kill().expect("killed");
        child.wait().expect("ended");
        // Before the reader leaves: the last one to leave empties the log.
        let base = folder.join(format!("base-{}", bases.len()));
        let _ = std::fs::remove_dir_all(&base);
        copied(&out, &base);
        drop(beside);
        if has_run(&out.join(DATABASE)) {
            bases.push(Base::of(base, folder));
        }
    }
    bases
}

/// A damage of a folder.
struct Damage {
    what: String,
    /// Whether the program may refuse to recover it.
    may_refuse: bool,
    /// Recordings that it can cost at most; `None` where it is not known.
    costs: Option<usize>,
}

/// Changes the bytes of a file: one bit, a page of noise, or a cut.
fn spoiled(path: &Path, kind: u32, rng: &mut ChaCha8Rng) -> String {
    let mut bytes = std::fs::read(path).expect("read");
    let at = rng.random_range(0..bytes.len());
    let what = match kind {
        0 => {
            let bit = rng.random_range(0..8);
            bytes[at] ^= 1 << bit;
            format!("bit {bit} of byte {at}")
        }
        1 => {
            let page = at / 4096 * 4096;
            for byte in bytes.iter_mut().skip(page).take(4096) {
                *byte = rng.random();
            }
            format!("page at {page}")
        }
        _ => {
            bytes.truncate(at);
            format!("cut to {at} bytes")
        }
    };
    std::fs::write(path, bytes).expect("written");
    what
}

/// Damages a database or its log.
fn damage(folder: &Path, base: &Base, rng: &mut ChaCha8Rng) -> Damage {
    let path = folder.join(DATABASE);
    let table = TABLES[rng.random_range(0..TABLES.len())];
    let holds = table.starts_with("recording");
    let (what, may_refuse, costs) = match rng.random_range(0..8 + 4 * u32::from(base.logged)) {
        // A flip hits the row of one recording, or those of its joints.
        0 | 1 => (spoiled(&path, 0, rng), false, Some(2)),
        2 | 3 => {
            let row = rng.random_range(0..40);
            let statement = format!(
                "DELETE FROM {table} WHERE rowid IN (SELECT rowid FROM {table} ORDER BY rowid LIMIT 1 OFFSET \
                 {row} % MAX(1, (SELECT COUNT(*) FROM {table})))"
            );
            assert!(execute(&path, std::slice::from_ref(&statement)), "{statement}");
            (statement, false, Some(usize::from(holds)))
        }
        4 => {
            let statement = format!("DELETE FROM {table}");
            assert!(execute(&path, std::slice::from_ref(&statement)), "{statement}");
            (statement, false, if holds { None } else { Some(0) })
        }
        // The page may be that of the run's settings and of their second copy.
        5 => (spoiled(&path, 1, rng), true, None),
        6 => (spoiled(&path, 2, rng), true, None),
        7 => {
            let statements = [
                "ALTER TABLE recordings ADD COLUMN warmth_c DOUBLE PRECISION NOT NULL DEFAULT 21.0".to_owned(),
                "PRAGMA user_version = 99".to_owned(),
            ];
            assert!(execute(&path, &statements));
            ("a newer schema".to_owned(), true, None)
        }
        8 => {
            std::fs::remove_file(folder.join(LOG)).expect("removed");
            ("the log is lost".to_owned(), true, None)
        }
        // The log may hold all of a young file.
        kind => (
            format!("log, {}", spoiled(&folder.join(LOG), kind - 9, rng)),
            true,
            None,
        ),
    };
    Damage {
        what,
        may_refuse,
        costs,
    }
}

/// Damages the telemetry of a run. Returns whether it is refused.
fn damaged_telemetry(folder: &Path, base: &Base, rng: &mut ChaCha8Rng) -> bool {
    let file = folder.join("telemetry-run-1.mcap");
    let kind = rng.random_range(0..3);
    let what = spoiled(&file, kind, rng);
    match exported(folder) {
        Ok(rows) => {
            let invented = rows.difference(&base.telemetry).next();
            assert_eq!(invented, None, "telemetry, {what}: a row that was not measured");
            false
        }
        Err(said) => {
            assert!(said.contains("telemetry-run-1.mcap"), "telemetry, {what}: {said}");
            true
        }
    }
}

/// What became of the damages.
#[derive(Debug, Default)]
struct Ends {
    equal: usize,
    unseen: usize,
    refused: usize,
    telemetry: usize,
    telemetry_refused: usize,
    lost: usize,
}

/// Walks so many damages to their end, and prints what became of them.
fn walk(count: usize, kills: usize, seed: u64) {
    let folder = tempfile::tempdir().expect("a folder");
    let alone = folder.path().join("alone");
    let begun = Instant::now();
    finished(measure(folder.path(), &alone, "sim", false));
    let took = begun.elapsed();
    // What a lost session was is known nowhere else: a resumed run begins a new one.
    let expected = compared(&alone.join(DATABASE), false);
    let measured: BTreeSet<String> = recorded(&alone.join(DATABASE)).into_iter().collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut bases = killed(folder.path(), took, kills, &mut rng);
    bases.push(Base::of(alone, folder.path()));
    let words = |path: &Path| path.display().to_string();
    let check = |path: &Path| spherecal(folder.path(), &["store", "check", &words(path)]);
    let mut ends = Ends::default();
    for number in 0..count {
        if number > 0 && number.is_multiple_of(100) {
            println!("{number} damages: {ends:?}");
        }
        let base = &bases[rng.random_range(0..bases.len())];
        let out = folder.path().join(format!("run-{number}"));
        copied(&base.folder, &out);
        let database = out.join(DATABASE);
        if number % 5 == 4 {
            // The database is whole: the run goes on beside the damaged file.
            ends.telemetry += 1;
            ends.telemetry_refused += usize::from(damaged_telemetry(&out, base, &mut rng));
            finished(measure(folder.path(), &out, "sim", true));
            assert!(compared(&database, false) == expected, "telemetry: another database");
            ends.equal += 1;
            std::fs::remove_dir_all(&out).expect("removed");
            continue;
        }
        let damage = damage(&out, base, &mut rng);
        let what = format!("{}: {}", words(&base.folder), damage.what);
        let bytes = std::fs::read(&database).expect("read");
        let sound = check(&database).status.success();
        let saved = folder.path().join(format!("saved-{number}"));
        std::fs::create_dir(&saved).expect("made");
        let new = saved.join(DATABASE);
        let resumed = if sound {
            ends.unseen += 1;
            &out
        } else {
            let recovery = spherecal(folder.path(), &["store", "recover", &words(&database), &words(&new)]);
            // What is refused is not written to, but sound frames of a log that ends early come into the file.
            let same = std::fs::read(&database).expect("read") == bytes;
            assert!(same || base.logged, "{what}: a refused file is written to");
            let said = text(&recovery.stderr);
            assert!(!said.contains("panicked"), "{what}: {said}");
            if !recovery.status.success() {
                assert!(damage.may_refuse && !said.is_empty(), "{what} is refused: {said}");
                ends.refused += 1;
                std::fs::remove_dir_all(&out).expect("removed");
                std::fs::remove_dir_all(&saved).expect("removed");
                continue;
            }
            let again = check(&new);
            assert!(
                again.status.success(),
                "{what}: {}{}",
                text(&again.stdout),
                text(&again.stderr)
            );
            &saved
        };
        let database = resumed.join(DATABASE);
        let kept: BTreeSet<String> = recorded(&database).into_iter().collect();
        assert!(kept.is_subset(&measured), "{what}: a recording is invented");
        let lost = base.recorded.iter().filter(|r| !kept.contains(*r)).count();
        let costs = damage.costs.unwrap_or(lost);
        assert!(lost <= costs, "{what}: {lost} intact recordings are lost");
        ends.lost += lost;
        finished(measure(folder.path(), resumed, "sim", has_run(&database)));
        let again = check(&database);
        assert!(again.status.success(), "{what}: {}", text(&again.stderr));
        assert!(compared(&database, false) == expected, "{what}: another database");
        ends.equal += 1;
        std::fs::remove_dir_all(&out).expect("removed");
        std::fs::remove_dir_all(&saved).expect("removed");
    }
    println!("{count} damages of {} folders: {ends:?}", bases.len());
    assert!(ends.equal * 2 > count, "{ends:?}");
}

// Fails if any damage of a finished or a killed run (of its database: a bit, a row, a table, a page, a cut, a newer schema;
// of its log: a bit, noise, a cut, its loss; of its telemetry) is walked to another end than the database of a run that
// nothing disturbed or a refusal, if a refused file is written to, if a recovered or continued file is called damaged, if a
// recording or a row of telemetry is invented, or if an intact recording is lost.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_every_damage_is_walked_to_its_end() {
    walk(14, 2, 1);
}

// The same for as many damages as are asked.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_every_damage_is_walked_to_its_end() {
    let asked = std::env::var("SPHERECAL_CIRCLES")
        .ok()
        .and_then(|text| text.parse().ok());
    walk(asked.unwrap_or(300), 12, 2);
}
