//! Score tests of named causes: is the certificate right, did the plate slip, did an
//! encoder jump?
//!
//! Every *alternative* is a set of columns `A` in the space of the residuals. With
//! `P` the inverse of the covariance of the data by the model of the fit ([`extended`](super::extended)),
//! its score is `s = Aᵀ P y`, its information `V = Aᵀ P A`, and under the model
//! `sᵀ V⁻¹ s` is chi-square with as many degrees of freedom as columns. The effect is
//! `V⁻¹ s` with covariance `V⁻¹`. The most significant alternative is taken into the
//! model, and the others are tested again, until none is left. The limits hold for
//! all alternatives together (Bonferroni), in equal parts for the families.

use nalgebra::{DMatrix, DVector};

use super::alternatives::Alternative;
use super::columns::alternatives;
use super::extended::Extended;
use super::finding::{FamilyTest, Finding};
use super::linear::Linear;
use super::patterns::patterns;
use super::payload::{LoadEffects, LoadInModel};
use super::selection::{Selection, TriedAlternative, odds, prepare};
use super::tail::log_tail;
use crate::course::Course;
use crate::error::IdentifyError;
use crate::parameters::Layout;

/// Findings at most.
const MOST: usize = 4;
/// A load is named if it is at least so many of its standard deviations: else its 95 % interval holds none at all.
const LEAST_LOAD: f64 = 2.0;

/// Tests every alternative.
///
/// A score under the model alone, which is cheap, says which alternatives deserve a
/// closer look. Each of these is then taken into the model, and the evidence says which explains the data with less. Where
/// causes are `known`, those are taken into it, and no other: what a sharper fit would name besides depends on single rows.
///
/// # Errors
/// Equations that have no solution.
pub(crate) fn scan(
    linear: &Linear,
    layout: &Layout,
    course: &Course,
    loaded: Option<&LoadEffects<'_>>,
    known: &[Finding],
    mut model: Extended,
) -> Result<Scanned, IdentifyError> {
    let mut list = alternatives(linear, layout, course);
    list.extend(patterns(linear, layout, course, loaded));
    let wanted = |a: &Alternative| known.is_empty() || known.iter().any(|known| known.alternative == *a);
    list.retain(|(alternative, columns)| wanted(alternative) && columns.norm_squared() > 0.0);
    let mut trials: Vec<TriedAlternative> = list
        .into_iter()
        .map(|(alternative, columns)| TriedAlternative {
            alternative,
            columns,
            half: DMatrix::zeros(0, 0),
            score: DVector::zeros(0),
        })
        .collect();
    prepare(linear, &model, &mut trials);
    let mut selection = Selection::new(&trials);
    let mut families = selection.families();
    let mut findings: Vec<Finding> = Vec::new();
    let mut means: Vec<DVector<f64>> = Vec::new();
    for known in known {
        let is_known = |trial: &TriedAlternative| trial.alternative == known.alternative;
        let Some(index) = trials.iter().position(is_known) else {
            continue;
        };
        // With the others in the model the data may no longer see it, and what is left of a load that already hangs there.
        let columns = selection.wide(index);
        if columns.is_empty() {
            if known.load_kg().is_some() {
                findings.push(known.clone());
                means.push(model.mean().rows(0, model.m).into_owned());
            }
            continue;
        }
        let candidate = Candidate::new(index, &known.alternative, linear, &model, columns, loaded)?;
        let (with, columns) = candidate.named();
        findings.push(selection.finding(index, 0.0, Some(known), with, columns, linear, course));
        selection.chosen.push(index);
        model = candidate.with;
        means.push(model.mean().rows(0, model.m).into_owned());
    }
    while known.is_empty() && findings.len() < MOST {
        let mut best: Option<(f64, f64, Candidate)> = None;
        let shortlist = selection.shortlist();
        if shortlist.is_empty() {
            break;
        }
        let without = model.log_evidence(linear);
        for index in shortlist {
            let alternative = &selection.trials[index].alternative;
            let candidate = Candidate::new(index, alternative, linear, &model, selection.wide(index), loaded)?;
            let freedom = selection.trials[index].score.len();
            // A load must explain the data better than joints that are all softer or stiffer than expected.
            let (without, judged) = match loaded.filter(|_| *alternative == Alternative::Payload) {
                Some(load) => {
                    let soft = model.with(linear, &[load.softness(linear)])?;
                    let judged = Candidate::new(index, alternative, linear, &soft, selection.wide(index), loaded)?;
                    (soft.log_evidence(linear), Some(judged))
                }
                None => (without, None),
            };
            let judged = judged.as_ref().unwrap_or(&candidate);
            let (evidence, volume) = judged.evidence(linear);
            // The width of its prior is no argument against it.
            let log_p = log_tail(2.0 * (evidence - without) + volume, freedom);
            let weighed = log_p - odds(alternative);
            if log_p < selection.limit(alternative) && judged.is_told() && best.as_ref().is_none_or(|b| weighed < b.0) {
                best = Some((weighed, log_p, candidate));
            }
        }
        let Some((_, log_p, candidate)) = best else { break };
        let index = candidate.index;
        let (with, columns) = candidate.named();
        let finding = selection.finding(index, log_p, None, with, columns, linear, course);
        let family = finding.alternative.family();
        for test in families.iter_mut().filter(|t| t.family == family) {
            test.found = true;
            test.sigmas = test.sigmas.max(finding.sigmas);
        }
        findings.push(finding);
        selection.chosen.push(index);
        model = candidate.with;
        means.push(model.mean().rows(0, model.m).into_owned());
    }
    Ok(Scanned {
        findings,
        families,
        means,
        model,
    })
}

