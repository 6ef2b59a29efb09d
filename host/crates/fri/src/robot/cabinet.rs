//! The cabinet's rules, without socket and clock.
//!
//! Each period the caller does three things in this order:
//! 1. [`Cabinet::decide`]: the answer to the last message in, the command for the arm out;
//! 2. the arm's step;
//! 3. [`Cabinet::message`]: the arm's measurement in, the next message out.

use super::arm::{ArmCommand, ArmState};
use super::config::CabinetConfig;
use crate::JOINTS;
use crate::wire::{
    ClientCommandMode, CommandMessage, ConnectionInfo, ControlMode, DriveState, IpoData, MonitoringMessage,
    OperationMode, OverlayType, Quality, RobotInfo, SafetyState, SessionState, Timestamp,
};

/// Answers that the quality counts.
const WINDOW: usize = 100;
/// Due answers before the quality can be better than POOR.
const FIRST_RATING: usize = 50;
/// Mirrored cycles before the robot follows commands.
const MIRRORED: u32 = 50;
/// How far a mirrored position may be from the interpolated one, rad.
const MIRROR_RAD: f64 = 1e-6;
/// How far a commanded position may be from the measured one, rad.
const POSITION_RAD: f64 = 0.1;

/// The state machine of cabinet and application.
pub struct Cabinet {
    config: CabinetConfig,
    session: SessionState,
    answered: [bool; WINDOW],
    due: usize,
    since_answer: u32,
    sequence: u32,
    reflected: u32,
    mirrored: u32,
    overlay: [f64; JOINTS],
    position: [f64; JOINTS],
    safety: SafetyState,
    guiding: bool,
    /// The application wants its motion.
    command: bool,
    /// The application's motion has ended; it wants none until `command` was off.
    ended: bool,
    arm: ArmState,
}

impl Cabinet {
    /// A cabinet that opens its session. Its arm measures this.
    pub fn new(config: CabinetConfig, arm: ArmState) -> Self {
        Self {
            config,
            session: SessionState::MonitoringWait,
            answered: [false; WINDOW],
            due: 0,
            since_answer: 0,
            sequence: 0,
            reflected: 0,
            mirrored: 0,
            overlay: [0.0; JOINTS],
            position: arm.q,
            safety: SafetyState::NormalOperation,
            guiding: false,
            command: false,
            ended: false,
            arm,
        }
    }

    /// The session's state.
    pub fn session(&self) -> SessionState {
        self.session
    }

    /// Whether the robot follows commands, or is about to: every answer counts then.
    pub fn is_commanding(&self) -> bool {
        matches!(
            self.session,
            SessionState::CommandingWait | SessionState::CommandingActive
        )
    }

    /// The sequence counter of the newest message.
    pub fn sequence(&self) -> u32 {
        self.sequence.wrapping_sub(1)
    }

    /// Sets what the application wants and what persons and safety functions do.
    pub fn set_controls(&mut self, command: bool, safety: SafetyState, guiding: bool) {
        self.command = command;
        if !command {
            self.ended = false;
        }
        self.safety = safety;
        self.guiding = guiding;
    }

    /// How well the client answers, by the last 100 answers that were due.
    pub fn quality(&self) -> Quality {
        if self.due < FIRST_RATING {
            return Quality::Poor;
        }
        let hits = self.answered.iter().filter(|a| **a).count();
        match hits as f64 / self.due.min(WINDOW) as f64 {
            share if share >= 0.9 => Quality::Excellent,
            share if share >= 0.75 => Quality::Good,
            share if share >= 0.5 => Quality::Fair,
            _ => Quality::Poor,
        }
    }

    /// Whether an answer to the newest message is due: to each n-th.
    pub fn answer_is_due(&self) -> bool {
        self.since_answer >= self.config.receive_multiplier.max(1)
    }

    /// Ends the application's motion: drives off, brakes closed.
    fn fall(&mut self, to: SessionState) {
        if self.is_commanding() {
            self.ended = true;
        }
        self.session = to;
        self.overlay = [0.0; JOINTS];
        self.mirrored = 0;
    }

    /// One period: takes the answer to the last message and says what the arm has to do.
    pub fn decide(&mut self, answer: Option<&CommandMessage>) -> ArmCommand {
        if answer.is_some() || self.answer_is_due() {
            self.answered[self.due % WINDOW] = answer.is_some();
            // Keeps its place in the ring, and never returns to the first rating.
            self.due = if self.due + 1 >= 3 * WINDOW {
                2 * WINDOW
            } else {
                self.due + 1
            };
            self.since_answer = 0;
        }
        if let Some(answer) = answer {
            self.reflected = answer.sequence;
        }
        self.advance(answer);
        match self.session {
            SessionState::CommandingWait => ArmCommand::Hold,
            SessionState::CommandingActive => ArmCommand::Impedance {
                position: self.position,
                overlay: self.overlay,
            },
            _ if self.guiding && self.safety == SafetyState::NormalOperation => ArmCommand::Guide,
            _ => ArmCommand::Brake,
        }
    }

