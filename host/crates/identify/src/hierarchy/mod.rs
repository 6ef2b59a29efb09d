//! One hierarchical model of a measured arm, fitted once.
//!
//! Row k of any instrument is `y = h(q, x) + e`. The unknowns `x` are the geometry, the frames and the tool, and the
//! effects of joints and links. Each group of them is a random effect whose size the data find ([`sizes`]). The noise has
//! a part of the joints and one of each instrument, with Student's t ([`noise`]). A round of the search is
//!
//! 1. one Gauss-Newton step on `x` with the present sizes and noise,
//! 2. one update of the sizes and of the noise from the posterior of that step,
//!
//! until no standard deviation moves by [`constants::SETTLED`]. The posterior of the last round (Laplace) gives the estimate,
//! every sigma and every statement about the result.

mod alike;
pub(crate) mod constants;
pub(crate) mod cross;
pub(crate) mod noise;
pub(crate) mod open;
mod scale;
pub(crate) mod sizes;
mod springs;
mod start;
mod tails;
pub(crate) use tails::highest;

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;

use self::alike::Alike;
use self::constants::{FIRST_ROUNDS, ROUNDS, SETTLED};
use self::cross::CrossEffects;
use self::noise::{RowsNoise, Seen as SeenRows};
use self::open::OpenSizes;
use self::sizes::{Sizes, Strangeness};
pub(crate) use self::start::{Before, Displacements, Ends, Scale, measured, prepare, register};
use self::start::{check_targets, start_state};
use super::chain::{Prepared, State};
use super::error::IdentifyError;
use super::identifiability::{Identifiability, analyse};
use super::load::Nominal;
use super::normal::{Group, Normal, Own, Whitening, accumulate, distances, groups, log_determinant};
use super::options::{Model, Options};
use super::parameter_table::table;
use super::parameters::{Kind, Layout, Parameter};
use super::seen::RowPart;
use super::solve::{Posterior, Unknowns, about_base};
use spherecal_model::{Experiment, Set};

/// Fewest observations: their three numbers each must exceed the six of the base.
pub(crate) const FEWEST: usize = 3;
/// A fitted model with all data for its result.
pub(crate) struct Fit {
    pub(crate) layout: Layout,
    pub(crate) table: Vec<Parameter>,
    pub(crate) start: State,
    pub(crate) state: State,
    pub(crate) nominal: Nominal,
    pub(crate) prepared: Vec<Prepared>,
    pub(crate) groups: Vec<Group>,
    pub(crate) whitening: Whitening,
    /// Weights by prepared observation: robust ones times the shares.
    pub(crate) weights: Vec<f64>,
    /// What each prepared observation counts among those of postures that are alike.
    pub(crate) shares: Vec<f64>,
    /// Parameters that the data determine.
    pub(crate) effective: f64,
    pub(crate) unknowns: Unknowns,
    pub(crate) covariance: DMatrix<f64>,
    /// Errors of joints by the angles of others, which the model does not hold.
    pub(crate) cross: CrossEffects,
    /// Displacements (m, F0) of observations by named causes, by their index.
    pub(crate) by_causes: BTreeMap<usize, Vector3<f64>>,
    /// How far named causes in the cell displace observations.
    pub(crate) displaced: Displacements,
    /// Squared length of the whitened residual that causes and [`Self::cross`] leave, scaled to three numbers.
    pub(crate) left: BTreeMap<usize, f64>,
    /// Some observations, left out of their own prediction, by their index.
    pub(crate) left_out: BTreeMap<usize, LeftOut>,
    /// How well the sizes of the groups are known.
    pub(crate) open: OpenSizes,
    /// Log evidence (Laplace) at the estimated noise, up to a constant of the data. Each row counts as one, so that fits of the
    /// same rows compare.
    pub(crate) log_evidence: f64,
    /// Degrees of freedom of Student's t; 0 for normal noise.
    pub(crate) nu: f64,
    /// See [`Sizes::strangeness`].
    pub(crate) strangeness: Strangeness,
    /// Whether a scale as wrong as a mistake makes it explains the rows best.
    pub(crate) scale: Scale,
    /// Where its search ended.
    pub(crate) ends: Ends,
    pub(crate) identifiability: Identifiability,
}

/// An observation that is left out of its own prediction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeftOut {
    /// Turns the uncertainty (m, F0) of what the model says of its first target into that without the observation.
    pub(crate) factor: Matrix3<f64>,
    /// Whether it alone determines an unknown, as the only row of a place does: it tells nothing of its own prediction.
    pub(crate) alone: bool,
}

impl Fit {
    /// Own noise of a target in the rows that have a line of sight, or in all rows where none has. The line is that of X.
    pub(crate) fn target_noise(&self, number: usize) -> Own {
        let sighted = self.prepared.iter().any(|p| p.sighted);
        let sight = if sighted { Vector3::x() } else { Vector3::zeros() };
        self.whitening.own(RowPart::Target(number), sight)
    }

