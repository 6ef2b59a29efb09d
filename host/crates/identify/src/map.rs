//! The full model's maximum a posteriori estimator, and geometry alone.
//!
//! 1. Every reference frame is registered to the nominal robot.
//! 2. Gauss-Newton fits the geometry with its priors, with an analytic Jacobian and Student-t
//!    weights. Gross errors are down-weighted from here on.
//! 3. Compliance, bending and harmonics are added as random effects. The noise scale is
//!    re-estimated from the residuals, with the number of parameters that the data really
//!    determine. [`effects`](super::effects) chooses among a few priors and tails by evidence.
//! 4. The noise is inflated by the part that repeats ([`Noise::inflation`](super::options::Noise));
//!    mode and covariance are computed with it.

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;

use super::chain::{Prepared, State, trig};
use super::effects::EffectPriors;
use super::error::IdentifyError;
use super::geometry_fit::RowNoise;
use super::identifiability::{Identifiability, analyse};
use super::load::Nominal;
use super::noise_scale::Squared;
use super::normal::{Group, Whitening, distances, groups, log_determinant};
use super::options::{Model, Options, Torque};
use super::parameter_table::table;
use super::parameters::{Kind, Layout, Parameter};
use super::search::{SETTLED, Search, joined};
use super::seen::{RowPart, Seen};
use super::solve::{Posterior, Unknowns};
use super::targets::{reference_of, target_of};
use spherecal_model::{Experiment, Pose, Set, Target, fit_pose};

/// Fewest observations: their three numbers each must exceed the six of the base.
pub(crate) const FEWEST: usize = 3;
/// Most Gauss-Newton steps of geometry alone.
const STEPS: usize = 10;
/// Most steps if the effects are added afterwards: enough to find gross errors.
const FIRST_STEPS: usize = 4;
/// Most steps with the effects, besides the last step with inflated noise.
const STRUCTURED_STEPS: usize = 4;
/// With at most this many poses the equations of the full model are rebuilt at every step. The
/// robust weights of few poses still change much, and rebuilding is cheap.
const FEW: usize = 600;
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
    /// Robust weights by prepared observation.
    pub(crate) weights: Vec<f64>,
    /// Lengths of the whitened residuals by prepared observation that say which rows are outliers, where
    /// a richer model decided it.
    pub(crate) richer: Option<Vec<f64>>,
    /// Noise scale estimated, before inflation.
    pub(crate) scale: f64,
    /// Parameters that the data determine.
    pub(crate) effective: f64,
    pub(crate) unknowns: Unknowns,
    pub(crate) covariance: DMatrix<f64>,
    /// Log evidence (Laplace) at the estimated noise, up to a constant of the data.
    pub(crate) log_evidence: f64,
    /// Priors of the effects that the evidence chose.
    pub(crate) choice: EffectPriors,
    /// Log likelihood of heavy tails of the residuals over light ones; 0 where none was compared.
    pub(crate) heavy_tails: f64,
    /// Factor on the noise that was used: see [`Noise::inflation`](super::options::Noise).
    pub(crate) inflation: f64,
    pub(crate) identifiability: Identifiability,
}

/// Whether the torques that bend the joints are those of the data, not of the inertial model.
pub(crate) fn measured(experiment: &Experiment, nominal: &Nominal, torque: Torque) -> bool {
    match torque {
        Torque::Model => false,
        Torque::Measured => true,
        Torque::Auto => nominal.assumed() && experiment.observations.iter().all(|o| o.tau.is_some()),
    }
}

