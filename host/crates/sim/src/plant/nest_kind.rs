//! What a nest is made of, and how it seats.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a nest seats its sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NestKind {
    /// Three steel planes with a magnet: a kinematic coupling, whose seats repeat to a micrometre
    /// (Hale and Slocum 2001, Precision Engineering 25, 114; Schouten et al. 1997, the same 20, 46).
    #[default]
    Steel,
    /// A printed socket, set by hand: 40 % of its couplings seat badly, by 50 µm and more, and the sphere finds another seat
    /// 0.3 times per rad of turning. The distribution of the residuals of a real iiwa 14 (`mukca_iiwa14.csv`).
    Socket,
}

/// The bad couplings of a nest: dirt between ball and pads, a ball that is not fully seated, a stand that yields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BadSeats {
    /// Their share.
    pub share: f64,
    /// Scale of their seats, each axis, in m. They are drawn from a Cauchy distribution and limited to 1 mm; half of the
    /// draws exceed the scale.
    pub scale_m: f64,
    /// Rate at which the sphere finds another seat while the nest turns about it, per rad of turning.
    pub per_rad: f64,
}

impl NestKind {
    /// Its bad couplings; `None` where there are none.
    pub fn bad_seats(self) -> Option<BadSeats> {
        match self {
            Self::Steel => None,
            Self::Socket => Some(BadSeats {
                share: 0.4,
                scale_m: 50e-6,
                per_rad: 0.3,
            }),
        }
    }
}
