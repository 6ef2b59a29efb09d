//! What a data package says.

use super::Unready;
use crate::JOINTS;
use crate::wire::{FieldType, RobotMode, RuntimeState, SafetyMode, Value, words};

/// The fields that the client reads, in this order.
pub(super) const FIELDS: [(&str, FieldType); 6] = [
    ("timestamp", FieldType::Double),
    ("actual_q", FieldType::Vector6D),
    ("actual_qd", FieldType::Vector6D),
    ("robot_mode", FieldType::Int32),
    ("safety_mode", FieldType::Int32),
    ("runtime_state", FieldType::Uint32),
];

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
    /// The state that these values of [`FIELDS`] say; `None` if one has another type or is not finite.
    pub(super) fn of(values: &[Value]) -> Option<Self> {
        let &[
            Value::Double(timestamp),
            Value::Vector6D(actual_q),
            Value::Vector6D(actual_qd),
            Value::Int32(robot_mode),
            Value::Int32(safety_mode),
            Value::Uint32(runtime_state),
        ] = values
        else {
            return None;
        };
        let mut numbers = actual_q.iter().chain(&actual_qd).chain([&timestamp]);
        numbers.all(|number| number.is_finite()).then_some(Self {
            timestamp,
            actual_q,
            actual_qd,
            robot_mode,
            safety_mode,
            runtime_state: i32::try_from(runtime_state).unwrap_or(i32::MAX),
        })
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
