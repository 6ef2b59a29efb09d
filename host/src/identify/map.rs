//! The structured maximum a posteriori estimator, and geometry alone.
//!
//! 1. Every reference frame is registered to the nominal robot.
//! 2. Geometry with its priors is fitted by Gauss-Newton, analytic Jacobian,
//!    Student-t weights: gross errors are down-weighted from here on.
//! 3. Compliance, bending and harmonics join as zero-mean random effects; the
//!    noise scale is re-estimated from the residuals, counting the parameters
//!    that the data really determine.
//! 4. The noise is inflated ([`Noise::inflation`](super::options::Noise)) and the mode and covariance
//!    taken there.

use nalgebra::{DMatrix, Vector3};

use super::chain::{Nominal, Prepared, State};
use super::data::{Experiment, Pose, Set};
use super::error::IdentifyError;
use super::normal::{Group, Normal, Whitening, accumulate, distances, groups};
use super::options::{Model, Options, Torque};
use super::parameters::{Layout, Parameter, reference_of, table};
use super::solve::{Posterior, Unknowns};

/// Fewest observations: their three numbers must exceed the six of the base.
pub(crate) const FEWEST: usize = 3;
/// Most Gauss-Newton steps of one stage.
const STEPS: usize = 8;
/// A stage ends when no TCP column moves more than this, in units of noise.
const SETTLED: f64 = 0.02;

/// A fitted model with all that its result is written from.
pub(crate) struct Fit {
    pub(crate) layout: Layout,
    pub(crate) table: Vec<Parameter>,
    pub(crate) start: State,
    pub(crate) state: State,
    pub(crate) nominal: Nominal,
    pub(crate) prepared: Vec<Prepared>,
    pub(crate) groups: Vec<Group>,
    pub(crate) whitening: Whitening,
    /// Robust weights by prepared observation.
    pub(crate) weights: Vec<f64>,
    /// Noise scale estimated, before inflation.
    pub(crate) scale: f64,
    /// Parameters that the data determine.
    pub(crate) effective: f64,
    pub(crate) unknowns: Unknowns,
    pub(crate) covariance: DMatrix<f64>,
    /// Log evidence (Laplace) at the estimated noise, up to a constant of the data.
    pub(crate) log_evidence: f64,
}

/// Observations of one set, ready to use.
pub(crate) fn prepare(
    experiment: &Experiment,
    layout: &Layout,
    nominal: &Nominal,
    torque: Torque,
    wanted: impl Fn(usize) -> bool,
) -> Result<(Vec<Prepared>, bool), IdentifyError> {
    let all = |o: &super::data::Observation| o.tau.is_some();
    let measured = match torque {
        Torque::Model => false,
        Torque::Measured => true,
        Torque::Auto => !nominal.has_mass() && experiment.observations.iter().all(all),
    };
    let mut prepared = Vec::with_capacity(experiment.observations.len());
    for (index, observation) in experiment.observations.iter().enumerate() {
        if !wanted(index) {
            continue;
        }
        let tau = if measured {
            Some(observation.tau.as_deref().ok_or(IdentifyError::NoTorque {
                row: index + 1,
                expected: layout.n,
            })?)
        } else {
            None
        };
        let mut q = [0.0; super::chain::N];
        for (slot, angle) in q.iter_mut().zip(&observation.q) {
            *slot = *angle;
        }
        let reference = reference_of(&observation.target);
        let (target, sphere) = match observation.target {
            super::data::Target::Point(p) => (Vector3::from(p), None),
            super::data::Target::Sphere { sphere, .. } => {
                let known = experiment.spheres.iter().find(|s| s.id == sphere);
                let position = known.map_or([0.0; 3], |s| s.position_m);
                (
                    Vector3::from(position),
                    layout.spheres.iter().position(|id| *id == sphere),
                )
            }
        };
        prepared.push(Prepared {
            index,
            q,
            load: nominal.load(&observation.q, tau),
            target,
            reference: layout
                .references
                .iter()
                .position(|r| *r == reference)
                .unwrap_or_default(),
            sphere,
        });
    }
    Ok((prepared, measured))
}

