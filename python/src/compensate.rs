//! Joint commands with which a nominal controller reaches its pose with the real arm.

use spherecal_identify::study::Study;
use spherecal_model::chain::{Chain, TcpPose};
use spherecal_shared::robot::Tool;

use crate::error::Failure;

/// Largest distance (m) that is left between the full model's TCP and the wanted one.
const CLOSE_M: f64 = 1e-9;
/// Most rounds: each gains some three digits, because the effects are some 1e-3 of a radian.
const ROUNDS: usize = 20;

/// The calibrated and the nominal arm of a study.
pub(crate) struct StudyCompensator<'a> {
    study: &'a Study,
    nominal: Chain,
    calibrated: Chain,
}

impl<'a> StudyCompensator<'a> {
    /// Errors: robots that cannot take an orientation.
    pub(crate) fn new(study: &'a Study) -> Result<Self, Failure> {
        let made = |robot, tool: &Tool| {
            Chain::new(robot, tool).map_err(|e| Failure::input("robot", &study.model.robot.name, &e.to_string()))
        };
        let calibration = &study.evaluation.calibration;
        Ok(Self {
            study,
            nominal: made(&study.model.robot, &study.model.tool_in_table())?,
            calibrated: made(&calibration.robot, &calibration.tool)?,
        })
    }

    /// The command in place of `q` (rad): position by the full model, orientation by its table.
    /// Errors: a pose that the calibrated arm does not reach from `q` within the limits.
    pub(crate) fn command(&self, index: usize, q: &[f64]) -> Result<Vec<f64>, Failure> {
        let refuse = |why: &str| Failure::unreachable(format!("row {} of q_nominal: {why}", index + 1));
        let wanted = self.nominal.pose(q);
        let mut target = TcpPose { elbow: None, ..wanted };
        let mut command = q.to_vec();
        for _ in 0..ROUNDS {
            command = self.calibrated.follow(&target, &command).ok_or_else(|| {
                refuse("the calibrated arm does not reach its pose near this posture: keep away from singular postures")
            })?;
            let off = wanted.position - self.study.evaluation.calibration.tcp_m(&command, None);
            if off.norm() < CLOSE_M {
                return if self.calibrated.limit_margin(&command) < 0.0 {
                    Err(refuse(
                        "the corrected command is beyond a joint limit: keep away from the limits",
                    ))
                } else {
                    Ok(command)
                };
            }
            target.position += off;
        }
        Err(refuse(
            "the correction does not converge: keep away from singular postures",
        ))
    }
}
