//! Units that the header says and the numbers contradict.
//!
//! One wrong value is a matter of its cell. Here the columns are looked at as a
//! whole: radians in a column of degrees are all small, degrees in a column of
//! radians are mostly beyond a turn. The error names the first such row.

use super::columns::{ColumnRole, TableHeader};
use super::error::InputError;
use super::table::Table;

/// Rows below which the numbers say too little.
const FEWEST: usize = 5;
/// Largest angle (rad) that joints reach, with a margin: 360 degrees.
const TURN_RAD: f64 = 6.5;

/// Checks a table's units.
/// Errors: angles or points whose numbers fit another unit only.
pub(super) fn check(table: &Table, header: &TableHeader) -> Result<(), InputError> {
    if table.len() < FEWEST {
        return Ok(());
    }
    let rad = |c: &ColumnRole| matches!(c, ColumnRole::Angle { scale, .. } if *scale == 1.0);
    let deg = |c: &ColumnRole| matches!(c, ColumnRole::Angle { scale, .. } if *scale != 1.0);
    if header.columns.iter().any(rad) {
        degrees_as_radians(table, header)?;
    }
    if header
        .columns
        .iter()
        .filter(|c| matches!(c, ColumnRole::Angle { .. }))
        .all(deg)
    {
        radians_as_degrees(table, header)?;
    }
    metres_as_millimetres(table, header)
}

/// The refusal of a value in row `k` (from 0).
fn refuse(table: &Table, header: &TableHeader, k: usize, column: usize, value: f64, remedy: String) -> InputError {
    InputError::Cell {
        file: table.file.clone(),
        row: k + 1,
        line: table.fields.get(k).map_or(0, |f| u64::from(f.line)),
        column: header.names.get(column).cloned().unwrap_or_default(),
        value: format!("{}", (value * 1e6).round() / 1e6),
        remedy,
    }
}

fn column_of(header: &TableHeader, joint: usize) -> usize {
    let found = |c: &ColumnRole| matches!(c, ColumnRole::Angle { joint: j, .. } if *j == joint);
    header.columns.iter().position(found).unwrap_or_default()
}

/// Most rows lie beyond a turn: these are degrees.
fn degrees_as_radians(table: &Table, header: &TableHeader) -> Result<(), InputError> {
    let rad = |joint: usize| {
        let role = header.columns.get(column_of(header, joint));
        matches!(role, Some(ColumnRole::Angle { scale, .. }) if *scale == 1.0)
    };
    let mut beyond = 0;
    let mut first = None;
    for (k, row) in table.rows().enumerate() {
        if let Some(joint) = row.q.iter().position(|q| q.abs() > TURN_RAD).filter(|j| rad(*j)) {
            beyond += 1;
            first.get_or_insert((k, joint, row.q[joint]));
        }
    }
    match first {
        Some((k, joint, value)) if 2 * beyond > table.len() => Err(refuse(
            table,
            header,
            k,
            column_of(header, joint),
            value,
            format!(
                "{beyond} of {} rows are beyond a full turn: name the columns q1_deg.. if these are degrees",
                table.len()
            ),
        )),
        _ => Ok(()),
    }
}

/// All angles lie within a turn's worth of radians: these are radians.
fn radians_as_degrees(table: &Table, header: &TableHeader) -> Result<(), InputError> {
    let largest = table.q.iter().fold(0.0_f64, |most, q| most.max(q.abs())).to_degrees();
    let at = table
        .q
        .iter()
        .position(|q| q.to_degrees().abs() == largest)
        .unwrap_or_default();
    if !(0.5..=TURN_RAD).contains(&largest) {
        return Ok(());
    }
    let (k, joint) = (at / table.joints.max(1), at % table.joints.max(1));
    Err(refuse(
        table,
        header,
        k,
        column_of(header, joint),
        table.q[at].to_degrees(),
        format!(
            "no angle of the table is beyond {largest:.2} degrees: name the columns q1.. if these are radians (or give \
             the few degrees in radians)"
        ),
    ))
}

/// All points lie within 10 mm of the origin, in columns of mm: these are metres.
fn metres_as_millimetres(table: &Table, header: &TableHeader) -> Result<(), InputError> {
    let mm = |c: &ColumnRole| matches!(c, ColumnRole::Coordinate { scale, .. } if *scale == 1e-3);
    let Some(column) = header.columns.iter().position(mm) else {
        return Ok(());
    };
    let points = table
        .fields
        .iter()
        .flat_map(|f| f.point)
        .chain(table.points.iter().copied());
    let mut largest = 0.0_f64;
    let mut first = None;
    for value in points.filter(|v| !v.is_nan()) {
        first.get_or_insert(value * 1e3);
        largest = largest.max(value.abs() * 1e3);
    }
    // All zero is one point in its own frame; a robot's workspace is wider than 10 mm.
    if !(0.05..=10.0).contains(&largest) {
        return Ok(());
    }
    Err(refuse(
        table,
        header,
        0,
        column,
        first.unwrap_or_default(),
        format!("no coordinate of the table is beyond {largest:.3} mm: name the columns x_m.. if these are metres"),
    ))
}
