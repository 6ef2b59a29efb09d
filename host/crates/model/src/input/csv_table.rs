//! The table of poses that a user brings: joint angles, and where the TCP was.
//!
//! | columns | meaning |
//! |---|---|
//! | `q1..qn` (rad) or `q1_deg..` | joint angles, base to flange |
//! | `tau1..taun` (N m), optional | measured joint torques |
//! | `x_mm,y_mm,z_mm` or `x_m..` | a measured point: absolute data |
//! | `sphere` (integer) | the sphere that the tool sat on: closed-loop data |
//! | `place` (integer or name), optional | which placement of the plate |
//! | `set` (`calibrate` or `validate`), optional | what the row may be used for |
//!
//! A table may mix both kinds: a row then fills one and leaves the other empty.
//! Unknown columns are named in an error, except the one label column that the
//! caller asks for (to hold out by it).

use std::io::Read;
use std::path::Path;

use super::error::{InputError, shown};
use crate::Set;

/// Names that were given to numbers in the order in which they appeared.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Labels {
    names: Vec<String>,
}

impl Labels {
    /// The number of a name; a new name gets the next number.
    pub fn number(&mut self, name: &str) -> u32 {
        let at = self.names.iter().position(|n| n == name).unwrap_or_else(|| {
            self.names.push(name.to_owned());
            self.names.len() - 1
        });
        u32::try_from(at).unwrap_or(u32::MAX)
    }

    /// The name behind a number.
    pub fn name(&self, number: u32) -> &str {
        self.names.get(number as usize).map_or("", String::as_str)
    }

    /// All names, in the order of their numbers.
    pub fn names(&self) -> &[String] {
        &self.names
    }
}

/// One row of the table, in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Line of the file, from 1.
    pub line: u64,
    /// Joint angles, in rad.
    pub q: Vec<f64>,
    /// Joint torques, in N m.
    pub tau: Option<Vec<f64>>,
    /// Measured point, in m.
    pub point: Option<[f64; 3]>,
    /// Sphere that the tool sat on.
    pub sphere: Option<u32>,
    /// Placement of the plate: number of its name in the caller's [`Labels`].
    pub place: u32,
    /// What the row may be used for, where the table says.
    pub set: Option<Set>,
    /// Value of the label column that the caller asked for.
    pub label: Option<String>,
}

/// A whole table.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Where it came from, for messages.
    pub file: String,
    /// Rows in the file's order; never empty.
    pub rows: Vec<Row>,
}

/// What a column holds.
#[derive(Clone, Debug, PartialEq)]
enum Column {
    Angle { joint: usize, scale: f64 },
    Torque { joint: usize },
    Coordinate { axis: usize, scale: f64 },
    Sphere,
    Place,
    Set,
    Label,
}

/// A column's name as the contract knows it.
fn column(name: &str) -> Option<Column> {
    let indexed = |rest: &str| {
        rest.parse::<usize>()
            .ok()
            .filter(|j| (1..=99).contains(j))
            .map(|j| j - 1)
    };
    match name {
        "sphere" => return Some(Column::Sphere),
        "place" => return Some(Column::Place),
        "set" => return Some(Column::Set),
        _ => {}
    }
    if let Some(rest) = name.strip_prefix("tau") {
        return indexed(rest).map(|joint| Column::Torque { joint });
    }
    if let Some(rest) = name.strip_prefix('q') {
        let (rest, scale) = match rest.strip_suffix("_deg") {
            Some(rest) => (rest, std::f64::consts::PI / 180.0),
            None => (rest, 1.0),
        };
        return indexed(rest).map(|joint| Column::Angle { joint, scale });
    }
    let (axis, unit) = name.split_once('_')?;
    let axis = ["x", "y", "z"].iter().position(|a| *a == axis)?;
    let scale = match unit {
        "mm" => 1e-3,
        "m" => 1.0,
        _ => return None,
    };
    Some(Column::Coordinate { axis, scale })
}

/// Reads a table's file for a robot with `joints` joints.
///
/// # Errors
/// What the system or [`read_csv`] refuses.
pub fn read_csv_file(
    path: &Path,
    joints: usize,
    label: Option<&str>,
    places: &mut Labels,
) -> Result<Table, InputError> {
    let file = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| InputError::Read {
        file: file.clone(),
        source,
    })?;
    read_csv(&file, bytes.as_slice(), joints, label, places)
}

/// The separator of a header line: comma, semicolon or tab.
fn separator(text: &[u8]) -> u8 {
    let header = text
        .split(|b| *b == b'\n')
        .find(|line| !line.starts_with(b"#") && line.iter().any(|b| !b.is_ascii_whitespace()))
        .unwrap_or(&[]);
    let count = |sep: u8| String::from_utf8_lossy(header).matches(char::from(sep)).count();
    [b',', b';', b'\t']
        .into_iter()
        .rev()
        .max_by_key(|s| count(*s))
        .unwrap_or(b',')
}

