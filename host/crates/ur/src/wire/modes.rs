//! What the robot says of itself: modes, stops, programs, with the maker's numbers and words.
//!
//! Source: `ur/datatypes.h` of the maker's client library. The program's states are not documented by the maker; these are
//! what users measured on robots (forum of Universal Robots, "RTDE `runtime_state` enumeration").

use spherecal_cyclic::wire_enum;

use super::WireError;

wire_enum! {
    /// What the arm does.
    RobotMode(i32), "robot_mode" {
        /// The controller does not answer.
        NoController = -1, "NO_CONTROLLER";
        /// The arm is not connected.
        Disconnected = 0, "DISCONNECTED";
        /// A person has to confirm the safety configuration.
        ConfirmSafety = 1, "CONFIRM_SAFETY";
        /// The controller boots.
        Booting = 2, "BOOTING";
        /// The arm has no power.
        PowerOff = 3, "POWER_OFF";
        /// The arm gets power.
        PowerOn = 4, "POWER_ON";
        /// Power is on, the brakes are closed.
        Idle = 5, "IDLE";
        /// A person moves the arm with released brakes.
        Backdrive = 6, "BACKDRIVE";
        /// Ready for programs and for freedrive.
        Running = 7, "RUNNING";
        /// The firmware is updated.
        UpdatingFirmware = 8, "UPDATING_FIRMWARE";
    }
}

wire_enum! {
    /// What the safety system does.
    SafetyMode(i32), "safety_mode" {
        /// Nothing.
        Normal = 1, "NORMAL";
        /// The reduced limits count.
        Reduced = 2, "REDUCED";
        /// The arm was stopped to protect people or itself.
        ProtectiveStop = 3, "PROTECTIVE_STOP";
        /// The arm is outside of its limits and may be moved back.
        Recovery = 4, "RECOVERY";
        /// A safeguard stops the arm.
        SafeguardStop = 5, "SAFEGUARD_STOP";
        /// An emergency stop of the system.
        SystemEmergencyStop = 6, "SYSTEM_EMERGENCY_STOP";
        /// The robot's emergency stop.
        RobotEmergencyStop = 7, "ROBOT_EMERGENCY_STOP";
        /// A limit of the safety configuration was exceeded.
        Violation = 8, "VIOLATION";
        /// The safety system has a fault.
        Fault = 9, "FAULT";
        /// The joints' identities are checked.
        ValidateJointId = 10, "VALIDATE_JOINT_ID";
        /// None of the others.
        Undefined = 11, "UNDEFINED_SAFETY_MODE";
        /// A safeguard of the automatic mode stops the arm.
        AutomaticModeSafeguardStop = 12, "AUTOMATIC_MODE_SAFEGUARD_STOP";
        /// An enabling device is not held.
        SystemThreePositionEnablingStop = 13, "SYSTEM_THREE_POSITION_ENABLING_STOP";
        /// The enabling device of the teach pendant is not held.
        PendantThreePositionEnablingStop = 14, "TP_THREE_POSITION_ENABLING_STOP";
        /// An emergency stop of an injection moulding machine.
        ImmiEmergencyStop = 15, "IMMI_EMERGENCY_STOP";
        /// A safeguard of an injection moulding machine stops the arm.
        ImmiSafeguardStop = 16, "IMMI_SAFEGUARD_STOP";
        /// The fieldbus PROFIsafe has not sent its parameters.
        ProfisafeWaiting = 17, "PROFISAFE_WAITING_FOR_PARAMETERS";
        /// A safeguard of the automatic mode, by PROFIsafe.
        ProfisafeAutomaticModeSafeguardStop = 18, "PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP";
        /// A safeguard, by PROFIsafe.
        ProfisafeSafeguardStop = 19, "PROFISAFE_SAFEGUARD_STOP";
        /// An emergency stop, by PROFIsafe.
        ProfisafeEmergencyStop = 20, "PROFISAFE_EMERGENCY_STOP";
        /// A safeguard, by the safety interface.
        SafetyApiSafeguardStop = 22, "SAFETY_API_SAFEGUARD_STOP";
    }
}

wire_enum! {
    /// What the robot's program does.
    RuntimeState(i32), "runtime_state" {
        /// It ends.
        Stopping = 0, "STOPPING";
        /// None runs.
        Stopped = 1, "STOPPED";
        /// It runs.
        Playing = 2, "PLAYING";
        /// It will pause.
        Pausing = 3, "PAUSING";
        /// It pauses.
        Paused = 4, "PAUSED";
        /// It goes on.
        Resuming = 5, "RESUMING";
    }
}

/// The maker's word for a number, or the number itself where newer software has a word that is not known here.
pub fn words(name: Result<&'static str, WireError>, number: i32) -> String {
    name.map_or_else(|_| number.to_string(), str::to_owned)
}

/// A generation of controllers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// CB3: software 3, 125 Hz.
    Cb3,
    /// e-Series and newer: software 5 and PolyScope X, 500 Hz.
    ESeries,
}

impl Series {
    /// The series with this major version of the software.
    pub const fn of(major: u32) -> Self {
        if major < 5 { Self::Cb3 } else { Self::ESeries }
    }

    /// The largest rate of data packages, Hz.
    pub const fn rate_hz(self) -> f64 {
        match self {
            Self::Cb3 => 125.0,
            Self::ESeries => 500.0,
        }
    }
}
