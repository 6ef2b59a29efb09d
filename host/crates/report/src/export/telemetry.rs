//! The 1 kHz telemetry of a run, from its MCAP file, as one wide table.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Column, ExportError, Format, Table, TableFile};

/// Rows held in memory: one row group of the file.
const ROWS: usize = 1 << 16;

/// Writes the table; returns `None` if the file has no samples.
pub(super) fn export(path: &Path, format: Format, folder: &Path) -> Result<Option<PathBuf>, ExportError> {
    let unreadable = |what: String| ExportError::Telemetry {
        path: path.display().to_string(),
        what,
    };
    let bytes = std::fs::read(path).map_err(|e| unreadable(e.to_string()))?;
    let messages = mcap::MessageStream::new(&bytes).map_err(|e| unreadable(e.to_string()))?;
    let mut rows = Rows::default();
    for message in messages {
        let message = message.map_err(|e| unreadable(e.to_string()))?;
        let value: Value = serde_json::from_slice(&message.data)
            .map_err(|e| unreadable(format!("a message of {}: {e}", message.channel.topic)))?;
        // The four messages of one period have the same time; the first starts a row.
        if message.channel.topic == "/joint_states" {
            rows.end_row(format, folder)?;
        }
        rows.take(&message.channel.topic, message.log_time, &value);
    }
    rows.end_row(format, folder)?;
    rows.finish(format, folder)
}

#[derive(Default)]
struct Rows {
    table: Option<Table>,
    file: Option<TableFile>,
    row: BTreeMap<String, Cell>,
    order: Vec<String>,
}

enum Cell {
    Real(f64),
    Whole(i64),
    Text(String),
}

impl Rows {
    fn put(&mut self, name: String, cell: Cell) {
        if self.table.is_none() && !self.row.contains_key(&name) {
            self.order.push(name.clone());
        }
        self.row.insert(name, cell);
    }

    fn real(&mut self, name: String, value: &Value) {
        self.put(name, Cell::Real(value.as_f64().unwrap_or(f64::NAN)));
    }

    fn xyz(&mut self, name: &str, unit: &str, value: &Value) {
        for axis in ["x", "y", "z"] {
            self.real(format!("{name}_{axis}_{unit}"), &value[axis]);
        }
    }

    /// Takes one message into the present row.
    fn take(&mut self, topic: &str, time_ns: u64, value: &Value) {
        match topic {
            "/joint_states" => {
                self.put("time_ns".to_owned(), Cell::Whole(time_ns as i64));
                for (field, name, unit) in [
                    ("position", "q", "rad"),
                    ("velocity", "dq", "rad_s"),
                    ("effort", "tau", "nm"),
                    ("command", "command", "nm"),
                ] {
                    for (value, joint) in value[field].as_array().into_iter().flatten().zip(1..) {
                        self.real(format!("{name}{joint}_{unit}"), value);
                    }
                }
            }
            "/wrench" => {
                self.xyz("force", "n", &value["wrench"]["force"]);
                self.xyz("torque", "nm", &value["wrench"]["torque"]);
            }
            "/tcp" => {
                self.xyz("tcp", "m", &value["pose"]["position"]);
                self.xyz("setpoint", "m", &value["setpoint"]);
            }
            "/phase" => {
                let phase = value["phase"].as_str().unwrap_or_default().to_owned();
                self.put("phase".to_owned(), Cell::Text(phase));
                for flag in ["saturated", "rate_limited", "near_singular"] {
                    let set = value[flag].as_bool().unwrap_or(false);
                    self.put(flag.to_owned(), Cell::Whole(i64::from(set)));
                }
            }
            _ => {}
        }
    }

    fn end_row(&mut self, format: Format, folder: &Path) -> Result<(), ExportError> {
        if self.row.is_empty() {
            return Ok(());
        }
        let (row, order) = (&self.row, &self.order);
        let table = self.table.get_or_insert_with(|| {
            let mut table = Table::new("telemetry");
            for name in order {
                let column = match row.get(name) {
                    Some(Cell::Whole(_)) => Column::Whole(Vec::new()),
                    Some(Cell::Text(_)) => Column::Text(Vec::new()),
                    _ => Column::Real(Vec::new()),
                };
                table.columns.push((name.clone(), column));
            }
            table
        });
        for (name, column) in &mut table.columns {
            match (column, self.row.remove(name)) {
                (Column::Real(v), cell) => v.push(if let Some(Cell::Real(x)) = cell { x } else { f64::NAN }),
                (Column::Whole(v), cell) => v.push(if let Some(Cell::Whole(x)) = cell { x } else { 0 }),
                (Column::Text(v), cell) => v.push(if let Some(Cell::Text(x)) = cell {
                    x
                } else {
                    String::new()
                }),
            }
        }
        self.row.clear();
        if table.rows() >= ROWS {
            self.flush(format, folder)?;
        }
        Ok(())
    }

    fn flush(&mut self, format: Format, folder: &Path) -> Result<(), ExportError> {
        let Some(table) = &mut self.table else { return Ok(()) };
        if self.file.is_none() {
            self.file = Some(TableFile::create(folder, format, table)?);
        }
        if let Some(file) = &mut self.file {
            file.append(table)?;
        }
        for (_, column) in &mut table.columns {
            column.clear();
        }
        Ok(())
    }

    fn finish(mut self, format: Format, folder: &Path) -> Result<Option<PathBuf>, ExportError> {
        if self.table.as_ref().is_some_and(|t| t.rows() > 0) {
            self.flush(format, folder)?;
        }
        self.file.map(TableFile::finish).transpose()
    }
}
