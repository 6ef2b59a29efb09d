//! Named causes: what else than the robot the data speak of, and the fit with it.
//!
//! ```text
//! Fit ─ Linear ─ scan (alternatives · selection) ─▶ findings, and the fit with their columns
//! ```
//!
//! Beside them the model holds errors of the joints that no cause is (`cross`): without them their slow course passes for
//! causes.
//!
//! A cause that is found is a part of the model from then on: the estimate and its covariance are those of the fit with its
//! columns, so every statement about the result holds it.

mod alternatives;
mod columns;
mod cross;
mod extended;
mod finding;
mod left_out;
pub(crate) mod linear;
mod patterns;
mod payload;
mod scan;
mod scatter;
mod selection;
mod size;
mod tail;
mod words;

pub use crate::course::Course;
pub use alternatives::{Alternative, Family};
pub use finding::{FamilyTest, Finding};
pub use scatter::ScatteredPlace;

use std::collections::BTreeMap;

use nalgebra::{DVector, Vector3};

pub(crate) use self::payload::hang;
pub(crate) use self::tail::log_tail;

use self::cross::Cross;
use self::linear::Linear;
use self::payload::{LoadEffects, PAYLOAD_UNIT_KG};
use self::scan::scan;
use crate::chain::Prepared;
use crate::error::IdentifyError;
use crate::hierarchy::{Displacements, Fit};
use crate::options::{Options, Torque};
use crate::parameters::Kind;
use crate::seen::RowPart;
use crate::workspace::{Rigid, workspace};
use spherecal_model::Experiment;

/// What the data name.
#[derive(Clone, Debug, Default)]
pub struct Causes {
    /// Causes that the data name, strongest first.
    pub findings: Vec<Finding>,
    /// Largest statistic of each family of causes.
    pub families: Vec<FamilyTest>,
    /// Places whose rows scatter more than the others, worst first.
    pub scattered: Vec<ScatteredPlace>,
}

impl Causes {
    /// The causes that change what is fitted: those in the cell, and the load.
    pub(crate) fn of_inputs(&self) -> impl Iterator<Item = &Finding> {
        self.findings
            .iter()
            .filter(|finding| finding.alternative.family().is_of_inputs())
    }

    /// How much heavier (kg) than stated the load at the flange is, if the data say it.
    pub(crate) fn load_kg(&self) -> Option<f64> {
        self.findings.iter().find_map(Finding::load_kg)
    }

    /// Says how much of the load (kg) the fit holds.
    pub(crate) fn hung(&mut self, load_kg: f64) {
        let loads = self.findings.iter_mut().filter(|finding| finding.load_kg().is_some());
        loads.for_each(|finding| finding.effect.fill(load_kg / PAYLOAD_UNIT_KG));
    }

    /// Says that no target is free of the causes in the cell.
    pub(crate) fn forget_displacements(&mut self) {
        let in_cell = |finding: &&mut Finding| finding.alternative.family().is_of_cell();
        self.findings
            .iter_mut()
            .filter(in_cell)
            .for_each(|finding| finding.effect.fill(0.0));
    }

    /// The causes in the cell: what is no error of the arm.
    pub(crate) fn in_cell(&self) -> impl Iterator<Item = &Finding> {
        self.findings
            .iter()
            .filter(|finding| finding.alternative.family().is_of_cell())
    }
}

