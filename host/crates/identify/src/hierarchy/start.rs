//! Observations ready to use, and the state from which a search begins.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use rayon::prelude::*;
use spherecal_model::{Experiment, Pose, Target, fit_pose};

use super::FEWEST;
use super::noise::RowsNoise;
use super::sizes::Sizes;
use crate::chain::{Prepared, State, trig};
use crate::error::IdentifyError;
use crate::load::Nominal;
use crate::options::Torque;
use crate::parameters::{Kind, Layout, Parameter};
use crate::seen::{RowPart, Seen};
use crate::targets::{reference_of, target_of};

/// Whether a scale may be as wrong as a mistake makes it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Scale {
    /// It is as good as its prior says, by a small factor.
    #[default]
    Known,
    /// A second search tries a mistake.
    Doubted,
}

/// Displacements (m) of targets, by the index of the observation and in the axes of its frame.
pub(crate) type Displacements = BTreeMap<usize, Vector3<f64>>;

/// Sizes, noise and the correlation of alike postures at the end of a search.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ends(pub(super) Option<(Sizes, RowsNoise, f64)>);

/// What is known before a fit.
#[derive(Clone, Debug, Default)]
pub(crate) struct Before {
    /// Whether a scale may be as wrong as a mistake makes it.
    pub(crate) scale: Scale,
    /// Displacements of the targets.
    pub(crate) displaced: Displacements,
    /// Where the fit of more rows of the same arm ended: from there, a part of them takes fewer rounds.
    pub(crate) ends: Ends,
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
        let mut q = [0.0; crate::chain::N];
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
            sighted: matches!(observation.target, Target::Frame(_)),
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
pub(super) fn check_targets(layout: &Layout, prepared: &[Prepared]) -> Result<(), IdentifyError> {
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
pub(super) fn start_state(
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

#[cfg(test)]
#[path = "start_tests.rs"]
mod tests;
