//! Why an input was refused: where, which field, its value, and the remedy.
//!
//! What comes from the user's file is escaped ([`printable`](crate::printable))
//! where it enters a message.

use crate::{FileError, TomlError, excerpt, printable};

/// What can be wrong with a user's table, plate or number.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// The file could not be read, or is not text.
    #[error(transparent)]
    File(#[from] FileError),
    /// A line cannot be a row of a table.
    #[error("{}: line {line}: {what}: {remedy}", printable(file))]
    Line {
        /// File.
        file: String,
        /// Line of the file, from 1.
        line: u64,
        /// What is wrong with it.
        what: String,
        /// What to write instead.
        remedy: String,
    },
    /// The text is not the TOML of what it should describe.
    #[error("{}: {source} ({expected})", printable(file))]
    Toml {
        /// File.
        file: String,
        /// What is wrong and where.
        source: TomlError,
        /// What the file should hold.
        expected: &'static str,
    },
    /// There is nothing in it, or too much.
    #[error("{}: holds {found}: {remedy}", printable(file))]
    Count {
        /// File.
        file: String,
        /// What was found.
        found: String,
        /// What to write instead.
        remedy: String,
    },
    /// Columns that the contract does not know.
    #[error(
        "{}: {} not known: {hint}remove or rename {}, or leave {} out with --ignore-columns; known are {known}",
        printable(file),
        named(columns),
        them(columns),
        them(columns)
    )]
    UnknownColumns {
        /// File.
        file: String,
        /// The columns as written.
        columns: Vec<String>,
        /// What may have been meant, with a space behind; or nothing.
        hint: String,
        /// What may stand there.
        known: String,
    },
    /// A column that is needed is missing, or given twice.
    #[error("{}: {what}: {remedy}", printable(file))]
    Columns {
        /// File.
        file: String,
        /// What is wrong with the header.
        what: String,
        /// What to write instead.
        remedy: String,
    },
    /// One cell cannot be used.
    #[error(
        "{}: row {row} (line {line}), column {} is \"{value}\": {remedy}",
        printable(file),
        excerpt(column)
    )]
    Cell {
        /// File.
        file: String,
        /// Row of data, from 1.
        row: usize,
        /// Line of the file, from 1.
        line: u64,
        /// Column as written.
        column: String,
        /// What stands there; printable.
        value: String,
        /// What to write instead.
        remedy: String,
    },
    /// A field of a TOML file or of the command line cannot be used.
    #[error("{}: {field} is {value}: {remedy}", printable(file))]
    Field {
        /// File or option.
        file: String,
        /// Field.
        field: String,
        /// Its value; printable.
        value: String,
        /// What to write instead.
        remedy: String,
    },
}

/// Most columns that a message lists.
const LISTED: usize = 8;

fn named(columns: &[String]) -> String {
    let names: Vec<String> = columns
        .iter()
        .take(LISTED)
        .map(|c| format!("\"{}\"", excerpt(c)))
        .collect();
    match columns.len() {
        1 => format!("column {} is", names.join("")),
        n if n > LISTED => format!("columns {} and {} more are", names.join(", "), n - LISTED),
        _ => format!("columns {} are", names.join(", ")),
    }
}

fn them(columns: &[String]) -> &'static str {
    if columns.len() == 1 { "it" } else { "them" }
}
