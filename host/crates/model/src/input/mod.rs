//! What users bring: CSV tables of poses, plate certificates, numbers on the
//! command line. Text in, plain data or a friendly refusal out.
//!
//! Stands between the user's files and the identification: everything that
//! leaves this module is finite, in SI units, and belongs to the robot named.
//!
//! ```text
//!   file ─ lines ─ cells ─┬─ header ─┐
//!                         └─ rows ───┴─ Table ─ plausible units
//! ```

mod adjust;
mod cells;
mod column_plan;
mod columns;
mod csv_row;
mod csv_table;
mod error;
mod header;
mod header_names;
mod lines;
mod mapping;
mod orientation;
mod plate;
mod plausible;
mod recorded;
mod table;
mod to_csv;

pub use adjust::{Adjustments, between};
pub use cells::MOST_COLUMNS;
pub use columns::{MOST_TARGETS, TableFormat};
pub use csv_table::{MOST_FILE_BYTES, MOST_ROWS, ReadingProgress, read_csv, read_csv_file};
pub use error::InputError;
pub use lines::MOST_LINE_BYTES;
pub use mapping::{ColumnMapping, triple};
pub use plate::{Plate, read_plate, read_plate_file};
pub use recorded::{Recorded, recorded};
pub use table::{Labels, Table, TableRow};

#[cfg(test)]
mod adjust_tests;
#[cfg(test)]
mod plate_tests;
#[cfg(test)]
mod recorded_tests;
#[cfg(test)]
mod tests;
