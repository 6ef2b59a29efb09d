//! Tables as Apache Parquet, compressed by Snappy.

use std::fs::File;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use super::{Column, ExportTable};

/// A Parquet file that takes a table, one row group after the other.
pub(super) struct ParquetFile(SerializedFileWriter<File>);

impl ParquetFile {
    /// Starts a file for tables with the name and columns of `table`.
    pub(super) fn new(file: File, table: &ExportTable) -> Result<Self, ParquetError> {
        let about = KeyValue::new(
            "created_by".to_owned(),
            concat!("spherecal ", env!("CARGO_PKG_VERSION")).to_owned(),
        );
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(vec![about]))
            .build();
        SerializedFileWriter::new(file, Arc::new(schema(table)?), Arc::new(properties)).map(Self)
    }

    /// Appends one row group.
    pub(super) fn append(&mut self, table: &ExportTable) -> Result<(), ParquetError> {
        row_group(&mut self.0, table)
    }

    /// Writes the file's end.
    pub(super) fn finish(&mut self) -> Result<(), ParquetError> {
        self.0.finish().map(|_| ())
    }
}

fn schema(table: &ExportTable) -> Result<Type, ParquetError> {
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

fn row_group(writer: &mut SerializedFileWriter<File>, table: &ExportTable) -> Result<(), ParquetError> {
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
