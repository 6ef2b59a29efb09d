//! A fleet of 100 arms with 10,000 calibrations in PostgreSQL. `scripts/test` starts the server and
//! names it in `SPHERECAL_POSTGRES_URL`; without it this test is left out.

use sqlx::{AssertSqlSafe, Row as _};

use super::columns::rows;
use super::fleet::statements;
use super::history::{self, FINGERPRINT, Fingerprint, HEADLINE};
use super::seal::{SealedValue, of_row};
use super::tests::new_run;
use super::{CalibrationStore as _, RunInfo, SqlStore, StoreError};

const RUNS: i64 = 10_000;
const ARMS: i64 = 100;

fn execute(store: &mut SqlStore, statement: String) {
    let done = store.block(async |c| sqlx::query(AssertSqlSafe(statement)).execute(c).await.map(|_| ()));
    done.expect("executed");
}

/// A store in a schema of its own, and how to remove it.
fn own_schema(url: &str) -> (SqlStore, String) {
    let name = format!("fleet_of_{}", std::process::id());
    let mut store = SqlStore::postgres(url).expect("the server answers");
    execute(&mut store, format!("DROP SCHEMA IF EXISTS {name} CASCADE"));
    execute(&mut store, format!("CREATE SCHEMA {name}"));
    let separator = if url.contains('?') { '&' } else { '?' };
    let own = SqlStore::postgres(&format!("{url}{separator}options[search_path]={name}")).expect("tables are made");
    (own, format!("DROP SCHEMA {name} CASCADE"))
}

fn fingerprint(stretch: f64) -> String {
    let robot = spherecal_shared::robot::iiwa7();
    let tcp = |q: &[f64]| nalgebra::Vector3::new(q[0].sin(), q[1].cos(), q[2].sin() * (1.0 + stretch));
    serde_json::to_string(&Fingerprint::of(&robot, tcp, |_| 1e-9)).expect("JSON")
}

/// Repeats run 1 as runs 2 to `RUNS` of `ARMS` arms, sealed as the store does it.
fn repeat(store: &mut SqlStore, texts: &[(&str, &str)]) {
    execute(
        store,
        format!(
            "INSERT INTO runs SELECT g, created_utc, seed, link, robot, robot_json, tool_json, config_toml, plan_json, \
             program, 'complete', 'arm-' || (g % {ARMS}) FROM runs, generate_series(2, {RUNS}) g WHERE run = 1"
        ),
    );
    execute(
        store,
        format!("INSERT INTO results SELECT g, name, json FROM results, generate_series(2, {RUNS}) g WHERE run = 1"),
    );
    let seals: Vec<(i64, String, i64)> = (2..=RUNS)
        .flat_map(|run| texts.iter().map(move |(name, json)| (run, *name, *json)))
        .map(|(run, name, json)| {
            let values = [
                SealedValue::Whole(run),
                SealedValue::Text(name.to_owned()),
                SealedValue::Text(json.to_owned()),
            ];
            (run, format!("results {name}"), of_row("results", &values))
        })
        .collect();
    for chunk in seals.chunks(5000) {
        let statement = rows("INSERT INTO digests (run, subject, digest)", chunk.len(), 3);
        let done = store.block(async |c| {
            let mut insert = sqlx::query(AssertSqlSafe(statement));
            for (run, subject, digest) in chunk {
                insert = insert.bind(*run).bind(subject.clone()).bind(*digest);
            }
            insert.execute(c).await.map(|_| ())
        });
        done.expect("sealed");
    }
    for table in ["runs", "results", "digests"] {
        execute(store, format!("ANALYZE {table}"));
    }
}

