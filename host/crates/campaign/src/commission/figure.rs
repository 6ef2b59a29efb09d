//! What a step measures, and whether it is within its limit.

use serde::{Deserialize, Serialize};

/// Whether a figure is within its limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judgement {
    /// It is.
    Within,
    /// It is not, or it is not a number.
    Beyond,
    /// It has no limit: it is for the person to read.
    Shown,
    /// It could not be measured.
    CannotTell,
}

/// A measured value with its unit and its limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// The value; none if it could not be measured.
    pub value: Option<f64>,
    /// Unit of value and limit.
    pub unit: String,
    /// Largest magnitude that is accepted; none if nothing is judged.
    pub limit: Option<f64>,
}

impl Figure {
    /// A value with the largest magnitude that is accepted.
    pub(crate) fn judged(name: impl Into<String>, value: f64, unit: &str, limit: f64) -> Self {
        Self {
            name: name.into(),
            value: Some(value),
            unit: unit.to_owned(),
            limit: Some(limit),
        }
    }

    pub(crate) fn shown(name: impl Into<String>, value: f64, unit: &str) -> Self {
        Self {
            name: name.into(),
            value: Some(value),
            unit: unit.to_owned(),
            limit: None,
        }
    }

    /// What could not be measured.
    pub(crate) fn unknown(name: impl Into<String>, unit: &str) -> Self {
        Self {
            name: name.into(),
            value: None,
            unit: unit.to_owned(),
            limit: None,
        }
    }

    /// Whether it is within its limit.
    pub fn judgement(&self) -> Judgement {
        match (self.value, self.limit) {
            (None, _) => Judgement::CannotTell,
            (Some(_), None) => Judgement::Shown,
            // A NaN is within no limit.
            (Some(value), Some(limit)) if value.abs() <= limit => Judgement::Within,
            _ => Judgement::Beyond,
        }
    }
}
