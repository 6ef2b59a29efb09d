//! The 41 error flags of a state.

/// Declares the errors with the names of libfranka's `Errors`, in the order of their bits.
macro_rules! errors {
    ($($number:literal $variant:ident $name:literal $doc:literal;)+) => {
        /// One error flag. Its [`name`](Self::name) is the one in libfranka's `Errors`.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum ErrorFlag { $(#[doc = $doc] $variant = $number,)+ }

        impl ErrorFlag {
            /// All errors, in the order of their bits.
            pub const ALL: [Self; 41] = [$(Self::$variant),+];

            /// The robot's own name of the error.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)+ }
            }
        }
    };
}

errors! {
    0 JointPositionLimitsViolation "joint_position_limits_violation" "A joint left its position limits.";
    1 CartesianPositionLimitsViolation "cartesian_position_limits_violation" "The end effector left its Cartesian limits.";
    2 SelfCollisionAvoidanceViolation "self_collision_avoidance_violation" "The arm came too close to itself.";
    3 JointVelocityViolation "joint_velocity_violation" "A joint was too fast.";
    4 CartesianVelocityViolation "cartesian_velocity_violation" "The end effector was too fast.";
    5 ForceControlSafetyViolation "force_control_safety_violation" "Force control left its safe range.";
    6 JointReflex "joint_reflex" "An external joint torque exceeded its upper threshold.";
    7 CartesianReflex "cartesian_reflex" "An external force exceeded its upper threshold.";
    8 MaxGoalPoseDeviationViolation "max_goal_pose_deviation_violation" "The goal was missed by too much.";
    9 MaxPathPoseDeviationViolation "max_path_pose_deviation_violation" "The path was missed by too much.";
    10 CartesianVelocityProfileSafetyViolation "cartesian_velocity_profile_safety_violation" "The Cartesian velocity profile is not safe.";
    11 JointPositionMotionGeneratorStartPoseInvalid "joint_position_motion_generator_start_pose_invalid" "The joint motion does not start at the arm's pose.";
    12 JointMotionGeneratorPositionLimitsViolation "joint_motion_generator_position_limits_violation" "The joint motion leaves the position limits.";
    13 JointMotionGeneratorVelocityLimitsViolation "joint_motion_generator_velocity_limits_violation" "The joint motion leaves the velocity limits.";
    14 JointMotionGeneratorVelocityDiscontinuity "joint_motion_generator_velocity_discontinuity" "The joint motion's velocity jumps.";
    15 JointMotionGeneratorAccelerationDiscontinuity "joint_motion_generator_acceleration_discontinuity" "The joint motion's acceleration jumps.";
    16 CartesianPositionMotionGeneratorStartPoseInvalid "cartesian_position_motion_generator_start_pose_invalid" "The Cartesian motion does not start at the arm's pose.";
    17 CartesianMotionGeneratorElbowLimitViolation "cartesian_motion_generator_elbow_limit_violation" "The Cartesian motion leaves the elbow's limits.";
    18 CartesianMotionGeneratorVelocityLimitsViolation "cartesian_motion_generator_velocity_limits_violation" "The Cartesian motion leaves the velocity limits.";
    19 CartesianMotionGeneratorVelocityDiscontinuity "cartesian_motion_generator_velocity_discontinuity" "The Cartesian motion's velocity jumps.";
    20 CartesianMotionGeneratorAccelerationDiscontinuity "cartesian_motion_generator_acceleration_discontinuity" "The Cartesian motion's acceleration jumps.";
    21 CartesianMotionGeneratorElbowSignInconsistent "cartesian_motion_generator_elbow_sign_inconsistent" "The Cartesian motion changes the elbow's sign.";
    22 CartesianMotionGeneratorStartElbowInvalid "cartesian_motion_generator_start_elbow_invalid" "The Cartesian motion does not start at the arm's elbow.";
    23 ForceControllerDesiredForceToleranceViolation "force_controller_desired_force_tolerance_violation" "The desired force was missed by too much.";
    24 StartElbowSignInconsistent "start_elbow_sign_inconsistent" "The elbow's sign at the start is inconsistent.";
    25 CommunicationConstraintsViolation "communication_constraints_violation" "Too many commands were late or lost.";
    26 PowerLimitViolation "power_limit_violation" "The commanded power is too high.";
    27 CartesianMotionGeneratorJointPositionLimitsViolation "cartesian_motion_generator_joint_position_limits_violation" "The Cartesian motion leads to a joint beyond its limits.";
    28 CartesianMotionGeneratorJointVelocityLimitsViolation "cartesian_motion_generator_joint_velocity_limits_violation" "The Cartesian motion leads to a joint that is too fast.";
    29 CartesianMotionGeneratorJointVelocityDiscontinuity "cartesian_motion_generator_joint_velocity_discontinuity" "The Cartesian motion leads to a jump of a joint's velocity.";
    30 CartesianMotionGeneratorJointAccelerationDiscontinuity "cartesian_motion_generator_joint_acceleration_discontinuity" "The Cartesian motion leads to a jump of a joint's acceleration.";
    31 CartesianPositionMotionGeneratorInvalidFrame "cartesian_position_motion_generator_invalid_frame" "The commanded pose is no rigid transformation.";
    32 ControllerTorqueDiscontinuity "controller_torque_discontinuity" "The commanded torque changed faster than 1,000 N m/s.";
    33 JointP2pInsufficientTorqueForPlanning "joint_p2p_insufficient_torque_for_planning" "The planned motion needs more torque than there is.";
    34 TauJRangeViolation "tau_j_range_violation" "A measured joint torque left the sensor's range.";
    35 InstabilityDetected "instability_detected" "The robot detected an instability.";
    36 JointMoveInWrongDirection "joint_move_in_wrong_direction" "A joint beyond its limit moved further away from the permitted range.";
    37 CartesianSplineMotionGeneratorViolation "cartesian_spline_motion_generator_violation" "The Cartesian spline motion broke a limit.";
    38 JointViaMotionGeneratorPlanningJointLimitViolation "joint_via_motion_generator_planning_joint_limit_violation" "A planned motion through via points leaves the joint limits.";
    39 BaseAccelerationInitializationTimeout "base_acceleration_initialization_timeout" "The base's acceleration could not be measured in time.";
    40 BaseAccelerationInvalidReading "base_acceleration_invalid_reading" "The base's acceleration reads wrong.";
}

