//! The paper's procedure, implemented faithfully: Sections 3.2, 4.2 and 4.3.
//!
//! 21 parameters in mm and rad start at their nominal values. The objective is the squared
//! difference of vectors between pairs of contacts (Equations 9 to 11). 100 random poses per sphere
//! give 44,850 pairs. They are processed in random order in mini-batches of 32. Nelder-Mead
//! minimises each batch from the end of the previous one. For laser data the objective is the
//! squared position error of all configurations at once (Equation 13).
//!
//! The paper does not say how long each mini-batch runs, but its Table 6 shows it. Eleven of the
//! twelve parameters with nominal value zero moved by the same 6.1e-5, in mm and in rad alike. That
//! is a quarter of the simplex's first step for zeros, after some 50 iterations.
//! [`PaperProcedure::default`] stops there; [`PaperProcedure::to_the_end`] uses the stopping rules of
//! `fminsearch` instead.
//!
//! [`scaled`] is the same simplex with first steps of prior size. It reaches the optimum, so the
//! cause is the method and not the objective.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::simplex::{Minimum, SearchLimits, Stopping, minimise, stepped_simplex, usual_simplex};
use spherecal_identify::{
    Calibration, DistanceProblem, Experiment, IdentifyError, Observation, Options, Pairs, Set, Target,
};

/// The value in Table 6 of parameters that were never identified (mm or rad), and the tolerance
/// about it.
pub const FROZEN: (f64, f64) = (6.1e-5, 0.3e-5);

/// How the paper's procedure runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperProcedure {
    /// Poses drawn at random on each sphere.
    pub poses_per_sphere: usize,
    /// Pairs of a mini-batch.
    pub batch: usize,
    /// Mini-batches, one after the other.
    pub batches: usize,
    /// When the search in one mini-batch ends.
    pub limits: SearchLimits,
    /// Stopping rule of the search over all laser configurations.
    pub laser: SearchLimits,
}

impl Default for PaperProcedure {
    fn default() -> Self {
        Self {
            poses_per_sphere: 100,
            batch: 32,
            batches: 5,
            limits: SearchLimits {
                evaluations: Some(120),
                ..SearchLimits::default()
            },
            laser: SearchLimits {
                evaluations: Some(120),
                ..SearchLimits::default()
            },
        }
    }
}

impl PaperProcedure {
    /// The same with `fminsearch`'s own stopping rules, and `batches` of them.
    pub fn to_the_end(batches: usize) -> Self {
        let limits = SearchLimits {
            stopping: Stopping::Fminsearch,
            ..SearchLimits::default()
        };
        Self {
            batches,
            limits,
            laser: limits,
            ..Self::default()
        }
    }
}

/// What a run of the simplex did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Names of the parameters.
    pub names: Vec<String>,
    /// Where they started, in mm and rad.
    pub nominal: Vec<f64>,
    /// Where they ended, in mm and rad.
    pub x: Vec<f64>,
    /// The whole fitness there, in mm².
    pub objective_mm2: f64,
    /// Evaluations and iterations of each search.
    pub searches: Vec<(usize, usize)>,
}

impl Run {
    /// Name and end value of the lengths and joint offsets that started at zero.
    pub fn zeros(&self) -> Vec<(&str, f64)> {
        let all = self.names.iter().zip(&self.nominal).zip(&self.x);
        all.filter(|((name, nominal), _)| !name.starts_with("alpha") && **nominal == 0.0)
            .map(|((name, _), x)| (name.as_str(), *x))
            .collect()
    }

    /// Number of these with the frozen value of Table 6 (see [`FROZEN`]).
    pub fn frozen(&self) -> usize {
        let (value, width) = FROZEN;
        self.zeros().iter().filter(|(_, x)| (x - value).abs() <= width).count()
    }
}

/// Indices of `per_sphere` random contacts on each sphere, in the order of the data.
pub fn subset(experiment: &Experiment, per_sphere: usize, seed: u64) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7375_6273_6574);
    let mut chosen = Vec::new();
    for sphere in &experiment.spheres {
        let on = |i: &usize| {
            let o = &experiment.observations[*i];
            let here = matches!(o.target, Target::Sphere { sphere: id, .. } if id == sphere.id);
            here && o.set == Set::Calibrate
        };
        let mut own: Vec<usize> = (0..experiment.observations.len()).filter(on).collect();
        own.shuffle(&mut rng);
        own.truncate(per_sphere);
        chosen.extend(own);
    }
    chosen.sort_unstable();
    chosen
}

