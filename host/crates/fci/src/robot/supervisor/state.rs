//! What the robot's state shows.

use super::super::generator::Desired;
use super::super::kinematics::{flange, product};
use super::{CollisionBehavior, Request, RobotSupervisor, RunningMotion, Status};
use crate::wire::{ControllerMode, MotionGeneratorMode, MoveControllerMode, RobotState};
use crate::{JOINTS, PERIOD_S};

/// What the base's acceleration sensor shows of a robot that stands upright, m/s^2.
const GRAVITY: [f64; 3] = [0.0, 0.0, -9.81];

impl RobotSupervisor {
    /// Writes the robot's state.
    pub fn fill(&self, message_id: u64, state: &mut RobotState) {
        let arm = &self.arm;
        let flags = |values: &[f64], limits: &[f64], out: &mut [f64]| {
            for ((out, value), limit) in out.iter_mut().zip(values).zip(limits) {
                *out = f64::from(u8::from(value.abs() > *limit));
            }
        };
        state.message_id = message_id;
        state.NE_T_EE = self.ee_in_ne;
        state.F_T_EE = product(&state.F_T_NE, &state.NE_T_EE);
        state.EE_T_K = self.k_in_ee;
        state.O_T_EE = product(&flange(&arm.q), &state.F_T_EE);
        // A robot that follows torques, or rests, wants nothing else than what it measures.
        let own = self
            .motion
            .as_ref()
            .filter(|m| m.request.controller != MoveControllerMode::External);
        let desired = own.map_or_else(|| Desired::at_rest(arm.q), |motion| motion.desired);
        state.O_T_EE_d = product(&flange(&desired.q), &state.F_T_EE);
        state.O_T_EE_c = state.O_T_EE_d;
        state.m_load = self.load.mass;
        state.F_x_Cload = self.load.centre_of_mass;
        state.I_load = self.load.inertia;
        state.elbow = [arm.q[2], if arm.q[3] < 0.0 { -1.0 } else { 1.0 }];
        state.elbow_d = [desired.q[2], if desired.q[3] < 0.0 { -1.0 } else { 1.0 }];
        state.elbow_c = state.elbow_d;
        for joint in 0..JOINTS {
            state.dtau_J[joint] = (arm.tau[joint] - state.tau_J[joint]) / PERIOD_S;
        }
        state.tau_J = arm.tau;
        state.tau_J_d = self.torque;
        (state.q, state.q_d, state.theta) = (arm.q, desired.q, arm.q);
        (state.dq_d, state.ddq_d) = (desired.dq, desired.ddq);
        (state.dq, state.dtheta) = (arm.dq, arm.dq);
        state.tau_ext_hat_filtered = arm.tau_external;
        state.O_F_ext_hat_K = arm.wrench_external;
        state.O_ddP_O = GRAVITY;
        flags(
            &arm.tau_external,
            &self.thresholds.lower_torque_nominal,
            &mut state.joint_contact,
        );
        flags(
            &arm.tau_external,
            &self.thresholds.upper_torque_nominal,
            &mut state.joint_collision,
        );
        flags(
            &arm.wrench_external,
            &self.thresholds.lower_force_nominal,
            &mut state.cartesian_contact,
        );
        flags(
            &arm.wrench_external,
            &self.thresholds.upper_force_nominal,
            &mut state.cartesian_collision,
        );
        let motion = self.motion.as_ref();
        state.motion_generator_mode = motion.map_or(MotionGeneratorMode::Idle, |m| m.request.generator.in_state());
        state.controller_mode = motion.map_or(ControllerMode::Other, |m| m.request.controller.in_state());
        state.errors = self.errors;
        state.reflex_reason = self.reflex_reason;
        state.robot_mode = self.mode;
        state.control_command_success_rate = motion.map_or(0.0, RunningMotion::success_rate);
    }
}

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
