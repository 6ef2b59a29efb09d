//! What a calibration is worth: the error of its TCP over a region, from the one posterior.
//!
//! A *region* is a set of postures. Draws from the posterior of all unknowns are differences between what may be true and
//! what was estimated; each gives one mean error over the region. Their mean is the expected error, their quantiles are its
//! interval. There are three regions:
//!
//! * *measured*: the rows' own postures. The error is that of further rows which are measured in the same way, with the noise
//!   of the instrument. What a row told of itself is taken out of its own prediction (leave one out, in closed form:
//!   `h (1 − h)⁻¹` with the row's leverage `h`).
//! * *work*: where the arm is to work. The error is that of the TCP in the robot's base frame, the best rigid motion taken
//!   out, because where the base stands is not the model's merit. The measured postures where nothing else is stated.
//! * *whole*: spread over all joint ranges. An extrapolation, as large as the data leave it.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix3, SymmetricEigen, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution as _, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;

use crate::dense::Factor;
use crate::hierarchy::constants::{AMONG, DRAWS, FEWEST_JUDGES, LARGEST_LEVERAGE, MODEL_ERROR, POSTURES};
use crate::recordings::{Judge, Recordings};
use crate::residuals::ResidualRow;
use crate::targets::{frame_of, reference_of};
use crate::workspace::{Rigid, stacked};
use crate::{Calibration, Experiment, Reference, Target, halton_configurations};

/// Error of the TCP to expect over a region, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
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

/// A source of the expected error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The certified coordinates of the spheres, by their stated uncertainty.
    Plate,
    /// Where the nest sits: scatter of each contact, and of each coupling as a whole.
    Seating,
    /// The instrument that measured points.
    Instrument,
    /// White errors of the joint angles: those of the recordings, and those of one pose in use.
    EncoderNoise,
    /// Parameters of the robot that the data leave open, by their priors.
    OpenParameters,
    /// What the model leaves out: the distance of a file's geometry from the full model.
    ModelDiscrepancy,
}

/// What a source contributes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BudgetTerm {
    /// The source.
    pub source: Source,
    /// Root mean square of the TCP's displacement over the work region by it alone, in mm.
    pub rms_mm: f64,
}

/// The expected error by source.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorBudget {
    /// Root mean square of the TCP's error over the work region, in mm: the standard uncertainty of a position.
    pub total_mm: f64,
    /// The sources that these data have. Their squares add up to that of the total.
    pub terms: Vec<BudgetTerm>,
}

/// A row of the data, as the statement needs it.
pub(crate) struct MeasuredRow<'a> {
    pub(crate) q: &'a [f64],
    pub(crate) reference: Reference,
    pub(crate) sphere: Option<u32>,
    /// Robust weight in the fit.
    pub(crate) weight: f64,
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
        weight: 1.0,
    };
    recordings.set_aside().map(row).collect()
}

/// The rows of an experiment that a calibration was made from.
pub(crate) fn measured_rows<'a>(experiment: &'a Experiment, calibration: &Calibration) -> Vec<MeasuredRow<'a>> {
    let row = |row: &ResidualRow| {
        let observation = experiment.observations.get(row.index)?;
        Some(MeasuredRow {
            q: &observation.q,
            reference: reference_of(&observation.target),
            sphere: match observation.target {
                Target::Sphere { sphere, .. } => Some(sphere),
                _ => None,
            },
            weight: row.weight,
        })
    };
    calibration.residual.rows.iter().filter_map(row).collect()
}

/// What is taken out of displacements before they count.
#[derive(Clone, Debug)]
enum Taken {
    /// The best rigid motion.
    Rigid(Rigid),
    /// The best rigid motion of another model; nothing of the draws, whose frame is that of the fit.
    RigidOfModels(Rigid),
    /// Of contacts the mean of the postures on each sphere and place: of the draws where the fit does not have the place.
    Means {
        unknown: Vec<Vec<usize>>,
        all: Vec<Vec<usize>>,
    },
}

impl Taken {
    fn of_draws(&self, columns: &mut DMatrix<f64>) {
        match self {
            Self::Rigid(rigid) => rigid.remove(columns),
            Self::RigidOfModels(_) => {}
            Self::Means { unknown, .. } => remove_means(unknown, columns),
        }
    }

