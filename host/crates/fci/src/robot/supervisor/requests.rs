//! The requests of a client that are not control: each has its answer.

use super::{CollisionBehavior, Request, RobotSupervisor, Status};

impl RobotSupervisor {
    /// Handles a request; returns its first response. `None`: the response comes later, from
    /// [`take_finished`](Self::take_finished).
    pub fn request(&mut self, id: u32, request: &Request) -> Option<Status> {
        if self.safety_stop && !matches!(request, Request::GetRobotModel | Request::Connect { .. }) {
            return Some(Status::RejectedBySafetyFunction);
        }
        let still = self.motion.is_none();
        match request {
            Request::Connect { .. } | Request::GetRobotModel | Request::GetCartesianLimit { .. } => {
                Some(Status::Success)
            }
            Request::LoadModelLibrary { .. } => Some(Status::Failed),
            Request::Move(request) => Some(self.start(id, request)),
            Request::StopMove => Some(self.stop()),
            Request::AutomaticErrorRecovery => self.recover(id),
            _ if !still => Some(Status::NotPossible),
            Request::SetCollisionBehavior(thresholds) => Some(self.set_thresholds(thresholds)),
            Request::SetLoad(load) => {
                let valid = load.mass >= 0.0;
                if valid {
                    self.load = *load;
                }
                Some(if valid {
                    Status::Success
                } else {
                    Status::InvalidArgument
                })
            }
            Request::SetNeToEe(pose) => {
                self.ee_in_ne = *pose;
                Some(Status::Success)
            }
            Request::SetEeToK(pose) => {
                self.k_in_ee = *pose;
                Some(Status::Success)
            }
            // The robot's own controllers are not simulated: their settings change nothing.
            Request::SetJointImpedance(_)
            | Request::SetCartesianImpedance(_)
            | Request::SetGuidingMode { .. }
            | Request::SetFilters(_) => Some(Status::Success),
        }
    }

    pub(super) fn set_thresholds(&mut self, t: &CollisionBehavior) -> Status {
        let positive = t.lower_torque_acceleration.iter().chain(&t.upper_torque_acceleration);
        let positive = positive.chain(&t.lower_torque_nominal).chain(&t.upper_torque_nominal);
        let positive = positive
            .chain(&t.lower_force_acceleration)
            .chain(&t.upper_force_acceleration);
        let mut positive = positive.chain(&t.lower_force_nominal).chain(&t.upper_force_nominal);
        if positive.all(|t| *t > 0.0) {
            self.thresholds = *t;
            Status::Success
        } else {
            Status::InvalidArgument
        }
    }
}
