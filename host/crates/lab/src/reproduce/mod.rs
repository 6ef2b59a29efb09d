//! Repeats the paper's study on one robot's recordings: Tables 1 to 6 and Figures 5 and 10 to 12
//! beside the published numbers, its redundancy analysis, the frozen simplex of its Table 6, and
//! the results of better estimators on the same recordings.
//!
//! Works on plain data ([`Recordings`]) from a stored campaign or from a synthetic world
//! ([`Trial`]).
//!
//! ```text
//! Recordings ─ reproduce ─▶ Reproduction ─ write ─▶ reproduce.txt · reproduce.json · figure_*.svg
//! ```

mod figures;
mod published;
mod source;
mod tables;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::Tool;

use crate::worlds::Trial;
use spherecal_identify::arcs::{LaserError, Measured, MeasuredArc, MeasuredFrames, frames_from_arcs};
use spherecal_identify::paper::{self, Procedure, Run};
use spherecal_identify::validate::{Prediction, ValidateError, ValidationTable, validate};
use spherecal_identify::{Calibration, Experiment, IdentifyError, Method, Options, Pairs, Target, identify};
use spherecal_model::chain::Chain;

pub use tables::{Redundancy, Side, Table};

/// Names of the models in the validation table.
pub const NOMINAL: &str = "nominal";
/// The paper's sphere calibration: mini-batch Nelder-Mead.
pub const SPHERE: &str = "sphere";
/// The paper's laser calibration: Nelder-Mead on absolute errors.
pub const LASER: &str = "laser";
/// Its optimum: Gauss-Newton on the same pairs and parameters.
pub const SPHERE_OPTIMUM: &str = "sphere, optimum";
/// The laser calibration's optimum.
pub const LASER_OPTIMUM: &str = "laser, optimum";
/// The structured estimator on the same contacts.
pub const SPHERE_MAP: &str = "sphere, map";
/// The full model on the same laser points.
pub const LASER_MAP: &str = "laser, map";

/// What one robot recorded; SI units.
#[derive(Clone, Debug)]
pub struct Recordings {
    /// Contacts: nominal robot and tool, certificate, observations.
    pub spheres: Experiment,
    /// Laser points for the calibration: nominal robot and tool.
    pub laser: Experiment,
    /// Arcs of joints 1 and 2.
    pub base_arcs: Vec<MeasuredArc>,
    /// Arcs of the last three joints.
    pub tool_arcs: Vec<MeasuredArc>,
    /// Base and tool if they were measured in another way; otherwise they come from the arcs.
    pub frames: Option<MeasuredFrames>,
    /// Validation measurements.
    pub validation: Vec<Measured>,
    /// Force on the tool during one contact (Figure 5): time in s, force in N.
    pub contact_force: Vec<(f64, f64)>,
    /// Seed of the random choices: the 300 poses, the mini-batches.
    pub seed: u64,
}

impl From<&Trial> for Recordings {
    fn from(trial: &Trial) -> Self {
        Self {
            spheres: trial.spheres.clone(),
            laser: trial.laser.clone(),
            base_arcs: trial.base_arcs.clone(),
            tool_arcs: trial.tool_arcs.clone(),
            frames: Some(trial.frames.clone()),
            validation: trial.validation.clone(),
            contact_force: Vec::new(),
            seed: trial.seed,
        }
    }
}

/// The study's results.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Reproduction {
    /// Contacts, laser points and validation points.
    pub counts: [usize; 3],
    /// Tables 1, 2, 3, 4 and 6, published beside ours.
    pub tables: Vec<Table>,
    /// Table 5 with all models.
    pub validation: ValidationTable,
    /// The published models of Table 5 beside ours.
    pub table_5: Table,
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
    /// TCPs of the laser calibration and of the validation in F0, in m (Figure 10).
    pub points_m: [Vec<[f64; 3]>; 2],
    /// Force during a contact (Figure 5): s, N.
    pub contact_force: Vec<(f64, f64)>,
}

