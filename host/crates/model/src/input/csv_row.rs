//! One row of the table of poses: reads its cells, checks them, and keeps them.

use super::cells::{Decimals, NumberError, SeenSign, SplitError, Splitter, no_value};
use super::columns::{ColumnRole, TableFormat, TableHeader};
use super::error::InputError;
use super::lines::{LineError, MOST_LINE_BYTES};
use super::table::{Labels, NONE, RowFields, Table, rotation};
use crate::{FileError, Set, excerpt};

/// Longest name of a place or value of a label, in characters.
const MOST_LETTERS: usize = 100;

/// Most by which the length of a quaternion may differ from 1: what rounding to three digits leaves.
const MOST_OFF: f64 = 1e-3;

/// The rows read so far, and what is needed to read the next and to complain about it.
pub(super) struct RowReader<'a> {
    file: &'a str,
    header: &'a TableHeader,
    separator: u8,
    format: &'a TableFormat,
    decimals: Decimals,
    row: usize,
    line: u64,
    q: Vec<f64>,
    tau: Vec<f64>,
    /// Coordinates of the row's points.
    numbers: Vec<f64>,
    /// Quaternion or rotation matrix.
    orientation: [f64; 9],
    table: Table,
}

impl<'a> RowReader<'a> {
    /// No row read yet.
    pub(super) fn new(file: &'a str, header: &'a TableHeader, separator: u8, format: &'a TableFormat) -> Self {
        Self {
            file,
            header,
            separator,
            format,
            decimals: Decimals::default(),
            row: 0,
            line: 0,
            q: vec![0.0; format.joints],
            tau: vec![f64::NAN; format.joints],
            numbers: vec![f64::NAN; 3 * header.targets.max(1)],
            orientation: [f64::NAN; 9],
            table: Table {
                file: file.to_owned(),
                joints: format.joints,
                numbered: if header.numbered { header.targets } else { 0 },
                ..Table::default()
            },
        }
    }

    /// Begins the next row, which stands in this line of the file. Returns its number, from 1.
    pub(super) fn next_row(&mut self, line: u64) -> usize {
        self.row += 1;
        self.line = line;
        self.row
    }

    /// The rows read.
    pub(super) fn into_table(self) -> Table {
        self.table
    }

    fn refuse(&self, k: usize, value: &str, remedy: &str) -> InputError {
        let name = self.header.names.get(k).cloned();
        InputError::Cell {
            file: self.file.to_owned(),
            row: self.row,
            line: self.line,
            column: name.unwrap_or_else(|| format!("{} (without a name)", k + 1)),
            value: excerpt(value),
            remedy: remedy.to_owned(),
        }
    }

    /// Refuses the row for something that it left empty.
    fn incomplete(&self, column: &str, remedy: &str) -> InputError {
        InputError::Cell {
            file: self.file.to_owned(),
            row: self.row,
            line: self.line,
            column: column.to_owned(),
            value: String::new(),
            remedy: remedy.to_owned(),
        }
    }

    /// A finite number times `scale`, at most `largest` either way; `limit` says
    /// what a larger one means.
    fn number(&mut self, k: usize, text: &str, scale: f64, largest: f64, limit: &str) -> Result<f64, InputError> {
        let here = SeenSign {
            row: self.row,
            column: k,
        };
        let scaled = match self.decimals.number(text, self.separator, here) {
            Ok(value) => value * scale,
            Err(error) => return Err(self.refuse(k, text, &self.remedy(error))),
        };
        if scaled.abs() > largest {
            return Err(self.refuse(k, text, limit));
        }
        Ok(scaled)
    }

    fn remedy(&self, error: NumberError) -> String {
        match error {
            NumberError::Empty => "write a number, or leave the row out".to_owned(),
            NumberError::NotFinite => "write a finite number, or leave the row out".to_owned(),
            NumberError::Spreadsheet => "a formula failed there: correct the sheet and export it again".to_owned(),
            NumberError::Mixed(seen) => format!(
                "decimal points and decimal commas are mixed (row {}, column {} has the other): write all numbers the \
                 same way",
                seen.row,
                excerpt(self.header.names.get(seen.column).map_or("", String::as_str))
            ),
            NumberError::Thousands => {
                "write it with a decimal point and no other sign between the digits, such as 1234.5".to_owned()
            }
            NumberError::NotANumber => "write a number".to_owned(),
        }
    }

