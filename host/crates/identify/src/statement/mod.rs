//! What a calibration is worth: the error of its TCP over a region, from the one posterior.
//!
//! A *region* is a set of postures. Draws from the posterior of all unknowns are differences between what may be true and
//! what was estimated; each gives one mean error over the region. Their mean is the expected error, their quantiles are its
//! interval. There are three regions:
//!
//! * *measured*: the rows' own postures. The error is that of further rows which are measured in the same way, with the noise
//!   of the instrument, and with what moved in the cell meanwhile. What a row told of itself is taken out of its own prediction
//!   (leave one out, in closed form: `h (1 − h)⁻¹` with the row's leverage `h`).
//! * *work*: where the arm is to work. The error is that of the TCP in the robot's base frame, the best rigid motion taken
//!   out, because where the base stands is not the model's merit. The measured postures where nothing else is stated.
//! * *whole*: spread over all joint ranges. An extrapolation, as large as the data leave it.

mod budget;
mod region;
mod taken;
#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use spherecal_model::statistics::quantile;

pub use self::budget::{BudgetTerm, ErrorBudget, Source};
use self::region::{Maker, Posture, Region, Root, Seen, displaced, left_out, spread};
use crate::hierarchy::LeftOut;
use crate::hierarchy::constants::{FEWEST_JUDGES, POSTURES};
use crate::recordings::{Judge, Recordings};
use crate::residuals::ResidualRow;
use crate::targets::{Reference, frame_of, reference_of};
use crate::workspace::stacked;
use crate::{Calibration, Experiment, Target, halton_configurations};

/// Error of the TCP to expect over a region, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ExpectedError {
    /// Mean over the region.
    pub mean: f64,
    /// 95 % of the region has an error below this.
    pub p95: f64,
    /// 95 % interval of the mean.
    pub interval: [f64; 2],
}

/// The same over each region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ExpectedErrors {
    /// The work region.
    #[serde(flatten)]
    pub work: ExpectedError,
    /// The postures of the data, with the noise of the instrument.
    pub measured: ExpectedError,
    /// The whole range of the joints.
    pub whole: ExpectedError,
}

impl std::ops::Deref for ExpectedErrors {
    type Target = ExpectedError;

    fn deref(&self) -> &ExpectedError {
        &self.work
    }
}

/// A row of the data, as the statement needs it.
pub(crate) struct MeasuredRow<'a> {
    pub(crate) q: &'a [f64],
    pub(crate) reference: Reference,
    pub(crate) sphere: Option<u32>,
    /// The row left out of its own prediction, where the fit has it.
    pub(crate) left_out: Option<LeftOut>,
    /// How far named causes in the cell displaced it, in m in F0.
    pub(crate) displaced: Vector3<f64>,
}

/// The rows that judge a result.
pub(crate) fn judging_rows<'a>(recordings: &'a Recordings, closed_loop: bool) -> Vec<MeasuredRow<'a>> {
    let row = |judge: Judge<'a>| MeasuredRow {
        q: &judge.observation.q,
        reference: frame_of(&judge.observation.target, judge.place, closed_loop),
        sphere: match judge.observation.target {
            Target::Sphere { sphere, .. } => Some(sphere),
            _ => None,
        },
        left_out: None,
        displaced: Vector3::zeros(),
    };
    recordings.set_aside().map(row).collect()
}

/// The rows of an experiment that a calibration was made from.
pub(crate) fn measured_rows<'a>(experiment: &'a Experiment, calibration: &Calibration) -> Vec<MeasuredRow<'a>> {
    let row = |row: &ResidualRow| {
        let observation = experiment.observations.get(row.index)?;
        let reference = reference_of(&observation.target);
        let frame = calibration.frames.iter().find(|frame| frame.reference == reference);
        let displaced = calibration.displaced.get(&row.index).zip(frame);
        Some(MeasuredRow {
            q: &observation.q,
            reference,
            sphere: match observation.target {
                Target::Sphere { sphere, .. } => Some(sphere),
                _ => None,
            },
            left_out: calibration.left_out.get(&row.index).copied(),
            displaced: displaced.map_or_else(Vector3::zeros, |(moved, frame)| frame.base.rotation.tr_mul(moved)),
        })
    };
    calibration.residual.rows.iter().filter_map(row).collect()
}

/// The error of a calibration, and of any other model of the same arm, over each region.
#[derive(Clone, Debug)]
pub struct Statement {
    work: Region,
    measured: Region,
    whole: Region,
    /// Posterior covariance, prior precision and kind of each free parameter.
    covariance: DMatrix<f64>,
    precision: Vec<f64>,
    kinds: Vec<String>,
    /// Share of the rows' noise that is the joints', and whether rows are contacts or points.
    joint_share: f64,
    contacts: bool,
}

