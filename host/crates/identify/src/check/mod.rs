//! How wrong a robot's forward kinematics is, as a dozen contacts with spheres tell.
//!
//! A dozen contacts do not calibrate an arm, but they tell the size of its error. The sphere's position as the robot
//! sees it scatters from pose to pose. The same model, priors and noise as in [`identify`](crate::identify()) turn that
//! scatter into the mean error of the TCP over the workspace: each draw from the posterior is an arm that agrees with the
//! contacts, and its distance from the given forward kinematics is one possible error ([`Statement`]).
//!
//! What the errors of an arm are like before the contacts are seen decides how far the scatter at a dozen poses says
//! something about the rest of the workspace. So several expectations are compared by their evidence
//! ([`Expectation`]), and the interval holds every one that the contacts do not speak against.

use serde::Serialize;
use spherecal_model::chain::Chain;
use spherecal_model::{Experiment, Observation, Set, Target};

use crate::statement::{ExpectedError, Statement, measured_rows};
use crate::workspace::workspace;
use crate::{IdentifyError, Options, Override, identify, priors};

/// Fewest contacts: fewer leave too little beside the six unknowns of the plate.
pub const FEWEST_CONTACTS: usize = 8;
/// Share of the evidence from which an expectation counts.
const COUNTS: f64 = 0.05;

/// What the errors of the arm are expected to be before the contacts are seen. The first three are those of calibrated
/// arms: their tables hold what they can of compliance and encoder errors, so these are smaller, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Expectation {
    /// A thirtieth of the default priors of links and tool, a tenth of those of compliance and encoders.
    Finest,
    /// A tenth, and a quarter.
    Fine,
    /// Three tenths, and half.
    Small,
    /// The default priors: made with care, and mastered by the maker.
    Made,
    /// Without a factory calibration: [`priors::UNCALIBRATED`].
    Uncalibrated,
}

impl Expectation {
    /// All of them, the smallest errors first.
    pub const ALL: [Self; 5] = [Self::Finest, Self::Fine, Self::Small, Self::Made, Self::Uncalibrated];

    /// In words, as in "the contacts look like those of ...".
    pub const fn words(self) -> &'static str {
        match self {
            Self::Finest => "a calibrated arm with errors of some hundredths of a millimetre",
            Self::Fine => "a calibrated arm with errors of about 0.1 mm",
            Self::Small => "an arm with errors of a few tenths of a millimetre",
            Self::Made => "an arm with a maker's usual tolerances, with errors of about 1 mm",
            Self::Uncalibrated => "an arm without a factory calibration, with errors of some millimetres",
        }
    }

    fn options(self, options: &Options) -> Options {
        let mut options = options.clone();
        let (links, effects) = match self {
            Self::Finest => (1.0 / 30.0, 0.1),
            Self::Fine => (0.1, 0.25),
            Self::Small => (0.3, 0.5),
            Self::Made => return options,
            Self::Uncalibrated => {
                options.parameters.expect_uncalibrated();
                return options;
            }
        };
        let smaller = [
            ("a", links * priors::LENGTH_SIGMA_M),
            ("d", links * priors::LENGTH_SIGMA_M),
            ("alpha", links * priors::TWIST_SIGMA_RAD),
            ("theta", links * priors::OFFSET_SIGMA_RAD),
            ("tool", links * priors::TOOL_SIGMA_M),
            ("compliance", effects * priors::COMPLIANCE_SIGMA),
            ("bending", effects * priors::BENDING),
            ("tilt", effects * priors::TILT_SIGMA),
            ("harmonic", effects * priors::HARMONIC_SIGMA_RAD),
        ];
        for (group, sigma) in smaller {
            let set = Override {
                nominal: ["compliance", "bending"].contains(&group).then_some(0.0),
                prior_sigma: Some(sigma),
                ..Override::default()
            };
            options.parameters.0.insert(group.to_owned(), set);
        }
        options
    }
}

/// What the contacts tell about a forward kinematics.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Checked {
    /// Contacts.
    pub contacts: usize,
    /// Root mean square distance of the TCP from the spheres, as the robot computes it, after the best fit of the
    /// plate's position, in mm.
    pub scatter_mm: f64,
    /// Error of the forward kinematics over the workspace, with the tool as it was given.
    pub error_mm: ExpectedError,
    /// The same with the tool that fits the contacts best: the error of the arm alone.
    pub arm_error_mm: ExpectedError,
    /// The expectation with the largest evidence.
    pub expectation: Expectation,
    /// Share of the evidence of each in [`Expectation::ALL`].
    pub shares: [f64; Expectation::ALL.len()],
}

