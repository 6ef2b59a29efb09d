//! Whatever was recorded, as the table that [`read_csv`](super::read_csv) reads.
//!
//! The reader takes one kind of table and refuses what could mean two things. This front end knows the tables that people
//! have: other names of columns (or none), blanks between the cells, orientations as Euler angles or rotation vectors, rows
//! without a value, further columns. It puts names and cells right, line by line, and says what it did. Lines keep their
//! numbers, so a later refusal names the line of the user's file.
//!
//! ```text
//!   file ─ lines ─ cells ─ plan (by mapping, by known names) ─▶ CSV + notes
//! ```

use std::io::Read;

use super::cells::{Splitter, no_value, separator};
use super::column_plan::{OutColumn, Plan};
use super::columns::TableFormat;
use super::csv_row::{line_error, split_error};
use super::csv_table::comment as is_comment;
use super::error::InputError;
use super::header_names::decimal;
use super::lines::Lines;
use super::mapping::ColumnMapping;
use super::orientation::Orientation;
use crate::excerpt;

/// A table put right.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recorded {
    /// The table as CSV.
    pub csv: String,
    /// What was done to it: one sentence each.
    pub notes: Vec<String>,
    /// Whether anything was: else the file itself may be read.
    pub changed: bool,
}

fn is_number(cell: &str) -> bool {
    no_value(cell) && !cell.is_empty() || cell.replacen(',', ".", 1).parse::<f64>().is_ok()
}

/// Cells of a line: separated by one sign, or by any number of blanks.
struct Cells {
    splitter: Splitter,
    blanks: bool,
}

impl Cells {
    fn new(header: &str, said: Option<u8>) -> (Self, u8) {
        let found = said.unwrap_or_else(|| separator(header));
        let blanks = !header.bytes().any(|b| b == found) && header.split_whitespace().count() > 2;
        let written = if blanks { b';' } else { found };
        (
            Self {
                splitter: Splitter::new(if blanks { b'\t' } else { found }),
                blanks,
            },
            written,
        )
    }

    fn split(&mut self, file: &str, line: u64, text: &str) -> Result<Vec<String>, InputError> {
        let joined;
        let text = if self.blanks {
            joined = text.split_whitespace().collect::<Vec<_>>().join("\t");
            &joined
        } else {
            text
        };
        let count = self.splitter.split(text).map_err(|e| split_error(file, line, e))?;
        Ok((0..count).map(|k| self.splitter.cell(k).to_owned()).collect())
    }
}