/// Observations of one set, ready to use.
pub(crate) fn prepare(
    experiment: &Experiment,
    layout: &Layout,
    nominal: &Nominal,
    torque: Torque,
    wanted: impl Fn(usize) -> bool,
) -> Result<Vec<Prepared>, IdentifyError> {
    let measured = measured(experiment, nominal, torque);
    let chosen: Vec<usize> = (0..experiment.observations.len()).filter(|i| wanted(*i)).collect();
    for &index in &chosen {
        let observation = &experiment.observations[index];
        if measured && observation.tau.is_none() {
            return Err(IdentifyError::NoTorque {
                row: index + 1,
                expected: layout.n,
            });
        }
    }
    let prepared = chosen.par_iter().map(|&index| {
        let observation = &experiment.observations[index];
        let mut q = [0.0; super::chain::N];
        for (slot, angle) in q.iter_mut().zip(&observation.q) {
            *slot = *angle;
        }
        let reference = reference_of(&observation.target);
        let sphere = match &observation.target {
            Target::Sphere { sphere, .. } => layout.spheres.binary_search(sphere).ok(),
            _ => None,
        };
        let (lead, further) = parts(&observation.target);
        Prepared {
            index,
            q,
            trig: trig(&q),
            load: nominal.load(&observation.q, observation.tau.as_deref().filter(|_| measured)),
            lead,
            target: target_of(&observation.target, &experiment.spheres),
            further,
            reference: layout.references.binary_search(&reference).unwrap_or_default(),
            sphere,
            seat: observation.seat.and_then(|seat| layout.seats.binary_search(&seat).ok()),
        }
    });
    Ok(prepared.collect())
}

/// The number of the target that leads a row, and the other parts of the row.
fn parts(target: &Target) -> (usize, Box<[Seen]>) {
    match target {
        Target::Points(points) => {
            let mut seen = points
                .iter()
                .enumerate()
                .filter_map(|(number, at)| Some((number, (*at)?)));
            let lead = seen.next().map_or(0, |(number, _)| number);
            let further = seen.map(|(number, at)| Seen::Target {
                number,
                at: Vector3::from(at),
            });
            (lead, further.collect())
        }
        Target::Frame(pose) => (0, Box::new([Seen::Body(pose.rotation)])),
        Target::Point(_) | Target::Sphere { .. } => (0, Box::default()),
    }
}

/// Every target is in enough rows to be placed on the tool.
fn check_targets(layout: &Layout, prepared: &[Prepared]) -> Result<(), IdentifyError> {
    if layout.targets == 1 && !layout.body {
        return Ok(());
    }
    let count = |part: RowPart| prepared.iter().filter(|p| p.parts().any(|own| own == part)).count();
    let targets = (0..layout.targets).map(|number| (RowPart::Target(number), format!("target {}", number + 1)));
    let body = layout.body.then(|| (RowPart::Body, "the orientation".to_owned()));
    for (part, what) in targets.chain(body) {
        let found = count(part);
        if found < FEWEST {
            return Err(IdentifyError::TooFewOfTarget {
                what,
                found,
                needed: FEWEST,
            });
        }
    }
    Ok(())
}

/// Registers every reference frame to the state's robot, by the rows that saw the TCP.
pub(crate) fn register(state: &mut State, prepared: &[Prepared], base: Option<&Pose>) {
    let mut members: Vec<Vec<&Prepared>> = vec![Vec::new(); state.bases.len()];
    for p in prepared.iter().filter(|p| p.lead == 0) {
        members[p.reference].push(p);
    }
    for (reference, of) in members.iter().enumerate() {
        let from: Vec<_> = of.par_iter().map(|p| state.at(p).tcp).collect();
        let onto: Vec<_> = of.iter().map(|p| p.target).collect();
        if let Some(pose) = fit_pose(&from, &onto) {
            state.bases[reference] = pose;
            state.pivots[reference] = onto.iter().sum::<Vector3<f64>>() / onto.len() as f64;
        }
    }
    if let (Some(base), Some(slot)) = (base, state.bases.first_mut()) {
        *slot = *base;
    }
}

