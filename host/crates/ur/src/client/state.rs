//! What a data package says.

use super::Unready;
use crate::JOINTS;
use crate::wire::{FieldType, Reader, RobotMode, RuntimeState, SafetyMode, WireError, words};

/// The fields that the client reads, in this order.
pub(super) const FIELDS: [(&str, FieldType); 6] = [
    ("timestamp", FieldType::Double),
    ("actual_q", FieldType::Vector6D),
    ("actual_qd", FieldType::Vector6D),
    ("robot_mode", FieldType::Int32),
    ("safety_mode", FieldType::Int32),
    ("runtime_state", FieldType::Uint32),
];

/// Refuses a number that is not finite.
pub(super) fn finite<'a>(mut numbers: impl Iterator<Item = &'a f64>) -> Result<(), WireError> {
    let field = "data package";
    let all = numbers.all(|number| number.is_finite());
    all.then_some(()).ok_or(WireError::NotFinite { field })
}

/// The robot at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotState {
    /// Time since the controller's start, s.
    pub timestamp: f64,
    /// Measured joint angles, base to flange, rad.
    pub actual_q: [f64; JOINTS],
    /// Measured joint velocities, rad/s.
    pub actual_qd: [f64; JOINTS],
    /// Number of the [`RobotMode`].
    pub robot_mode: i32,
    /// Number of the [`SafetyMode`].
    pub safety_mode: i32,
    /// Number of the [`RuntimeState`].
    pub runtime_state: i32,
}

impl RobotState {
    /// The state that the values of [`FIELDS`] say.
    pub(super) fn read(bytes: &mut Reader<'_>) -> Result<Self, WireError> {
        let state = Self {
            timestamp: bytes.f64("timestamp")?,
            actual_q: bytes.doubles("actual_q")?,
            actual_qd: bytes.doubles("actual_qd")?,
            robot_mode: bytes.i32("robot_mode")?,
            safety_mode: bytes.i32("safety_mode")?,
            runtime_state: bytes.i32("runtime_state")?,
        };
        let numbers = state.actual_q.iter().chain(&state.actual_qd);
        finite(numbers.chain([&state.timestamp]))?;
        Ok(state)
    }

    /// Why nobody can guide the arm by hand now, if so. A mode that is unknown here counts as a stop.
    ///
    /// # Errors
    /// The arm is off or its brakes are closed, or the safety system stops it.
    pub fn ready(&self) -> Result<(), Unready> {
        let mode = RobotMode::from_number(self.robot_mode);
        if !matches!(mode, Ok(RobotMode::Running | RobotMode::Backdrive)) {
            return Err(Unready::Mode(self.robot_mode));
        }
        let safety = SafetyMode::from_number(self.safety_mode);
        if !matches!(
            safety,
            Ok(SafetyMode::Normal | SafetyMode::Reduced | SafetyMode::Recovery)
        ) {
            return Err(Unready::Stopped(self.safety_mode));
        }
        Ok(())
    }

    /// The robot's word for what its program does, if a program runs: the arm may then move by itself.
    pub fn program(&self) -> Option<String> {
        let state = RuntimeState::from_number(self.runtime_state);
        let rests = matches!(state, Ok(RuntimeState::Stopped | RuntimeState::Paused));
        (!rests).then(|| words(state.map(RuntimeState::name), self.runtime_state))
    }
}