// Fails if the past of a fleet takes more statements when there are more calibrations, if the past
// of one arm reads a table from end to end where an index should serve, if an index is missing,
// if a run that is no calibration is among
// them, or if a row that was changed behind the store's back is believed.
#[test]
fn the_past_of_a_fleet_takes_a_fixed_number_of_statements() {
    let Ok(url) = std::env::var("SPHERECAL_POSTGRES_URL") else {
        assert!(
            std::env::var_os("SPHERECAL_REQUIRE_FIELD").is_none(),
            "SPHERECAL_POSTGRES_URL is not set: scripts/test starts a server"
        );
        eprintln!("left out: no PostgreSQL server is named in SPHERECAL_POSTGRES_URL");
        return;
    };
    let (mut store, drop_schema) = own_schema(&url);
    let run = store.create_run(&new_run()).expect("a run");
    let summary = r#"{"verdict":{"may_be_used":true},"poses":{"recorded":150},"residual":{"rms_mm":0.05}}"#;
    history::put_summary(&mut store, run, summary).expect("stored");
    let print = fingerprint(0.001);
    store.put_result(run, FINGERPRINT, &print).expect("stored");
    store.set_state(run, "complete").expect("set");

    let counted = |store: &mut SqlStore, arm: &str| {
        let before = super::STATEMENTS.get();
        let past = history::read(store, arm).expect("read");
        (past, super::STATEMENTS.get() - before)
    };
    let (one, few) = counted(&mut store, "");
    assert_eq!(one.len(), 1);
    let headline = store.result(run, HEADLINE).expect("read").expect("there");
    repeat(
        &mut store,
        &[(HEADLINE, &headline), (FINGERPRINT, &print), ("summary", summary)],
    );

    let begun = std::time::Instant::now();
    let (all, many) = counted(&mut store, "");
    println!("{} calibrations in {:.3} s", all.len(), begun.elapsed().as_secs_f64());
    assert_eq!((all.len() as i64, many), (RUNS, few));
    assert!(many <= 4, "{many} statements");
    assert!(
        all.iter()
            .all(|p| p.trusted == Some(true) && p.recorded == Some(150) && p.fingerprint.is_some())
    );
    let arms = history::by_arm(all);
    // Run 1 has an arm of its own.
    assert_eq!(arms.len() as i64, ARMS + 1);
    assert!(
        arms.iter()
            .all(|runs| history::trend(runs, 0.3).is_some_and(|t| t.steps.len() == runs.len()))
    );
    let (own, statements_for_one) = counted(&mut store, "arm-7");
    assert_eq!((own.len() as i64, statements_for_one), (RUNS / ARMS, few));

    // By query plan: indexes can find the rows of one arm. In a table of this size the server may well prefer to
    // read it from end to end; with that forbidden, it still does so where no index serves.
    execute(&mut store, "SET enable_seqscan = off".to_owned());
    for statement in statements(true) {
        let explain = format!("EXPLAIN {}", statement.replace("$1", "'arm-7'"));
        let plan = store.block(async |c| sqlx::query(AssertSqlSafe(explain)).fetch_all(c).await);
        let plan: Vec<String> = plan
            .expect("a plan")
            .iter()
            .map(|row| row.get::<String, _>(0))
            .collect();
        assert!(!plan.iter().any(|line| line.contains("Seq Scan")), "{plan:#?}");
    }

    // Which of two indexes it takes is the server's choice; those of the migration must be there.
    let statement = "SELECT CAST(indexname AS TEXT) FROM pg_indexes WHERE schemaname = current_schema()";
    let indexes = store
        .block(async |c| sqlx::query(statement).fetch_all(c).await)
        .expect("a list");
    let indexes: Vec<String> = indexes.iter().map(|row| row.get::<String, _>(0)).collect();
    for name in ["runs_of_arm", "results_by_name"] {
        assert!(indexes.iter().any(|index| index == name), "{name}: {indexes:?}");
    }

    // A commissioning is no calibration.
    let state = RunInfo::COMMISSIONED;
    execute(&mut store, format!("UPDATE runs SET state = '{state}' WHERE run = 78"));
    assert!(counted(&mut store, "arm-78").0.iter().all(|p| p.run != 78));

    execute(
        &mut store,
        "UPDATE results SET json = replace(json, '150', '151') WHERE run = 79 AND name = 'headline'".to_owned(),
    );
    let error = history::read(&mut store, "arm-79").expect_err("a changed row");
    assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
    assert!(error.to_string().contains("run 79: the result \"headline\""), "{error}");
    execute(&mut store, drop_schema);
}
