//! A table's file: Parquet (compressed by Snappy) or CSV with a header row.

use std::fs::File;
use std::path::{Path, PathBuf};

use spherecal_model::NewFile;

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