/// Registers every reference frame to the state's robot.
pub(crate) fn register(state: &mut State, prepared: &[Prepared], base: Option<&Pose>) {
    for reference in 0..state.bases.len() {
        let of = || prepared.iter().filter(move |p| p.reference == reference);
        let from: Vec<_> = of().map(|p| state.evaluate(&p.q, &p.load).tcp).collect();
        let onto: Vec<_> = of().map(|p| p.target).collect();
        if let Some(pose) = Pose::fit(&from, &onto) {
            state.bases[reference] = pose;
        }
    }
    if let (Some(base), Some(slot)) = (base, state.bases.first_mut()) {
        *slot = *base;
    }
}

/// Student-t weights for three-dimensional residuals; 1 where `nu` is 0.
fn weights(d2: &[f64], s2: f64, nu: f64) -> Vec<f64> {
    if nu <= 0.0 {
        return vec![1.0; d2.len()];
    }
    d2.iter().map(|d| (nu + 3.0) / (nu + d / s2)).collect()
}

/// Noise variance by the Student-t likelihood, `effective` parameters taken off.
fn scale(d2: &[f64], effective: f64, nu: f64, start: f64) -> f64 {
    let freedom = (3.0 * d2.len() as f64 - effective).max(1.0);
    let mut s2 = start;
    for _ in 0..if nu > 0.0 { 12 } else { 1 } {
        let sum: f64 = weights(d2, s2, nu).iter().zip(d2).map(|(w, d)| w * d).sum();
        s2 = (sum / freedom).max(1e-8);
    }
    s2
}