/// Checks the robot of `experiment` with its contacts. The result holds for the table of links alone.
///
/// # Errors
/// Data or options that cannot be used, fewer than [`FEWEST_CONTACTS`], or no convergence.
pub fn check(experiment: &Experiment, options: &Options) -> Result<Checked, IdentifyError> {
    let used = |o: &&Observation| o.set == Set::Calibrate;
    let contacts = experiment.observations.iter().filter(used).count();
    if contacts < FEWEST_CONTACTS {
        return Err(IdentifyError::TooFewObservations {
            found: contacts,
            needed: FEWEST_CONTACTS,
        });
    }
    let chain = Chain::unchecked(&experiment.robot, &experiment.tool);
    let workspace = workspace(&experiment.robot, &experiment.tool);
    let mut found: Vec<Found> = Vec::new();
    let mut failed = IdentifyError::NoVariety;
    for expectation in Expectation::ALL {
        let options = expectation.options(options);
        let own = identify(experiment, &options).and_then(|fit| {
            let rows = measured_rows(experiment, &fit);
            let statement = Statement::new(&fit, &rows, &[], Some(&workspace)).ok_or(IdentifyError::NoVariety)?;
            let fitted = Chain::unchecked(&experiment.robot, &fit.tool);
            Ok(Found {
                expectation,
                log_evidence: fit.log_evidence,
                given: statement.expected_error_of(|q| chain.pose(q).position),
                fitted: statement.expected_error_of(|q| fitted.pose(q).position),
            })
        });
        match own {
            Ok(own) if own.log_evidence.is_finite() => found.push(own),
            Ok(_) => {}
            Err(error) => failed = error,
        }
    }
    let top = found.iter().map(|f| f.log_evidence).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = found.iter().map(|f| (f.log_evidence - top).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let weights: Vec<f64> = weights.iter().map(|w| w / sum).collect();
    let best = found.iter().zip(&weights).max_by(|a, b| a.1.total_cmp(b.1));
    let Some((best, _)) = best else { return Err(failed) };
    let share = |expectation| {
        let own = found.iter().zip(&weights).filter(|(f, _)| f.expectation == expectation);
        own.map(|(_, w)| w).sum()
    };
    Ok(Checked {
        contacts,
        scatter_mm: scatter_m(experiment, &chain) * 1e3,
        error_mm: mixed(found.iter().map(|f| f.given), &weights),
        arm_error_mm: mixed(found.iter().map(|f| f.fitted), &weights),
        expectation: best.expectation,
        shares: Expectation::ALL.map(share),
    })
}

/// What one expectation says.
struct Found {
    expectation: Expectation,
    log_evidence: f64,
    given: ExpectedError,
    fitted: ExpectedError,
}

/// The mean by the shares of evidence, and the interval that holds the intervals of all that count.
fn mixed(errors: impl Iterator<Item = ExpectedError>, weights: &[f64]) -> ExpectedError {
    let mut mix = ExpectedError {
        mean: 0.0,
        p95: 0.0,
        interval: [f64::INFINITY, 0.0],
    };
    for (error, weight) in errors.zip(weights) {
        mix.mean += weight * error.mean;
        mix.p95 += weight * error.p95;
        if *weight >= COUNTS {
            let [low, high] = error.interval;
            mix.interval = [mix.interval[0].min(low), mix.interval[1].max(high)];
        }
    }
    mix
}

/// Root mean square distance of the TCPs from their spheres after the best fit of each placement, in m.
fn scatter_m(experiment: &Experiment, chain: &Chain) -> f64 {
    let mut places: std::collections::BTreeMap<u32, (Vec<_>, Vec<_>)> = std::collections::BTreeMap::new();
    for observation in experiment.observations.iter().filter(|o| o.set == Set::Calibrate) {
        let Target::Sphere { sphere, place } = observation.target else {
            continue;
        };
        let Some(known) = experiment.spheres.iter().find(|s| s.id == sphere) else {
            continue;
        };
        let (seen, real) = places.entry(place).or_default();
        seen.push(chain.pose(&observation.q).position);
        real.push(nalgebra::Vector3::from(known.position_m));
    }
    let (mut sum, mut count) = (0.0, 0);
    for (seen, real) in places.values() {
        let Some(pose) = spherecal_model::fit_pose(seen, real) else {
            continue;
        };
        sum += seen
            .iter()
            .zip(real)
            .map(|(seen, real)| (pose.point(seen) - real).norm_squared())
            .sum::<f64>();
        count += seen.len();
    }
    (sum / f64::from(u32::try_from(count.max(1)).unwrap_or(u32::MAX))).sqrt()
}

#[cfg(test)]
mod tests;