/// Why the study could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReproduceError {
    /// An estimator failed.
    #[error("{model}: {source}")]
    Identify {
        /// The model.
        model: &'static str,
        /// Why.
        source: IdentifyError,
    },
    /// The arcs gave no frames.
    #[error(transparent)]
    Arcs(#[from] LaserError),
    /// The models could not be validated.
    #[error(transparent)]
    Validate(#[from] ValidateError),
    /// A file could not be written.
    #[error("{path}: {reason}: choose another folder with --out")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

/// Repeats the paper's study on recordings.
///
/// # Errors
/// Data that an estimator, the arcs or the validation refuse.
pub fn reproduce(recordings: &Recordings) -> Result<Reproduction, ReproduceError> {
    let frames = match &recordings.frames {
        Some(frames) => frames.clone(),
        None => frames_from_arcs(&recordings.spheres.robot, &recordings.base_arcs, &recordings.tool_arcs)?,
    };
    let tool = Tool {
        tcp_m: frames.tool_m,
        ..recordings.spheres.tool
    };
    let with_tool = |experiment: &Experiment| Experiment {
        tool,
        ..experiment.clone()
    };
    let (spheres, laser) = (with_tool(&recordings.spheres), with_tool(&recordings.laser));
    let named = |model: &'static str| move |source| ReproduceError::Identify { model, source };
    let plain = Options {
        seed: recordings.seed,
        ..Options::default()
    };

    // The paper's two calibrations, and the optimum of the fitness of each.
    let procedure = Procedure::default();
    let simplex_options = Options {
        method: Method::NelderMead,
        ..plain.clone()
    };
    let (problem, options) = paper::problem(&spheres, &simplex_options, &procedure).map_err(named(SPHERE))?;
    let simplex = paper::mini_batches(&problem, &procedure, recordings.seed);
    let sphere = problem.calibration(&spheres, &options, &simplex.x);
    let best = problem.solve(false).map_err(named(SPHERE_OPTIMUM))?;
    let least = problem.objective_mm2(&best).max(f64::MIN_POSITIVE);
    let scaled = paper::scaled(&problem);
    let pairs = Options {
        method: Method::GaussNewton,
        pairs: Pairs::Norm,
        subset: options.subset.clone(),
        ..plain.clone()
    };
    let sphere_optimum = identify(&spheres, &pairs).map_err(named(SPHERE_OPTIMUM))?;
    let absolute = |method| Options {
        method,
        base: Some(frames.base),
        ..plain.clone()
    };
    let laser_simplex = identify(&laser, &absolute(Method::NelderMead)).map_err(named(LASER))?;
    let laser_optimum = identify(&laser, &absolute(Method::GaussNewton)).map_err(named(LASER_OPTIMUM))?;
    // The same recordings, done better.
    let sphere_map = identify(&recordings.spheres, &plain).map_err(named(SPHERE_MAP))?;
    let laser_map = identify(&recordings.laser, &plain).map_err(named(LASER_MAP))?;

    let chain = Chain::unchecked(&recordings.spheres.robot, &tool);
    let nominal = |q: &[f64]| chain.tcp_of(&chain.frames(q));
    let mut models = vec![Prediction {
        name: NOMINAL.to_owned(),
        points_m: recordings.validation.iter().map(|m| nominal(&m.q).into()).collect(),
        own_base: None,
    }];
    let calibrations = [
        (SPHERE, &sphere, false),
        (LASER, &laser_simplex, true),
        (SPHERE_OPTIMUM, &sphere_optimum, false),
        (LASER_OPTIMUM, &laser_optimum, true),
        (SPHERE_MAP, &sphere_map, false),
        (LASER_MAP, &laser_map, true),
    ];
    models.extend(calibrations.map(|(name, calibration, absolute)| Prediction {
        name: name.to_owned(),
        points_m: predict(calibration, &recordings.validation),
        own_base: absolute.then_some(calibration.base),
    }));
    let measured: Vec<_> = recordings.validation.iter().map(|m| m.point_m).collect();
    let validation = validate(&measured, &frames.base, &models)?;

    let seen = |p: &[f64; 3]| frames.base.inverse_point(&Vector3::from(*p));
    let laser_points = recordings.laser.observations.iter().filter_map(|o| match &o.target {
        Target::Point(p) => Some(seen(p)),
        _ => None,
    });
    let points: [Vec<Vector3<f64>>; 2] = [laser_points.collect(), measured.iter().map(seen).collect()];
    let redundancy = tables::redundancy(&recordings.spheres);
    let tables = vec![
        tables::spheres(&recordings.spheres, &sphere_map),
        tables::parameters(&redundancy),
        tables::spread(3, &points[0]),
        tables::spread(4, &points[1]),
        tables::calibrated(&sphere, &sphere_map),
    ];
    let mut reproduction = Reproduction {
        counts: [
            recordings.spheres.observations.len(),
            recordings.laser.observations.len(),
            recordings.validation.len(),
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
        points_m: points.map(|p| p.into_iter().map(Into::into).collect()),
        contact_force: recordings.contact_force.clone(),
    };
    reproduction.findings = tables::findings(&reproduction);
    Ok(reproduction)
}

/// TCPs that a calibration predicts in F0, in m.
fn predict(calibration: &Calibration, measured: &[Measured]) -> Vec<[f64; 3]> {
    measured.iter().map(|m| calibration.tcp_m(&m.q, None).into()).collect()
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
            std::fs::write(&path, text).map_err(|e| failed(&path, e.to_string()))?;
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
        Ok(())
    }
}
