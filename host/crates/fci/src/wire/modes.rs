//! The enumerations of state and Move request.

use spherecal_cyclic::wire_enum;

use super::WireError;

wire_enum! {
    /// What the robot does as a whole.
    RobotMode(u32), "robot_mode" {
        /// None of the others; brakes closed, for example.
        Other = 0, "Other";
        /// Ready for a motion.
        Idle = 1, "Idle";
        /// A motion runs.
        Move = 2, "Move";
        /// A person guides the arm by hand.
        Guiding = 3, "Guiding";
        /// A reflex stopped the robot; it needs an error recovery.
        Reflex = 4, "Reflex";
        /// The user stop (external activation device) is pressed.
        UserStopped = 5, "User stopped";
        /// An automatic error recovery runs.
        AutomaticErrorRecovery = 6, "Automatic error recovery";
    }
}

wire_enum! {
    /// The motion generator in a state.
    MotionGeneratorMode(u32), "motion_generator_mode" {
        /// No motion.
        Idle = 0, "Idle";
        /// Joint positions.
        JointPosition = 1, "Joint position";
        /// Joint velocities. Torque motions before version 7 show this one.
        JointVelocity = 2, "Joint velocity";
        /// Cartesian poses.
        CartesianPosition = 3, "Cartesian position";
        /// Cartesian velocities.
        CartesianVelocity = 4, "Cartesian velocity";
        /// A motion without a generator. Torque motions of version 7 and later show this one.
        None = 5, "None";
    }
}

wire_enum! {
    /// The controller in a state.
    ControllerMode(u32), "controller_mode" {
        /// The robot's own joint impedance.
        JointImpedance = 0, "Joint impedance";
        /// The robot's own Cartesian impedance.
        CartesianImpedance = 1, "Cartesian impedance";
        /// The torques of the client.
        External = 2, "External controller";
        /// None of the others; no motion.
        Other = 3, "Other";
    }
}

wire_enum! {
    /// The controller that a Move request asks for.
    MoveControllerMode(u32), "controller_mode" {
        /// The robot's own joint impedance.
        JointImpedance = 0, "Joint impedance";
        /// The robot's own Cartesian impedance.
        CartesianImpedance = 1, "Cartesian impedance";
        /// The torques of the client.
        External = 2, "External controller";
    }
}

wire_enum! {
    /// The motion generator that a Move request asks for. Its numbers are not those of [`MotionGeneratorMode`].
    MoveGeneratorMode(u32), "motion_generator_mode" {
        /// Joint positions.
        JointPosition = 0, "Joint position";
        /// Joint velocities. Torque motions before version 7 ask for this one and send zeros.
        JointVelocity = 1, "Joint velocity";
        /// Cartesian poses.
        CartesianPosition = 2, "Cartesian position";
        /// Cartesian velocities.
        CartesianVelocity = 3, "Cartesian velocity";
        /// None. Torque motions of version 7 and later ask for this one.
        None = 4, "None";
    }
}

impl MoveGeneratorMode {
    /// What a state shows while a motion with this generator runs.
    pub const fn in_state(self) -> MotionGeneratorMode {
        match self {
            Self::JointPosition => MotionGeneratorMode::JointPosition,
            Self::JointVelocity => MotionGeneratorMode::JointVelocity,
            Self::CartesianPosition => MotionGeneratorMode::CartesianPosition,
            Self::CartesianVelocity => MotionGeneratorMode::CartesianVelocity,
            Self::None => MotionGeneratorMode::None,
        }
    }
}

impl MoveControllerMode {
    /// What a state shows while a motion with this controller runs.
    pub const fn in_state(self) -> ControllerMode {
        match self {
            Self::JointImpedance => ControllerMode::JointImpedance,
            Self::CartesianImpedance => ControllerMode::CartesianImpedance,
            Self::External => ControllerMode::External,
        }
    }
}
