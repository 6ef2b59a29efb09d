//! What the client knows of the robot after a message.

use crate::JOINTS;
use crate::wire::{
    ClientCommandMode, ConnectionInfo, ControlMode, DriveState, MonitoringMessage, OperationMode, OverlayType, Quality,
    RobotInfo, SafetyState, SessionState, Timestamp,
};

/// The robot after one monitoring message. What the cabinet did not send is `None`: unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct MonitoredState {
    /// The cabinet's sequence counter.
    pub sequence: u32,
    /// The cabinet's clock.
    pub time: Option<Timestamp>,
    /// Measured joint positions, motor side, rad.
    pub q: [f64; JOINTS],
    /// Joint velocities, differentiated and filtered by the client (see [`VelocityFilter`](super::VelocityFilter)),
    /// rad/s.
    pub dq: [f64; JOINTS],
    /// Measured joint torques, gravity included, with the cabinet's sign, N m.
    pub measured_torque: [f64; JOINTS],
    /// The cabinet's estimate of the external torques, N m.
    pub external_torque: Option<[f64; JOINTS]>,
    /// Commanded joint positions, rad.
    pub commanded_position: Option<[f64; JOINTS]>,
    /// Commanded joint torques, N m.
    pub commanded_torque: Option<[f64; JOINTS]>,
    /// Interpolated joint positions, rad; sent while commanding.
    pub interpolated_position: Option<[f64; JOINTS]>,
    /// The state of the session.
    pub session: SessionState,
    /// How well the client answers.
    pub quality: Quality,
    /// Whether a safety function stops the robot.
    pub safety: Option<SafetyState>,
    /// The drives of the joints.
    pub drives: Option<[DriveState; JOINTS]>,
    /// The operating mode.
    pub operation: Option<OperationMode>,
    /// The cabinet's controller.
    pub control: Option<ControlMode>,
    /// What the application lets the client command.
    pub command_mode: Option<ClientCommandMode>,
    /// What the commands are laid over.
    pub overlay: Option<OverlayType>,
    /// 0 to 1: how well the robot follows.
    pub tracking_performance: Option<f64>,
    /// Time between two messages, ms.
    pub send_period_ms: Option<u32>,
    /// The cabinet expects an answer to each n-th message.
    pub receive_multiplier: Option<u32>,
}

impl Default for MonitoredState {
    fn default() -> Self {
        Self::new(
            &MonitoringMessage {
                sequence: 0,
                reflected_sequence: 0,
                robot: RobotInfo::default(),
                measured_position: [0.0; JOINTS],
                measured_torque: [0.0; JOINTS],
                commanded_position: None,
                commanded_torque: None,
                external_torque: None,
                time: None,
                connection: ConnectionInfo {
                    session: SessionState::Idle,
                    quality: Quality::Poor,
                    send_period_ms: None,
                    receive_multiplier: None,
                },
                ipo: None,
                end: None,
            },
            [0.0; JOINTS],
        )
    }
}

impl MonitoredState {
    pub(super) fn new(message: &MonitoringMessage, dq: [f64; JOINTS]) -> Self {
        let ipo = message.ipo.unwrap_or_default();
        Self {
            sequence: message.sequence,
            time: message.time,
            q: message.measured_position,
            dq,
            measured_torque: message.measured_torque,
            external_torque: message.external_torque,
            commanded_position: message.commanded_position,
            commanded_torque: message.commanded_torque,
            interpolated_position: ipo.joint_position,
            session: message.connection.session,
            quality: message.connection.quality,
            safety: message.robot.safety,
            drives: message.robot.drives,
            operation: message.robot.operation,
            control: message.robot.control,
            command_mode: ipo.command_mode,
            overlay: ipo.overlay,
            tracking_performance: ipo.tracking_performance,
            send_period_ms: message.connection.send_period_ms,
            receive_multiplier: message.connection.receive_multiplier,
        }
    }

    /// Whether the robot follows commands, or is about to.
    pub fn is_commanding(&self) -> bool {
        matches!(
            self.session,
            SessionState::CommandingWait | SessionState::CommandingActive
        )
    }

    /// The time between two messages, s. The cabinet sends it; 1 ms where it does not.
    pub fn period_s(&self) -> f64 {
        f64::from(self.send_period_ms.unwrap_or(1).max(1)) * 1e-3
    }
}
