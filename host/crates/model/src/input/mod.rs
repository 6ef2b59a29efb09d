//! What users bring: CSV tables of poses, plate certificates, numbers on the
//! command line. Text in, plain data or a friendly refusal out.
//!
//! Stands between the user's files and the identification: everything that
//! leaves this module is finite, in SI units, and belongs to the robot named.

mod csv_table;
mod error;
mod numbers;
mod plate;

pub use csv_table::{Labels, Row, Table, read_csv, read_csv_file};
pub use error::InputError;
pub use numbers::triple;
pub use plate::{read_plate, read_plate_file};

#[cfg(test)]
mod tests;