    fn of_models(&self, columns: &mut DMatrix<f64>) {
        match self {
            Self::Rigid(rigid) | Self::RigidOfModels(rigid) => rigid.remove(columns),
            Self::Means { all, .. } => remove_means(all, columns),
        }
    }
}

fn remove_means(groups: &[Vec<usize>], columns: &mut DMatrix<f64>) {
    for mut column in columns.column_iter_mut() {
        for group in groups {
            for axis in 0..3 {
                let mean = group.iter().map(|k| column[3 * k + axis]).sum::<f64>() / group.len().max(1) as f64;
                group.iter().for_each(|k| column[3 * k + axis] -= mean);
            }
        }
    }
}

/// Draws of the error over a region.
#[derive(Clone, Debug)]
struct Region {
    q: Vec<Vec<f64>>,
    /// The estimated TCP at each posture, in F0 (m).
    tcp: Vec<Vector3<f64>>,
    /// True minus estimated, one draw a column (3n x draws, m, axes of F0).
    draws: DMatrix<f64>,
    taken: Taken,
    /// Columns of the free parameters, what is taken out (3n x m), and the mean square displacement by the joints' noise (m²).
    columns: DMatrix<f64>,
    joint_square: f64,
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
        let root = Root::of(&calibration.covariance)?;
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
        };
        let own_noise = if closed {
            calibration.noise.seating_m
        } else {
            calibration.noise.point_m
        };
        let seen = maker.left_out(spread(rows));
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
        ExpectedError {
            mean: mean * 1e3,
            p95: p95 * 1e3,
            interval: [quantile(&mut means, 0.025) * 1e3, quantile(&mut means, 0.975) * 1e3],
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
            (mean, quantile(&mut lengths, 0.95))
        };
        let all: Vec<(f64, f64)> = (0..region.draws.ncols()).into_par_iter().map(of).collect();
        let p95 = all.iter().map(|x| x.1).sum::<f64>() / all.len().max(1) as f64;
        (all.into_iter().map(|x| x.0).collect(), p95)
    }

    /// The error of a model over the work region by source, as a root mean square.
    pub fn budget_of(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64> + Sync) -> ErrorBudget {
        let count = self.work.q.len().max(1) as f64;
        let share = &self.work.columns * &self.covariance;
        let whole = share.component_mul(&self.work.columns).sum() / count;
        let (mut plate, mut seating, mut open) = (0.0, 0.0, 0.0);
        for (c, name) in self.kinds.iter().enumerate() {
            let own = share.column(c).norm_squared() * self.precision[c] / count;
            *if name.starts_with("sphere") {
                &mut plate
            } else if name.starts_with("seat") {
                &mut seating
            } else {
                &mut open
            } += own;
        }
        let noise = (whole - plate - seating - open).max(0.0);
        let joints = noise * self.joint_share + self.work.joint_square;
        let rest = noise * (1.0 - self.joint_share);
        let discrepancy = self.off(&self.work, &tcp_m).norm_squared() / count;
        let certified = self.kinds.iter().any(|name| name.starts_with("sphere"));
        let squares = [
            (certified, Source::Plate, plate),
            (self.contacts, Source::Seating, seating + rest),
            (!self.contacts, Source::Instrument, rest),
            (true, Source::EncoderNoise, joints),
            (true, Source::OpenParameters, open),
            (true, Source::ModelDiscrepancy, discrepancy),
        ];
        let there = squares.iter().filter(|s| s.0);
        ErrorBudget {
            total_mm: there.clone().map(|s| s.2).sum::<f64>().sqrt() * 1e3,
            terms: there
                .map(|&(_, source, square)| BudgetTerm {
                    source,
                    rms_mm: square.sqrt() * 1e3,
                })
                .collect(),
        }
    }
}

/// Makes the regions of one calibration from the same draws of its unknowns.
struct Maker<'a> {
    calibration: &'a Calibration,
    /// One draw a column.
    unknowns: &'a DMatrix<f64>,
    random: ChaCha8Rng,
    /// Degrees of freedom that the noise rests on.
    freedom: f64,
    rows: Seen,
}

