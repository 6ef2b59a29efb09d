//! Causes that the score tests try: what each one is called, and its family.

use serde::{Deserialize, Serialize};

use crate::parameters::Reference;

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
    /// All distances of the certificate are wrong by one factor.
    CertificateScale,
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
}

/// Families of alternatives: each is one check of the verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// Coordinates of the certificate.
    Certificate,
    /// The certificate's scale.
    CertificateScale,
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
}

impl Alternative {
    /// Its family.
    pub fn family(&self) -> Family {
        match self {
            Self::Certificate { .. } => Family::Certificate,
            Self::CertificateScale => Family::CertificateScale,
            Self::Slip { .. } => Family::Slip,
            Self::Drift { .. } => Family::Drift,
            Self::SphereMoved { .. } => Family::SphereMoved,
            Self::Seat { .. } => Family::Seat,
            Self::EncoderStep { .. } | Self::EncoderDrift { .. } => Family::Encoder,
            Self::JointRegion { .. } => Family::JointRegion,
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
            (Self::Seat { coupling: a }, Self::Seat { coupling: b }) => a == b,
            (Self::EncoderStep { joint: a, .. }, Self::EncoderStep { joint: b, .. })
            | (Self::EncoderDrift { joint: a }, Self::EncoderDrift { joint: b })
            | (Self::JointRegion { joint: a, .. }, Self::JointRegion { joint: b, .. }) => a == b,
            (Self::CertificateScale, Self::CertificateScale) => true,
            _ => false,
        }
    }
}
