//! `about.json` beside the tables: the run that they are of.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use spherecal_model::{read_text, write_file};
use spherecal_store::RunInfo;

use super::ExportError;

const FILE: &str = "about.json";
/// Largest such file, in bytes.
const MOST_BYTES: u64 = 1 << 16;

/// The run that the tables of a folder are of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct About {
    run: i64,
    created_utc: String,
    robot: String,
    arm: String,
}

impl About {
    fn of(info: &RunInfo) -> Self {
        Self {
            run: info.run,
            created_utc: info.about.created_utc.clone(),
            robot: info.about.robot.name.to_string(),
            arm: info.about.arm.clone(),
        }
    }

    /// The run of the tables in `folder`; `None` if they do not tell.
    fn read(folder: &Path) -> Option<Self> {
        let text = read_text(&folder.join(FILE), MOST_BYTES, "it has some bytes").ok()?;
        serde_json::from_str(&text).ok()
    }
}

/// Prepares `folder` for the tables of run `info`: removes the tables that are not of this run, and
/// says of which run the folder is. `names` are the tables that come from the store. Returns what was
/// removed.
/// Errors: when a file cannot be removed or written.
pub(super) fn begin(
    folder: &Path,
    info: &RunInfo,
    names: impl Iterator<Item = &'static str>,
) -> Result<Vec<PathBuf>, ExportError> {
    let about = About::of(info);
    let mut removed = Vec::new();
    if About::read(folder).as_ref() == Some(&about) {
        return Ok(removed);
    }
    // The parameters are a table of identified runs only.
    for name in names.chain(["parameters", "telemetry"]) {
        for extension in ["csv", "parquet"] {
            let path = folder.join(format!("{name}.{extension}"));
            match std::fs::remove_file(&path) {
                Ok(()) => removed.push(path),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => return Err(ExportError::unwritten(&path)(error)),
            }
        }
    }
    let path = folder.join(FILE);
    let text = serde_json::to_string_pretty(&about).map_err(ExportError::unwritten(&path))?;
    write_file(&path, text + "\n").map_err(ExportError::unwritten(&path))?;
    Ok(removed)
}