    /// TCP (m, F0) at joint angles (rad).
    pub(crate) fn tcps(&self, postures: &[Vec<f64>]) -> Vec<Vector3<f64>> {
        let at = |q: &Vec<f64>| {
            let mut padded = [0.0; super::chain::N];
            padded.iter_mut().zip(q).for_each(|(slot, angle)| *slot = *angle);
            self.state.evaluate(&padded, &self.nominal.load(q, None)).tcp
        };
        postures.par_iter().map(at).collect()
    }

    /// Moves the unknowns by `step`, in their own units.
    pub(crate) fn moved_by(&mut self, step: &nalgebra::DVector<f64>) {
        for (i, &column) in self.unknowns.columns.iter().enumerate() {
            self.state.add(self.table[column].kind, step[i]);
            self.unknowns.deviation[i] += step[i];
        }
        self.state.refresh();
    }

    /// Takes mean and covariance of the unknowns and of [`Self::cross`], with base shifts at the pivots.
    pub(crate) fn replace_posterior(&mut self, mean: DVector<f64>, covariance: DMatrix<f64>) {
        let turn = about_base(covariance.nrows(), &self.unknowns, &self.layout, &self.state);
        let covariance = &turn * covariance * turn.transpose();
        self.cross.mean = turn * mean;
        let m = self.unknowns.len();
        self.covariance = covariance.view((0, 0), (m, m)).into_owned();
        self.cross.covariance = covariance;
        let open = std::mem::take(&mut self.open);
        self.open = open.about(&self.unknowns.deviation, &self.covariance);
    }
}

/// Fits `model` to the observations that `wanted` names.
///
/// # Errors
/// Bad data, too few of them, or no convergence.
pub(crate) fn fit(
    experiment: &Experiment,
    options: &Options,
    model: Model,
    before: &Before,
    wanted: impl Fn(usize) -> bool,
) -> Result<Fit, IdentifyError> {
    let nominal = Nominal::new(&experiment.robot, &experiment.tool);
    let (stiffness, orders) = match model {
        Model::Geometry => (false, 0),
        Model::Stiffness => (true, 0),
        Model::Full => (true, options.harmonics),
    };
    let layout = Layout::new(experiment, orders, stiffness);
    let in_set = |i: usize| experiment.observations.get(i).is_some_and(|o| o.set == Set::Calibrate) && wanted(i);
    let mut prepared = prepare(experiment, &layout, &nominal, options.torque, in_set)?;
    for row in &mut prepared {
        row.target -= before.displaced.get(&row.index).copied().unwrap_or_default();
    }
    if prepared.len() < FEWEST {
        return Err(IdentifyError::TooFewObservations {
            found: prepared.len(),
            needed: FEWEST,
        });
    }
    if prepared.iter().all(|p| p.q == prepared[0].q) {
        return Err(IdentifyError::NoVariety);
    }
    check_targets(&layout, &prepared)?;
    let table = table(experiment, &layout, options)?;
    let start = start_state(experiment, &layout, &table, &prepared, options.base.as_ref());
    let unknowns = Unknowns::new(&table);
    let mut search = Search {
        sizes: Sizes::new(&table, &unknowns),
        noise: RowsNoise::new(
            Whitening::new(&options.noise),
            options.student_t,
            options.noise.estimate,
        ),
        groups: groups(&prepared),
        weights: vec![1.0; prepared.len()],
        alike: Alike::new(&prepared),
        state: start.clone(),
        layout: &layout,
        table: &table,
        prepared: &prepared,
        unknowns,
    };
    let identifiability = search.identifiability(experiment, options)?;
    if let Some((sizes, noise, correlation)) = &before.ends.0 {
        search.sizes.begin_at(sizes, &mut search.unknowns);
        search.noise.begin_at(noise);
        search.alike.share_by(*correlation);
        search.weights.clone_from(&search.alike.share);
    }
    let found = search.run()?;
    let (found, scale) = match before.scale {
        Scale::Known => (found, before.scale),
        Scale::Doubted => found.or_with_a_wrong_scale(),
    };
    let log_evidence = found.log_evidence(&vec![1.0; prepared.len()]);
    let Found { search, posterior, .. } = found;
    let mut covariance = posterior.covariance();
    let Search {
        sizes,
        noise,
        groups,
        weights,
        alike,
        state,
        unknowns,
        ..
    } = search;
    let numbers: f64 = prepared.iter().map(Prepared::numbers).sum();
    let effective = Posterior::effective(&unknowns, &covariance).min(numbers);
    let turn = about_base(covariance.nrows(), &unknowns, &layout, &state);
    covariance = &turn * covariance * turn.transpose();
    let open = OpenSizes::new(sizes.groups(&unknowns), &unknowns.deviation, &covariance);
    let mut table = table;
    sizes.describe(&unknowns, &mut table);
    let strangeness = sizes.strangeness();
    Ok(Fit {
        layout,
        table,
        start,
        state,
        nominal,
        prepared,
        groups,
        whitening: noise.whitening,
        weights,
        shares: alike.share,
        effective,
        unknowns,
        cross: CrossEffects::none(&covariance),
        by_causes: BTreeMap::new(),
        displaced: Displacements::new(),
        left: BTreeMap::new(),
        left_out: BTreeMap::new(),
        covariance,
        log_evidence,
        nu: noise.nu,
        strangeness,
        scale,
        ends: Ends(Some((sizes, noise, alike.correlation))),
        open,
        identifiability,
    })
}

