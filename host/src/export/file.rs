//! A table's file: Parquet (compressed by Snappy) or CSV with a header row.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use super::{Column, ExportError, Table};

/// Kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Apache Parquet.
    Parquet,
    /// Comma-separated values with a header row.
    Csv,
}

enum Writer {
    Parquet(SerializedFileWriter<File>),
    Csv(csv::Writer<File>),
}

/// A file that takes a table, in one piece or in several.
pub struct TableFile {
    path: PathBuf,
    writer: Writer,
}

impl TableFile {
    /// Makes the file for tables with the name and columns of `table`, and
    /// writes no row yet.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn create(folder: &Path, format: Format, table: &Table) -> Result<Self, ExportError> {
        let extension = match format {
            Format::Parquet => "parquet",
            Format::Csv => "csv",
        };
        let path = folder.join(format!("{}.{extension}", table.name));
        let failed = |what: String| ExportError::Write {
            path: path.display().to_string(),
            what,
        };
        let file = File::create(&path).map_err(|e| failed(e.to_string()))?;
        let writer = match format {
            Format::Parquet => {
                let about = KeyValue::new(
                    "created_by".to_owned(),
                    concat!("spherecal ", env!("CARGO_PKG_VERSION")).to_owned(),
                );
                let properties = WriterProperties::builder()
                    .set_compression(Compression::SNAPPY)
                    .set_key_value_metadata(Some(vec![about]))
                    .build();
                let schema = schema(table).map_err(|e| failed(e.to_string()))?;
                let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties));
                Writer::Parquet(writer.map_err(|e| failed(e.to_string()))?)
            }
            Format::Csv => {
                let mut writer = csv::Writer::from_writer(file);
                let header = table.columns.iter().map(|(name, _)| name);
                writer.write_record(header).map_err(|e| failed(e.to_string()))?;
                Writer::Csv(writer)
            }
        };
        Ok(Self { path, writer })
    }

    /// Appends rows: a table with the same columns.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn append(&mut self, table: &Table) -> Result<(), ExportError> {
        let result = match &mut self.writer {
            Writer::Parquet(writer) => rows_to_parquet(writer, table).map_err(|e| e.to_string()),
            Writer::Csv(writer) => (0..table.rows())
                .try_for_each(|row| writer.write_record(table.columns.iter().map(|(_, c)| c.cell(row))))
                .map_err(|e| e.to_string()),
        };
        result.map_err(|what| self.failed(what))
    }

    /// Closes the file; returns its path.
    ///
    /// # Errors
    /// When its end cannot be written.
    pub fn finish(mut self) -> Result<PathBuf, ExportError> {
        let result = match &mut self.writer {
            Writer::Parquet(writer) => writer.finish().map(|_| ()).map_err(|e| e.to_string()),
            Writer::Csv(writer) => writer.flush().map_err(|e| e.to_string()),
        };
        match result {
            Ok(()) => Ok(self.path),
            Err(what) => Err(self.failed(what)),
        }
    }

    fn failed(&self, what: String) -> ExportError {
        ExportError::Write {
            path: self.path.display().to_string(),
            what,
        }
    }
}

fn schema(table: &Table) -> Result<Type, ParquetError> {
    let fields = table.columns.iter().map(|(name, column)| {
        let kind = match column {
            Column::Real(_) => Physical::DOUBLE,
            Column::Whole(_) => Physical::INT64,
            Column::Text(_) => Physical::BYTE_ARRAY,
        };
        let builder = Type::primitive_type_builder(name, kind).with_repetition(Repetition::REQUIRED);
        let builder = match column {
            Column::Text(_) => builder.with_logical_type(Some(LogicalType::String)),
            _ => builder,
        };
        builder.build().map(Arc::new)
    });
    Type::group_type_builder(table.name)
        .with_fields(fields.collect::<Result<_, _>>()?)
        .build()
}

/// One row group.
fn rows_to_parquet(writer: &mut SerializedFileWriter<File>, table: &Table) -> Result<(), ParquetError> {
    let mut group = writer.next_row_group()?;
    for (name, column) in &table.columns {
        let Some(mut slot) = group.next_column()? else {
            return Err(ParquetError::General(format!("no room for the column {name}")));
        };
        match (slot.untyped(), column) {
            (ColumnWriter::DoubleColumnWriter(w), Column::Real(values)) => w.write_batch(values, None, None)?,
            (ColumnWriter::Int64ColumnWriter(w), Column::Whole(values)) => w.write_batch(values, None, None)?,
            (ColumnWriter::ByteArrayColumnWriter(w), Column::Text(values)) => {
                let values: Vec<ByteArray> = values.iter().map(|v| ByteArray::from(v.as_str())).collect();
                w.write_batch(&values, None, None)?
            }
            _ => return Err(ParquetError::General(format!("the column {name} has changed its type"))),
        };
        slot.close()?;
    }
    group.close().map(|_| ())
}
