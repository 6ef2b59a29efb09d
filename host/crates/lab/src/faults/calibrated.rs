//! What the recordings of a run with faults calibrate to: the error, and the job's verdict.

use serde::{Deserialize, Serialize};
use spherecal::simulated::evaluate;
use spherecal_identify::EvaluateError;
use spherecal_identify::validate::{Prediction, validate};
use spherecal_job::{JobError, Link, LinkRecord, Measurements, PreparedRun};
use spherecal_model::LaserShot;

use super::FaultsError;
use super::case::FaultTrial;

/// What a run's recordings calibrate to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibratedTrial {
    /// Mean error on the tracker's points, base fitted, in mm. The verdict does not see them.
    pub error_mm: f64,
    /// Names of the checks by which the job refuses the result; none if it may be used.
    pub refused_by: Vec<String>,
}

impl CalibratedTrial {
    /// Evaluates a run as the job does for a user without a tracker, then measures the error on `shots`.
    ///
    /// # Errors
    /// Recordings from which nothing can be identified.
    pub(super) fn of(prepared: &PreparedRun, shots: &[LaserShot], trial: &FaultTrial) -> Result<Self, FaultsError> {
        let measured = Measurements {
            seed: prepared.config.seed,
            link_name: Link::Sim.to_string(),
            robot: prepared.robot.clone(),
            tool: prepared.tool,
            config: prepared.config.clone(),
            plan: prepared.plan.clone(),
            spheres: prepared.spheres.clone(),
            recordings: trial.recordings.clone(),
            rejected: trial.rejected.clone(),
            contacts: Vec::new(),
            couplings: trial.couplings.clone(),
            faults: trial.faults.clone(),
            laser: Vec::new(),
            link: LinkRecord::default(),
            simulated_s: trial.robot_s,
            wall_s: 0.0,
        };
        let found = evaluate(&measured)?;
        let models = [Prediction {
            name: "spheres".to_owned(),
            points_m: shots
                .iter()
                .map(|s| found.calibration.tcp_m(&s.q, None).into())
                .collect(),
            own_base: Some(found.calibration.base),
        }];
        let points: Vec<[f64; 3]> = shots.iter().map(|s| s.point_m).collect();
        let table = validate(&points, &found.calibration.base, &models)
            .map_err(EvaluateError::from)
            .map_err(JobError::from)?;
        let failed = found.verdict.checks.iter().filter(|c| c.refuses && !c.passed);
        Ok(Self {
            error_mm: table.models.first().map_or(f64::NAN, |m| m.best_fit.mean_mm),
            refused_by: failed.map(|c| c.name.to_owned()).collect(),
        })
    }
}
