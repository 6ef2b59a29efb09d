//! A bounded map of what a calibration leaves: a displacement of the TCP that depends smoothly on the
//! tool's orientation, or on the joint angles, and that no parameter of the model describes.
//!
//! The map is a Gaussian process on the residual vectors of the calibration set. Its three
//! coordinates, in the tool's axes or in those of the base, share one kernel
//!
//! `k(x, y) = a² exp(−|x − y|² / (2 l²))`
//!
//! where `x` is the rotation matrix of the last frame of the table in F0 (`|x − y|` is the Frobenius norm, the chord
//! between two orientations: `2 √2 sin(θ/2)` for a turn by θ), or the vector of joint angles.
//! Far from its centres the correction falls to zero, and its uncertainty rises to `a`. Nowhere is
//! the correction longer than its bound.
//!
//! ```text
//! Calibration ─ samples ─▶ Samples ─ learn ─▶ ResidualMap ─ correction ─▶ shift, sigma
//! ```
//!
//! [`evaluate`](crate::evaluate()) decides by blocked cross-validation whether a map is kept.

mod learn;
mod share;
#[cfg(test)]
mod tests;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::Calibration;
use crate::flange::Flange;

pub(crate) use self::learn::{Samples, learn};
pub use self::share::MapShare;

/// Most centres of a map that is read: as many as a hundred megabytes of equations allow.
const MOST_CENTRES: usize = 2_000;

/// What a map depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapInput {
    /// The orientation of the tool in F0.
    Orientation,
    /// The joint angles.
    Joints,
}

impl MapInput {
    /// Both, in the order in which they are tried.
    pub const ALL: [Self; 2] = [Self::Orientation, Self::Joints];

    /// In words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Orientation => "the tool's orientation",
            Self::Joints => "the joint angles",
        }
    }
}

/// The axes in which a map displaces the TCP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapFrame {
    /// Those of the last frame of the robot's table, which turn with the tool.
    Tool,
    /// Those of F0.
    Base,
}

/// One pose that a map was learnt from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapCentre {
    /// Where it is: the nine numbers of the rotation matrix of the last frame of the table in F0, row by row; or
    /// the joint angles, base to flange, in rad.
    pub at: Vec<f64>,
    /// What it adds to the correction, in m, times `exp(−|x − at|² / (2 length²))`.
    pub weight_m: [f64; 3],
    /// Standard deviation of its residual's noise, each coordinate, in m.
    pub noise_m: f64,
}

/// The numbers of a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapData {
    /// What it depends on.
    pub input: MapInput,
    /// The axes of its correction.
    pub frame: MapFrame,
    /// Length of the kernel: a chord between orientations (no unit), or rad.
    pub length: f64,
    /// Standard deviation of each coordinate before the data, in m.
    pub amplitude_m: f64,
    /// The correction is nowhere longer than this, in m.
    pub bound_m: f64,
    /// The poses that it was learnt from.
    pub centres: Vec<MapCentre>,
}

/// Why the numbers of a map are none.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapError {
    /// A number that is not positive and finite.
    #[error("residual map: `{field}` is {value}: give a positive number")]
    Number {
        /// Which.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A centre that is not like the others, or not one of the map's input.
    #[error("residual map: centre {index} has {found} coordinates and {expected} are needed")]
    Centre {
        /// Its number, from 0.
        index: usize,
        /// Coordinates found.
        found: usize,
        /// Coordinates needed.
        expected: usize,
    },
    /// No centres, or too many.
    #[error("residual map: {found} centres: give 1 to {MOST_CENTRES}")]
    Count {
        /// Centres found.
        found: usize,
    },
    /// The covariance of the centres has no inverse.
    #[error("residual map: the covariance of the centres has no inverse: check `noise_m`, `amplitude_m` and `length`")]
    Singular,
}

/// A learnt map. It is written and read as its numbers ([`MapData`]).
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "MapData", into = "MapData")]
pub struct ResidualMap {
    data: MapData,
    /// Factor of the covariance of the centres' residuals, in units of the amplitude's square.
    factor: Cholesky<f64, Dyn>,
}

/// What a map says at one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// To be added to the predicted TCP, in m, axes of F0.
    pub shift_m: Vector3<f64>,
    /// Its standard deviation by the map, each coordinate, in m.
    pub sigma_m: f64,
}

impl TryFrom<MapData> for ResidualMap {
    type Error = MapError;

