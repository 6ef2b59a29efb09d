//! The regions of a statement: postures with draws of the error of the TCP at each.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::seq::IndexedRandom as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution as _, StandardNormal};
use rayon::prelude::*;

use spherecal_model::statistics::quantile;

use super::MeasuredRow;
use super::taken::Taken;
use crate::dense::Factor;
use crate::hierarchy::constants::{AMONG, DRAWS, MODEL_ERROR, POSTURES};
use crate::workspace::Rigid;
use crate::{Calibration, Reference};

/// Draws of the error over a region.
#[derive(Clone, Debug)]
pub(super) struct Region {
    pub(super) q: Vec<Vec<f64>>,
    /// The estimated TCP at each posture, in F0 (m).
    pub(super) tcp: Vec<Vector3<f64>>,
    /// True minus estimated, one draw a column (3n x draws, m, axes of F0).
    pub(super) draws: DMatrix<f64>,
    pub(super) taken: Taken,
    /// Columns of the free parameters, what is taken out (3n x m), and the mean square displacement by the joints' noise (m²).
    pub(super) columns: DMatrix<f64>,
    pub(super) joint_square: f64,
    /// The same by errors that depend on other joints.
    pub(super) cross_square: f64,
}

/// Makes the regions of one calibration from the same draws of its unknowns.
pub(super) struct Maker<'a> {
    pub(super) calibration: &'a Calibration,
    /// One draw a column.
    pub(super) unknowns: &'a DMatrix<f64>,
    pub(super) random: ChaCha8Rng,
    /// Degrees of freedom that the noise rests on.
    pub(super) freedom: f64,
    pub(super) rows: Seen,
    pub(super) displaced: Displaced,
}

/// Displacements (m, F0) by named causes of all rows of a frame and a sphere. Frames and spheres without one are left out.
pub(super) type Displaced = BTreeMap<(Reference, Option<u32>), Vec<Vector3<f64>>>;