/// Where the rows are in the space of the joints.
struct Seen {
    /// Postures in units of the spread of each joint.
    scaled: Vec<Vec<f64>>,
    spread: Vec<f64>,
    /// Squared distance to the nearest other row that [`AMONG`] of the rows keep.
    near: f64,
}

impl Seen {
    fn new(rows: &[MeasuredRow<'_>]) -> Self {
        let chosen: Vec<&[f64]> = spread(rows).map(|row| row.q).collect();
        let joints = chosen.first().map_or(0, |q| q.len());
        let of = |j: usize| {
            let values = || chosen.iter().map(|q| q[j]);
            let mean = values().sum::<f64>() / chosen.len().max(1) as f64;
            let variance = values().map(|q| (q - mean).powi(2)).sum::<f64>() / chosen.len().max(1) as f64;
            variance.sqrt().max(1e-2)
        };
        let spread: Vec<f64> = (0..joints).map(of).collect();
        let scaled: Vec<Vec<f64>> = chosen.iter().map(|q| scale(q, &spread)).collect();
        let own = |k: usize| {
            let others = scaled.iter().enumerate().filter(|(other, _)| *other != k);
            others.map(|(_, q)| square(q, &scaled[k])).fold(f64::INFINITY, f64::min)
        };
        let mut nearest: Vec<f64> = (0..scaled.len()).map(own).collect();
        Self {
            near: quantile(&mut nearest, AMONG),
            scaled,
            spread,
        }
    }

    /// Share of postures that are far from the rows.
    fn far(&self, postures: &[Posture]) -> f64 {
        let is_far = |p: &&Posture| {
            let own = scale(&p.q, &self.spread);
            p.factor.is_none() && self.scaled.iter().all(|q| square(q, &own) > self.near)
        };
        postures.iter().filter(is_far).count() as f64 / postures.len().max(1) as f64
    }
}

fn scale(q: &[f64], by: &[f64]) -> Vec<f64> {
    q.iter().zip(by).map(|(q, s)| q / s).collect()
}

fn square(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

impl Maker<'_> {
    /// The postures of rows that the fit has seen, each with what its own part in the fit is worth. Rows that alone
    /// determine an unknown, as the only one of a place does, tell nothing of their own prediction.
    fn left_out<'r>(&self, rows: impl Iterator<Item = &'r MeasuredRow<'r>>) -> Vec<Posture> {
        let rows: Vec<&MeasuredRow<'_>> = rows.collect();
        let own: Vec<(DMatrix<f64>, Vec<Vector3<f64>>)> = rows
            .par_iter()
            .map(|row| self.calibration.columns_at(row.q, Some((row.reference, row.sphere))))
            .collect();
        let mut columns = DMatrix::zeros(3 * rows.len(), self.unknowns.nrows());
        for (k, (block, _)) in own.iter().enumerate() {
            columns.rows_mut(3 * k, 3).copy_from(block);
        }
        let spread = &columns * &self.calibration.covariance;
        let posture = |(k, (row, (a, joints))): (usize, (&&MeasuredRow<'_>, &(DMatrix<f64>, Vec<Vector3<f64>>)))| {
            let g = a * spread.rows(3 * k, 3).transpose();
            let g = Matrix3::from_fn(|r, c| g[(r, c)]);
            let (factor, alone) = left_out(self.calibration, &g, joints, row)?;
            let posture = Posture {
                factor: Some(factor),
                ..Posture::of(row)
            };
            Some((posture, alone))
        };
        let all: Vec<(Posture, bool)> = rows.iter().zip(&own).enumerate().filter_map(posture).collect();
        let told = all.iter().filter(|(_, alone)| !alone).count();
        // Of few rows each determines something: then all count, as uncertain as the limit makes them.
        let few = 2 * told < all.len();
        all.into_iter()
            .filter(|(_, alone)| few || !alone)
            .map(|(posture, _)| posture)
            .collect()
    }

    /// The region of rows that are measured, with the noise of the instrument. A row in a frame that the fit does not have
    /// counts about the mean of its sphere.
    fn measured(&mut self, postures: &[Posture], own_noise: f64) -> Option<Region> {
        let closed = postures
            .iter()
            .any(|p| p.seen.is_some_and(|(_, sphere)| sphere.is_some()));
        let known = |p: &Posture| {
            p.seen
                .is_some_and(|(frame, _)| self.calibration.frames.iter().any(|f| f.reference == frame))
        };
        let mut groups: BTreeMap<(Reference, Option<u32>), Vec<usize>> = BTreeMap::new();
        for (k, p) in postures.iter().enumerate() {
            groups.entry(p.seen?).or_default().push(k);
        }
        let taken = if closed {
            Taken::Means {
                unknown: groups
                    .values()
                    .filter(|own| own.iter().any(|k| !known(&postures[*k])))
                    .cloned()
                    .collect(),
                all: groups.into_values().collect(),
            }
        } else if postures.iter().all(known) {
            Taken::RigidOfModels(self.rigid(postures))
        } else {
            Taken::Rigid(self.rigid(postures))
        };
        (postures.len() > 1).then(|| self.region(postures, taken, true, own_noise))
    }

    /// A region in the robot's base frame.
    fn aligned(&mut self, postures: Vec<Posture>) -> Region {
        let taken = Taken::Rigid(self.rigid(&postures));
        self.region(&postures, taken, false, 0.0)
    }

    fn rigid(&self, postures: &[Posture]) -> Rigid {
        let points: Vec<Vector3<f64>> = postures.iter().map(|p| self.calibration.tcp_m(&p.q, None)).collect();
        Rigid::new(&points)
    }

    /// Draws over postures; `frames` says whether the uncertainty of frames counts, `own_noise` is that of the
    /// instrument on each axis (m).
    fn region(&mut self, postures: &[Posture], taken: Taken, frames: bool, own_noise: f64) -> Region {
        let calibration = self.calibration;
        let noise = calibration.noise;
        let count = postures.len();
        let own: Vec<(DMatrix<f64>, Vec<Vector3<f64>>)> = postures
            .par_iter()
            .map(|p| calibration.columns_at(&p.q, p.seen.filter(|_| frames)))
            .collect();
        let mut columns = DMatrix::zeros(3 * count, self.unknowns.nrows());
        for (k, (block, _)) in own.iter().enumerate() {
            columns.rows_mut(3 * k, 3).copy_from(block);
        }
        let mut draws = &columns * self.unknowns;
        for (k, posture) in postures.iter().enumerate() {
            let Some(factor) = &posture.factor else { continue };
            for mut column in draws.column_iter_mut() {
                let v = factor * Vector3::new(column[3 * k], column[3 * k + 1], column[3 * k + 2]);
                (0..3).for_each(|axis| column[3 * k + axis] = v[axis]);
            }
        }
        let joint_square = own
            .iter()
            .flat_map(|(_, joints)| joints)
            .map(Vector3::norm_squared)
            .sum::<f64>()
            * noise.joint_rad.powi(2)
            / count.max(1) as f64;
        let chi = ChiSquared::new(self.freedom).ok();
        let tails = ChiSquared::new(noise.student_t).ok().filter(|_| noise.student_t > 0.0);
        for mut column in draws.column_iter_mut() {
            let common = chi.map_or(1.0, |c| (self.freedom / c.sample(&mut self.random).max(1e-9)).sqrt());
            for (k, (_, joints)) in own.iter().enumerate() {
                let tail = tails.map_or(1.0, |c| (noise.student_t / c.sample(&mut self.random).max(1e-9)).sqrt());
                let mut error = Vector3::from_fn(|_, _| normal(&mut self.random)) * own_noise;
                for joint in joints {
                    error += joint * (noise.joint_rad * normal(&mut self.random));
                }
                for axis in 0..3 {
                    column[3 * k + axis] += error[axis] * common * tail;
                }
            }
        }
        taken.of_draws(&mut draws);
        let [(mean, sigma), (far_mean, far_sigma)] = MODEL_ERROR;
        let far = self.rows.far(postures);
        let (mean, sigma) = (mean + far * (far_mean - mean), sigma + far * (far_sigma - sigma));
        for mut column in draws.column_iter_mut() {
            column *= (mean + sigma * normal(&mut self.random)).exp();
        }
        taken.of_draws(&mut columns);
        Region {
            tcp: postures.iter().map(|p| calibration.tcp_m(&p.q, None)).collect(),
            q: postures.iter().map(|p| p.q.clone()).collect(),
            draws,
            taken,
            columns,
            joint_square,
        }
    }
}

/// A posture of a region.
#[derive(Clone)]
struct Posture {
    q: Vec<f64>,
    /// Frame and sphere where it is measured.
    seen: Option<(Reference, Option<u32>)>,
    /// Turns the uncertainty of its prediction into that without the row itself.
    factor: Option<Matrix3<f64>>,
}

impl Posture {
    fn of(row: &MeasuredRow<'_>) -> Self {
        Self {
            seen: Some((row.reference, row.sphere)),
            ..Self::at(row.q)
        }
    }

