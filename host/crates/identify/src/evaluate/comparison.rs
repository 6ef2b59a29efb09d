//! Other estimators that an evaluation can compare with.

use std::fmt;
use std::sync::Arc;

use spherecal_shared::robot::Tool;

use crate::arcs::MeasuredFrames;
use crate::recordings::{Recordings, TrackerRecordings};
use crate::{Calibration, Experiment, IdentifyError, Method, Options, identify};

type Fit = dyn Fn(&Compared<'_>) -> Result<Calibration, IdentifyError> + Send + Sync;

/// Another estimator to compare with, passed in by who asks for an evaluation.
#[derive(Clone)]
pub struct Comparison {
    /// Its name in tables.
    pub name: &'static str,
    /// Whether it calibrates from the instrument's points, so that its base is the instrument's.
    pub by_points: bool,
    pub(super) fit: Arc<Fit>,
}

impl fmt::Debug for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Comparison").field(&self.name).finish()
    }
}

impl Comparison {
    /// An estimator on the contacts by its function.
    pub fn of_contacts(
        name: &'static str,
        fit: impl Fn(&Compared<'_>) -> Result<Calibration, IdentifyError> + Send + Sync + 'static,
    ) -> Self {
        Self {
            name,
            by_points: false,
            fit: Arc::new(fit),
        }
    }

    /// An estimator on the instrument's points by its function.
    pub fn of_points(
        name: &'static str,
        fit: impl Fn(&Compared<'_>) -> Result<Calibration, IdentifyError> + Send + Sync + 'static,
    ) -> Self {
        Self {
            by_points: true,
            ..Self::of_contacts(name, fit)
        }
    }

    /// Gauss-Newton on the geometry by the instrument's points, base and tool as it measured them.
    pub fn laser() -> Self {
        Self::of_points("laser", |c| {
            identify(&c.with_tool(&c.points()), &c.absolute(Method::GaussNewton))
        })
    }

    /// The full model by the instrument's points.
    pub fn laser_full() -> Self {
        Self::of_points("laser_full", |c| identify(&c.points(), &c.absolute(Method::Full)))
    }
}

/// What a model of a table is called for people, on the terminal and in the report; its own
/// name where it has no other.
pub fn model_title(name: &str) -> &str {
    match name {
        "sphere" => "spheres (this calibration)",
        "laser" => "laser tracker, geometry",
        "laser_full" => "laser tracker, full model",
        "calibrated_table_only" => "calibrated, URDF only",
        other => other,
    }
}

/// What another estimator may use.
pub struct Compared<'a> {
    pub(super) recordings: &'a Recordings,
    pub(super) tracker: &'a TrackerRecordings,
    pub(super) frames: &'a MeasuredFrames,
    /// Options of the calibration after all choices from the data.
    pub options: &'a Options,
}

impl Compared<'_> {
    /// The contacts.
    pub fn contacts(&self) -> &Experiment {
        &self.recordings.experiment
    }

    /// The instrument's calibration points.
    pub fn points(&self) -> Experiment {
        self.tracker.experiment(self.contacts())
    }

    /// The same data with the tool as the instrument measured it.
    pub fn with_tool(&self, experiment: &Experiment) -> Experiment {
        Experiment {
            tool: Tool {
                tcp_m: self.frames.tool_m,
                ..experiment.tool
            },
            ..experiment.clone()
        }
    }

    /// The options with another method.
    pub fn by(&self, method: Method) -> Options {
        Options {
            method,
            ..self.options.clone()
        }
    }

    /// The same, with the base as the instrument measured it.
    pub fn absolute(&self, method: Method) -> Options {
        Options {
            base: Some(self.frames.base),
            ..self.by(method)
        }
    }
}