impl Statement {
    /// Of a calibration from `rows`. The measured region is that of `judges` where there are any; the work region is
    /// `work` (rad), or the postures of the rows. `None` where the covariance is unknown.
    pub(crate) fn new(
        calibration: &Calibration,
        rows: &[MeasuredRow<'_>],
        judges: &[MeasuredRow<'_>],
        work: Option<&[Vec<f64>]>,
    ) -> Option<Self> {
        let root = Root::of(&calibration.cross.covariance)?;
        let closed = rows.iter().any(|row| row.sphere.is_some());
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let unknowns = root.draws(&mut random);
        let freedom = (3.0 * rows.len() as f64 - calibration.effective_parameters).max(3.0);
        let mut maker = Maker {
            calibration,
            unknowns: &unknowns,
            random,
            freedom,
            rows: Seen::new(rows),
            displaced: displaced(rows),
        };
        let own_noise = if closed {
            calibration.noise.seating_m
        } else {
            calibration.noise.point_m
        };
        let seen = left_out(rows);
        let judging: Vec<Posture> = spread(judges).map(Posture::of).collect();
        let measured = maker.measured(if judging.len() < FEWEST_JUDGES { &seen } else { &judging }, own_noise)?;
        let work = match work {
            Some(q) => maker.aligned(q.iter().map(|q| Posture::at(q)).collect()),
            None => maker.aligned(seen),
        };
        let everywhere = halton_configurations(&calibration.robot, POSTURES / 2);
        let whole = maker.aligned(everywhere.iter().map(|q| Posture::at(q)).collect());
        let free = || calibration.parameters.iter().filter(|p| p.free);
        let joint = measured.joint_square;
        Some(Self {
            work,
            measured,
            whole,
            covariance: calibration.covariance.clone(),
            precision: free().map(|p| p.prior_sigma.powi(-2)).collect(),
            kinds: free().map(|p| p.name.clone()).collect(),
            joint_share: joint / (joint + 3.0 * own_noise.powi(2)).max(1e-300),
            contacts: closed,
        })
    }

    /// The postures of the work region, in rad.
    pub fn work_postures(&self) -> &[Vec<f64>] {
        &self.work.q
    }

    /// The expected error of a model; `tcp_m` gives its TCP in its own F0 (m) at joint angles (rad).
    pub fn expected_errors_of(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64> + Sync) -> ExpectedErrors {
        let of = |region: &Region| self.summary(region, &tcp_m);
        ExpectedErrors {
            work: of(&self.work),
            measured: of(&self.measured),
            whole: of(&self.whole),
        }
    }

    /// The same over the work region alone.
    pub fn expected_error_of(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64> + Sync) -> ExpectedError {
        self.summary(&self.work, &tcp_m)
    }

    /// Probability that a model's mean error over the work region is below `limit_mm`.
    pub fn probability_below(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64> + Sync, limit_mm: f64) -> f64 {
        let means = self.means(&self.work, &tcp_m).0;
        means.iter().filter(|m| **m * 1e3 < limit_mm).count() as f64 / means.len().max(1) as f64
    }

    /// Probability that one model's mean error over the work region is below another's.
    pub fn probability_better(
        &self,
        model_m: impl Fn(&[f64]) -> Vector3<f64> + Sync,
        than_m: impl Fn(&[f64]) -> Vector3<f64> + Sync,
    ) -> f64 {
        let (own, other) = (self.means(&self.work, &model_m).0, self.means(&self.work, &than_m).0);
        own.iter().zip(&other).filter(|(a, b)| a < b).count() as f64 / own.len().max(1) as f64
    }

    fn summary(&self, region: &Region, tcp_m: &(impl Fn(&[f64]) -> Vector3<f64> + Sync)) -> ExpectedError {
        let (mut means, p95) = self.means(region, tcp_m);
        let mean = means.iter().sum::<f64>() / means.len().max(1) as f64;
        means.sort_unstable_by(f64::total_cmp);
        ExpectedError {
            mean: mean * 1e3,
            p95: p95 * 1e3,
            interval: [quantile(&means, 0.025) * 1e3, quantile(&means, 0.975) * 1e3],
        }
    }

    /// A model's TCP minus the estimate's, without the motion that does not count.
    fn off(&self, region: &Region, tcp_m: &(impl Fn(&[f64]) -> Vector3<f64> + Sync)) -> DMatrix<f64> {
        let pairs = region.q.iter().zip(&region.tcp);
        let moved: Vec<Vector3<f64>> = pairs.map(|(q, tcp)| tcp_m(q) - tcp).collect();
        let mut off = stacked(&moved);
        region.taken.of_models(&mut off);
        off
    }

    /// Mean error (m) by draw, and the mean of the draws' 95 % quantiles.
    fn means(&self, region: &Region, tcp_m: &(impl Fn(&[f64]) -> Vector3<f64> + Sync)) -> (Vec<f64>, f64) {
        let off = self.off(region, tcp_m);
        let of = |c: usize| {
            let column = region.draws.column(c);
            let length = |k: usize| {
                let at = |axis: usize| column[3 * k + axis] - off[3 * k + axis];
                Vector3::new(at(0), at(1), at(2)).norm()
            };
            let mut lengths: Vec<f64> = (0..region.q.len()).map(length).collect();
            let mean = lengths.iter().sum::<f64>() / lengths.len().max(1) as f64;
            lengths.sort_unstable_by(f64::total_cmp);
            (mean, quantile(&lengths, 0.95))
        };
        let all: Vec<(f64, f64)> = (0..region.draws.ncols()).into_par_iter().map(of).collect();
        let p95 = all.iter().map(|x| x.1).sum::<f64>() / all.len().max(1) as f64;
        (all.into_iter().map(|x| x.0).collect(), p95)
    }
}
