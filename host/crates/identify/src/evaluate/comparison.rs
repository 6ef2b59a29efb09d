//! Other estimators that an evaluation can compare with.

use std::fmt;
use std::sync::Arc;

use spherecal_shared::robot::Tool;

use super::estimator::Estimator;
use crate::arcs::MeasuredFrames;
use crate::recordings::{Recordings, TrackerRecordings};
use crate::{Calibration, Experiment, IdentifyError, Method, Options, identify};

/// Another estimator to compare with, passed in by who asks for an evaluation.
#[derive(Clone)]
pub struct Comparison {
    /// Its name in tables.
    pub estimator: Estimator,
    pub(super) fit: Arc<dyn Fn(&Compared<'_>) -> Result<Calibration, IdentifyError> + Send + Sync>,
}

impl fmt::Debug for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Comparison").field(&self.estimator).finish()
    }
}

impl Comparison {
    /// An estimator by its function.
    pub fn new(
        estimator: Estimator,
        fit: impl Fn(&Compared<'_>) -> Result<Calibration, IdentifyError> + Send + Sync + 'static,
    ) -> Self {
        Self {
            estimator,
            fit: Arc::new(fit),
        }
    }

    /// Gauss-Newton on the geometry by the instrument's points, base and tool as it measured them.
    pub fn laser() -> Self {
        Self::new(Estimator::Laser, |c| {
            identify(&c.with_tool(&c.points()), &c.absolute(Method::GaussNewton))
        })
    }

    /// The full model by the instrument's points.
    pub fn laser_full() -> Self {
        Self::new(Estimator::LaserFull, |c| {
            identify(&c.points(), &c.absolute(Method::Full))
        })
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