    fn at(q: &[f64]) -> Self {
        Self {
            q: q.to_vec(),
            seen: None,
            factor: None,
        }
    }
}

/// At most [`POSTURES`] rows, spread evenly.
fn spread<'a, 'r>(rows: &'a [MeasuredRow<'r>]) -> impl Iterator<Item = &'a MeasuredRow<'r>> {
    rows.iter().step_by(rows.len().div_ceil(POSTURES).max(1))
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// What turns the uncertainty of a row's prediction into that without the row itself: `L (I − h)^(−1/2) L⁻¹`; `g` is the
/// uncertainty with it, `A P Aᵀ`. And whether the row alone determines an unknown.
fn left_out(
    calibration: &Calibration,
    g: &Matrix3<f64>,
    joints: &[Vector3<f64>],
    row: &MeasuredRow<'_>,
) -> Option<(Matrix3<f64>, bool)> {
    let noise = calibration.noise;
    let own = if row.sphere.is_some() {
        noise.seating_m
    } else {
        noise.point_m
    };
    let mut c = Matrix3::identity() * own.powi(2);
    for joint in joints {
        c += joint * joint.transpose() * noise.joint_rad.powi(2);
    }
    let l = (c / row.weight.max(1e-6)).cholesky()?.l();
    let inverse = l.try_inverse()?;
    let eigen = SymmetricEigen::new(inverse * g * inverse.transpose());
    let alone = eigen.eigenvalues.max() > LARGEST_LEVERAGE;
    let root = eigen
        .eigenvalues
        .map(|h| (1.0 - h.clamp(0.0, LARGEST_LEVERAGE)).powf(-0.5));
    let factor = l * eigen.eigenvectors * Matrix3::from_diagonal(&root) * eigen.eigenvectors.transpose() * inverse;
    Some((factor, alone))
}

/// A root of a covariance.
struct Root {
    scale: DVector<f64>,
    factor: Factor,
}

impl Root {
    /// `None` where the covariance is unknown.
    fn of(covariance: &DMatrix<f64>) -> Option<Self> {
        if covariance.is_empty() || covariance.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let scale = covariance.diagonal().map(|v| v.max(1e-300).sqrt());
        let m = scale.len();
        let mut a = DMatrix::from_fn(m, m, |r, c| covariance[(r, c)] / (scale[r] * scale[c]));
        (0..m).for_each(|i| a[(i, i)] += 1e-9);
        Some(Self {
            scale,
            factor: Factor::new(a)?,
        })
    }

    /// Draws with the covariance, one a column. Each draw has its mirror image, so that their mean is zero.
    fn draws(&self, random: &mut ChaCha8Rng) -> DMatrix<f64> {
        let m = self.scale.len();
        let white = DMatrix::from_fn(m, DRAWS / 2, |_, _| normal(random));
        let mut half = self.factor.times(&white);
        for (mut row, scale) in half.row_iter_mut().zip(self.scale.iter()) {
            row.scale_mut(*scale);
        }
        DMatrix::from_fn(m, DRAWS, |r, c| {
            if c % 2 == 0 {
                half[(r, c / 2)]
            } else {
                -half[(r, c / 2)]
            }
        })
    }
}

/// Quantile of values, between neighbours in proportion; sorts them.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else {
        return 0.0;
    };
    let at = share * last as f64;
    let (low, high) = (at.floor() as usize, at.ceil() as usize);
    values[low] + (values[high] - values[low]) * (at - low as f64)
}
