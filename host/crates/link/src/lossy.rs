//! How bad a host link is, and what it did to frames: plain data of configurations and records. What makes a link bad is in
//! `spherecal-sim`.

use serde::{Deserialize, Serialize};

/// Quality of a host link: what happens to a frame in either direction, each with its own
/// probability. All zero is a perfect link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Lossy {
    /// Probability that a frame is lost.
    pub loss: f64,
    /// Probability that a frame comes twice.
    pub duplication: f64,
    /// Probability that a frame is overtaken by those behind it.
    pub reorder: f64,
    /// Probability that one bit of a frame is flipped.
    pub bit_flip: f64,
    /// Seed of the draws.
    pub seed: u64,
}

/// A number of [`Lossy`] that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{field} is {value}: give a probability from 0 to 0.9")]
pub struct LossyError {
    /// Field.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
}

impl Lossy {
    /// Whether anything happens to frames at all.
    pub fn is_active(&self) -> bool {
        [self.loss, self.duplication, self.reorder, self.bit_flip]
            .iter()
            .any(|p| *p != 0.0)
    }

    /// Checks the probabilities.
    ///
    /// # Errors
    /// The first that is not a probability, or that would block the link.
    pub fn check(&self) -> Result<(), LossyError> {
        let fields = [
            ("loss", self.loss),
            ("duplication", self.duplication),
            ("reorder", self.reorder),
            ("bit_flip", self.bit_flip),
        ];
        match fields.into_iter().find(|(_, p)| !(0.0..=0.9).contains(p)) {
            Some((field, value)) => Err(LossyError { field, value }),
            None => Ok(()),
        }
    }
}

/// What was done to the frames of both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Injected {
    /// Frames that were given to the link.
    pub frames: u64,
    /// Of those, lost.
    pub lost: u64,
    /// Sent twice.
    pub duplicated: u64,
    /// Held back.
    pub reordered: u64,
    /// With a flipped bit.
    pub flipped: u64,
}

impl Injected {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Self {
            frames: self.frames.saturating_add(other.frames),
            lost: self.lost.saturating_add(other.lost),
            duplicated: self.duplicated.saturating_add(other.duplicated),
            reordered: self.reordered.saturating_add(other.reordered),
            flipped: self.flipped.saturating_add(other.flipped),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_probability_is_refused() {
        for bad in [f64::NAN, -0.1, 1.5] {
            let config = Lossy {
                bit_flip: bad,
                ..Lossy::default()
            };
            let refusal = config.check().expect_err("refused").to_string();
            assert!(refusal.contains("bit_flip") && refusal.contains("0.9"), "{refusal}");
        }
        assert!(
            Lossy {
                loss: 0.2,
                ..Lossy::default()
            }
            .check()
            .is_ok()
        );
    }
}
