//! Exports a run as tables for data analysis, in Parquet or CSV.
//!
//! ```text
//!   Store ───────────┐
//!                    ├─▶ Table ─▶ TableFile ─▶ recordings.parquet, contacts.csv, …
//!   telemetry files ─┘
//! ```
//!
//! One file per table, with SI units in the columns' names. Numbers are written so that they read
//! back bit by bit. The tables in a folder are of one run: `about.json` beside them says of which, and
//! an export of another run removes them first.
//!
//! | table | a row is |
//! |---|---|
//! | `recordings` | one pose, averaged: joint angles and torques |
//! | `poses` | the same, as `spherecal identify --data` reads it |
//! | `contacts`, `couplings`, `phases`, `faults` | one event |
//! | `laser` | one shot of the tracker |
//! | `parameters` | one parameter of the model, if the run was identified |
//! | `telemetry` | one control period, if the run's telemetry is there |
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
pub use table::{Column, ExportTable};

use spherecal_campaign::telemetry::Torn;
use spherecal_store::{CalibrationStore, RunInfo, StoreError};

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

impl ExportError {
    /// The error of a file or folder that cannot be written.
    fn unwritten<E: std::fmt::Display>(path: &Path) -> impl Fn(E) -> Self + Copy + '_ {
        |error| Self::Write {
            path: path.display().to_string(),
            what: error.to_string(),
        }
    }
}

/// A telemetry file that ends in the middle of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TornFile {
    /// The file.
    pub file: PathBuf,
    /// What was read of it.
    pub read: Torn,
}

/// What an export wrote.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Exported {
    /// Files, in the order in which they were written.
    pub files: Vec<PathBuf>,
    /// Telemetry files that end in the middle of a record, because their writer was killed. Their
    /// whole chunks are exported.
    pub torn_telemetry: Vec<TornFile>,
    /// Tables of another run that were in the folder and were removed.
    pub removed: Vec<PathBuf>,
}

/// Writes every table of run `info` that has rows into `folder`. `telemetry` are the run's MCAP
/// files, in the order in which they were written; none if there are none. Tables of another run in
/// `folder` are removed.
///
/// # Errors
/// When the run or its telemetry cannot be read, or a file cannot be written.
pub fn export(
    store: &mut dyn CalibrationStore,
    info: &RunInfo,
    telemetry: &[PathBuf],
    format: Format,
    folder: &Path,
) -> Result<Exported, ExportError> {
    std::fs::create_dir_all(folder).map_err(ExportError::unwritten(folder))?;
    let tables = tables::of_run(store, info.run)?;
    let mut exported = Exported {
        removed: file::begin(folder, info, tables.iter().map(|table| table.name))?,
        ..Exported::default()
    };
    for table in tables {
        if table.rows() > 0 {
            let mut file = TableFile::create(folder, format, &table)?;
            file.append(&table)?;
            exported.files.push(file.finish()?);
        }
    }
    let mut file: Option<TableFile> = None;
    exported.torn_telemetry = telemetry::read(telemetry, |table| {
        let mut out = match file.take() {
            Some(out) => out,
            None => TableFile::create(folder, format, &table)?,
        };
        out.append(&table)?;
        file = Some(out);
        Ok(())
    })?;
    exported.files.extend(file.map(TableFile::finish).transpose()?);
    Ok(exported)
}

/// The same tables in memory; that of the telemetry in pieces, one after the other. Also the telemetry files that end in the
/// middle of a record.
///
/// # Errors
/// When the run or its telemetry cannot be read.
pub fn tables(
    store: &mut dyn CalibrationStore,
    info: &RunInfo,
    telemetry: &[PathBuf],
) -> Result<(Vec<ExportTable>, Vec<TornFile>), ExportError> {
    let mut tables = tables::of_run(store, info.run)?;
    tables.retain(|table| table.rows() > 0);
    let torn = telemetry::read(telemetry, |piece| {
        tables.push(piece);
        Ok(())
    })?;
    Ok((tables, torn))
}

#[cfg(test)]
mod tests;
