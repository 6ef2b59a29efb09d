//! The digests of a damaged file, and the second copies of its settings.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use super::Recovered;
use super::rows::{Source, StoredRow, read_rows, read_table, run_of};
use crate::seal::{RECORDINGS, RESULTS, SEALED, SPARES, SealedValue, of_row};
use crate::spares::{SPARED, poses_of, spheres_of};
use crate::{RunInfo, SqlStore, StoreError};

/// The digests and second copies of a damaged file, as far as they can be read.
pub(super) struct Seals {
    /// Digests by run and subject.
    by_subject: HashMap<(i64, String), i64>,
    /// All digests. A digest covers the row's table and key, so its own key is not needed.
    values: HashSet<i64>,
    /// Whether the file's rows have digests: not in a file of an older schema.
    sealed: bool,
    /// Whether all digests could be read.
    whole: bool,
    /// Second copies of settings by run and name.
    spares: BTreeMap<i64, BTreeMap<String, String>>,
}

impl Seals {
    pub(super) async fn read(sources: &mut [Source]) -> Self {
        let columns = |names: &[&str]| names.iter().map(|name| ((*name).to_owned(), None)).collect::<Vec<_>>();
        let mut seals = Self {
            by_subject: HashMap::new(),
            values: HashSet::new(),
            sealed: false,
            whole: true,
            spares: BTreeMap::new(),
        };
        for source in sources.iter_mut() {
            let (digests, _, whole) = read_table("digests", &columns(&["run", "subject", "digest"]), source).await;
            seals.whole &= whole;
            for row in digests {
                let [
                    SealedValue::Whole(run),
                    SealedValue::Text(subject),
                    SealedValue::Whole(digest),
                ] = row.as_slice()
                else {
                    continue;
                };
                seals.sealed |= SEALED.iter().any(|table| subject.starts_with(table.name));
                seals.values.insert(*digest);
                // The first source has the newest.
                seals.by_subject.entry((*run, subject.clone())).or_insert(*digest);
            }
        }
        let (spares, _) = read_rows("spares", &columns(&["run", "name", "value"]), sources).await;
        for row in spares {
            if !seals.vouch_for("spares", &row) {
                continue;
            }
            if let [
                SealedValue::Whole(run),
                SealedValue::Text(name),
                SealedValue::Text(value),
            ] = row.as_slice()
            {
                let own = seals.spares.entry(*run).or_default();
                own.entry(name.clone()).or_insert_with(|| value.clone());
            }
        }
        seals
    }

    /// The runs of the new file that lack a row of which there is a digest. Results are computed again, and second
    /// copies written again.
    pub(super) fn runs_that_lack(&self, target: &mut SqlStore) -> Result<BTreeSet<i64>, StoreError> {
        let mut there: HashMap<i64, BTreeMap<String, i64>> = HashMap::new();
        for run in target.run_numbers()? {
            there.insert(run, target.digests(run)?);
        }
        let counts = |subject: &str| ![RESULTS, SPARES].iter().any(|table| subject.starts_with(table.name));
        let lost = self.by_subject.keys().filter(|(run, subject)| {
            there.get(run).is_some_and(|subjects| !subjects.contains_key(subject)) && counts(subject)
        });
        Ok(lost.map(|(run, _)| *run).collect())
    }

    /// Whether the digest is stored, or differs in one bit from a stored one. Of a row and a digest
    /// that differ in one bit, the digest is the damaged one: another row has another digest in half
    /// of all bits.
    fn has(&self, digest: i64) -> bool {
        self.values.contains(&digest) || (0..64).any(|bit| self.values.contains(&(digest ^ (1 << bit))))
    }

    /// Whether a digest is as it was written; `None` if there is none that could tell.
    pub(super) fn known(&self, run: i64, subject: &str, digest: i64) -> Option<bool> {
        if self.has(digest) {
            Some(true)
        } else if self.by_subject.contains_key(&(run, subject.to_owned())) {
            Some(false)
        } else {
            None
        }
    }

    /// Of the rows of `recordings` that no digest vouches for, those whose own digest is lost. The digest of the whole
    /// recording, with its joints, may still vouch for them.
    pub(super) fn open(&self, rows: &[StoredRow]) -> Vec<StoredRow> {
        let lost = |row: &&StoredRow| match row.as_slice() {
            [SealedValue::Whole(run), sphere, pose, ..] => {
                let subject = format!("{} {sphere} {pose}", RECORDINGS.name);
                !self.by_subject.contains_key(&(*run, subject))
            }
            _ => false,
        };
        rows.iter().filter(lost).cloned().collect()
    }

    /// Whether a row is as it was written, or nothing is known against it.
    pub(super) fn vouch_for(&self, table: &str, row: &StoredRow) -> bool {
        if !self.sealed || SEALED.iter().all(|sealed| sealed.name != table) {
            return true;
        }
        // Where digests are lost, a row without one is kept.
        self.has(of_row(table, row)) || !self.whole
    }

