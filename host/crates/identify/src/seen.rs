//! What a row measures: positions of targets on the tool, and the orientation of a measured body.

use nalgebra::{Matrix3, Vector3};

/// What three numbers of a row measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RowPart {
    /// Position of a target on the tool, numbered from 0: the TCP.
    Target(usize),
    /// Orientation of the measured body.
    Body,
}

/// A part of a row as it was measured, in the reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Seen {
    /// Position of a target, in m.
    Target {
        /// Number of the target, from 0.
        number: usize,
        /// Its position, in m.
        at: Vector3<f64>,
    },
    /// Orientation of the measured body.
    Body(Matrix3<f64>),
}

impl Seen {
    pub(crate) fn part(&self) -> RowPart {
        match *self {
            Self::Target { number, .. } => RowPart::Target(number),
            Self::Body(_) => RowPart::Body,
        }
    }
}