impl ErrorFlag {
    /// The number of the error's flag in a state.
    pub const fn bit(self) -> usize {
        self as usize
    }
}

impl std::fmt::Display for ErrorFlag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A set of errors: the 41 flags of a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ErrorSet(u64);

impl ErrorSet {
    /// Number of flags on the wire, one byte each.
    pub const SIZE: usize = 41;
    /// No error.
    pub const NONE: Self = Self(0);

    /// The set with this one error.
    pub const fn of(error: ErrorFlag) -> Self {
        Self(1 << error.bit())
    }

    /// Whether no flag is set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether this error is in the set.
    pub const fn contains(self, error: ErrorFlag) -> bool {
        self.0 & Self::of(error).0 != 0
    }

    /// Both sets together.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The errors of the set, in the order of their bits.
    pub fn iter(self) -> impl Iterator<Item = ErrorFlag> {
        ErrorFlag::ALL.into_iter().filter(move |e| self.contains(*e))
    }

    /// Sets the error.
    pub const fn insert(&mut self, error: ErrorFlag) {
        self.0 |= Self::of(error).0;
    }

    /// Reads a flag from each byte; any value but 0 is set. A version with fewer flags has the first ones.
    pub(super) fn decode(bytes: &[u8]) -> Self {
        let mut set = Self::NONE;
        for (byte, error) in bytes.iter().zip(ErrorFlag::ALL) {
            if *byte != 0 {
                set.insert(error);
            }
        }
        set
    }

    /// The 41 bytes.
    pub(super) fn encode(self) -> [u8; Self::SIZE] {
        let mut bytes = [0; Self::SIZE];
        for error in self.iter() {
            bytes[error.bit()] = 1;
        }
        bytes
    }
}

impl std::fmt::Display for ErrorSet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.is_empty() {
            return f.write_str("no error");
        }
        for (index, error) in self.iter().enumerate() {
            write!(f, "{}{error}", if index == 0 { "" } else { ", " })?;
        }
        Ok(())
    }
}