/// What a scan gives.
pub(crate) struct Scanned {
    /// What was found, strongest first.
    pub(crate) findings: Vec<Finding>,
    /// The largest statistic of each family.
    pub(crate) families: Vec<FamilyTest>,
    /// The model's own columns after each finding, in units of their priors' sigmas.
    pub(crate) means: Vec<DVector<f64>>,
    /// The model with all that was found.
    pub(crate) model: Extended,
}

/// An alternative in the extended model.
struct Candidate {
    /// Its number among the trials.
    index: usize,
    /// Its whitened columns and the sigmas of their priors.
    columns: Vec<(DVector<f64>, f64)>,
    /// The model with it, about the fit.
    with: Extended,
    /// Of the load: the model about what is estimated with it.
    load: Option<LoadInModel>,
}

impl Candidate {
    fn new(
        index: usize,
        alternative: &Alternative,
        linear: &Linear,
        model: &Extended,
        mut columns: Vec<(DVector<f64>, f64)>,
        loaded: Option<&LoadEffects<'_>>,
    ) -> Result<Self, IdentifyError> {
        let loaded = loaded.filter(|_| *alternative == Alternative::Payload);
        if let Some(loaded) = loaded {
            for (_, sigma) in &mut columns {
                *sigma = loaded.prior();
            }
        }
        let with = model.with(linear, &columns)?;
        let load = match loaded {
            Some(loaded) => Some(loaded.in_model(linear, model, &with, &columns)?),
            None => None,
        };
        Ok(Self {
            index,
            columns,
            with,
            load,
        })
    }

    /// Logarithm of the evidence of the model with it, and of what the width of its prior takes off twice that.
    fn evidence(&self, linear: &Linear) -> (f64, f64) {
        let (model, linear) = match &self.load {
            Some(load) => (&load.model, &load.linear),
            None => (&self.with, linear),
        };
        (model.log_evidence(linear), model.named_volume(self.columns.len()))
    }

    /// Whether its size is told apart from nothing. The evidence for a load that the compliance could pass for is also that
    /// for the other compliance; its size is then uncertain.
    fn is_told(&self) -> bool {
        let Some(load) = &self.load else { return true };
        let (effect, covariance) = load.model.named_effect(&load.columns);
        effect[0].powi(2) > LEAST_LOAD.powi(2) * covariance[(0, 0)]
    }

    /// The model from which its effect is told, with its columns there.
    fn named(&self) -> (&Extended, Vec<(DVector<f64>, f64)>) {
        match &self.load {
            Some(load) => (&load.model, load.columns.clone()),
            None => (&self.with, self.columns.clone()),
        }
    }
}
