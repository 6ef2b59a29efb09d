//! Learns a map from the residuals of a fit.
//!
//! Length and amplitude have the largest marginal likelihood on a grid; the noise follows from both in
//! closed form. A map that does not win against plain noise by [`GAIN`] is no map: a process without an
//! amplitude corrects nothing.

use nalgebra::{Cholesky, DMatrix, Matrix3, Vector3};

use super::{MapCentre, MapData, MapFrame, MapInput, ResidualMap, coordinates, kernel, squared};
use crate::flange::Flange;
use crate::residuals::OUTLIER_SIGMAS;
use crate::targets::reference_of;
use crate::{Calibration, Experiment};

/// Most centres. Where there are more rows, they are thinned evenly in the order of measurement: the time grows
/// with the cube of the centres.
pub(super) const CENTRES: usize = 300;
/// Fewest residuals that a map is learnt from.
const FEWEST: usize = 20;
/// Lengths that are tried: chords between orientations (turns by about 29, 41, 59, 90, 163 degrees and more).
const CHORDS: [f64; 6] = [0.7, 1.0, 1.4, 2.0, 2.8, 4.0];
/// Lengths that are tried for joints, in rad.
const ANGLES: [f64; 6] = [0.5, 0.8, 1.3, 2.0, 3.2, 5.0];
/// Squares of the amplitude over that of the noise that are tried.
const RATIOS: [f64; 6] = [0.03, 0.1, 0.3, 1.0, 3.0, 10.0];
/// Log marginal likelihood that a map must win by: it has three numbers and a choice of axes.
const GAIN: f64 = 6.0;
/// The bound, as a multiple of the root mean square of the residuals' coordinates.
pub(super) const BOUND: f64 = 3.0;

/// One residual of a calibration.
pub(super) struct MapSample {
    /// Last frame of the calibrated table in F0.
    pub(super) rotation: Matrix3<f64>,
    /// Joint angles, in rad.
    pub(super) q: Vec<f64>,
    /// Predicted minus measured TCP, in m, axes of F0.
    pub(super) residual: Vector3<f64>,
    /// Variance of its noise over that of a sound row.
    pub(super) noise: f64,
}

/// Residuals of a calibration's own rows, without its outliers and at most [`CENTRES`].
pub(crate) struct Samples(pub(super) Vec<MapSample>);

impl Samples {
    /// Of a calibration of this experiment.
    pub(crate) fn of(calibration: &Calibration, experiment: &Experiment) -> Self {
        let flange = Flange::new(&calibration.robot);
        let rows = &calibration.residual.rows;
        let step = rows.len().div_ceil(CENTRES).max(1);
        let sound = rows.iter().step_by(step).filter(|row| row.deviation <= OUTLIER_SIGMAS);
        let sample = sound.filter_map(|row| {
            let observation = experiment.observations.get(row.index)?;
            let reference = reference_of(&observation.target);
            let frame = calibration.frames.iter().find(|f| f.reference == reference)?;
            Some(MapSample {
                rotation: flange.at(&observation.q).rotation,
                q: observation.q.clone(),
                residual: frame.base.rotation.tr_mul(&Vector3::from(row.error_mm)) * 1e-3,
                noise: (1.0 / row.weight).max(1.0),
            })
        });
        Self(sample.collect())
    }

    /// Residuals (m) in the axes of the map, one row a sample.
    fn residuals(&self, frame: MapFrame) -> DMatrix<f64> {
        let mut all = DMatrix::zeros(self.0.len(), 3);
        for (mut row, sample) in all.row_iter_mut().zip(&self.0) {
            let own = match frame {
                MapFrame::Tool => sample.rotation.tr_mul(&sample.residual),
                MapFrame::Base => sample.residual,
            };
            row.copy_from(&own.transpose());
        }
        all
    }

    /// Root mean square of a coordinate, in m: of each row as far as it counts.
    fn rms_m(&self) -> f64 {
        let sum: f64 = self.0.iter().map(|s| s.residual.norm_squared() / s.noise).sum();
        let count: f64 = self.0.iter().map(|s| 3.0 / s.noise).sum();
        (sum / count.max(1.0)).sqrt()
    }
}

/// The best map so far.
struct Best {
    likelihood: f64,
    length: f64,
    ratio: f64,
    frame: MapFrame,
    /// Of the noise of a sound row, in m².
    variance: f64,
    /// Inverse of the covariance, in units of that variance, times the residuals.
    solved: DMatrix<f64>,
}

/// Log marginal likelihood, the noise at its best; and the noise variance. `square` is the sum of the
/// whitened squares, `log_determinant` that of the covariance in units of the noise.
fn likelihood(square: f64, log_determinant: f64, count: usize) -> (f64, f64) {
    let numbers = 3.0 * count as f64;
    let variance = (square / numbers).max(f64::MIN_POSITIVE);
    (-0.5 * numbers * variance.ln() - 1.5 * log_determinant, variance)
}

/// The map of these residuals; none where they speak for none.
pub(crate) fn learn(input: MapInput, samples: &Samples) -> Option<ResidualMap> {
    let n = samples.0.len();
    if n < FEWEST {
        return None;
    }
    let at: Vec<Vec<f64>> = samples
        .0
        .iter()
        .map(|s| coordinates(input, &s.rotation, &s.q))
        .collect();
    let apart = DMatrix::from_fn(n, n, |i, j| if j <= i { squared(&at[i], &at[j]) } else { 0.0 });
    let residuals = [MapFrame::Tool, MapFrame::Base].map(|frame| (frame, samples.residuals(frame)));
    let squares = samples.0.iter().map(|s| s.residual.norm_squared() / s.noise);
    let noises = samples.0.iter().map(|s| s.noise.ln());
    let (none, _) = likelihood(squares.sum(), noises.sum(), n);
    let mut best: Option<Best> = None;
    for length in match input {
        MapInput::Orientation => CHORDS,
        MapInput::Joints => ANGLES,
    } {
        let shape = apart.map(|squared| kernel(squared, length));
        for ratio in RATIOS {
            let mut covariance = &shape * ratio;
            for (i, sample) in samples.0.iter().enumerate() {
                covariance[(i, i)] += sample.noise;
            }
            let Some(factor) = Cholesky::new(covariance) else {
                continue;
            };
            let log_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
            for (frame, residuals) in &residuals {
                let solved = factor.solve(residuals);
                let (likelihood, variance) = likelihood(residuals.dot(&solved), log_determinant, n);
                if best.as_ref().is_none_or(|best| likelihood > best.likelihood) {
                    best = Some(Best {
                        likelihood,
                        length,
                        ratio,
                        frame: *frame,
                        variance,
                        solved,
                    });
                }
            }
        }
    }
    let best = best.filter(|best| best.likelihood > none + GAIN)?;
    let centres = at.into_iter().zip(&samples.0).zip(best.solved.row_iter());
    let centres = centres.map(|((at, sample), solved)| MapCentre {
        at,
        weight_m: [0, 1, 2].map(|axis| best.ratio * solved[axis]),
        noise_m: (best.variance * sample.noise).sqrt(),
    });
    let data = MapData {
        input,
        frame: best.frame,
        length: best.length,
        amplitude_m: (best.ratio * best.variance).sqrt(),
        bound_m: BOUND * samples.rms_m(),
        centres: centres.collect(),
    };
    ResidualMap::try_from(data).ok()
}
