//! What an evaluation gives.

use nalgebra::Vector3;

use super::align::NominalFrames;
use super::reference::InstrumentView;
use crate::causes::Causes;
use crate::errors::Errors;
use crate::judge::{HeldOut, Judged};
use crate::recordings::Recordings;
use crate::validate::ValidationTable;
use crate::verdict::Verdict;
use crate::{Calibration, GeometryOnly, Options, Statement};

/// A calibration with everything that is known about it.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Options that were used, after all choices from the data.
    pub options: Options,
    /// Rows that the fit used, in the order of the calibration's observations.
    pub used: Vec<usize>,
    /// Rows left out as gross errors, with their distance in mm.
    pub rejected: Vec<(usize, f64)>,
    /// Rows that are copies of another: the copy, and what it repeats. They count once.
    pub repeated: Vec<(usize, usize)>,
    /// Frames and tool with the nominal geometry.
    pub nominal: NominalFrames,
    /// The tool (m, last frame of the table) as it was given, where the data said
    /// another and it was taken from them.
    pub given_tcp_m: Option<Vector3<f64>>,
    /// The result.
    pub calibration: Calibration,
    /// What an independent instrument says, where there was one.
    pub reference: Option<InstrumentView>,
    /// Errors of rows that the fit has not seen; none where there are no such rows
    /// and none could be left out.
    pub judged: Option<Judged>,
    /// Whether those are a cross-validation of the calibration data.
    pub cross_validated: bool,
    /// The hold-out that was asked for.
    pub holdout: Option<HeldOut>,
    /// Predicted standard deviation of the TCP (root of the summed variances)
    /// over the judging rows: mean and largest, in mm.
    pub predicted_mm: (f64, f64),
    /// What the residuals name; it is a part of the result.
    pub causes: Causes,
    /// What the result is worth over each region; `None` for estimators without a posterior.
    pub statement: Option<Statement>,
    /// The geometry that files hold: the best over the work region.
    pub geometry: GeometryOnly,
    /// Whether the result may be used, and why.
    pub verdict: Verdict,
    /// What the user should know.
    pub notes: Vec<String>,
    pub(super) closed_loop: bool,
}

impl Evaluation {
    /// Errors of all models on the independent instrument's points.
    pub fn table(&self) -> Option<&ValidationTable> {
        self.reference.as_ref().and_then(|r| r.table.as_ref())
    }

    /// Predicted standard deviation of the TCP at joint angles `q`, in mm: the root
    /// of the summed variances; in closed loops that of the robot's own frame.
    pub fn predicted_sigma_mm(&self, q: &[f64]) -> f64 {
        sigma_mm(&self.calibration, q, self.closed_loop)
    }
}

/// Predicted deviation of the TCP over the judging rows: mean and largest, in mm.
/// Closed loops may leave the plate's turn open (two spheres do): there it is that
/// of the robot's own frame.
pub(super) fn predicted(
    recordings: &Recordings,
    calibration: &Calibration,
    cross_validated: bool,
    closed_loop: bool,
) -> (f64, f64) {
    let tracker = recordings.tracker.as_ref().map_or(&[][..], |t| &t.validation);
    let rows: Vec<&[f64]> = match recordings.judges(cross_validated).map(|j| &*j.observation.q).collect() {
        rows if Vec::is_empty(&rows) => tracker.iter().map(|m| &*m.q).collect(),
        rows => rows,
    };
    let step = rows.len().div_ceil(200).max(1);
    let sigma: Vec<f64> = rows
        .iter()
        .step_by(step)
        .map(|q| sigma_mm(calibration, q, closed_loop))
        .collect();
    let e = Errors::of(&sigma);
    (e.mean_mm, e.max_mm)
}

fn sigma_mm(calibration: &Calibration, q: &[f64], closed_loop: bool) -> f64 {
    let covariance = if closed_loop {
        calibration.tcp_covariance_in_base(q)
    } else {
        calibration.tcp_covariance(q)
    };
    covariance.trace().max(0.0).sqrt() * 1e3
}