/// Reads a table of poses for a robot with `joints` joints; `file` is for
/// messages, `label` names one further column that is allowed, `places` gives
/// numbers to the names of placements (and keeps those it has).
///
/// # Errors
/// The first column or cell that cannot be used, with its value and the remedy.
pub fn read_csv(
    file: &str,
    mut source: impl Read,
    joints: usize,
    label: Option<&str>,
    places: &mut Labels,
) -> Result<Table, InputError> {
    let mut bytes = Vec::new();
    source.read_to_end(&mut bytes).map_err(|source| InputError::Read {
        file: file.to_owned(),
        source,
    })?;
    // Line ends of Windows are made plain, so that lines are counted right.
    if bytes.contains(&b'\r') {
        let ends_line = |k: usize| bytes.get(k + 1) == Some(&b'\n');
        bytes = (0..bytes.len())
            .filter(|&k| bytes[k] != b'\r' || !ends_line(k))
            .map(|k| bytes[k])
            .collect();
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let mut reader = ::csv::ReaderBuilder::new()
        .delimiter(separator(text))
        .trim(::csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text);
    let syntax = |e: ::csv::Error| InputError::Syntax {
        file: file.to_owned(),
        message: format!("not a CSV table: {e}"),
    };
    let names: Vec<String> = reader
        .headers()
        .map_err(syntax)?
        .iter()
        .map(str::to_lowercase)
        .collect();
    let columns = header(file, &names, joints, label)?;
    let mut rows = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let record = record.map_err(syntax)?;
        let line = record.position().map_or(0, ::csv::Position::line);
        let cells = Cells {
            file,
            names: &names,
            columns: &columns,
            record: &record,
            row: index + 1,
            line,
        };
        rows.push(cells.row(joints, places)?);
    }
    if rows.is_empty() {
        return Err(InputError::Syntax {
            file: file.to_owned(),
            message: "holds no rows: give a header line and one row per pose".to_owned(),
        });
    }
    Ok(Table {
        file: file.to_owned(),
        rows,
    })
}

/// The columns of a header, complete and without doubles.
fn header(file: &str, names: &[String], joints: usize, label: Option<&str>) -> Result<Vec<Column>, InputError> {
    let refuse = |what: String, remedy: String| InputError::Columns {
        file: file.to_owned(),
        what,
        remedy,
    };
    let mut columns: Vec<Column> = Vec::with_capacity(names.len());
    for name in names {
        let kind = match column(name) {
            Some(kind) => kind,
            None if label.is_some_and(|l| l.to_lowercase() == *name) => Column::Label,
            None => {
                return Err(InputError::UnknownColumn {
                    file: file.to_owned(),
                    column: shown(name),
                    known: format!(
                        "q1..q{joints} or q1_deg.., tau1..tau{joints}, x_mm,y_mm,z_mm or x_m.., sphere, place, set"
                    ),
                });
            }
        };
        let twin = columns.iter().position(|c| same_place(c, &kind));
        if let Some(twin) = twin.and_then(|t| names.get(t)) {
            return Err(refuse(
                format!("columns \"{twin}\" and \"{name}\" say the same"),
                "keep one of them".to_owned(),
            ));
        }
        columns.push(kind);
    }
    let most = |of: fn(&Column) -> Option<usize>| columns.iter().filter_map(of).max().map_or(0, |j| j + 1);
    let found = most(|c| {
        if let Column::Angle { joint, .. } = c {
            Some(*joint)
        } else {
            None
        }
    });
    if found == 0 {
        return Err(refuse(
            "there are no joint columns".to_owned(),
            format!("name them q1..q{joints} (rad) or q1_deg..q{joints}_deg"),
        ));
    }
    let torques = most(|c| {
        if let Column::Torque { joint } = c {
            Some(*joint)
        } else {
            None
        }
    });
    for (count, what) in [(found, "q"), (torques, "tau")] {
        if count > joints {
            return Err(refuse(
                format!("there is a column {what}{count}, but the robot has {joints} joints"),
                "name the robot that these data are of, or remove the column".to_owned(),
            ));
        }
    }
    for j in 0..joints {
        if !columns
            .iter()
            .any(|c| matches!(c, Column::Angle { joint, .. } if *joint == j))
        {
            return Err(refuse(
                format!("column q{} is missing; the robot has {joints} joints", j + 1),
                "give every joint, or name the robot that these data are of".to_owned(),
            ));
        }
        if torques > 0 && !columns.contains(&Column::Torque { joint: j }) {
            return Err(refuse(
                format!("column tau{} is missing", j + 1),
                "give the torques of all joints or of none".to_owned(),
            ));
        }
    }
    let axes = columns
        .iter()
        .filter(|c| matches!(c, Column::Coordinate { .. }))
        .count();
    if axes > 0 && axes < 3 {
        return Err(refuse(
            "a measured point needs x, y and z".to_owned(),
            "give x_mm, y_mm and z_mm (or x_m, y_m and z_m)".to_owned(),
        ));
    }
    if axes == 0 && !columns.contains(&Column::Sphere) {
        return Err(refuse(
            "nothing says where the TCP was".to_owned(),
            "give x_mm,y_mm,z_mm (absolute data) or sphere (closed-loop data)".to_owned(),
        ));
    }
    Ok(columns)
}

