//! Repeats the paper's study on one robot's recordings: Tables 1 to 6 and Figures 5 and 10 to 12
//! beside the published numbers, its redundancy analysis, the frozen simplex of its Table 6, and
//! the results of better estimators on the same recordings.
//!
//! Works on plain data ([`Recordings`]): they may come from a stored campaign or from
//! a synthetic world ([`Trial`](crate::worlds::Trial)).
//!
//! ```text
//! Recordings ─ reproduce ─▶ Reproduction ─ write ─▶ reproduce.txt · reproduce.json · figure_*.svg
//! ```

mod figures;
mod many;
mod published;
mod tables;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::Tool;

use crate::Estimator;
use spherecal_identify::validate::ValidationTable;
use spherecal_identify::{
    EvaluateError, EvaluateOptions, Experiment, IdentifyError, Method, Options, Pairs, Recordings, Verdict, evaluate,
};
use spherecal_model::write_file;

use crate::estimators::comparison;
use crate::paper::{self, PaperProcedure, Run};

pub use many::{
    ManyOptions, ManyStudies, ModelSpread, RobotSpread, RobotStudy, RobotStudyError, merge_many, reproduce_many,
};
pub use tables::{ComparedNumber, PaperTable, Redundancy};

/// The models of the study besides nominal and sphere.
const MODELS: [Estimator; 5] = [
    Estimator::PaperNelderMead,
    Estimator::LaserNelderMead,
    Estimator::GaussNewton,
    Estimator::Laser,
    Estimator::LaserFull,
];

/// The study's results.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Reproduction {
    /// Contacts, laser points and validation points.
    pub counts: [usize; 3],
    /// Tables 1, 2, 3, 4 and 6, published beside ours.
    pub tables: Vec<PaperTable>,
    /// Table 5 with all models.
    pub validation: ValidationTable,
    /// The published models of Table 5 beside ours.
    pub table_5: PaperTable,
    /// The redundancy analysis.
    pub redundancy: Redundancy,
    /// The paper's run on the spheres.
    pub simplex: Run,
    /// How many of the parameters that start at zero end at Table 6's frozen value.
    pub frozen: usize,
    /// The fitness at the simplex's end, divided by the optimum.
    pub simplex_over_optimum: f64,
    /// The fitness at the end of the simplex with steps of prior size, divided by the optimum.
    pub scaled_over_optimum: f64,
    /// Conclusions, in words.
    pub findings: Vec<String>,
    /// Whether the sphere calibration may be used.
    #[serde(skip_deserializing)]
    pub verdict: Verdict,
    /// TCPs of the laser calibration and validation in F0, in m (Figure 10).
    pub points_m: [Vec<[f64; 3]>; 2],
    /// Force during a contact (Figure 5): s, N.
    pub contact_force: Vec<(f64, f64)>,
}