/// The nominal state, every parameter at its table's value, every frame registered.
fn start_state(
    experiment: &Experiment,
    layout: &Layout,
    table: &[Parameter],
    prepared: &[Prepared],
    base: Option<&Pose>,
) -> State {
    let mut state = State::nominal(&experiment.robot, &experiment.tool, layout);
    for parameter in table {
        let now = state.get(parameter.kind);
        if parameter.nominal != now && !matches!(parameter.kind, Kind::Base(..) | Kind::Target(..) | Kind::Body(_)) {
            state.add(parameter.kind, parameter.nominal - now);
        }
    }
    state.refresh();
    register(&mut state, prepared, base);
    state.place_targets(prepared);
    state
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
    fit_knowing(experiment, options, model, None, wanted)
}

/// The same, where a richer model has found the noise of each row that `wanted` names.
///
/// # Errors
/// As [`fit`].
pub(crate) fn fit_knowing(
    experiment: &Experiment,
    options: &Options,
    model: Model,
    known: Option<&RowNoise>,
    wanted: impl Fn(usize) -> bool,
) -> Result<Fit, IdentifyError> {
    let nominal = Nominal::new(&experiment.robot, &experiment.tool);
    let plain = Layout::new(experiment, 0, false);
    let in_set = |i: usize| experiment.observations.get(i).is_some_and(|o| o.set == Set::Calibrate) && wanted(i);
    let prepared = prepare(experiment, &plain, &nominal, options.torque, in_set)?;
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
    check_targets(&plain, &prepared)?;
    let noise = &options.noise;
    let grouped = groups(&prepared);
    let stiffness = model != Model::Geometry;
    let orders = if model == Model::Full { options.harmonics } else { 0 };
    let layout = Layout::new(experiment, orders, stiffness);
    let full_table = table(experiment, &layout, options)?;
    let start = start_state(experiment, &layout, &full_table, &prepared, options.base.as_ref());

    // The geometry, with the effects at their nominal values.
    let plain_table: Vec<Parameter> = plain
        .kinds()
        .into_iter()
        .filter_map(|kind| full_table.iter().find(|p| p.kind == kind).cloned())
        .collect();
    let mut search = Search {
        layout: &plain,
        table: &plain_table,
        prepared: &prepared,
        groups: &grouped,
        whitening: known.map_or_else(|| Whitening::new(noise), |known| known.whitening),
        state: start.clone(),
        unknowns: Unknowns::new(&plain_table),
        weights: vec![1.0; prepared.len()],
        s2: 1.0,
        effective: 0.0,
        nu: options.student_t,
        known,
        options,
    };
    let richer = layout != plain;
    let most = if richer { FIRST_STEPS } else { STEPS };
    let (first, mut normal) = search.settle(most)?;
    let identifiability = analyse(&first, &plain_table, prepared.len());
    // A richer model has weighted the targets already.
    let several = known.is_none() && search.several();
    let changed = if several {
        search.choose_components()?
    } else {
        search.choose_shape()?
    };
    if changed {
        (_, normal) = search.settle(most)?;
    }
    // The effects join, with the geometry where it is.
    search.unknowns = joined(&full_table, &plain_table, &search.unknowns);
    search.layout = &layout;
    search.table = &full_table;
    let (mut choice, mut heavy_tails) = (EffectPriors::default(), 0.0);
    if richer {
        if noise.estimate {
            search.s2 = search.s2.min(1.0);
        }
        normal = search.equations();
        search.step(&normal, true)?;
        for k in 0..STRUCTURED_STEPS {
            if several && k > 0 {
                search.choose_components()?;
            }
            if several || prepared.len() <= FEW {
                normal = search.equations();
            } else {
                search.renew(&mut normal);
            }
            if k == 1 {
                heavy_tails = search.choose_tails()?;
                choice = search.choose_priors(&normal, search.inflation())?;
            }
            if search.step(&normal, true)? < SETTLED && k > 0 {
                break;
            }
        }
        if several {
            search.choose_components()?;
        }
        normal = search.equations();
    } else {
        search.effective = Posterior::new(&normal, &search.unknowns, search.s2)?.effective(&search.unknowns);
        search.reweight()?;
        search.renew(&mut normal);
    }
    // The mode and covariance under inflated noise.
    let d2 = distances(&search.state, search.layout, &prepared, &search.whitening);
    let posterior = Posterior::new(&normal, &search.unknowns, search.s2)?;
    let of_rows = match known {
        Some(_) => weighted_likelihood(&d2, &search.weights, search.s2),
        None => likelihood(&d2, search.s2, search.nu),
    };
    let mut log_evidence = evidence(&posterior, &search.unknowns, of_rows);
    if several {
        // The whitening is of these data, and other models have another.
        log_evidence += log_determinant(&search.state, search.layout, &prepared, &search.whitening);
    }
    let inflation = search.inflation();
    let inflated = search.s2 * inflation.powi(2);
    let posterior = Posterior::new(&normal, &search.unknowns, inflated)?;
    let (step, _) = posterior.step(&normal, &search.unknowns, inflated);
    search.advance(&step);
    let mut covariance = posterior.covariance();
    let Search {
        whitening,
        state,
        unknowns,
        weights,
        s2,
        effective,
        ..
    } = search;
    about_base(&mut covariance, &unknowns, &layout, &state);
    let mut full_table = full_table;
    for (&column, precision) in unknowns.columns.iter().zip(&unknowns.precision) {
        full_table[column].prior_sigma = precision.powf(-0.5);
    }
    Ok(Fit {
        layout,
        table: full_table,
        start,
        state,
        nominal,
        prepared,
        groups: grouped,
        whitening,
        weights,
        richer: None,
        scale: s2.sqrt(),
        effective,
        unknowns,
        covariance,
        log_evidence,
        choice,
        heavy_tails,
        inflation,
        identifiability,
    })
}

