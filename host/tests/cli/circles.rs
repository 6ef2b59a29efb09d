//! Every damage walked to its end: check, recover, check, resume, and the database of a run that nothing disturbed.
//!
//! `SPHERECAL_CIRCLES=1000 cargo test -p spherecal --test cli circles -- --ignored` walks as many as are asked.

#![cfg(unix)]

use std::path::Path;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use sqlx::{AssertSqlSafe, ConnectOptions as _, Connection as _};

use crate::kills::{compared, finished, measure};
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

/// Damages a database; what was done, and whether the program may refuse to recover it.
fn damage(path: &Path, rng: &mut ChaCha8Rng) -> (String, bool) {
    let whole = std::fs::read(path).expect("read");
    let changed = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = whole.clone();
        change(&mut bytes);
        std::fs::write(path, bytes).expect("written");
    };
    let at = rng.random_range(0..whole.len());
    match rng.random_range(0..8) {
        0 | 1 => {
            let bit = rng.random_range(0..8);
            changed(&|bytes| bytes[at] ^= 1 << bit);
            (format!("bit {bit} of byte {at}"), false)
        }
        2 | 3 => {
            let table = TABLES[rng.random_range(0..TABLES.len())];
            let row = rng.random_range(0..40);
            let statement = format!(
                "DELETE FROM {table} WHERE rowid IN (SELECT rowid FROM {table} ORDER BY rowid LIMIT 1 OFFSET \
                 {row} % MAX(1, (SELECT COUNT(*) FROM {table})))"
            );
            assert!(execute(path, std::slice::from_ref(&statement)), "{statement}");
            (statement, false)
        }
        4 => {
            let table = TABLES[rng.random_range(0..TABLES.len())];
            let statement = format!("DELETE FROM {table}");
            assert!(execute(path, std::slice::from_ref(&statement)), "{statement}");
            (statement, false)
        }
        5 => {
            let page = at / 4096 * 4096;
            let noise: Vec<u8> = (0..4096).map(|_| rng.random()).collect();
            changed(&|bytes| bytes[page..page + 4096].copy_from_slice(&noise));
            // The page may be that of the run's settings and of their second copy.
            (format!("page at {page}"), true)
        }
        6 => {
            changed(&|bytes| bytes.truncate(at));
            (format!("cut to {at} bytes"), true)
        }
        _ => {
            let statements = [
                "ALTER TABLE recordings ADD COLUMN warmth_c DOUBLE PRECISION NOT NULL DEFAULT 21.0".to_owned(),
                "PRAGMA user_version = 99".to_owned(),
            ];
            assert!(execute(path, &statements));
            ("a newer schema".to_owned(), true)
        }
    }
}

/// Walks so many damages to their end, and prints how many were refused.
fn walk(count: usize, seed: u64) {
    let folder = tempfile::tempdir().expect("a folder");
    let alone = folder.path().join("alone");
    finished(measure(folder.path(), &alone, "sim", false));
    // What a lost session was is known nowhere else: a resumed run begins a new one.
    let expected = compared(&alone.join("calibration.db"), false);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut equal, mut refused, mut unseen) = (0, 0, 0);
    for number in 0..count {
        let out = folder.path().join(format!("run-{number}"));
        std::fs::create_dir(&out).expect("made");
        let database = out.join("calibration.db");
        std::fs::copy(alone.join("calibration.db"), &database).expect("copied");
        let (what, may_refuse) = damage(&database, &mut rng);
        let bytes = std::fs::read(&database).expect("read");
        let words = |path: &Path| path.display().to_string();
        let check = |path: &Path| spherecal(folder.path(), &["store", "check", &words(path)]);
        let sound = check(&database).status.success();
        let saved = folder.path().join(format!("saved-{number}"));
        std::fs::create_dir(&saved).expect("made");
        let new = saved.join("calibration.db");
        let resumed = if sound {
            unseen += 1;
            &out
        } else {
            // What is refused is not written to.
            assert_eq!(std::fs::read(&database).expect("read"), bytes, "{what}");
            let recovery = spherecal(folder.path(), &["store", "recover", &words(&database), &words(&new)]);
            let said = text(&recovery.stderr);
            assert!(!said.contains("panicked"), "{what}: {said}");
            if !recovery.status.success() {
                assert!(may_refuse && !said.is_empty(), "{what} is refused: {said}");
                refused += 1;
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
        finished(measure(folder.path(), resumed, "sim", true));
        let database = resumed.join("calibration.db");
        let again = check(&database);
        assert!(again.status.success(), "{what}: {}", text(&again.stderr));
        assert!(compared(&database, false) == expected, "{what}: another database");
        equal += 1;
        std::fs::remove_dir_all(&out).expect("removed");
        std::fs::remove_dir_all(&saved).expect("removed");
    }
    println!("{count} damages: {equal} equal ({unseen} lay where nothing is), {refused} refused");
    assert!(equal * 2 > count, "{equal} of {count}");
}

// Fails if any damage of a database (a bit, a row, a table, a page, a cut, a newer schema) is walked to another end than
// the database of a run that nothing disturbed or a refusal, if a refused file is written to, or if a recovered or
// continued file is called damaged.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_every_damage_is_walked_to_its_end() {
    walk(12, 1);
}

// The same for as many damages as are asked.
#[test]
#[ignore = "long: the nightly run has it"]
fn long_every_damage_is_walked_to_its_end() {
    let asked = std::env::var("SPHERECAL_CIRCLES")
        .ok()
        .and_then(|text| text.parse().ok());
    walk(asked.unwrap_or(300), 2);
}