/// Start value of the noise variance that gross errors cannot move.
fn median_scale(d2: &[f64]) -> f64 {
    let mut sorted = d2.to_vec();
    let middle = sorted.len() / 2;
    if sorted.is_empty() {
        return 1.0;
    }
    let (_, median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
    // Median of chi-square with three degrees of freedom.
    (*median / 2.366).max(1e-8)
}

/// Takes a step and says how far it moved the TCP at most, in units of noise.
fn advance(state: &mut State, fit: &mut Unknowns, table: &[Parameter], normal: &Normal, step: &[f64], s2: f64) -> f64 {
    let mut largest: f64 = 0.0;
    for (i, &column) in fit.columns.iter().enumerate() {
        state.add(table[column].kind, step[i]);
        fit.deviation[i] += step[i];
        largest = largest.max(step[i].abs() * (normal.matrix[(column, column)] / s2).sqrt());
    }
    state.refresh();
    largest
}

fn mean_distance(d2: &[f64]) -> f64 {
    (d2.iter().sum::<f64>() / d2.len().max(1) as f64).sqrt()
}

/// Fits `model` to the observations that `wanted` names.
///
/// # Errors
/// Bad data, too few of them, or no convergence.
pub(crate) fn fit(
    experiment: &Experiment,
    options: &Options,
    model: Model,
    wanted: impl Fn(usize) -> bool,
) -> Result<Fit, IdentifyError> {
    let nominal = Nominal::new(&experiment.robot, &experiment.tool);
    let plain = Layout::new(experiment, 0, false);
    let in_set = |i: usize| experiment.observations.get(i).is_some_and(|o| o.set == Set::Calibrate) && wanted(i);
    let (prepared, measured_torque) = prepare(experiment, &plain, &nominal, options.torque, in_set)?;
    let needed = FEWEST;
    if prepared.len() < needed {
        return Err(IdentifyError::TooFewObservations {
            found: prepared.len(),
            needed,
        });
    }
    if prepared.iter().all(|p| p.q == prepared[0].q) {
        return Err(IdentifyError::NoVariety);
    }
    let noise = &options.noise;
    let whitening = Whitening {
        joint: noise.joint_rad.powi(2),
        seating: noise.seating_m.powi(2),
        point: noise.point_m.powi(2),
    };
    let grouped = groups(&prepared);
    let has_load = nominal.has_mass() || measured_torque;
    let stiffness = model != Model::Geometry && has_load;
    let orders = if model == Model::Full { options.harmonics } else { 0 };
    let layout = Layout::new(experiment, orders, stiffness);
    let full_table = table(experiment, &layout, options)?;
    let mut state = State::nominal(&experiment.robot, &experiment.tool, &layout);
    for parameter in &full_table {
        let now = state.get(parameter.kind);
        if parameter.nominal != now && !matches!(parameter.kind, super::parameters::Kind::Base(..)) {
            state.add(parameter.kind, parameter.nominal - now);
        }
    }
    state.refresh();
    register(&mut state, &prepared, options.base.as_ref());
    let start = state.clone();

    let nu = options.student_t;
    let settled = SETTLED * (prepared.len() as f64).sqrt();
    let mut s2 = 1.0;
    let mut w = vec![1.0; prepared.len()];
    // The geometry, with the effects where their nominal values put them.
    let plain_table: Vec<Parameter> = plain
        .kinds()
        .into_iter()
        .filter_map(|kind| full_table.iter().find(|p| p.kind == kind).cloned())
        .collect();
    let mut unknowns = Unknowns::new(&plain_table);
    let mut d2;
    for k in 0..STEPS {
        let normal = accumulate(&state, &plain, &prepared, &grouped, &whitening, &w);
        let step = Posterior::new(&normal, &unknowns, s2)?.step(&normal, &unknowns, s2);
        let moved = advance(&mut state, &mut unknowns, &plain_table, &normal, step.as_slice(), s2);
        d2 = distances(&state, &plain, &prepared, &whitening);
        if !mean_distance(&d2).is_finite() {
            return Err(IdentifyError::Diverged { rms_mm: f64::NAN });
        }
        if noise.estimate {
            s2 = scale(&d2, 0.0, nu, median_scale(&d2));
        }
        w = weights(&d2, s2, nu);
        if k > 1 && moved < settled {
            break;
        }
    }
    // The effects join, with the geometry where it is.
    let mut unknowns_full = Unknowns::new(&full_table);
    for (i, &column) in unknowns_full.columns.iter().enumerate() {
        let kind = full_table[column].kind;
        if let Some(at) = unknowns.columns.iter().position(|&c| plain_table[c].kind == kind) {
            unknowns_full.deviation[i] = unknowns.deviation[at];
        }
    }
    let mut unknowns = unknowns_full;
    let richer = layout != plain;
    if richer && noise.estimate {
        s2 = s2.min(1.0);
    }
    let mut effective;
    let mut k = 0;
    loop {
        let normal = accumulate(&state, &layout, &prepared, &grouped, &whitening, &w);
        let posterior = Posterior::new(&normal, &unknowns, s2)?;
        let step = posterior.step(&normal, &unknowns, s2);
        let moved = advance(&mut state, &mut unknowns, &full_table, &normal, step.as_slice(), s2);
        d2 = distances(&state, &layout, &prepared, &whitening);
        if !mean_distance(&d2).is_finite() {
            return Err(IdentifyError::Diverged { rms_mm: f64::NAN });
        }
        effective = posterior.effective(&unknowns);
        if noise.estimate {
            s2 = scale(&d2, effective, nu, s2);
        }
        w = weights(&d2, s2, nu);
        k += 1;
        if !richer || k >= 3 || moved < settled {
            break;
        }
    }
    // The mode and covariance under inflated noise, from the last equations.
    let normal = accumulate(&state, &layout, &prepared, &grouped, &whitening, &w);
    let posterior = Posterior::new(&normal, &unknowns, s2)?;
    let log_evidence = evidence(&posterior, &unknowns, &d2, s2, nu);
    let inflated = s2 * noise.inflation.powi(2);
    let posterior = Posterior::new(&normal, &unknowns, inflated)?;
    let step = posterior.step(&normal, &unknowns, inflated);
    advance(
        &mut state,
        &mut unknowns,
        &full_table,
        &normal,
        step.as_slice(),
        inflated,
    );
    let covariance = posterior.covariance();
    Ok(Fit {
        layout,
        table: full_table,
        start,
        state,
        nominal,
        prepared,
        groups: grouped,
        whitening,
        weights: w,
        scale: s2.sqrt(),
        effective,
        unknowns,
        covariance,
        log_evidence,
    })
}

/// Laplace evidence: Student-t likelihood, priors and the posterior's volume.
fn evidence(posterior: &Posterior, unknowns: &Unknowns, d2: &[f64], s2: f64, nu: f64) -> f64 {
    let data: f64 = d2
        .iter()
        .map(|d| {
            let shape = if nu > 0.0 {
                -0.5 * (nu + 3.0) * (d / (s2 * nu)).ln_1p()
            } else {
                -0.5 * d / s2
            };
            shape - 1.5 * s2.ln()
        })
        .sum();
    let prior: f64 = unknowns
        .precision
        .iter()
        .zip(&unknowns.deviation)
        .map(|(p, x)| 0.5 * p.ln() - 0.5 * p * x * x)
        .sum();
    data + prior - 0.5 * posterior.log_determinant()
}
