//! The table of poses that a user brings: joint angles, and where the TCP was.
//!
//! | columns | meaning |
//! |---|---|
//! | `q1..qn` (rad) or `q1_deg..`, or the robot's joint names | joint angles, base to flange |
//! | `tau1..taun` (N m), optional | measured joint torques |
//! | `x_mm,y_mm,z_mm` or `x_m..` | a measured point: absolute data |
//! | `x1_mm,y1_mm,z1_mm,x2_mm,..` | up to six targets on the tool, the first the TCP; an empty one was not seen |
//! | `qw,qx,qy,qz` or `r11..r33`, with `x_mm..` | the pose of a body on the tool |
//! | `sphere` (integer) | the sphere that the tool sat on: closed-loop data |
//! | `place` (integer or name), optional | which placement of the plate |
//! | `set` (`calibrate` or `validate`), optional | what the row may be used for |
//!
//! A table may mix single points and contacts: a row then fills one and leaves the other empty.
//!
//! Read as spreadsheets write it: separated by commas, semicolons or tabs, decimals
//! with a point or (between semicolons or tabs) a comma, quoted cells, UTF-8 or
//! UTF-16, blank rows and blank columns at the end. What could mean two things is
//! refused with its row and column.
//!
//! The file is read as a stream. Bounds: [`MOST_FILE_BYTES`], [`MOST_ROWS`],
//! [`MOST_LINE_BYTES`](super::MOST_LINE_BYTES), [`MOST_COLUMNS`](super::MOST_COLUMNS).

use std::io::Read;
use std::path::Path;

use super::cells::{Splitter, separator};
use super::columns::{TableFormat, TableHeader};
use super::csv_row::{RowReader, line_error, split_error};
use super::error::InputError;
use super::header::header;
use super::lines::{LineError, Lines};
use super::plausible;
use super::table::{Labels, Table};
use crate::open_regular;

/// Largest table that is read, in bytes.
pub const MOST_FILE_BYTES: u64 = 2 << 30;
/// Most rows of a table: 0.5 GB in memory with seven joints.
pub const MOST_ROWS: usize = 5_000_000;
/// Rows between two reports of progress.
const REPORTED: usize = 8192;

/// How far the reading has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadingProgress {
    /// Rows so far.
    pub rows: usize,
    /// Bytes so far.
    pub bytes: u64,
    /// Bytes in all; 0 where that is not known.
    pub total_bytes: u64,
}

/// Reads a table's file. `places` gives numbers to the names of placements and
/// keeps those it has; `progress` is called every few thousand rows.
///
/// # Errors
/// Files that are not regular or too large, and what [`read_csv`] refuses.
pub fn read_csv_file(
    path: &Path,
    format: &TableFormat,
    places: &mut Labels,
    progress: &mut dyn FnMut(ReadingProgress),
) -> Result<Table, InputError> {
    let (file, total) = open_regular(path, MOST_FILE_BYTES, "split the table into several files")?;
    let name = path.display().to_string();
    // What grows while it is read ends at the limit.
    read(&name, file.take(MOST_FILE_BYTES), total, format, places, progress)
}

/// Reads a table of poses; `file` is for messages, `places` as in [`read_csv_file`].
///
/// # Errors
/// The first column or cell that cannot be used, with its value and the remedy.
pub fn read_csv(file: &str, source: impl Read, format: &TableFormat, places: &mut Labels) -> Result<Table, InputError> {
    read(file, source, 0, format, places, &mut |_| {})
}

fn read(
    file: &str,
    source: impl Read,
    total_bytes: u64,
    format: &TableFormat,
    places: &mut Labels,
    progress: &mut dyn FnMut(ReadingProgress),
) -> Result<Table, InputError> {
    let failed = |error| line_error(file, error);
    let mut lines = Lines::new(source).map_err(failed)?;
    let (mut splitter, header, separator) = begin(file, &mut lines, format, failed)?;
    let mut reader = RowReader::new(file, &header, separator, format);
    while let Some((text, line)) = lines.next().map_err(failed)? {
        if comment(text) {
            continue;
        }
        let cells = splitter.split(text).map_err(|e| split_error(file, line, e))?;
        if (0..cells).all(|k| splitter.cell(k).is_empty()) {
            continue;
        }
        let row = reader.next_row(line);
        if row > MOST_ROWS {
            return Err(InputError::Count {
                file: file.to_owned(),
                found: format!("more than {MOST_ROWS} rows"),
                remedy: "split it into several tables, or average repeated readings".to_owned(),
            });
        }
        reader.push(&splitter, cells, places)?;
        if row.is_multiple_of(REPORTED) {
            progress(ReadingProgress {
                rows: row,
                bytes: lines.bytes(),
                total_bytes,
            });
        }
    }
    let table = reader.into_table();
    if table.is_empty() {
        return Err(InputError::Count {
            file: file.to_owned(),
            found: "no rows".to_owned(),
            remedy: "give a header line and one row per pose".to_owned(),
        });
    }
    progress(ReadingProgress {
        rows: table.len(),
        bytes: lines.bytes(),
        total_bytes,
    });
    plausible::check(&table, &header)?;
    Ok(table)
}

/// Texts that a spreadsheet writes in place of the result of a formula that failed.
const FORMULA_ERRORS: [&str; 8] = [
    "#DIV/0!", "#N/A", "#NAME?", "#NULL!", "#NUM!", "#REF!", "#VALUE!", "#SPILL!",
];

/// Whether a line is a comment: it begins with `#`, but not with the error of a
/// spreadsheet's formula (`#DIV/0!`, `#N/A`), which is a cell and must be refused.
pub(super) fn comment(line: &str) -> bool {
    let line = line.trim_start();
    let first = line.split([',', ';', '\t']).next().unwrap_or_default().trim_end();
    line.starts_with('#') && !FORMULA_ERRORS.contains(&first)
}

/// Finds the header line; returns what splits the lines below it, the header and
/// the separator.
fn begin<R: Read>(
    file: &str,
    lines: &mut Lines<R>,
    format: &TableFormat,
    failed: impl Fn(LineError) -> InputError,
) -> Result<(Splitter, TableHeader, u8), InputError> {
    let mut said = None;
    loop {
        let Some((text, line)) = lines.next().map_err(&failed)? else {
            return Err(InputError::Count {
                file: file.to_owned(),
                found: "no header line".to_owned(),
                remedy: format!("begin with one, such as {}", example(format)),
            });
        };
        // Excel's word to itself on the separator.
        if let Some(rest) = text.trim().strip_prefix("sep=")
            && let &[separator @ (b',' | b';' | b'\t')] = rest.as_bytes()
        {
            said = Some(separator);
            continue;
        }
        if comment(text) {
            continue;
        }
        let separator = said.unwrap_or_else(|| separator(text));
        let mut splitter = Splitter::new(separator);
        let count = splitter.split(text).map_err(|e| split_error(file, line, e))?;
        let mut names: Vec<String> = (0..count).map(|k| splitter.cell(k).to_owned()).collect();
        if names.iter().all(String::is_empty) {
            continue;
        }
        while names.last().is_some_and(String::is_empty) {
            names.pop();
        }
        return Ok((splitter, header(file, names, format)?, separator));
    }
}

/// A header line for a robot.
fn example(format: &TableFormat) -> String {
    let joints: Vec<String> = (1..=format.joints).map(|k| format!("q{k}")).collect();
    format!("{},x_mm,y_mm,z_mm", joints.join(","))
}
