//! What an evaluation is asked for, and how far it has come.

use super::comparison::Comparison;
use crate::Options;

/// What an evaluation does besides identifying.
#[derive(Clone, Debug)]
pub struct EvaluateOptions {
    /// How to identify.
    pub identify: Options,
    /// Align frames and tool first: leaves gross errors out, and takes a tool that is far
    /// from what was said from the data.
    pub align: bool,
    /// Cross-validate where nothing else judges the result.
    pub cross_validate: bool,
    /// Test the residuals for causes, take those that are found into the fit, and state the expected error.
    pub diagnose: bool,
    /// Postures of the work region (rad); those of the rows without it.
    pub work: Option<Vec<Vec<f64>>>,
    /// Other estimators to compare with, where an independent instrument measured.
    pub models: Vec<Comparison>,
    /// Mean error of the TCP (mm) that was asked for: a worse result is refused.
    pub accuracy_mm: Option<f64>,
}

impl Default for EvaluateOptions {
    fn default() -> Self {
        Self {
            identify: Options::default(),
            align: true,
            cross_validate: true,
            diagnose: true,
            work: None,
            models: Vec::new(),
            accuracy_mm: None,
        }
    }
}

/// How far an evaluation has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EvaluationStep {
    /// The frames are aligned, priors and model chosen and the model fitted.
    Fitting {
        /// Rows of the calibration set.
        rows: usize,
    },
    /// Another estimator is fitted.
    Comparing {
        /// Its name.
        name: &'static str,
    },
    /// The result is judged.
    Judging {
        /// Fits that are judged.
        fits: usize,
        /// Rows that judge them.
        rows: usize,
    },
}