    /// Reads one row.
    pub(super) fn push(&mut self, cells: &Splitter, count: usize, places: &mut Labels) -> Result<(), InputError> {
        let header = self.header;
        let width = header.columns.len();
        if let Some(k) = (width..count).find(|k| !cells.cell(*k).is_empty()) {
            return Err(self.refuse(
                k,
                cells.cell(k),
                &format!("the header has {width} columns: give every column a name, or remove the cell"),
            ));
        }
        if count < width {
            return Err(refuse_line(
                self.file,
                self.line,
                &format!("row {} has {count} cells, the header has {width}", self.row),
                "give every cell of the row; leave empty what is not known",
            ));
        }
        self.tau.fill(f64::NAN);
        self.numbers.fill(f64::NAN);
        self.orientation.fill(f64::NAN);
        let mut fields = RowFields {
            point: [f64::NAN; 3],
            sphere: NONE,
            place: NONE,
            label: NONE,
            line: u32::try_from(self.line).unwrap_or(u32::MAX),
            set: None,
        };
        let contacts = header.columns.contains(&ColumnRole::Sphere);
        for (k, column) in header.columns.iter().enumerate() {
            let text = cells.cell(k);
            match *column {
                ColumnRole::Angle { joint, scale } => {
                    let limit = if scale == 1.0 {
                        "more than four turns: name the column with _deg if it is in degrees"
                    } else {
                        "more than four turns: check the value and the unit"
                    };
                    self.q[joint] = self.number(k, text, scale, 25.2, limit)?;
                }
                ColumnRole::Ignored => {}
                ColumnRole::Blank if text.is_empty() => {}
                ColumnRole::Blank => {
                    return Err(self.refuse(k, text, "give the column a name, or remove the cell"));
                }
                _ if text.is_empty() => {}
                // A contact names its sphere, whatever stands in the columns of points.
                ColumnRole::Coordinate { .. } if contacts && no_value(text) => {}
                ColumnRole::Torque { joint } => {
                    self.tau[joint] = self.number(k, text, 1.0, 1e5, "more than 100,000: torques are in N m")?;
                }
                ColumnRole::Coordinate { target, axis, scale } => {
                    let limit = "more than 100 m: check the unit in the column's name (x_mm or x_m)";
                    let slot = 3 * target.saturating_sub(1) + axis;
                    self.numbers[slot] = self.number(k, text, scale, 100.0, limit)?;
                }
                ColumnRole::Quaternion(part) => {
                    self.orientation[part] =
                        self.number(k, text, 1.0, 1.01, "parts of a unit quaternion are at most 1")?;
                }
                ColumnRole::Rotation(part) => {
                    self.orientation[part] =
                        self.number(k, text, 1.0, 1.001, "elements of a rotation matrix are at most 1")?;
                }
                ColumnRole::Sphere => fields.sphere = self.sphere(k, text)?,
                ColumnRole::Place => fields.place = places.number(self.name(k, text)?),
                ColumnRole::Label => {
                    self.name(k, text)?;
                    fields.label = self.table.labels.number(text);
                }
                ColumnRole::Set => {
                    fields.set = Some(match text {
                        _ if text.eq_ignore_ascii_case("calibrate") => Set::Calibrate,
                        _ if text.eq_ignore_ascii_case("validate") => Set::Validate,
                        _ => return Err(self.refuse(k, text, "write calibrate or validate")),
                    });
                }
            }
        }
        if fields.place == NONE {
            fields.place = places.number("");
        }
        self.keep(fields)
    }

    /// The id of a sphere; `1.0` is 1, as tools write whole numbers of a column with gaps.
    fn sphere(&mut self, k: usize, text: &str) -> Result<u32, InputError> {
        let digits = text
            .strip_suffix(".0")
            .or_else(|| text.strip_suffix(",0"))
            .unwrap_or(text);
        match digits.parse::<u32>() {
            Ok(id) if id < NONE => Ok(id),
            _ => Err(self.refuse(k, text, "a sphere is named by its integer id, such as 1")),
        }
    }