/// Whether two columns would fill the same cell.
fn same_place(a: &Column, b: &Column) -> bool {
    match (a, b) {
        (Column::Angle { joint: i, .. }, Column::Angle { joint: j, .. })
        | (Column::Coordinate { axis: i, .. }, Column::Coordinate { axis: j, .. }) => i == j,
        _ => a == b,
    }
}

/// One record with what is needed to read it and to complain about it.
struct Cells<'a> {
    file: &'a str,
    names: &'a [String],
    columns: &'a [Column],
    record: &'a ::csv::StringRecord,
    row: usize,
    line: u64,
}

impl Cells<'_> {
    fn refuse(&self, column: usize, value: &str, remedy: &str) -> InputError {
        InputError::Cell {
            file: self.file.to_owned(),
            row: self.row,
            line: self.line,
            column: self.names.get(column).cloned().unwrap_or_default(),
            value: shown(value),
            remedy: remedy.to_owned(),
        }
    }

    /// A finite number, scaled, at most `largest` either way.
    fn number(&self, k: usize, text: &str, scale: f64, largest: f64, remedy: &str) -> Result<f64, InputError> {
        let value: f64 = text.parse().map_err(|_| {
            let hint = if text.contains(',') {
                "write a number with a decimal point"
            } else {
                "write a number"
            };
            self.refuse(k, text, hint)
        })?;
        if !value.is_finite() {
            return Err(self.refuse(k, text, "give a finite number, or leave the row out"));
        }
        let scaled = value * scale;
        if scaled.abs() > largest {
            return Err(self.refuse(k, text, remedy));
        }
        Ok(scaled)
    }

    fn row(&self, joints: usize, places: &mut Labels) -> Result<Row, InputError> {
        let mut q = vec![0.0; joints];
        let mut tau = vec![None; joints];
        let mut point = [None; 3];
        let mut out = Row {
            line: self.line,
            q: Vec::new(),
            tau: None,
            point: None,
            sphere: None,
            place: 0,
            set: None,
            label: None,
        };
        let mut place = "";
        for (k, kind) in self.columns.iter().enumerate() {
            let text = self.record.get(k).unwrap_or("");
            match kind {
                Column::Angle { joint, scale } => {
                    let remedy = if *scale == 1.0 {
                        "is over four turns: name the column with _deg if it is in degrees"
                    } else {
                        "is over four turns: check the unit"
                    };
                    if let Some(slot) = q.get_mut(*joint) {
                        *slot = self.number(k, text, *scale, 25.2, remedy)?;
                    }
                }
                Column::Torque { joint } if !text.is_empty() => {
                    if let Some(slot) = tau.get_mut(*joint) {
                        *slot = Some(self.number(k, text, 1.0, 1e5, "torques are in N m")?);
                    }
                }
                Column::Coordinate { axis, scale } if !text.is_empty() => {
                    let remedy = "is over 100 m: check the unit in the column's name (x_mm or x_m)";
                    if let Some(slot) = point.get_mut(*axis) {
                        *slot = Some(self.number(k, text, *scale, 100.0, remedy)?);
                    }
                }
                Column::Sphere if !text.is_empty() => {
                    let id = text
                        .parse::<u32>()
                        .map_err(|_| self.refuse(k, text, "a sphere is named by its integer id, such as 1"))?;
                    out.sphere = Some(id);
                }
                Column::Place => place = text,
                Column::Set if !text.is_empty() => {
                    out.set = Some(match text.to_lowercase().as_str() {
                        "calibrate" => Set::Calibrate,
                        "validate" => Set::Validate,
                        _ => return Err(self.refuse(k, text, "write calibrate or validate")),
                    });
                }
                Column::Label => out.label = Some(text.to_owned()),
                _ => {}
            }
        }
        out.q = q;
        if tau.iter().any(Option::is_some) {
            let all: Option<Vec<f64>> = tau.into_iter().collect();
            out.tau = Some(all.ok_or_else(|| self.incomplete("tau", "give the torques of all joints or of none"))?);
        }
        out.point = match point {
            [Some(x), Some(y), Some(z)] => Some([x, y, z]),
            [None, None, None] => None,
            _ => return Err(self.incomplete("x, y, z", "a measured point needs all three")),
        };
        if out.point.is_none() && out.sphere.is_none() {
            return Err(self.incomplete("sphere", "say where the TCP was: a sphere, or x, y and z"));
        }
        out.place = places.number(place);
        Ok(out)
    }

    /// Refusal of a row with something left empty.
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
}