/// Converts the covariance of each base from shifts at the pivot to shifts of the base's origin:
/// `δt = δ + ω × (t − c)`.
fn about_base(covariance: &mut DMatrix<f64>, unknowns: &Unknowns, layout: &Layout, state: &State) {
    let m = unknowns.len();
    let at = |column: usize| unknowns.columns.iter().position(|c| *c == column);
    for (f, (base, pivot)) in state.bases.iter().zip(&state.pivots).enumerate() {
        let arm = base.position - pivot;
        let first = layout.base(f);
        let mut turn = DMatrix::identity(m, m);
        for axis in 0..3 {
            let Some(column) = at(first + 3 + axis) else { continue };
            let shift = Vector3::<f64>::ith(axis, 1.0).cross(&arm);
            for k in 0..3 {
                if let Some(row) = at(first + k) {
                    turn[(row, column)] = shift[k];
                }
            }
        }
        *covariance = &turn * &*covariance * turn.transpose();
    }
}

/// Log likelihood of the rows' whitened residuals under Student's t.
fn likelihood(rows: &[Squared], s2: f64, nu: f64) -> f64 {
    let of = |row: &Squared| row.shape(s2, nu) - 0.5 * row.numbers * s2.ln();
    rows.iter().map(of).sum()
}

/// The same under normal noise of variance `s2` over each row's weight.
fn weighted_likelihood(rows: &[Squared], weights: &[f64], s2: f64) -> f64 {
    let of = |(row, w): (&Squared, &f64)| 0.5 * row.numbers * (w / s2).ln() - 0.5 * row.d2 * w / s2;
    rows.iter().zip(weights).map(of).sum()
}

/// Laplace evidence: likelihood of the data, priors and the posterior's volume.
fn evidence(posterior: &Posterior, unknowns: &Unknowns, data: f64) -> f64 {
    let prior: f64 = unknowns
        .precision
        .iter()
        .zip(&unknowns.deviation)
        .map(|(p, x)| 0.5 * p.ln() - 0.5 * p * x * x)
        .sum();
    data + prior - 0.5 * posterior.log_determinant()
}
