//! The enumerations of the interface.

use spherecal_cyclic::wire_enum;

use super::WireError;

wire_enum! {
    /// The state of the session.
    SessionState(u64), "sessionState" {
        /// No session.
        Idle = 0, "IDLE";
        /// The connection is not good enough for commands.
        MonitoringWait = 1, "MONITORING_WAIT";
        /// The connection is good enough for commands.
        MonitoringReady = 2, "MONITORING_READY";
        /// A motion begins: the client has to mirror the interpolated position.
        CommandingWait = 3, "COMMANDING_WAIT";
        /// The robot follows the client's commands.
        CommandingActive = 4, "COMMANDING_ACTIVE";
    }
}

wire_enum! {
    /// How well the client answers.
    Quality(u64), "quality" {
        /// No commands possible.
        Poor = 0, "POOR";
        /// No commands possible.
        Fair = 1, "FAIR";
        /// Good enough for commands.
        Good = 2, "GOOD";
        /// Nearly every message is answered in time.
        Excellent = 3, "EXCELLENT";
    }
}

wire_enum! {
    /// Whether a safety function stops the robot.
    SafetyState(u64), "safetyState" {
        /// Nothing stops the robot.
        NormalOperation = 0, "NORMAL_OPERATION";
        /// A safety stop of level 0.
        StopLevel0 = 1, "SAFETY_STOP_LEVEL_0";
        /// A safety stop of level 1.
        StopLevel1 = 2, "SAFETY_STOP_LEVEL_1";
        /// A safety stop of level 2.
        StopLevel2 = 3, "SAFETY_STOP_LEVEL_2";
    }
}

wire_enum! {
    /// The operating mode that a person has chosen at the pendant.
    OperationMode(u64), "operationMode" {
        /// Manual, reduced velocity.
        T1 = 0, "T1";
        /// Manual, full velocity.
        T2 = 1, "T2";
        /// Automatic.
        Automatic = 2, "AUT";
    }
}

wire_enum! {
    /// The state of a joint's drive.
    DriveState(u64), "driveState" {
        /// Off, brake closed.
        Off = 0, "OFF";
        /// On its way from one to the other.
        Transitioning = 1, "TRANSITIONING";
        /// On.
        Active = 2, "ACTIVE";
    }
}

wire_enum! {
    /// The cabinet's controller.
    ControlMode(u64), "controlMode" {
        /// Position control.
        Position = 0, "POSITION";
        /// Cartesian impedance.
        CartesianImpedance = 1, "CARTESIAN_IMPEDANCE";
        /// Joint impedance: what a torque overlay needs.
        JointImpedance = 2, "JOINT_IMPEDANCE";
        /// No controller.
        None = 3, "NO_CONTROL";
    }
}

wire_enum! {
    /// What the client commands.
    ClientCommandMode(u64), "clientCommandMode" {
        /// Nothing.
        None = 0, "NO_COMMAND_MODE";
        /// Joint positions.
        Position = 1, "POSITION";
        /// A wrench.
        Wrench = 2, "WRENCH";
        /// Joint torques.
        Torque = 3, "TORQUE";
        /// Cartesian poses; from version 2.5 on.
        CartesianPose = 4, "CARTESIAN_POSE";
    }
}

wire_enum! {
    /// What the commands are laid over.
    OverlayType(u64), "overlayType" {
        /// Nothing.
        None = 0, "NO_OVERLAY";
        /// A joint motion.
        Joint = 1, "JOINT";
        /// A Cartesian motion.
        Cartesian = 2, "CARTESIAN";
    }
}