    fn try_from(data: MapData) -> Result<Self, MapError> {
        let positive = |field: &'static str, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(())
            } else {
                Err(MapError::Number { field, value })
            }
        };
        positive("length", data.length)?;
        positive("amplitude_m", data.amplitude_m)?;
        positive("bound_m", data.bound_m)?;
        let found = data.centres.len();
        if !(1..=MOST_CENTRES).contains(&found) {
            return Err(MapError::Count { found });
        }
        let expected = match data.input {
            MapInput::Orientation => 9,
            MapInput::Joints => data.centres.first().map_or(1, |c| c.at.len().max(1)),
        };
        for (index, centre) in data.centres.iter().enumerate() {
            positive("noise_m", centre.noise_m)?;
            let found = centre.at.len();
            if found != expected {
                return Err(MapError::Centre { index, found, expected });
            }
            for value in centre.at.iter().chain(&centre.weight_m).copied() {
                if !value.is_finite() {
                    return Err(MapError::Number {
                        field: "centres",
                        value,
                    });
                }
            }
        }
        let mut covariance = DMatrix::zeros(found, found);
        for (i, one) in data.centres.iter().enumerate() {
            for (j, other) in data.centres.iter().enumerate().take(i + 1) {
                covariance[(i, j)] = kernel(squared(&one.at, &other.at), data.length);
            }
            covariance[(i, i)] += (one.noise_m / data.amplitude_m).powi(2);
        }
        let factor = Cholesky::new(covariance).ok_or(MapError::Singular)?;
        Ok(Self { data, factor })
    }
}

impl From<ResidualMap> for MapData {
    fn from(map: ResidualMap) -> Self {
        map.data
    }
}

impl ResidualMap {
    /// Its numbers.
    pub fn data(&self) -> &MapData {
        &self.data
    }

    /// The correction of a calibration's TCP at encoder angles `q` (rad), axes of F0.
    pub fn correction(&self, calibration: &Calibration, q: &[f64]) -> Correction {
        self.at(&Flange::new(&calibration.robot).at(q).rotation, q)
    }

    /// TCP of a calibration in F0 with the correction, in m, at encoder angles `q` (rad) and, where
    /// the calibration uses them, measured torques (N m).
    pub fn corrected_m(&self, calibration: &Calibration, q: &[f64], tau: Option<&[f64]>) -> Vector3<f64> {
        calibration.tcp_m(q, tau) + self.shift(&Flange::new(&calibration.robot).at(q).rotation, q)
    }

    /// The same with the rotation of the last frame of the calibrated table in F0.
    pub(crate) fn at(&self, rotation: &Matrix3<f64>, q: &[f64]) -> Correction {
        Correction {
            shift_m: self.shift(rotation, q),
            sigma_m: self.sigma_m(&self.kernels(rotation, q)),
        }
    }

    /// The shift alone, which costs less.
    pub(crate) fn shift(&self, rotation: &Matrix3<f64>, q: &[f64]) -> Vector3<f64> {
        let kernels = self.kernels(rotation, q);
        let centres = kernels.iter().zip(&self.data.centres);
        let sum: Vector3<f64> = centres.map(|(k, c)| Vector3::from(c.weight_m) * *k).sum();
        let length = sum.norm();
        let bounded = if length > self.data.bound_m {
            sum * (self.data.bound_m / length)
        } else {
            sum
        };
        // The map is of predicted minus measured.
        match self.data.frame {
            MapFrame::Tool => -(rotation * bounded),
            MapFrame::Base => -bounded,
        }
    }

    /// Kernel between a pose and each centre, in units of the amplitude's square.
    pub(crate) fn kernels(&self, rotation: &Matrix3<f64>, q: &[f64]) -> DVector<f64> {
        let at = coordinates(self.data.input, rotation, q);
        let of = |c: &MapCentre| kernel(squared(&at, &c.at), self.data.length);
        DVector::from_iterator(self.data.centres.len(), self.data.centres.iter().map(of))
    }

    /// Part of the covariance of two poses, given their kernels to the centres, that the data take away; in units
    /// of the amplitude's square. One column a pose.
    pub(crate) fn explained(&self, kernels: &DMatrix<f64>) -> DMatrix<f64> {
        let mut half = kernels.clone();
        self.factor.l_dirty().solve_lower_triangular_mut(&mut half);
        half.tr_mul(&half)
    }

    /// Variance of the noise of a sound row over that of the residuals without the map.
    pub(crate) fn noise_share(&self) -> f64 {
        let noises = self.data.centres.iter().map(|c| c.noise_m);
        let sound = noises.fold(f64::INFINITY, f64::min);
        (sound * learn::BOUND / self.data.bound_m)
            .powi(2)
            .clamp(f64::MIN_POSITIVE, 1.0)
    }

    fn sigma_m(&self, kernels: &DVector<f64>) -> f64 {
        let column = DMatrix::from_columns(std::slice::from_ref(kernels));
        let left = 1.0 - self.explained(&column)[(0, 0)];
        self.data.amplitude_m * left.max(0.0).sqrt()
    }
}

/// Coordinates of a pose.
fn coordinates(input: MapInput, rotation: &Matrix3<f64>, q: &[f64]) -> Vec<f64> {
    match input {
        MapInput::Orientation => rotation.transpose().iter().copied().collect(),
        MapInput::Joints => q.to_vec(),
    }
}

fn squared(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum()
}

fn kernel(squared: f64, length: f64) -> f64 {
    (-0.5 * squared / length.powi(2)).exp()
}