/// One search over the whole objective with the usual first simplex.
pub fn whole(problem: &DistanceProblem, limits: &SearchLimits) -> Run {
    let found = minimise(|x| problem.objective_mm2(x), usual_simplex(&problem.nominal()), limits);
    run(problem, &found.x, vec![(found.evaluations, found.iterations)])
}

/// Mini-batches of pairs in random order, each started at the end of the previous one.
pub fn mini_batches(problem: &DistanceProblem, procedure: &PaperProcedure, seed: u64) -> Run {
    let n = problem.poses();
    let mut pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).collect();
    pairs.shuffle(&mut ChaCha8Rng::seed_from_u64(seed ^ 0x0062_6174_6368_6573));
    let mut x = problem.nominal();
    let mut searches = Vec::new();
    // More batches than pairs: begin again.
    for batch in pairs.chunks(procedure.batch.max(1)).cycle().take(procedure.batches) {
        let found = minimise(|x| problem.batch_mm2(x, batch), usual_simplex(&x), &procedure.limits);
        x = found.x;
        searches.push((found.evaluations, found.iterations));
    }
    run(problem, &x, searches)
}

/// Nelder-Mead over the whole objective, with first steps of prior size. It restarts with a fresh
/// simplex until a restart gains less than one part in a thousand.
pub fn scaled(problem: &DistanceProblem) -> Run {
    let steps = problem.prior_sigmas();
    // A search ends by its number of evaluations, or when neither changes any more.
    let limits = SearchLimits {
        evaluations: Some(200 * steps.len()),
        x_tolerance: 1e-9,
        f_tolerance: 1e-9,
        ..SearchLimits::default()
    };
    let mut x = problem.nominal();
    let mut value = f64::INFINITY;
    let mut searches = Vec::new();
    let mut size = 1.0;
    for _ in 0..20 {
        let sized: Vec<f64> = steps.iter().map(|s| s * size).collect();
        let found: Minimum = minimise(|x| problem.objective_mm2(x), stepped_simplex(&x, &sized), &limits);
        searches.push((found.evaluations, found.iterations));
        let gained = value - found.value;
        x = found.x;
        value = found.value;
        if gained <= 1e-3 * value.abs() {
            break;
        }
        // The first search has come within the priors; the following ones refine.
        size = 0.2;
    }
    run(problem, &x, searches)
}

fn run(problem: &DistanceProblem, x: &[f64], searches: Vec<(usize, usize)>) -> Run {
    Run {
        names: problem.names().into_iter().map(str::to_owned).collect(),
        nominal: problem.nominal(),
        x: x.to_vec(),
        objective_mm2: problem.objective_mm2(x),
        searches,
    }
}

/// The paper's problem for an experiment, with its subset of the contacts if the options name none.
///
/// # Errors
/// What [`DistanceProblem::new`] refuses.
pub fn problem(
    experiment: &Experiment,
    options: &Options,
    procedure: &PaperProcedure,
) -> Result<(DistanceProblem, Options), IdentifyError> {
    let mut options = options.clone();
    if options.subset.is_none() && has_contacts(experiment) {
        options.subset = Some(subset(experiment, procedure.poses_per_sphere, options.seed));
    }
    Ok((DistanceProblem::new(experiment, &options)?, options))
}

/// The paper's calibration: mini-batches of pairs of contacts by the vectors of Equation 9, or one search over all measured
/// points.
///
/// # Errors
/// What [`DistanceProblem::new`] refuses.
pub fn identify(experiment: &Experiment, options: &Options) -> Result<Calibration, IdentifyError> {
    let procedure = PaperProcedure::default();
    let options = Options {
        pairs: Pairs::Vector,
        ..options.clone()
    };
    let (problem, options) = problem(experiment, &options, &procedure)?;
    let run = if has_contacts(experiment) {
        mini_batches(&problem, &procedure, options.seed)
    } else {
        whole(&problem, &procedure.laser)
    };
    Ok(problem.calibration(experiment, &options, &run.x))
}

fn has_contacts(experiment: &Experiment) -> bool {
    let contact = |o: &Observation| matches!(o.target, Target::Sphere { .. });
    experiment.observations.iter().any(contact)
}