/// Tests the causes in the residuals of a fit, and takes those that are found into the fit. `course` says in which order
/// and in which coupling the observations were made. Where causes are `known`, only those are: the targets of the fit are free of
/// those in the cell.
///
/// # Errors
/// Equations that have no solution.
pub(crate) fn explain(
    fit: &mut Fit,
    experiment: &Experiment,
    options: &Options,
    course: &Course,
    known: &Causes,
) -> Result<Causes, IdentifyError> {
    let linear = Linear::new(fit);
    let share = fit.shares.iter().sum::<f64>() / fit.shares.len().max(1) as f64;
    let numbers = share * linear.y.len() as f64;
    let Cross {
        linear,
        model,
        size_rad,
        white,
    } = Cross::new(linear, numbers)?;
    fit.whitening = fit.whitening.times(white);
    let layout = fit.layout.clone();
    let kinds: Vec<Kind> = fit.unknowns.columns.iter().map(|c| fit.table[*c].kind).collect();
    // Of a robot without masses the load has no size, and measured torques hold any load.
    let loaded = LoadEffects {
        compliance: &fit.state.compliance.clone(),
        columns: (0..layout.n)
            .map(|joint| kinds.iter().position(|k| *k == Kind::Compliance(joint)))
            .collect(),
        com_from_tcp_m: com_from_tcp(experiment),
        arm_kg: experiment.robot.joints.iter().map(|joint| joint.link.mass_kg).sum(),
    };
    let by_model = !fit.nominal.assumed() && options.torque != Torque::Measured;
    let found = scan(
        &linear,
        &layout,
        course,
        by_model.then_some(&loaded),
        &known.findings,
        model.clone(),
    )?;
    let scattered = scatter::scattered(&linear, course);
    let mut findings = found.findings;
    let (of_model, before_causes) = (fit.unknowns.len(), model.w.ncols());
    // The estimate stays that of the model which is handed over: it follows these errors as far as it can.
    let mut at = model.mean().rows(0, of_model).into_owned();
    let beyond = &at - &linear.estimate;
    if !findings.is_empty() {
        let postures = workspace(&experiment.robot, &experiment.tool);
        let mut before = fit.tcps(&postures);
        let rigid = Rigid::new(&before);
        for (finding, mean) in findings.iter_mut().zip(&found.means) {
            fit.moved_by(&(mean - &at).component_mul(&linear.sigmas()));
            at.copy_from(mean);
            let after = fit.tcps(&postures);
            let moved: Vec<Vector3<f64>> = after.iter().zip(&before).map(|(a, b)| a - b).collect();
            if known.findings.is_empty() {
                finding.harm_mm = rigid.mean_without(&moved) * 1e3;
            }
            before = after;
        }
    }
    let (mut mean, mut covariance) = found.model.posterior(before_causes);
    let unit = |k: usize| linear.scale.get(k).copied().unwrap_or(1.0);
    for r in 0..before_causes {
        for c in 0..before_causes {
            covariance[(r, c)] *= unit(r) * unit(c);
        }
    }
    mean.rows_mut(0, of_model)
        .copy_from(&beyond.component_mul(&linear.sigmas()));
    fit.replace_posterior(mean, covariance);
    (fit.cross.size_rad, fit.cross.white) = (size_rad, white);
    fit.by_causes = unwhitened(&linear, &found.model.displaced(before_causes));
    fit.left_out = left_out::left_out(&linear, &found.model);
    fit.left = left(&linear, &(found.model.displaced(0) - &linear.y));
    let families = if known.findings.is_empty() {
        found.families
    } else {
        known.families.clone()
    };
    let causes = Causes {
        findings,
        families,
        scattered,
    };
    fit.displaced = displacements(fit, &linear, causes.in_cell());
    Ok(causes)
}

/// How far findings displace the targets, in the axes of their frames. None if the linear model has a part of the targets only.
fn displacements<'a>(fit: &Fit, linear: &Linear, findings: impl Iterator<Item = &'a Finding>) -> Displacements {
    let mut whitened = DVector::zeros(linear.y.len());
    for finding in findings {
        for ((column, _), effect) in finding.columns.iter().zip(&finding.effect) {
            whitened.axpy(*effect, column, 1.0);
        }
    }
    let targets = fit
        .prepared
        .iter()
        .flat_map(Prepared::parts)
        .filter(|part| *part != RowPart::Body);
    if targets.count() != fit.prepared.len() || linear.rows.len() != fit.prepared.len() {
        return Displacements::new();
    }
    let mut displaced = unwhitened(linear, &whitened);
    for row in &fit.prepared {
        if let (Some(moved), Some(base)) = (displaced.get_mut(&row.index), fit.state.bases.get(row.reference)) {
            *moved = base.rotation * *moved;
        }
    }
    displaced
}

/// Displacements (m, F0) of the first target of each observation, by their whitened ones.
fn unwhitened(linear: &Linear, whitened: &DVector<f64>) -> BTreeMap<usize, Vector3<f64>> {
    let leading = linear.rows.iter().enumerate().filter(|(_, row)| row.leads());
    leading
        .map(|(k, row)| (row.index, row.root.inverse() * whitened.fixed_rows::<3>(3 * k)))
        .collect()
}

/// Squared length of each observation's whitened residual without its robust weight, scaled to three numbers.
fn left(linear: &Linear, whitened: &DVector<f64>) -> BTreeMap<usize, f64> {
    let mut sums: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    for (k, row) in linear.rows.iter().enumerate() {
        let (sum, targets) = sums.entry(row.index).or_default();
        *sum += whitened.fixed_rows::<3>(3 * k).norm_squared() / row.weight;
        *targets += 1.0;
    }
    let scaled = sums.into_iter().map(|(index, (sum, targets))| (index, sum / targets));
    scaled.collect()
}

/// Centre of mass of the tool seen from the TCP, in m: half way to the flange where the tool has no mass.
fn com_from_tcp(experiment: &Experiment) -> Vector3<f64> {
    let (tcp, body) = (experiment.tool.tcp(), &experiment.tool.body);
    if body.mass_kg > 0.0 {
        body.com() - tcp
    } else {
        -0.5 * tcp
    }
}
