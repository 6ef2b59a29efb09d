//! A table's file: Parquet (compressed by Snappy) or CSV with a header row.

use std::fs::File;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use spherecal_model::{NewFile, read_text, write_file};
use spherecal_store::RunInfo;

use super::{ExportError, ExportTable};

/// Kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Apache Parquet.
    Parquet,
    /// Comma-separated values with a header row.
    Csv,
}

enum TableWriter {
    #[cfg(feature = "parquet")]
    Parquet(super::parquet_file::ParquetFile),
    Csv(csv::Writer<File>),
}

/// A file that takes a table, in one part or in several. It gets its name when it is finished.
pub struct TableFile {
    path: PathBuf,
    new: NewFile,
    writer: TableWriter,
}

impl TableFile {
    /// Creates the file for tables with the name and columns of `table`, without a row.
    ///
    /// # Errors
    /// When it cannot be created.
    pub fn create(folder: &Path, format: Format, table: &ExportTable) -> Result<Self, ExportError> {
        let extension = match format {
            Format::Parquet => "parquet",
            Format::Csv => "csv",
        };
        let path = folder.join(format!("{}.{extension}", table.name));
        if format == Format::Parquet && cfg!(not(feature = "parquet")) {
            return Err(ExportError::NoParquet);
        }
        let new = NewFile::create(&path).map_err(ExportError::unwritten(&path))?;
        let file = new.handle().map_err(ExportError::unwritten(&path))?;
        let writer = match format {
            #[cfg(feature = "parquet")]
            Format::Parquet => {
                let writer =
                    super::parquet_file::ParquetFile::new(file, table).map_err(ExportError::unwritten(&path))?;
                TableWriter::Parquet(writer)
            }
            #[cfg(not(feature = "parquet"))]
            Format::Parquet => return Err(ExportError::NoParquet),
            Format::Csv => {
                let mut writer = csv::Writer::from_writer(file);
                let header = table.columns.iter().map(|(name, _)| name);
                writer.write_record(header).map_err(ExportError::unwritten(&path))?;
                TableWriter::Csv(writer)
            }
        };
        Ok(Self { path, new, writer })
    }

    /// Appends rows: a table with the same columns.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn append(&mut self, table: &ExportTable) -> Result<(), ExportError> {
        let result = match &mut self.writer {
            #[cfg(feature = "parquet")]
            TableWriter::Parquet(writer) => writer.append(table).map_err(|e| e.to_string()),
            TableWriter::Csv(writer) => (0..table.rows())
                .try_for_each(|row| writer.write_record(table.columns.iter().map(|(_, c)| c.cell(row))))
                .map_err(|e| e.to_string()),
        };
        result.map_err(ExportError::unwritten(&self.path))
    }

    /// Closes the file; returns its path.
    ///
    /// # Errors
    /// When its end cannot be written.
    pub fn finish(mut self) -> Result<PathBuf, ExportError> {
        let result = match &mut self.writer {
            #[cfg(feature = "parquet")]
            TableWriter::Parquet(writer) => writer.finish().map_err(|e| e.to_string()),
            TableWriter::Csv(writer) => writer.flush().map_err(|e| e.to_string()),
        };
        let path = self.path;
        result.map_err(ExportError::unwritten(&path))?;
        self.new.finish().map_err(ExportError::unwritten(&path))?;
        Ok(path)
    }
}

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