/// Why the study could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReproduceError {
    /// The recordings could not be evaluated.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// The paper's estimator failed.
    #[error("the paper's Nelder-Mead: {0}")]
    Paper(#[from] IdentifyError),
    /// No instrument measured what the study compares with.
    #[error("the recordings hold no tracker's calibration and validation points: measure with [laser] enabled = true")]
    NoTracker,
    /// A file could not be written.
    #[error("{path}: {reason}: choose another folder with --out")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

/// Makes the paper's study from recordings. `seed` draws the 300 poses and the
/// mini-batches; `contact_force` is the force on the tool during one contact (time in
/// s, force in N; Figure 5).
///
/// # Errors
/// Data that an estimator, the arcs or the validation refuse.
pub fn reproduce(
    recordings: &Recordings,
    seed: u64,
    contact_force: &[(f64, f64)],
) -> Result<Reproduction, ReproduceError> {
    let tracker = recordings.tracker.as_ref().ok_or(ReproduceError::NoTracker)?;
    let plain = Options {
        seed,
        ..Options::default()
    };
    let asked = EvaluateOptions {
        identify: plain.clone(),
        align: false,
        cross_validate: false,
        diagnose: true,
        work: None,
        models: MODELS.into_iter().filter_map(|e| comparison(e, None)).collect(),
        accuracy_mm: None,
    };
    let evaluation = evaluate(recordings, &asked, &mut |_| {})?;
    let reference = evaluation.reference.as_ref().ok_or(ReproduceError::NoTracker)?;
    let validation = reference.table.clone().ok_or(ReproduceError::NoTracker)?;
    let frames = &reference.frames;

    // The paper's own search, step by step, with the tool as it was measured.
    let spheres = Experiment {
        tool: Tool {
            tcp_m: frames.tool_m,
            ..recordings.experiment.tool
        },
        ..recordings.experiment.clone()
    };
    let procedure = PaperProcedure::default();
    let simplex_options = Options {
        method: Method::GaussNewton,
        pairs: Pairs::Vector,
        ..plain
    };
    let (problem, options) = paper::problem(&spheres, &simplex_options, &procedure)?;
    let simplex = paper::mini_batches(&problem, &procedure, seed);
    let sphere = problem.calibration(&spheres, &options, &simplex.x);
    let best = problem.solve(false)?;
    let least = problem.objective_mm2(&best).max(f64::MIN_POSITIVE);
    let scaled = paper::scaled(&problem);

    let seen = |p: &[f64; 3]| frames.base.inverse_point(&Vector3::from(*p));
    let laser_points = tracker.calibration.iter().map(|m| seen(&m.point_m));
    let measured = tracker.validation.iter().map(|m| seen(&m.point_m));
    let points: [Vec<Vector3<f64>>; 2] = [laser_points.collect(), measured.collect()];
    let redundancy = tables::redundancy(&recordings.experiment);
    let tables = vec![
        tables::spheres(&recordings.experiment, &evaluation.calibration),
        tables::parameters(&redundancy),
        tables::spread(3, &points[0]),
        tables::spread(4, &points[1]),
        tables::calibrated(&sphere, &evaluation.calibration),
    ];
    let mut reproduction = Reproduction {
        counts: [
            recordings.experiment.observations.len(),
            tracker.calibration.len(),
            tracker.validation.len(),
        ],
        tables,
        table_5: tables::table_5(&validation),
        validation,
        redundancy,
        frozen: simplex.frozen(),
        simplex_over_optimum: simplex.objective_mm2 / least,
        scaled_over_optimum: scaled.objective_mm2 / least,
        simplex,
        findings: Vec::new(),
        verdict: evaluation.verdict,
        points_m: points.map(|p| p.into_iter().map(Into::into).collect()),
        contact_force: contact_force.to_vec(),
    };
    reproduction.findings = tables::findings(&reproduction);
    Ok(reproduction)
}

impl Reproduction {
    /// Writes text, JSON and figures into a folder, which is created if it is missing. Returns the
    /// files.
    ///
    /// # Errors
    /// A folder or file that cannot be written.
    pub fn write(&self, folder: &Path) -> Result<Vec<PathBuf>, ReproduceError> {
        let failed = |path: &Path, reason: String| ReproduceError::Write {
            path: path.to_owned(),
            reason,
        };
        std::fs::create_dir_all(folder).map_err(|e| failed(folder, e.to_string()))?;
        let mut files = Vec::new();
        let mut write = |name: &str, text: &str| {
            let path = folder.join(name);
            write_file(&path, text).map_err(|e| failed(&path, e.to_string()))?;
            files.push(path);
            Ok::<(), ReproduceError>(())
        };
        write("reproduce.txt", &self.to_string())?;
        let json = serde_json::to_string_pretty(self).map_err(|e| failed(folder, e.to_string()))?;
        write("reproduce.json", &json)?;
        for (name, svg) in figures::all(self).map_err(|e| failed(folder, e.to_string()))? {
            write(name, &svg)?;
        }
        Ok(files)
    }
}

impl std::fmt::Display for Reproduction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [contacts, laser, validation] = self.counts;
        writeln!(
            f,
            "The study of Nadeau, Bonev and Joubair (Robotics 2019, 8, 33) on these recordings:\n\
             {contacts} contacts, {laser} laser points, {validation} validation points\n"
        )?;
        let order = [1, 2, 3, 4, 5, 6];
        for number in order {
            let found = self.tables.iter().chain([&self.table_5]).find(|t| t.number == number);
            if let Some(table) = found {
                writeln!(f, "{table}")?;
            }
        }
        writeln!(f, "{}", self.redundancy)?;
        writeln!(
            f,
            "All models on the same {validation} measurements\n{}",
            self.validation
        )?;
        for finding in &self.findings {
            writeln!(f, "- {finding}")?;
        }
        if self.verdict.may_be_used {
            writeln!(f, "\nThe sphere calibration may be used.")?;
        } else {
            writeln!(f, "\nThe sphere calibration must NOT be used.")?;
        }
        for reason in &self.verdict.reasons {
            writeln!(f, "- {reason}")?;
        }
        Ok(())
    }
}