/// A cell as it stands in a line with this separator.
fn quoted(cell: &str, separator: u8) -> String {
    if cell.bytes().any(|b| b == separator || b == b'"') {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}

fn joined(cells: &[String], separator: u8) -> String {
    let cells: Vec<String> = cells.iter().map(|c| quoted(c, separator)).collect();
    cells.join(char::from(separator).encode_utf8(&mut [0; 4]))
}

/// Puts a table right for a robot; `file` is for messages.
///
/// # Errors
/// Text that cannot be read as lines of cells; a mapping that names columns that are not there.
pub fn recorded(
    file: &str,
    source: impl Read,
    format: &TableFormat,
    mapping: &ColumnMapping,
) -> Result<Recorded, InputError> {
    let failed = |error| line_error(file, error);
    let mut lines = Lines::new(source).map_err(failed)?;
    let mut out = Recorded::default();
    // The last comment, as a header may be written, and where it stands in `out`.
    let mut comment: Option<(String, usize)> = None;
    let mut said = None;
    let mut begun: Option<(Plan, Cells, u8)> = None;
    let mut left_out: (usize, u64) = (0, 0);
    let mut rows = 0_usize;
    while let Some((text, line)) = lines.next().map_err(failed)? {
        let trimmed = text.trim();
        if begun.is_none() {
            if let Some(rest) = trimmed.strip_prefix("sep=") {
                said = rest.bytes().next();
                out.csv.push('\n');
                continue;
            }
            if let Some(words) = trimmed.strip_prefix('#') {
                comment = Some((words.trim().to_owned(), out.csv.len()));
                out.csv.push('\n');
                continue;
            }
            if trimmed.is_empty() {
                out.csv.push('\n');
                continue;
            }
        } else if is_comment(trimmed) {
            out.csv.push('\n');
            continue;
        }
        let (plan, cells, separator) = if let Some(begun) = &mut begun {
            begun
        } else {
            let (mut cells, separator) = Cells::new(trimmed, said);
            let first = cells.split(file, line, text)?;
            let numbers = first.iter().filter(|c| is_number(c)).count();
            let is_row = first.len() > 1 && 2 * numbers > first.len();
            let above = comment.as_ref().filter(|_| is_row).and_then(|(words, at)| {
                let names = Cells::new(words, said).0.split(file, line, words).ok()?;
                (names.len() == first.len()).then_some((names, *at))
            });
            let (names, at) = match above {
                Some((names, at)) => {
                    out.changed = true;
                    out.notes
                        .push("the names of the columns stand in a comment (#)".to_owned());
                    (names, Some(at))
                }
                None if is_row && mapping.by_number() => {
                    out.changed = true;
                    ((1..=first.len()).map(|k| k.to_string()).collect(), None)
                }
                None => (first.clone(), None),
            };
            let plan = Plan::new(file, &names, format, mapping)?;
            out.changed |= plan.changed || cells.blanks;
            out.notes.extend(plan.notes.iter().cloned());
            let header = joined(&plan.names(), separator);
            let has_row = is_row && (at.is_some() || mapping.by_number());
            if let Some(at) = at {
                out.csv.insert_str(at, &header);
            } else {
                out.csv.push_str(&header);
                out.csv.push('\n');
            }
            begun = Some((plan, cells, separator));
            match &mut begun {
                Some(begun) if has_row => begun,
                _ => continue,
            }
        };
        let cells = cells.split(file, line, text)?;
        if cells.iter().all(String::is_empty) {
            out.csv.push('\n');
            continue;
        }
        rows += 1;
        if plan.is_without_value(&cells) {
            if left_out.0 == 0 {
                left_out.1 = line;
            }
            left_out.0 += 1;
            out.csv.push('\n');
            continue;
        }
        plan.carriers.iter_mut().for_each(|carrier| carrier.see(&cells));
        let row = plan.row(&cells);
        // A cell may have been emptied.
        out.changed |= row != cells;
        out.csv.push_str(&joined(&row, *separator));
        out.csv.push('\n');
    }
    if left_out.0 > 0 {
        out.changed = true;
        out.notes.push(format!(
            "{} of {rows} rows have no value and were left out (the first in line {})",
            left_out.0, left_out.1
        ));
    }
    let carriers = begun.iter().flat_map(|(plan, ..)| &plan.carriers);
    let moving: Vec<String> = carriers.filter(|c| c.moves()).map(|c| excerpt(&c.name)).collect();
    if !moving.is_empty() {
        out.notes.push(format!(
            "{} moves in these rows and carries the base of the chain: begin the chain before it (--robot FILE#BASE:TIP), \
             unless what measured rides on the base, too",
            moving.join(" and ")
        ));
    }
    // Nothing to read: the reader says so about the file itself.
    out.changed &= rows > left_out.0;
    Ok(out)
}

impl Plan {
    /// Whether a row lacks a joint angle, or all of its measurements.
    fn is_without_value(&self, cells: &[String]) -> bool {
        let without = |k: &usize| cells.get(*k).is_none_or(|c| no_value(c));
        let measured = || self.measured.iter().filter(|k| !without(k)).count();
        // A contact names its sphere: that no point was measured is no loss.
        let contact = measured() == 0 && self.targets.iter().any(|k| !without(k));
        // A line that is too short is refused by the reader.
        if cells.len() < self.width {
            return false;
        }
        self.joints.iter().any(without)
            || (!self.targets.is_empty() && self.targets.iter().all(without))
            || (!self.numbered
                && !contact
                && self
                    .measured
                    .iter()
                    .any(|k| cells.get(*k).is_some_and(|c| no_value(c) && !c.is_empty())))
    }

    /// The cells of a row in the plan's columns.
    fn row(&self, cells: &[String]) -> Vec<String> {
        let cell = |k: usize| cells.get(k).map_or("", String::as_str);
        let mut out = Vec::with_capacity(self.columns.len() + 4);
        // A line that is too short stays so: the reader refuses it.
        let within = |column: &&OutColumn| match column {
            OutColumn::Copy { from, .. } => *from < cells.len(),
            OutColumn::Quaternion { from, .. } => from.iter().all(|from| *from < cells.len()),
        };
        for column in self.columns.iter().take_while(within) {
            match column {
                OutColumn::Copy { from, .. } => {
                    let text = cell(*from);
                    let blank = (self.numbered && self.targets.contains(from) || self.measured.contains(from))
                        && no_value(text);
                    out.push(if blank { String::new() } else { text.to_owned() });
                }
                OutColumn::Quaternion { from, kind } => out.extend(quaternion(from.map(cell), *kind)),
            }
        }
        // What stands beyond the header is refused by the reader.
        out.extend(cells.get(self.width..).unwrap_or_default().iter().cloned());
        out
    }
}

/// The quaternion of an orientation's three cells; the cells themselves, for the reader's refusal, where they are no
/// numbers.
fn quaternion(cells: [&str; 3], kind: Orientation) -> [String; 4] {
    let comma = cells.iter().any(|c| c.contains(','));
    let word = |value: f64| {
        let word = value.to_string();
        if comma { word.replace('.', ",") } else { word }
    };
    match cells.map(decimal) {
        [Some(a), Some(b), Some(c)] => kind.quaternion([a, b, c]).map(word),
        _ if cells.iter().all(|c| c.is_empty()) => [const { String::new() }; 4],
        _ => {
            let [a, b, c] = cells.map(excerpt);
            [a, b, c, String::new()]
        }
    }
}