/// How far named causes displaced rows.
pub(super) fn displaced(rows: &[MeasuredRow<'_>]) -> Displaced {
    let mut displaced = Displaced::new();
    for row in rows {
        let own = displaced.entry((row.reference, row.sphere)).or_default();
        own.push(row.displaced);
    }
    displaced.retain(|_, own| own.iter().any(|moved| *moved != Vector3::zeros()));
    displaced
}

/// Where the rows are in the space of the joints.
pub(super) struct Seen {
    /// Postures in units of the spread of each joint.
    scaled: Vec<Vec<f64>>,
    spread: Vec<f64>,
    /// Squared distance to the nearest other row that [`AMONG`] of the rows keep.
    near: f64,
}

impl Seen {
    pub(super) fn new(rows: &[MeasuredRow<'_>]) -> Self {
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
        nearest.sort_unstable_by(f64::total_cmp);
        Self {
            near: quantile(&nearest, AMONG),
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

pub(super) fn scale(q: &[f64], by: &[f64]) -> Vec<f64> {
    q.iter().zip(by).map(|(q, s)| q / s).collect()
}

pub(super) fn square(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

impl Maker<'_> {
    /// The region of rows that are measured, with the noise of the instrument. A row in a frame that the fit does not have
    /// counts about the mean of its sphere.
    pub(super) fn measured(&mut self, postures: &[Posture], own_noise: f64) -> Option<Region> {
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
    pub(super) fn aligned(&mut self, postures: Vec<Posture>) -> Region {
        let taken = Taken::Rigid(self.rigid(&postures));
        self.region(&postures, taken, false, 0.0)
    }

    fn rigid(&self, postures: &[Posture]) -> Rigid {
        let points: Vec<Vector3<f64>> = postures.iter().map(|p| self.calibration.tcp_m(&p.q, None)).collect();
        Rigid::new(&points)
    }

    /// Draws over postures; `frames` says whether the uncertainty of frames counts, `own_noise` is that of the
    /// instrument on each axis (m), beside the shifts of the tool.
    fn region(&mut self, postures: &[Posture], taken: Taken, frames: bool, own_noise: f64) -> Region {
        let calibration = self.calibration;
        let noise = calibration.noise;
        let own_noise = (own_noise.powi(2) + calibration.inner.shift_variance).sqrt();
        let count = postures.len();
        let own: Vec<(DMatrix<f64>, Vec<Vector3<f64>>)> = postures
            .par_iter()
            .map(|p| calibration.columns_at(&p.q, p.seen.filter(|_| frames)))
            .collect();
        let mut columns = DMatrix::zeros(3 * count, calibration.covariance.ncols());
        for (k, (block, _)) in own.iter().enumerate() {
            columns.rows_mut(3 * k, 3).copy_from(block);
        }
        let free = columns.ncols();
        let mut draws = &columns * self.unknowns.rows(0, free);
        let mut spread = &columns * &calibration.covariance;
        taken.of_draws(&mut spread);
        let effect = calibration.open.effect(&columns, &spread);
        let chi = ChiSquared::new(self.freedom).ok();
        // What the noise of each draw is, by that of the fit.
        let noisy: Vec<f64> = (0..draws.ncols())
            .map(|_| chi.map_or(1.0, |c| (self.freedom / c.sample(&mut self.random).max(1e-9)).sqrt()))
            .collect();
        for (mut column, noisy) in draws.column_iter_mut().zip(&noisy) {
            let sizes = calibration.open.draw(&mut self.random);
            column *= effect.factor(&sizes, *noisy);
            column.gemv(1.0, &effect.shifts, &sizes, 1.0);
        }
        let each = postures
            .iter()
            .zip(&own)
            .map(|(p, (_, joints))| (&p.q[..], &joints[..]));
        let (mut cross, mean) = calibration.cross.draws(self.unknowns, &columns, each);
        draws += &cross;
        for (k, posture) in postures.iter().enumerate() {
            let Some(factor) = &posture.factor else { continue };
            for mut column in draws.column_iter_mut() {
                let v = factor * Vector3::new(column[3 * k], column[3 * k + 1], column[3 * k + 2]);
                (0..3).for_each(|axis| column[3 * k + axis] = v[axis]);
            }
        }
        for together in [&mut draws, &mut cross] {
            together.column_iter_mut().for_each(|mut column| column += &mean);
        }
        taken.of_draws(&mut cross);
        let cross_square = cross.norm_squared() / (count * cross.ncols()).max(1) as f64;
        let joint_square = own
            .iter()
            .flat_map(|(_, joints)| joints)
            .map(Vector3::norm_squared)
            .sum::<f64>()
            * noise.joint_rad.powi(2)
            / count.max(1) as f64;
        let tails = ChiSquared::new(noise.student_t).ok().filter(|_| noise.student_t > 0.0);
        for (mut column, noisy) in draws.column_iter_mut().zip(&noisy) {
            for (k, (posture, (_, joints))) in postures.iter().zip(&own).enumerate() {
                let tail = tails.map_or(1.0, |c| (noise.student_t / c.sample(&mut self.random).max(1e-9)).sqrt());
                let mut error = Vector3::from_fn(|_, _| normal(&mut self.random)) * own_noise;
                for joint in joints {
                    error += joint * (noise.joint_rad * normal(&mut self.random));
                }
                error = error * *noisy * tail;
                let group = posture.seen.filter(|_| frames);
                let displaced = group.and_then(|group| self.displaced.get(&group));
                if let Some(moved) = displaced.and_then(|own| own.choose(&mut self.random)) {
                    error += moved;
                }
                for axis in 0..3 {
                    column[3 * k + axis] += error[axis];
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
            cross_square,
        }
    }
}

/// A posture of a region.
#[derive(Clone)]
pub(super) struct Posture {
    q: Vec<f64>,
    /// Frame and sphere where it is measured.
    seen: Option<(Reference, Option<u32>)>,
    /// Turns the uncertainty of its prediction into that without the row itself.
    factor: Option<Matrix3<f64>>,
}

impl Posture {
    pub(super) fn of(row: &MeasuredRow<'_>) -> Self {
        Self {
            seen: Some((row.reference, row.sphere)),
            ..Self::at(row.q)
        }
    }

    pub(super) fn at(q: &[f64]) -> Self {
        Self {
            q: q.to_vec(),
            seen: None,
            factor: None,
        }
    }
}

/// At most [`POSTURES`] rows, spread evenly.
pub(super) fn spread<'a, 'r>(rows: &'a [MeasuredRow<'r>]) -> impl Iterator<Item = &'a MeasuredRow<'r>> {
    rows.iter().step_by(rows.len().div_ceil(POSTURES).max(1))
}

pub(super) fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// The postures of rows that the fit has seen, each with what its own part in the fit is worth. Rows that alone determine an
/// unknown tell nothing of their own prediction. Of a fit that has none left out, all count as they are.
pub(super) fn left_out(rows: &[MeasuredRow<'_>]) -> Vec<Posture> {
    let own = |row: &MeasuredRow<'_>| {
        let left_out = row.left_out?;
        let posture = Posture {
            factor: Some(left_out.factor),
            ..Posture::of(row)
        };
        Some((posture, left_out.alone))
    };
    let mut all: Vec<(Posture, bool)> = rows.iter().filter_map(own).collect();
    if all.is_empty() {
        return spread(rows).map(Posture::of).collect();
    }
    // Of few rows each determines something: then all count, as uncertain as the limit makes them.
    let told = all.iter().filter(|(_, alone)| !alone).count();
    if 2 * told >= all.len() {
        all.retain(|(_, alone)| !alone);
    }
    all.into_iter().map(|(posture, _)| posture).collect()
}

/// A root of a covariance.
pub(super) struct Root {
    scale: DVector<f64>,
    factor: Factor,
}

impl Root {
    /// `None` where the covariance is unknown.
    pub(super) fn of(covariance: &DMatrix<f64>) -> Option<Self> {
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
    pub(super) fn draws(&self, random: &mut ChaCha8Rng) -> DMatrix<f64> {
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
