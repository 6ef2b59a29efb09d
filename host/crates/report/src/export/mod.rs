//! Exports a run as tables for data analysis, in Parquet or CSV.
//!
//! ```text
//!   Store ───────────┐
//!                    ├─▶ Table ─▶ TableFile ─▶ recordings.parquet, contacts.csv, …
//!   telemetry.mcap ──┘
//! ```
//!
//! One file per table, with SI units in the columns' names. Numbers are written so that they read
//! back bit by bit.
//!
//! | table | a row is |
//! |---|---|
//! | `recordings` | one pose, averaged: joint angles and torques |
//! | `poses` | the same, as `spherecal identify --data` reads it |
//! | `contacts`, `couplings`, `phases`, `faults` | one event |
//! | `laser` | one shot of the tracker |
//! | `parameters` | one parameter of the model, if the run was identified |
//! | `telemetry` | one control period, if `telemetry.mcap` is there |
//!
//! [`export_ros2`] writes the telemetry as a ROS 2 bag instead.

mod file;
#[cfg(feature = "parquet")]
mod parquet_file;
mod ros2;
mod table;
mod tables;
mod telemetry;

use std::path::{Path, PathBuf};

pub use file::{Format, TableFile};
pub use ros2::export_ros2;
pub use table::{Column, Table};

use spherecal_store::{CalibrationStore, StoreError};

/// Why a run could not be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The run could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A file could not be written.
    #[error("{path}: {what}: check the folder, its permissions and its free space")]
    Write {
        /// File.
        path: String,
        /// What happened.
        what: String,
    },
    /// This program was built without the requested feature.
    #[error(
        "Parquet files need the feature `parquet`, which this program was built without: build it with \
         --features parquet, or give --format csv"
    )]
    NoParquet,
    /// The telemetry could not be read.
    #[error("{path}: {what}: move the file away to export without telemetry")]
    Telemetry {
        /// File.
        path: String,
        /// What is wrong.
        what: String,
    },
}

/// What an export wrote.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Exported {
    /// Files, in the order in which they were written.
    pub files: Vec<PathBuf>,
    /// Whether the telemetry ends in the middle of a record, because its writer was killed. Its
    /// whole chunks are exported.
    pub torn_telemetry: bool,
}

/// Writes every table of a run that has rows into `folder`. `telemetry` is the run's MCAP file, if
/// there is one.
///
/// # Errors
/// When the run or its telemetry cannot be read, or a file cannot be written.
pub fn export(
    store: &mut dyn CalibrationStore,
    run: i64,
    telemetry: Option<&Path>,
    format: Format,
    folder: &Path,
) -> Result<Exported, ExportError> {
    std::fs::create_dir_all(folder).map_err(|e| ExportError::Write {
        path: folder.display().to_string(),
        what: e.to_string(),
    })?;
    let mut exported = Exported::default();
    for table in tables::of_run(store, run)? {
        if table.rows() > 0 {
            let mut file = TableFile::create(folder, format, &table)?;
            file.append(&table)?;
            exported.files.push(file.finish()?);
        }
    }
    if let Some(path) = telemetry {
        let (file, torn) = telemetry::export(path, format, folder)?;
        exported.files.extend(file);
        exported.torn_telemetry = torn;
    }
    Ok(exported)
}

#[cfg(test)]
mod tests;
