//! The estimators that are compared, and how each is judged.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::{Tool, iiwa7};

use super::record::{Trial, WorldError};
use spherecal_identify::validate::{Prediction, ValidationTable, validate};
use spherecal_identify::{Calibration, IdentifyError, Method, Options, Override, Pose, identify, paper};
use spherecal_sim::worlds::World;

/// An estimator on one kind of data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// The nominal robot with the arc-measured tool.
    Nominal,
    /// Spheres: the paper's mini-batch Nelder-Mead, 300 poses.
    PaperNelderMead,
    /// Spheres: Gauss-Newton on the paper's pairs, 21 parameters, 300 poses.
    GaussNewton,
    /// Spheres: geometry with priors.
    Geometry,
    /// Spheres: geometry, compliance and two harmonics: the true model in W0.
    TwoHarmonics,
    /// Spheres: robust and structured, the default.
    Map,
    /// Laser: Gauss-Newton with arc-measured base and tool, as in the paper.
    LaserGeometry,
    /// Laser: the structured estimator.
    LaserMap,
    /// Spheres: least squares with the same priors from which the world is drawn.
    Bound,
}

impl Estimator {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 9] = [
        Self::Nominal,
        Self::PaperNelderMead,
        Self::GaussNewton,
        Self::Geometry,
        Self::TwoHarmonics,
        Self::Map,
        Self::LaserGeometry,
        Self::LaserMap,
        Self::Bound,
    ];

    /// Name in tables and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::PaperNelderMead => "paper-nelder-mead",
            Self::GaussNewton => "gauss-newton-21",
            Self::Geometry => "geometry",
            Self::TwoHarmonics => "two-harmonics",
            Self::Map => "map",
            Self::LaserGeometry => "laser-geometry",
            Self::LaserMap => "laser-map",
            Self::Bound => "bound",
        }
    }
}

impl std::fmt::Display for Estimator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// Options of the bound: the model, priors and noise that the trial's robot was drawn from. `None` for W4, which no
/// such model describes.
fn bound_options(trial: &Trial) -> Option<Options> {
    if matches!(trial.world, World::W4 | World::W4Bad) {
        return None;
    }
    let mut plant = trial.plant.clone();
    // The drawn geometry was rescaled, so its law was.
    plant.geometry.length_sigma_m *= trial.truth.geometry_scale;
    plant.geometry.alpha_sigma_rad *= trial.truth.geometry_scale;
    plant.geometry.theta_sigma_rad *= trial.truth.geometry_scale;
    Some(spherecal_job::bound_options(&plant, iiwa7().dof()))
}

/// Runs the estimators on a trial and judges them on its validation measurements. Leaves out
/// estimators that are not defined in the trial's world.
///
/// # Errors
/// An estimator that fails on this data.
pub fn judge(trial: &Trial, estimators: &[Estimator]) -> Result<ValidationTable, WorldError> {
    let failed = |estimator: Estimator, reason: String| WorldError::Estimator {
        world: trial.world,
        seed: trial.seed,
        estimator: estimator.name(),
        reason,
    };
    let mut models = Vec::new();
    for &estimator in estimators {
        let prediction = predict(trial, estimator).map_err(|e| failed(estimator, e.to_string()))?;
        models.extend(prediction);
    }
    let measured: Vec<_> = trial.validation.iter().map(|m| m.point_m).collect();
    let last = estimators.last().copied().unwrap_or(Estimator::Nominal);
    validate(&measured, &trial.frames.base, &models).map_err(|e| failed(last, e.to_string()))
}

/// What an estimator predicts for the validation configurations.
fn predict(trial: &Trial, estimator: Estimator) -> Result<Option<Prediction>, IdentifyError> {
    let measured_tool = Tool {
        tcp_m: trial.frames.tool_m,
        ..trial.spheres.tool
    };
    let spheres_as_the_paper = || {
        let mut experiment = trial.spheres.clone();
        experiment.tool = measured_tool;
        experiment
    };
    let plain = Options {
        seed: trial.seed,
        ..Options::default()
    };
    let (calibration, laser) = match estimator {
        Estimator::Nominal => {
            let chain = spherecal_model::chain::Chain::unchecked(&trial.spheres.robot, &measured_tool);
            let points = trial
                .validation
                .iter()
                .map(|m| chain.tcp_of(&chain.frames(&m.q)).into());
            return Ok(Some(Prediction {
                name: estimator.name().to_owned(),
                points_m: points.collect(),
                own_base: None,
            }));
        }
        Estimator::PaperNelderMead => {
            let options = Options {
                method: Method::NelderMead,
                ..plain
            };
            (identify(&spheres_as_the_paper(), &options)?, false)
        }
        Estimator::GaussNewton => {
            let experiment = spheres_as_the_paper();
            let options = Options {
                method: Method::GaussNewton,
                subset: Some(paper::subset(
                    &experiment,
                    paper::Procedure::default().poses_per_sphere,
                    trial.seed,
                )),
                ..plain
            };
            (identify(&experiment, &options)?, false)
        }
        Estimator::Geometry => {
            let options = Options {
                method: Method::Geometry,
                ..plain
            };
            (identify(&trial.spheres, &options)?, false)
        }
        Estimator::TwoHarmonics => {
            let mut options = Options { harmonics: 2, ..plain };
            for name in ["bending", "tilt"] {
                let fixed = Override {
                    free: Some(false),
                    ..Override::default()
                };
                options.parameters.0.insert(name.to_owned(), fixed);
            }
            (identify(&trial.spheres, &options)?, false)
        }
        Estimator::Map => (identify(&trial.spheres, &plain)?, false),
        Estimator::LaserGeometry => {
            let mut experiment = trial.laser.clone();
            experiment.tool = measured_tool;
            let options = Options {
                method: Method::GaussNewton,
                base: Some(trial.frames.base),
                ..plain
            };
            (identify(&experiment, &options)?, true)
        }
        Estimator::LaserMap => (identify(&trial.laser, &plain)?, true),
        Estimator::Bound => match bound_options(trial) {
            Some(options) => (identify(&trial.spheres, &options)?, false),
            None => return Ok(None),
        },
    };
    Ok(Some(prediction(trial, estimator.name(), &calibration, laser)))
}

/// Predictions of a calibration. Its own base is that in the tracker frame; for sphere data the
/// plate, as the tracker measures it, gives the base.
fn prediction(trial: &Trial, name: &str, calibration: &Calibration, laser: bool) -> Prediction {
    let points = trial
        .validation
        .iter()
        .map(|m| <[f64; 3]>::from(calibration.tcp_m(&m.q, None)));
    let base = calibration.base;
    let own = if laser {
        base
    } else {
        let translation: Vector3<f64> = trial.plate.point(&base.position);
        Pose {
            rotation: trial.plate.rotation * base.rotation,
            position: translation,
        }
    };
    Prediction {
        name: name.to_owned(),
        points_m: points.collect(),
        own_base: Some(own),
    }
}
