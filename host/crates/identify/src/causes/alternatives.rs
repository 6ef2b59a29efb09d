//! Causes that the score tests try: what each one is called, and its family.

use serde::{Deserialize, Serialize};

use crate::targets::Reference;

/// What was tested.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Alternative {
    /// One coordinate (0 x, 1 y, 2 z) of one sphere's certificate is wrong.
    Certificate {
        /// Id of the sphere.
        sphere: u32,
        /// Axis of the plate's frame.
        axis: usize,
    },
    /// The plate (or tracker) jumped.
    Slip {
        /// The frame that moved.
        reference: Reference,
        /// Share of the time after which it had moved.
        time: f64,
        /// Whether it turned as well.
        turned: bool,
    },
    /// The plate (or tracker) moved steadily.
    Drift {
        /// The frame that moved.
        reference: Reference,
    },
    /// One sphere moved between two couplings.
    SphereMoved {
        /// Id of the sphere.
        sphere: u32,
        /// Share of the time after which it had moved.
        time: f64,
    },
    /// One coupling sat elsewhere than the others on its sphere.
    Seat {
        /// Number of the coupling, from 0.
        coupling: usize,
    },
    /// The nest sat elsewhere on its sphere in some rows of one coupling that follow each other.
    Reseat {
        /// Number of the coupling, from 0.
        coupling: usize,
        /// First and last of the rows.
        rows: (usize, usize),
    },
    /// One encoder jumped.
    EncoderStep {
        /// Joint, from 0.
        joint: usize,
        /// Share of the time after which it had jumped.
        time: f64,
    },
    /// One encoder's zero moved steadily.
    EncoderDrift {
        /// Joint, from 0.
        joint: usize,
    },
    /// One joint is off in one part of its range.
    JointRegion {
        /// Joint, from 0.
        joint: usize,
        /// Lowest angle of the region, in rad.
        from_rad: f64,
        /// Highest angle of the region, in rad.
        to_rad: f64,
    },
    /// Angles that lag the last move: they were read before the arm was at rest.
    Lag {
        /// The joint, from 0; none where all lag alike.
        joint: Option<usize>,
    },
    /// One joint stands elsewhere after moves up and after moves down.
    Backlash {
        /// Joint, from 0.
        joint: usize,
    },
    /// What was measured at one place is off as a whole.
    Place {
        /// Number of the place.
        place: u32,
        /// The sphere that is off there; none for measured points.
        sphere: Option<u32>,
    },
    /// The load at the flange is another than was stated.
    Payload,
}

/// Families of alternatives: each is one check of the verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// Coordinates of the certificate.
    Certificate,
    /// Jumps of the plate or tracker.
    Slip,
    /// Steady motion of the plate or tracker.
    Drift,
    /// Spheres that moved.
    SphereMoved,
    /// Couplings that sat elsewhere.
    Seat,
    /// Jumps and drifts of encoders.
    Encoder,
    /// Joint regions.
    JointRegion,
    /// Readings before rest.
    Lag,
    /// Backlash by the direction of the last move.
    Backlash,
    /// Places that are off.
    Place,
    /// The load at the flange.
    Payload,
}

impl Family {
    /// Whether it is no error of the arm, whose sizes the model holds: something else was not where it should be.
    pub(crate) fn is_of_cell(self) -> bool {
        matches!(
            self,
            Self::Certificate | Self::Slip | Self::Drift | Self::SphereMoved | Self::Seat | Self::Place
        )
    }

    /// Whether it changes what is fitted: targets, or the load.
    pub(crate) fn is_of_inputs(self) -> bool {
        self.is_of_cell() || self == Self::Payload
    }
}

impl Alternative {
    /// Its family.
    pub fn family(&self) -> Family {
        match self {
            Self::Certificate { .. } => Family::Certificate,
            Self::Slip { .. } => Family::Slip,
            Self::Drift { .. } => Family::Drift,
            Self::SphereMoved { .. } => Family::SphereMoved,
            Self::Seat { .. } | Self::Reseat { .. } => Family::Seat,
            Self::EncoderStep { .. } | Self::EncoderDrift { .. } => Family::Encoder,
            Self::JointRegion { .. } => Family::JointRegion,
            Self::Lag { .. } => Family::Lag,
            Self::Backlash { .. } => Family::Backlash,
            Self::Place { .. } => Family::Place,
            Self::Payload => Family::Payload,
        }
    }

    /// Whether another differs in no more than instant or region.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Certificate { sphere: a, axis: x }, Self::Certificate { sphere: b, axis: y }) => a == b && x == y,
            (
                Self::Slip {
                    reference: a,
                    turned: x,
                    ..
                },
                Self::Slip {
                    reference: b,
                    turned: y,
                    ..
                },
            ) => a == b && x == y,
            (Self::Drift { reference: a }, Self::Drift { reference: b }) => a == b,
            (Self::SphereMoved { sphere: a, .. }, Self::SphereMoved { sphere: b, .. }) => a == b,
            (Self::Seat { coupling: a }, Self::Seat { coupling: b })
            | (Self::Reseat { coupling: a, .. }, Self::Reseat { coupling: b, .. }) => a == b,
            (Self::EncoderStep { joint: a, .. }, Self::EncoderStep { joint: b, .. })
            | (Self::EncoderDrift { joint: a }, Self::EncoderDrift { joint: b })
            | (Self::JointRegion { joint: a, .. }, Self::JointRegion { joint: b, .. })
            | (Self::Backlash { joint: a }, Self::Backlash { joint: b }) => a == b,
            (Self::Lag { joint: a }, Self::Lag { joint: b }) => a == b,
            (Self::Place { .. }, Self::Place { .. }) => self == other,
            (Self::Payload, Self::Payload) => true,
            _ => false,
        }
    }

    /// Whether another says the same of the cell to a reader: a plate that slips may turn, or not.
    pub(crate) fn says_the_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Slip { reference: a, .. }, Self::Slip { reference: b, .. }) => a == b,
            _ => self.is_like(other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a slip is named as what it cannot be told from, with another instant or with a turn, or if another frame's
    // slip, or another kind of cause, is not.
    #[test]
    fn a_cause_is_no_alternative_to_itself() {
        let slip = |place, time, turned| Alternative::Slip {
            reference: Reference::Place(place),
            time,
            turned,
        };
        let told = |other: &Alternative| slip(0, 0.3, true).says_the_same(other);
        assert!(told(&slip(0, 0.3, true)) && told(&slip(0, 0.7, true)) && told(&slip(0, 0.3, false)));
        assert!(!told(&slip(1, 0.3, true)) && !told(&Alternative::Payload));
        assert!(
            !slip(0, 0.3, true).is_like(&slip(0, 0.3, false)),
            "they are tested apart"
        );
    }
}