/// A search in progress.
#[derive(Clone)]
struct Search<'a> {
    layout: &'a Layout,
    table: &'a [Parameter],
    prepared: &'a [Prepared],
    groups: Vec<Group>,
    state: State,
    unknowns: Unknowns,
    sizes: Sizes,
    noise: RowsNoise,
    alike: Alike,
    /// Weights by prepared observation: robust ones times the shares.
    weights: Vec<f64>,
}

/// Where a search ended.
struct Found<'a> {
    search: Search<'a>,
    posterior: Posterior,
    /// Whether nothing moved any more.
    settled: bool,
}

impl Found<'_> {
    /// Log evidence (Laplace) at the estimated noise, up to a constant of the data and of what each row counts. A row is worth some
    /// 30: two searches compare only with the same shares.
    fn log_evidence(&self, shares: &[f64]) -> f64 {
        let Search {
            state,
            layout,
            prepared,
            noise,
            unknowns,
            sizes,
            ..
        } = &self.search;
        let d2 = distances(state, layout, prepared, &noise.whitening);
        let rows: f64 = d2
            .iter()
            .zip(shares)
            .map(|(row, share)| share * row.shape(1.0, noise.nu))
            .sum();
        let share = shares.iter().sum::<f64>() / shares.len() as f64;
        self.posterior.log_evidence_at(unknowns, rows)
            + share * log_determinant(state, layout, prepared, &noise.whitening)
            - sizes.penalty()
    }
}

impl<'a> Search<'a> {
    /// The normal equations at a state.
    fn equations(&self, state: &State, layout: &Layout) -> Normal {
        let Self {
            groups, noise, weights, ..
        } = self;
        accumulate(state, layout, self.prepared, groups, &noise.whitening, weights)
    }

    /// What the data determine of geometry, tool and base, at the start and with equal weights. The links are stiff here: how the
    /// prior expects them to bend would tell apart what geometry cannot, a joint's zero and a tool on its axis.
    fn identifiability(&self, experiment: &Experiment, options: &Options) -> Result<Identifiability, IdentifyError> {
        let layout = Layout::new(experiment, 0, false);
        let table = table(experiment, &layout, options)?;
        let mut stiff = self.state.clone();
        for bending in self.table.iter().filter(|p| matches!(p.kind, Kind::Bending(..))) {
            stiff.add(bending.kind, -bending.nominal);
        }
        stiff.refresh();
        Ok(analyse(&self.equations(&stiff, &layout), &table, self.prepared.len()))
    }

    /// Rounds until nothing moves.
    fn run(mut self) -> Result<Found<'a>, IdentifyError> {
        let mut rounds = 0;
        loop {
            self.sizes.apply(&mut self.unknowns);
            let normal = self.equations(&self.state, self.layout);
            let posterior = Posterior::new(&normal, &self.unknowns, 1.0)?;
            let (step, _) = posterior.step(&normal, &self.unknowns, 1.0);
            self.advance(&step);
            rounds += 1;
            let mut moved = f64::INFINITY;
            if rounds > FIRST_ROUNDS {
                moved = self.sizes.update(&mut self.unknowns, &posterior.root());
                let seen = SeenRows {
                    state: &self.state,
                    layout: self.layout,
                    unknowns: &self.unknowns,
                    prepared: self.prepared,
                    posterior: &posterior,
                    shares: &self.alike.share,
                };
                moved = moved.max(self.noise.update(&seen));
                moved = moved.max(self.reweight()?);
            }
            if moved < SETTLED || rounds == ROUNDS {
                return Ok(Found {
                    search: self,
                    posterior,
                    settled: moved < SETTLED,
                });
            }
        }
    }

    fn advance(&mut self, step: &nalgebra::DVector<f64>) {
        for (i, &column) in self.unknowns.columns.iter().enumerate() {
            self.state.add(self.table[column].kind, step[i]);
            self.unknowns.deviation[i] += step[i];
        }
        self.state.refresh();
    }

    /// Weights at the state. Returns the largest change of the logarithm of a share.
    fn reweight(&mut self) -> Result<f64, IdentifyError> {
        let rows = distances(&self.state, self.layout, self.prepared, &self.noise.whitening);
        if !rows.iter().map(|row| row.d2).sum::<f64>().is_finite() {
            return Err(IdentifyError::Diverged { rms_mm: f64::INFINITY });
        }
        let robust: Vec<f64> = rows.iter().map(|row| self.noise.weight(row.d2, row.numbers)).collect();
        let residual = |row: &Prepared| self.state.residual(row, &self.state.at(row).tcp);
        let residuals: Vec<Vector3<f64>> = self.prepared.par_iter().map(residual).collect();
        let moved = self.alike.update(&residuals, &robust);
        self.weights = robust
            .iter()
            .zip(&self.alike.share)
            .map(|(robust, share)| robust * share)
            .collect();
        Ok(moved)
    }
}