    fn name<'t>(&self, k: usize, text: &'t str) -> Result<&'t str, InputError> {
        if text.chars().nth(MOST_LETTERS).is_some() {
            return Err(self.refuse(k, text, &format!("use a name of at most {MOST_LETTERS} letters")));
        }
        Ok(text)
    }

    /// Puts a row whose cells have been read into the table.
    fn keep(&mut self, mut fields: RowFields) -> Result<(), InputError> {
        let header = self.header;
        if self.tau.iter().any(|t| !t.is_nan()) && self.tau.iter().any(|t| t.is_nan()) {
            return Err(self.incomplete("tau", "give the torques of all joints or of none"));
        }
        let mut points = 0;
        for (k, point) in self.numbers.chunks_exact(3).enumerate() {
            match point.iter().filter(|v| !v.is_nan()).count() {
                0 => {}
                3 => points += 1,
                _ => {
                    let number = if header.numbered {
                        (k + 1).to_string()
                    } else {
                        String::new()
                    };
                    let columns = ["x", "y", "z"].map(|axis| format!("{axis}{number}")).join(", ");
                    return Err(self.incomplete(&columns, "a measured point needs all three"));
                }
            }
        }
        if points == 0 && fields.sphere == NONE {
            let remedy = if header.targets == 0 {
                "say which sphere the tool sat on"
            } else if header.columns.contains(&ColumnRole::Sphere) {
                "say where the TCP was: a sphere, or x, y and z"
            } else {
                "say where the TCP was: x, y and z"
            };
            let column = if header.targets == 0 { "sphere" } else { "x, y, z" };
            return Err(self.incomplete(column, remedy));
        }
        if header.orientation {
            let quaternion = self.quaternion(points > 0)?;
            self.table.orientations.extend_from_slice(&quaternion);
        }
        if header.numbered {
            self.table.points.extend_from_slice(&self.numbers);
        } else if let &[x, y, z] = self.numbers.as_slice() {
            fields.point = [x, y, z];
        }
        if header.torques {
            self.table.tau.extend_from_slice(&self.tau);
        }
        debug_assert_eq!(self.q.len(), self.format.joints);
        self.table.q.extend_from_slice(&self.q);
        self.table.fields.push(fields);
        Ok(())
    }

    /// The unit quaternion of the row's orientation; NaN where it has none.
    fn quaternion(&self, positioned: bool) -> Result<[f64; 4], InputError> {
        let given = self.orientation.iter().filter(|v| !v.is_nan()).count();
        let matrix = self.header.columns.iter().any(|c| matches!(c, ColumnRole::Rotation(_)));
        let (columns, needed) = if matrix { ("r11..r33", 9) } else { ("qw, qx, qy, qz", 4) };
        if given == 0 {
            return Ok([f64::NAN; 4]);
        }
        if given != needed || !positioned {
            return Err(self.incomplete(columns, "a measured frame needs its position and its whole orientation"));
        }
        let refuse = |value: String, remedy: &str| InputError::Cell {
            file: self.file.to_owned(),
            row: self.row,
            line: self.line,
            column: columns.to_owned(),
            value,
            remedy: remedy.to_owned(),
        };
        if !matrix {
            let [w, x, y, z, ..] = self.orientation;
            let norm = (w * w + x * x + y * y + z * z).sqrt();
            if (norm - 1.0).abs() > MOST_OFF {
                return Err(refuse(
                    format!("of length {norm:.4}"),
                    "an orientation is a quaternion of length 1 (w first), written with four digits or more",
                ));
            }
            return Ok([w, x, y, z].map(|part| part / norm));
        }
        let m = nalgebra::Matrix3::from_row_slice(&self.orientation);
        let off = (m * m.transpose() - nalgebra::Matrix3::identity()).amax();
        if off > 1e-2 || m.determinant() < 0.0 {
            return Err(refuse(
                format!("off by {off:.4}, determinant {:.4}", m.determinant()),
                "an orientation is a rotation matrix: orthogonal rows of length 1, right-handed",
            ));
        }
        let q = nalgebra::UnitQuaternion::from_matrix_eps(&m, 1e-14, 100, nalgebra::UnitQuaternion::identity());
        debug_assert!((rotation(q.w, q.i, q.j, q.k) - m).amax() < 0.1);
        Ok([q.w, q.i, q.j, q.k])
    }
}

pub(super) fn refuse_line(file: &str, line: u64, what: &str, remedy: &str) -> InputError {
    InputError::Line {
        file: file.to_owned(),
        line,
        what: what.to_owned(),
        remedy: remedy.to_owned(),
    }
}

/// A line of the file that cannot be had.
pub(super) fn line_error(file: &str, error: LineError) -> InputError {
    match error {
        LineError::System(source) => FileError::system(file, source).into(),
        LineError::Encoding(source) => FileError::Encoding {
            path: file.to_owned(),
            source,
        }
        .into(),
        LineError::TooLong(line) => refuse_line(
            file,
            line,
            &format!("is longer than {MOST_LINE_BYTES} bytes"),
            "give one row per line, without other data in it",
        ),
    }
}

/// Refuses a line that cannot be split into cells.
pub(super) fn split_error(file: &str, line: u64, error: SplitError) -> InputError {
    match error {
        SplitError::OpenQuote => refuse_line(
            file,
            line,
            "has a quote (\") without its partner",
            "close it; a cell holds no line breaks",
        ),
        SplitError::TooMany => refuse_line(
            file,
            line,
            &format!("has more than {} cells", super::MOST_COLUMNS),
            "give one row per line",
        ),
    }
}
