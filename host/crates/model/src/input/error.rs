//! Why an input was refused: where, which field, its value, and the remedy.

/// What can be wrong with a user's table, plate or number.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// The file could not be read.
    #[error("{file}: cannot be read ({source}): check the path and its permissions")]
    Read {
        /// File.
        file: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not a table, or not TOML, at all.
    #[error("{file}: {message}")]
    Syntax {
        /// File.
        file: String,
        /// What is wrong and where.
        message: String,
    },
    /// A column that the contract does not know.
    #[error("{file}: column \"{column}\" is not known: remove or rename it; known are {known}")]
    UnknownColumn {
        /// File.
        file: String,
        /// The column as written.
        column: String,
        /// What may stand there.
        known: String,
    },
    /// A column that is needed is missing, or given twice.
    #[error("{file}: {what}: {remedy}")]
    Columns {
        /// File.
        file: String,
        /// What is wrong with the header.
        what: String,
        /// What to write instead.
        remedy: String,
    },
    /// One cell cannot be used.
    #[error("{file}: row {row} (line {line}), column {column} is \"{value}\": {remedy}")]
    Cell {
        /// File.
        file: String,
        /// Row of data, from 1.
        row: usize,
        /// Line of the file, from 1.
        line: u64,
        /// Column as written.
        column: String,
        /// What stands there.
        value: String,
        /// What to write instead.
        remedy: String,
    },
    /// A field of a TOML file or of the command line cannot be used.
    #[error("{file}: {field} is {value}: {remedy}")]
    Field {
        /// File or option.
        file: String,
        /// Field.
        field: String,
        /// Its value.
        value: String,
        /// What to write instead.
        remedy: String,
    },
}

/// At most 60 letters of a value, for a message.
pub(super) fn shown(value: &str) -> String {
    let mut text: String = value.chars().take(60).collect();
    if text.len() < value.len() {
        text.push('…');
    }
    text
}
