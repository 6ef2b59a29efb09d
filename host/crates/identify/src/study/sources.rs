//! Where a study's robot, plate and tables come from: files, or the memory of a caller.

use std::path::Path;

use crate::paper_plate;
use spherecal_model::input::{
    InputError, Labels, Plate, ReadingProgress, Table, TableFormat, read_csv, read_csv_file, read_plate_file,
};
use spherecal_model::robots::RobotModel;

/// Name of the plate of the paper's Table 1, in place of a file.
pub const PAPER_PLATE: &str = "paper";

/// A table of poses: a file, or text in memory.
#[derive(Clone, Copy, Debug)]
pub enum TableSource<'a> {
    /// A CSV file.
    File(&'a Path),
    /// CSV text; `name` is for messages.
    Text {
        /// What messages call it.
        name: &'a str,
        /// The whole table, with its header line.
        csv: &'a str,
    },
}

impl TableSource<'_> {
    pub(super) fn read(
        self,
        format: &TableFormat,
        places: &mut Labels,
        progress: &mut dyn FnMut(ReadingProgress),
    ) -> Result<Table, InputError> {
        match self {
            Self::File(path) => read_csv_file(path, format, places, progress),
            Self::Text { name, csv } => read_csv(name, csv.as_bytes(), format, places),
        }
    }
}

/// What a caller has in memory in place of the files that a [`StudyRequest`](super::StudyRequest) names.
#[derive(Clone, Debug)]
pub struct Sources<'a> {
    /// The nominal robot.
    pub model: RobotModel,
    /// The plate's certificate; none for measured points alone.
    pub plate: Option<Plate>,
    /// Table of poses.
    pub data: TableSource<'a>,
    /// Table of poses that judge the result.
    pub validate: Option<TableSource<'a>>,
    /// What the user should know about where the tables come from.
    pub notes: Vec<String>,
}

/// The plate of a file, or of the paper.
pub(super) fn plate(path: &Path) -> Result<Plate, InputError> {
    if path == Path::new(PAPER_PLATE) {
        return Ok(Plate {
            spheres: paper_plate(),
            ..Plate::default()
        });
    }
    read_plate_file(path)
}
