//! What a run stores of the accuracy that was asked for, and of its early end.

use serde::{Deserialize, Serialize};

use super::JobError;
use spherecal_store::{CalibrationStore, RunInfo};

/// Name of the stored result.
const ACCURACY: &str = "accuracy";

/// What the evaluation said that ended a run before its last planned pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EarlyEnding {
    /// Mean error (mm) that was asked for.
    pub accuracy_mm: f64,
    /// Recordings that it evaluated.
    pub poses: usize,
    /// Mean error (mm) to expect over the work region.
    pub expected_mm: f64,
    /// Probability that the mean error is below the one that was asked for.
    pub probability: f64,
}

impl EarlyEnding {
    /// In words, with the figures.
    pub fn words(&self) -> String {
        format!(
            "the mean error over the work region is below {:.3} mm with a probability of {:.3} ({:.3} mm expected) after {} \
             poses: the others are not needed",
            self.accuracy_mm, self.probability, self.expected_mm, self.poses
        )
    }
}

/// What a run keeps of an accuracy that was asked for while or after it was measured.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct StoredAccuracy {
    /// Mean error (mm) that was asked for last, if it is another than that of the run's configuration.
    asked_mm: Option<f64>,
    /// Why the run ended before its last planned pose.
    pub(super) ended: Option<EarlyEnding>,
}

impl StoredAccuracy {
    pub(super) fn read(store: &mut dyn CalibrationStore, run: i64) -> Result<Self, JobError> {
        let json = store.result(run, ACCURACY)?;
        let decoded = json.map(|json| serde_json::from_str(&json)).transpose();
        decoded.map(Option::unwrap_or_default).map_err(|e| JobError::Encode {
            what: "the stored accuracy",
            message: e.to_string(),
        })
    }

    fn write(&self, store: &mut dyn CalibrationStore, run: i64) -> Result<(), JobError> {
        let json = serde_json::to_string(self).map_err(|e| JobError::Encode {
            what: "the accuracy",
            message: e.to_string(),
        })?;
        Ok(store.put_result(run, ACCURACY, &json)?)
    }

    /// The mean error (mm) that counts; `configured` is that of the run's configuration.
    pub(super) fn asked_mm(&self, configured: Option<f64>) -> Option<f64> {
        self.asked_mm.or(configured)
    }

    /// Stores why a run ended, or that it did not end early.
    pub(super) fn end(store: &mut dyn CalibrationStore, run: i64, ended: Option<EarlyEnding>) -> Result<(), JobError> {
        let before = Self::read(store, run)?;
        if before.ended == ended {
            return Ok(());
        }
        Self { ended, ..before }.write(store, run)
    }
}

/// Asks another accuracy of a stored run. A run that ended early at a worse one is to be measured on.
///
/// # Errors
/// When the store fails.
pub fn ask_accuracy(store: &mut dyn CalibrationStore, info: &mut RunInfo, accuracy_mm: f64) -> Result<(), JobError> {
    let before = StoredAccuracy::read(store, info.run)?;
    let enough = before.ended.is_none_or(|ended| ended.accuracy_mm <= accuracy_mm);
    let after = StoredAccuracy {
        asked_mm: Some(accuracy_mm),
        ended: before.ended.filter(|_| enough),
    };
    // A program that is killed in between leaves a run that is measured on.
    if !enough {
        "running".clone_into(&mut info.state);
        store.set_state(info.run, &info.state)?;
    }
    after.write(store, info.run)
}
