//! The past of a fleet in a file.

use super::history::{self, FINGERPRINT, Fingerprint};
use super::tests::new_run;
use super::{CalibrationStore as _, NewRun, RunInfo, SqlStore};

// Fails if the past of a file takes more statements when there are more calibrations, if a run that is no calibration is
// among them, or if a result that was changed or lost behind the store's back is believed or passed over.
#[test]
fn the_past_of_a_file_takes_a_fixed_number_of_statements() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = SqlStore::create_or_open(&folder.path().join("c.db")).expect("made");
    let counted = |store: &mut SqlStore, arm: &str| {
        let before = super::STATEMENTS.get();
        let past = history::read(store, arm).expect("read");
        (past, super::STATEMENTS.get() - before)
    };
    let tcp = |q: &[f64]| nalgebra::Vector3::new(q[0].sin(), q[1].cos(), q[2].sin());
    let print = Fingerprint::of(&spherecal_shared::robot::iiwa7(), tcp, |_| 1e-9);
    let print = serde_json::to_string(&print).expect("JSON");
    let mut few = None;
    for run in 1..=30 {
        let arm = format!("arm-{}", run % 3);
        let new = NewRun {
            poses: Vec::new(),
            arm,
            ..new_run()
        };
        assert_eq!(store.create_run(&new).expect("a run"), run);
        history::put_summary(&mut store, run, r#"{"verdict":{"may_be_used":true}}"#).expect("stored");
        store.put_result(run, FINGERPRINT, &print).expect("stored");
        store.set_state(run, "complete").expect("set");
        let (all, statements) = counted(&mut store, "");
        assert_eq!((all.len() as i64, statements), (run, *few.get_or_insert(statements)));
    }
    store.set_state(30, RunInfo::COMMISSIONED).expect("set");
    let trends = history::trends(counted(&mut store, "").0, 0.3);
    let runs: Vec<usize> = trends.iter().map(|trend| trend.steps.len()).collect();
    assert_eq!(runs, [9, 10, 10]);
    let (own, statements) = counted(&mut store, "arm-2");
    assert_eq!((own.len(), Some(statements)), (10, few));

    for (damage, arm, run) in [
        (
            "UPDATE results SET json = replace(json, 'true', 'null') WHERE run = 4",
            "arm-1",
            4,
        ),
        ("DELETE FROM results WHERE run = 5 AND name = 'fingerprint'", "arm-2", 5),
        (
            "DELETE FROM digests WHERE run = 6 AND subject = 'results headline'",
            "arm-0",
            6,
        ),
    ] {
        let done = store.block(async |c| sqlx::query(damage).execute(c).await.map(|_| ()));
        done.expect("executed");
        let error = history::read(&mut store, arm).expect_err(damage);
        assert!(error.to_string().contains(&format!("run {run}: the result")), "{error}");
    }
}
