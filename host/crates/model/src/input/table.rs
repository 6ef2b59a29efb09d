//! A table of poses in memory, column by column.
//!
//! A million rows of seven joints take about 100 MB: no row has memory of its own.

use std::collections::HashMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use crate::{Pose, Set, Target};

/// Names that were given to numbers in the order in which they appeared.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Labels {
    names: Vec<Arc<str>>,
    numbers: HashMap<Arc<str>, u32>,
}

impl Labels {
    /// The number of a name; a new name gets the next number.
    pub fn number(&mut self, name: &str) -> u32 {
        if let Some(number) = self.numbers.get(name) {
            return *number;
        }
        let number = u32::try_from(self.names.len()).unwrap_or(u32::MAX);
        let name: Arc<str> = name.into();
        self.names.push(Arc::clone(&name));
        self.numbers.insert(name, number);
        number
    }

    /// The name behind a number; empty for a number that was not given.
    pub fn name(&self, number: u32) -> &str {
        self.names.get(number as usize).map_or("", |name| name)
    }

    /// All names, in the order of their numbers.
    pub fn names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.names.iter().map(|name| &**name)
    }

    /// How many names there are.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }
}

/// A number that stands for none.
pub(super) const NONE: u32 = u32::MAX;

/// What a row has besides joints and further points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RowFields {
    /// Measured point, in m; NaN where there is none.
    pub(super) point: [f64; 3],
    pub(super) sphere: u32,
    pub(super) place: u32,
    pub(super) label: u32,
    pub(super) line: u32,
    pub(super) set: Option<Set>,
}

/// A whole table, in SI units; never empty.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Where it came from, for messages.
    pub file: String,
    /// Values of the label column, by the numbers of the rows.
    pub labels: Labels,
    pub(super) joints: usize,
    /// Points in a row where they are numbered, else 0.
    pub(super) numbered: usize,
    pub(super) q: Vec<f64>,
    /// Empty where the table has no torques; NaN where a row has none.
    pub(super) tau: Vec<f64>,
    /// Numbered points, three numbers each; NaN where one was not seen.
    pub(super) points: Vec<f64>,
    /// Quaternions w, x, y, z; empty where the table has none, NaN where a row has none.
    pub(super) orientations: Vec<f64>,
    pub(super) fields: Vec<RowFields>,
}

/// One row of a table, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableRow<'a> {
    /// Line of the file, from 1.
    pub line: u64,
    /// Joint angles, in rad.
    pub q: &'a [f64],
    /// Joint torques, in N m.
    pub tau: Option<&'a [f64]>,
    /// Measured point (or the position of a measured frame), in m.
    pub point: Option<[f64; 3]>,
    /// Sphere that the tool sat on.
    pub sphere: Option<u32>,
    /// Placement of the plate: number of its name in the caller's [`Labels`].
    pub place: u32,
    /// What the row may be used for, where the table says.
    pub set: Option<Set>,
    /// Value of the label column that the caller asked for: its number in [`Table::labels`].
    pub label: Option<u32>,
    /// Numbered points, three numbers each.
    points: &'a [f64],
    /// Quaternion of the measured frame.
    orientation: Option<&'a [f64]>,
}

/// Three numbers, unless one of them is NaN.
fn seen(point: &[f64]) -> Option<[f64; 3]> {
    match point {
        &[x, y, z] if !(x.is_nan() || y.is_nan() || z.is_nan()) => Some([x, y, z]),
        _ => None,
    }
}

/// The rotation of a unit quaternion w, x, y, z.
pub(super) fn rotation(w: f64, x: f64, y: f64, z: f64) -> Matrix3<f64> {
    let unit = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    unit.to_rotation_matrix().into_inner()
}

impl TableRow<'_> {
    /// Where the tool was: the frame, the points or the point where the row has one,
    /// else the sphere.
    pub fn target(&self) -> Target {
        match (self.orientation, self.point, self.sphere) {
            (Some(&[w, x, y, z]), Some(at), _) => Target::Frame(Box::new(Pose {
                rotation: rotation(w, x, y, z),
                position: Vector3::from(at),
            })),
            _ if !self.points.is_empty() && (self.sphere.is_none() || self.points.iter().any(|v| !v.is_nan())) => {
                Target::Points(self.points.chunks_exact(3).map(seen).collect())
            }
            (_, Some(at), _) => Target::Point(at),
            (_, None, sphere) => Target::Sphere {
                sphere: sphere.unwrap_or_default(),
                place: self.place,
            },
        }
    }
}

impl Table {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.fields.len()
    }

    /// Whether there are no rows; a table that was read has at least one.
    pub fn is_empty(&self) -> bool {
        self.fields.is_empty()
    }

    /// The rows in the file's order.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = TableRow<'_>> {
        fn part(all: &[f64], k: usize, width: usize) -> &[f64] {
            all.get(k * width..(k + 1) * width).unwrap_or_default()
        }
        let whole = |values: &&[f64]| !values.is_empty() && !values.iter().any(|v| v.is_nan());
        let number = |number: u32| (number != NONE).then_some(number);
        self.fields.iter().enumerate().map(move |(k, fields)| TableRow {
            line: u64::from(fields.line),
            q: part(&self.q, k, self.joints),
            tau: Some(part(&self.tau, k, self.joints)).filter(whole),
            point: seen(&fields.point),
            sphere: number(fields.sphere),
            place: fields.place,
            set: fields.set,
            label: number(fields.label),
            points: part(&self.points, k, 3 * self.numbered),
            orientation: Some(part(&self.orientations, k, 4)).filter(whole),
        })
    }
}
