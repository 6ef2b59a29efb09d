//! Reads the past of a fleet with a fixed number of statements, however many calibrations there are.

use std::collections::HashMap;

use super::past::{FINGERPRINT, HEADLINE, StoredPast};
use super::seal::{RESULTS, SealedValue, of_row};
use super::{SqlStore, StoreError};

/// Calibrations. The statements for one arm and for all differ, so that each uses its own index.
const RUNS: &str = "SELECT run, created_utc, robot, arm, state FROM runs WHERE state <> 'commissioned'";
/// What [`history`](super::history) reads of each, with the digest of the row. A result without a digest and a digest
/// without a result are damage, so both are found.
const RESULTS_OF_RUNS: &str = "SELECT u.run AS run, n.name AS name, r.json AS json, d.digest AS digest FROM runs u \
     CROSS JOIN (SELECT 'headline' AS name UNION ALL SELECT 'fingerprint' AS name) n \
     LEFT JOIN results r ON r.run = u.run AND r.name = n.name \
     LEFT JOIN digests d ON d.run = u.run AND d.subject = 'results ' || n.name \
     WHERE (r.run IS NOT NULL OR d.run IS NOT NULL)";

/// The two statements for one arm (which is $1), or for all.
pub(super) fn statements(one_arm: bool) -> [String; 2] {
    let (runs, results) = if one_arm {
        (" AND arm = $1", " AND u.arm = $1")
    } else {
        ("", "")
    };
    [
        format!("{RUNS}{runs} ORDER BY run"),
        format!("{RESULTS_OF_RUNS}{results}"),
    ]
}

impl SqlStore {
    /// See [`CalibrationStore::past`](super::CalibrationStore::past).
    pub(super) fn past_at_once(&mut self, arm: &str) -> Result<Vec<StoredPast>, StoreError> {
        let [runs, results] = statements(!arm.is_empty());
        let runs = self.select(runs, arm)?;
        let results = self.select(results, arm)?;
        let mut texts: HashMap<(i64, bool), String> = HashMap::with_capacity(results.len());
        for row in &results {
            let (run, name): (i64, String) = (self.get(row, "run")?, self.get(row, "name")?);
            let json: Option<String> = self.get(row, "json")?;
            let stored: Option<i64> = self.get(row, "digest")?;
            let headline = name == HEADLINE;
            debug_assert!(headline || name == FINGERPRINT);
            let values = [
                SealedValue::Whole(run),
                SealedValue::Text(name),
                json.map_or(SealedValue::Nothing, SealedValue::Text),
            ];
            let digest = of_row(RESULTS.name, &values);
            let [_, SealedValue::Text(name), json] = values else {
                continue;
            };
            match json {
                SealedValue::Text(json) if stored == Some(digest) => texts.insert((run, headline), json),
                _ => {
                    return Err(StoreError::Damaged {
                        path: self.path.clone(),
                        what: format!("run {run}: the result \"{name}\" differs from what was written"),
                    });
                }
            };
        }
        runs.iter()
            .map(|row| {
                let run: i64 = self.get(row, "run")?;
                let mut text = |headline| texts.remove(&(run, headline));
                Ok(StoredPast {
                    run,
                    headline: text(true),
                    fingerprint: text(false),
                    created_utc: self.get(row, "created_utc")?,
                    robot: self.get(row, "robot")?,
                    arm: self.get(row, "arm")?,
                    state: self.get(row, "state")?,
                })
            })
            .collect()
    }

    /// The rows of a statement whose only parameter is an arm, if one is named.
    fn select(&mut self, statement: String, arm: &str) -> Result<Vec<sqlx::any::AnyRow>, StoreError> {
        self.block(async |connection| {
            let mut query = sqlx::query(sqlx::AssertSqlSafe(statement));
            if !arm.is_empty() {
                query = query.bind(arm.to_owned());
            }
            query.fetch_all(connection).await
        })
    }
}
