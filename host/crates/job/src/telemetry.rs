//! Finds the telemetry of a stored run in a folder.

use std::path::{Path, PathBuf};

use spherecal_campaign::telemetry::{RunKey, files_of_run, files_without_run};
use spherecal_store::{CalibrationStore, RunInfo, StoreError};

use super::Link;

/// The telemetry of a run in a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunTelemetry {
    /// Its files, in the order in which they were written: one, and one more for each time it was
    /// resumed.
    pub files: Vec<PathBuf>,
    /// Files of an earlier version, which do not say of which run they are, where the store has
    /// several runs. They are none of `files`.
    pub untold: Vec<PathBuf>,
}

impl RunTelemetry {
    /// What to tell the user of files that cannot be told apart; `None` where there are none.
    pub fn remark(&self, run: i64) -> Option<String> {
        let first = self.untold.first()?;
        Some(format!(
            "{}: an earlier version wrote it, without the number of its run, and the database has several runs: it \
             cannot be told whether it is of run {run}, so it is left out. If you know that it is, rename it to \
             telemetry-run-{run}.mcap",
            first.display()
        ))
    }
}

/// Key of a run in the metadata of its telemetry.
pub(super) fn run_key(info: &RunInfo) -> RunKey {
    RunKey {
        number: info.run,
        created_utc: info.created_utc.clone(),
    }
}

/// Finds the telemetry of run `info` of `store` in `folder`.
///
/// A simulated run that is resumed starts from its beginning, so each of its files repeats the ones
/// before. Of them only the largest is returned. Files of an earlier version belong to the only run
/// of a store.
///
/// # Errors
/// When the store fails.
pub fn run_telemetry(
    folder: &Path,
    store: &mut dyn CalibrationStore,
    info: &RunInfo,
) -> Result<RunTelemetry, StoreError> {
    let files = files_of_run(folder, &run_key(info));
    if !files.is_empty() {
        return Ok(RunTelemetry {
            files: without_repetitions(files, &info.link),
            untold: Vec::new(),
        });
    }
    let old = files_without_run(folder);
    if old.is_empty() || store.runs()?.len() == 1 {
        return Ok(RunTelemetry {
            files: without_repetitions(old, &info.link),
            untold: Vec::new(),
        });
    }
    Ok(RunTelemetry {
        files: Vec::new(),
        untold: old,
    })
}

/// Of files that repeat each other, the largest.
fn without_repetitions(files: Vec<PathBuf>, link: &str) -> Vec<PathBuf> {
    if !link.parse::<Link>().is_ok_and(|link| link.simulated()) {
        return files;
    }
    let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
    files.into_iter().max_by_key(size).into_iter().collect()
}
