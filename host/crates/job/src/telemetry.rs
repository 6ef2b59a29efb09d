//! Finds the telemetry of a stored run in a folder.

use std::path::{Path, PathBuf};

use spherecal_campaign::telemetry::{RunKey, files_of_run};
use spherecal_store::RunInfo;

use super::Link;

/// Key of a run in the metadata of its telemetry.
pub(super) fn run_key(info: &RunInfo) -> RunKey {
    RunKey {
        number: info.run,
        created_utc: info.about.created_utc.clone(),
    }
}

/// The telemetry of run `info` in `folder`: its files, in the order in which they were written. One, and one more for
/// each time it was resumed.
///
/// A simulated run that is resumed starts from its beginning, so each of its files repeats the ones
/// before. Of them only the largest is returned.
pub fn run_telemetry(folder: &Path, info: &RunInfo) -> Vec<PathBuf> {
    let files = files_of_run(folder, &run_key(info));
    if !info.about.link.parse::<Link>().is_ok_and(|link| link.simulated()) {
        return files;
    }
    let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
    files.into_iter().max_by_key(size).into_iter().collect()
}
