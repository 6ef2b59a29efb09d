//! Finds the telemetry of a stored run in a folder.

use std::path::{Path, PathBuf};

use spherecal_campaign::telemetry::{RunKey, files_of_earlier_versions, files_of_run};
use spherecal_store::RunInfo;

use super::Link;

/// The telemetry of a run in a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunTelemetry {
    /// Its files, in the order in which they were written: one, and one more for each time it was
    /// resumed.
    pub files: Vec<PathBuf>,
    /// Files of earlier versions, whose messages are in JSON. They are none of `files`.
    pub earlier: Vec<PathBuf>,
}

impl RunTelemetry {
    /// What to tell the user of files that are left out; `None` where there are none.
    pub fn remark(&self) -> Option<String> {
        let first = self.earlier.first()?;
        Some(format!(
            "{}: an earlier version wrote it, with messages in JSON: it is left out; Foxglove opens it",
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

/// Finds the telemetry of run `info` in `folder`.
///
/// A simulated run that is resumed starts from its beginning, so each of its files repeats the ones
/// before. Of them only the largest is returned.
pub fn run_telemetry(folder: &Path, info: &RunInfo) -> RunTelemetry {
    let run = run_key(info);
    RunTelemetry {
        files: without_repetitions(files_of_run(folder, &run), &info.link),
        earlier: files_of_earlier_versions(folder, &run),
    }
}

/// Of files that repeat each other, the largest.
fn without_repetitions(files: Vec<PathBuf>, link: &str) -> Vec<PathBuf> {
    if !link.parse::<Link>().is_ok_and(|link| link.simulated()) {
        return files;
    }
    let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
    files.into_iter().max_by_key(size).into_iter().collect()
}
