//! Joints that carry the base of a chain: a table of points is of one arm only while they rest.

use super::columns::TableFormat;
use super::header_names::{angle_unit, plain};

/// A joint that rests keeps its position to this (rad or m): servos hold to some mrad.
const STILL: f64 = 0.01;

/// A joint that carries the base of the chain, and how it moves in the rows.
#[derive(Clone, Debug)]
pub(super) struct Carrier {
    column: usize,
    pub(super) name: String,
    /// Its unit, in rad or m.
    scale: f64,
    /// Least and largest value so far, in its unit.
    range: Option<(f64, f64)>,
}

impl Carrier {
    pub(super) fn new(format: &TableFormat, column: usize, name: &str) -> Option<Self> {
        let lower = plain(name);
        let (stem, scale) = angle_unit(&lower);
        let is = |carrier: &String| [stem, lower.as_str()].contains(&plain(carrier).as_str());
        format.carriers.iter().any(is).then(|| Self {
            column,
            name: name.to_owned(),
            scale,
            range: None,
        })
    }

    /// Takes its value of a row.
    pub(super) fn see(&mut self, cells: &[String]) {
        let Some(value) = cells.get(self.column).and_then(|cell| decimal(cell)) else {
            return;
        };
        let (least, most) = self.range.unwrap_or((value, value));
        self.range = Some((value.min(least), value.max(most)));
    }

    /// Whether the base is elsewhere in some rows.
    pub(super) fn moves(&self) -> bool {
        self.range
            .is_some_and(|(least, most)| (most - least) * self.scale > STILL)
    }
}

/// A number with a decimal point or comma.
pub(super) fn decimal(cell: &str) -> Option<f64> {
    cell.parse().ok().or_else(|| cell.replacen(',', ".", 1).parse().ok())
}