    /// The rows of `runs`: those that are as they were written, and those that their second copy
    /// restores. `bad` ones without a second copy are kept as they are, if they can be read at all.
    pub(super) fn settings(
        &self,
        good: Vec<StoredRow>,
        bad: &[StoredRow],
        recovered: &mut Recovered,
    ) -> Vec<StoredRow> {
        // Where digests are lost, nothing is known against a row that lacks a page.
        let (mut good, unreadable): (Vec<_>, Vec<_>) = good.into_iter().partition(is_readable);
        let bad = [bad, &unreadable].concat();
        let there: HashSet<i64> = good.iter().filter_map(run_of).collect();
        for (run, copies) in &self.spares {
            if there.contains(run) {
                continue;
            }
            let copied: Option<BTreeMap<&str, SealedValue>> = SPARED
                .iter()
                .map(|name| {
                    let text = copies.get(*name)?;
                    let value = match *name {
                        "seed" => SealedValue::Whole(text.parse().ok()?),
                        _ => SealedValue::Text(text.clone()),
                    };
                    Some((*name, value))
                })
                .collect();
            let Some(mut copied) = copied else { continue };
            let state = bad
                .iter()
                .find(|row| run_of(row) == Some(*run))
                .and_then(|row| row.get(10));
            let state = match state {
                Some(SealedValue::Text(state)) if RunInfo::STATES.contains(&state.as_str()) => state,
                _ => "running",
            };
            copied.insert("run", SealedValue::Whole(*run));
            copied.insert("state", SealedValue::Text(state.to_owned()));
            let row = columns().filter_map(|name| copied.get(name).cloned()).collect();
            if is_readable(&row) {
                good.push(row);
                recovered.settings_restored.push(*run);
            }
        }
        let there: HashSet<i64> = good.iter().filter_map(run_of).collect();
        for row in &bad {
            let Some(run) = run_of(row).filter(|run| !there.contains(run)) else {
                continue;
            };
            if is_readable(row) {
                good.push(row.clone());
                recovered.settings_doubtful.push(run);
            } else {
                recovered.settings_lost.push(run);
            }
        }
        good
    }

    /// The rows of `poses`: those that are as they were written, and those that their second copy restores. Whether
    /// a pose was given up has no second copy: it is measured again.
    pub(super) fn poses(&self, mut good: Vec<StoredRow>) -> Vec<StoredRow> {
        let mut there: HashSet<Vec<String>> = good.iter().map(pose_of).collect();
        for (run, copies) in &self.spares {
            for values in copies.get("poses").and_then(|text| poses_of(text)).unwrap_or_default() {
                let mut row = vec![SealedValue::Whole(*run)];
                row.extend(values);
                row.push(SealedValue::Nothing);
                if there.insert(pose_of(&row)) {
                    good.push(row);
                }
            }
        }
        good
    }

    /// The rows of `spheres`: those that are as they were written, and those that the second copy of
    /// the certificate restores.
    pub(super) fn certificate(&self, mut good: Vec<StoredRow>, bad: &[StoredRow]) -> Vec<StoredRow> {
        let key = |row: &StoredRow| match (run_of(row), row.get(1)) {
            (Some(run), Some(SealedValue::Whole(sphere))) => Some((run, *sphere)),
            _ => None,
        };
        let mut there: HashSet<(i64, i64)> = good.iter().filter_map(key).collect();
        for (run, copies) in &self.spares {
            for (sphere, values) in copies
                .get("spheres")
                .and_then(|text| spheres_of(text))
                .unwrap_or_default()
            {
                if there.insert((*run, sphere)) {
                    let mut row = vec![SealedValue::Whole(*run), SealedValue::Whole(sphere)];
                    row.extend(values.map(SealedValue::Real));
                    good.push(row);
                }
            }
        }
        for row in bad {
            let copied = run_of(row).and_then(|run| self.spares.get(&run)?.get("spheres"));
            if copied.is_none() && key(row).is_some_and(|key| there.insert(key)) {
                good.push(row.clone());
            }
        }
        good
    }
}

/// Run, sphere and number of a row of `poses`.
fn pose_of(row: &StoredRow) -> Vec<String> {
    row.iter().take(3).map(ToString::to_string).collect()
}

/// How many rows of `poses` are not among the kept ones.
pub(super) fn without(rows: &[StoredRow], kept: &[StoredRow]) -> u64 {
    let there: HashSet<Vec<String>> = kept.iter().map(pose_of).collect();
    rows.iter().filter(|row| !there.contains(&pose_of(row))).count() as u64
}

/// Whether a row of `runs` holds robot, tool and plan in a form that can be read.
fn is_readable(row: &StoredRow) -> bool {
    let json = columns().zip(row).filter(|(name, _)| name.ends_with("_json"));
    let readable = |value: &SealedValue| match value {
        SealedValue::Text(text) => serde_json::from_str::<serde::de::IgnoredAny>(text).is_ok(),
        _ => false,
    };
    row.len() == SPARED.len() + 2 && json.map(|(_, value)| value).all(readable)
}

/// The columns of `runs`.
fn columns() -> impl Iterator<Item = &'static str> {
    let (arm, others) = (SPARED.len() - 1, SPARED.into_iter());
    let arm = others.clone().skip(arm);
    ["run"]
        .into_iter()
        .chain(others.take(SPARED.len() - 1))
        .chain(["state"])
        .chain(arm)
}