    fn advance(&mut self, answer: Option<&CommandMessage>) {
        let good = self.quality() >= Quality::Good;
        if self.safety != SafetyState::NormalOperation {
            let to = if good {
                SessionState::MonitoringReady
            } else {
                SessionState::MonitoringWait
            };
            return self.fall(to);
        }
        if !good {
            return self.fall(SessionState::MonitoringWait);
        }
        match self.session {
            SessionState::Idle | SessionState::MonitoringWait => self.session = SessionState::MonitoringReady,
            SessionState::MonitoringReady if self.command && !self.ended && !self.guiding => {
                self.session = SessionState::CommandingWait;
                self.position = self.arm.q;
                self.mirrored = 0;
            }
            SessionState::MonitoringReady => {}
            _ if !self.command => self.fall(SessionState::MonitoringReady),
            SessionState::CommandingWait => self.mirror(answer),
            SessionState::CommandingActive => self.follow(answer),
        }
    }

    fn mirror(&mut self, answer: Option<&CommandMessage>) {
        let Some(answer) = answer else { return };
        let near = |position: [f64; JOINTS]| (0..JOINTS).all(|j| (position[j] - self.position[j]).abs() <= MIRROR_RAD);
        let still = answer
            .joint_torque
            .is_some_and(|torque| torque.iter().all(|t| *t == 0.0));
        if !answer.joint_position.is_some_and(near) {
            // Answers to messages of the monitoring states may still be under way.
            if self.mirrored > 0 {
                self.fall(SessionState::MonitoringReady);
            }
        } else if still {
            self.mirrored += 1;
            if self.mirrored >= MIRRORED {
                self.session = SessionState::CommandingActive;
            }
        }
    }

    fn follow(&mut self, answer: Option<&CommandMessage>) {
        let Some(answer) = answer else { return };
        let limits = self.config.torque_limit;
        let (Some(position), Some(torque)) = (answer.joint_position, answer.joint_torque) else {
            return self.fall(SessionState::MonitoringReady);
        };
        let within = (0..JOINTS).all(|j| {
            let near = |to: f64| (position[j] - to).abs() <= POSITION_RAD;
            torque[j].abs() <= limits[j] && (near(self.arm.q[j]) || near(self.position[j]))
        });
        if within {
            self.overlay = torque;
        } else {
            self.fall(SessionState::MonitoringReady);
        }
    }

    /// Takes what the arm measures; returns the next message.
    pub fn message(&mut self, arm: &ArmState) -> MonitoringMessage {
        self.arm = *arm;
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        self.since_answer = self.since_answer.saturating_add(1);
        let commanding = self.is_commanding();
        let period = self.config.send_period_ms.max(1);
        let ms = u64::from(sequence) * u64::from(period);
        let drive = if commanding || self.guiding {
            DriveState::Active
        } else {
            DriveState::Off
        };
        MonitoringMessage {
            sequence,
            reflected_sequence: self.reflected,
            robot: RobotInfo {
                number_of_joints: Some(JOINTS as u32),
                safety: Some(self.safety),
                drives: Some([drive; JOINTS]),
                operation: Some(OperationMode::Automatic),
                control: Some(if commanding {
                    ControlMode::JointImpedance
                } else {
                    ControlMode::Position
                }),
            },
            measured_position: arm.q,
            measured_torque: arm.tau.map(|t| self.config.measured_sign * t),
            commanded_position: Some(if commanding { self.position } else { arm.q }),
            commanded_torque: Some(self.overlay),
            external_torque: Some(arm.tau_external),
            time: Some(Timestamp {
                sec: (ms / 1000) as u32,
                nanosec: (ms % 1000) as u32 * 1_000_000,
            }),
            connection: ConnectionInfo {
                session: self.session,
                quality: self.quality(),
                send_period_ms: Some(period),
                receive_multiplier: Some(self.config.receive_multiplier.max(1)),
            },
            ipo: commanding.then_some(IpoData {
                joint_position: Some(self.position),
                command_mode: Some(ClientCommandMode::Torque),
                overlay: Some(OverlayType::Joint),
                tracking_performance: Some(1.0),
            }),
            end: None,
        }
    }
}
