//! The 41 error flags of a state.

use spherecal_cyclic::named_enum;

named_enum! {
    /// One error flag, in the order of the bits. Its [`name`](Self::name) is the one in libfranka's `Errors`.
    ErrorFlag {
        #[doc = "A joint left its position limits."] JointPositionLimitsViolation = 0, "joint_position_limits_violation";
        #[doc = "The end effector left its Cartesian limits."] CartesianPositionLimitsViolation = 1, "cartesian_position_limits_violation";
        #[doc = "The arm came too close to itself."] SelfCollisionAvoidanceViolation = 2, "self_collision_avoidance_violation";
        #[doc = "A joint was too fast."] JointVelocityViolation = 3, "joint_velocity_violation";
        #[doc = "The end effector was too fast."] CartesianVelocityViolation = 4, "cartesian_velocity_violation";
        #[doc = "Force control left its safe range."] ForceControlSafetyViolation = 5, "force_control_safety_violation";
        #[doc = "An external joint torque exceeded its upper threshold."] JointReflex = 6, "joint_reflex";
        #[doc = "An external force exceeded its upper threshold."] CartesianReflex = 7, "cartesian_reflex";
        #[doc = "The goal was missed by too much."] MaxGoalPoseDeviationViolation = 8, "max_goal_pose_deviation_violation";
        #[doc = "The path was missed by too much."] MaxPathPoseDeviationViolation = 9, "max_path_pose_deviation_violation";
        #[doc = "The Cartesian velocity profile is not safe."] CartesianVelocityProfileSafetyViolation = 10, "cartesian_velocity_profile_safety_violation";
        #[doc = "The joint motion does not start at the arm's pose."] JointPositionMotionGeneratorStartPoseInvalid = 11, "joint_position_motion_generator_start_pose_invalid";
        #[doc = "The joint motion leaves the position limits."] JointMotionGeneratorPositionLimitsViolation = 12, "joint_motion_generator_position_limits_violation";
        #[doc = "The joint motion leaves the velocity limits."] JointMotionGeneratorVelocityLimitsViolation = 13, "joint_motion_generator_velocity_limits_violation";
        #[doc = "The joint motion's velocity jumps."] JointMotionGeneratorVelocityDiscontinuity = 14, "joint_motion_generator_velocity_discontinuity";
        #[doc = "The joint motion's acceleration jumps."] JointMotionGeneratorAccelerationDiscontinuity = 15, "joint_motion_generator_acceleration_discontinuity";
        #[doc = "The Cartesian motion does not start at the arm's pose."] CartesianPositionMotionGeneratorStartPoseInvalid = 16, "cartesian_position_motion_generator_start_pose_invalid";
        #[doc = "The Cartesian motion leaves the elbow's limits."] CartesianMotionGeneratorElbowLimitViolation = 17, "cartesian_motion_generator_elbow_limit_violation";
        #[doc = "The Cartesian motion leaves the velocity limits."] CartesianMotionGeneratorVelocityLimitsViolation = 18, "cartesian_motion_generator_velocity_limits_violation";
        #[doc = "The Cartesian motion's velocity jumps."] CartesianMotionGeneratorVelocityDiscontinuity = 19, "cartesian_motion_generator_velocity_discontinuity";
        #[doc = "The Cartesian motion's acceleration jumps."] CartesianMotionGeneratorAccelerationDiscontinuity = 20, "cartesian_motion_generator_acceleration_discontinuity";
        #[doc = "The Cartesian motion changes the elbow's sign."] CartesianMotionGeneratorElbowSignInconsistent = 21, "cartesian_motion_generator_elbow_sign_inconsistent";
        #[doc = "The Cartesian motion does not start at the arm's elbow."] CartesianMotionGeneratorStartElbowInvalid = 22, "cartesian_motion_generator_start_elbow_invalid";
        #[doc = "The desired force was missed by too much."] ForceControllerDesiredForceToleranceViolation = 23, "force_controller_desired_force_tolerance_violation";
        #[doc = "The elbow's sign at the start is inconsistent."] StartElbowSignInconsistent = 24, "start_elbow_sign_inconsistent";
        #[doc = "Too many commands were late or lost."] CommunicationConstraintsViolation = 25, "communication_constraints_violation";
        #[doc = "The commanded power is too high."] PowerLimitViolation = 26, "power_limit_violation";
        #[doc = "The Cartesian motion leads to a joint beyond its limits."] CartesianMotionGeneratorJointPositionLimitsViolation = 27, "cartesian_motion_generator_joint_position_limits_violation";
        #[doc = "The Cartesian motion leads to a joint that is too fast."] CartesianMotionGeneratorJointVelocityLimitsViolation = 28, "cartesian_motion_generator_joint_velocity_limits_violation";
        #[doc = "The Cartesian motion leads to a jump of a joint's velocity."] CartesianMotionGeneratorJointVelocityDiscontinuity = 29, "cartesian_motion_generator_joint_velocity_discontinuity";
        #[doc = "The Cartesian motion leads to a jump of a joint's acceleration."] CartesianMotionGeneratorJointAccelerationDiscontinuity = 30, "cartesian_motion_generator_joint_acceleration_discontinuity";
        #[doc = "The commanded pose is no rigid transformation."] CartesianPositionMotionGeneratorInvalidFrame = 31, "cartesian_position_motion_generator_invalid_frame";
        #[doc = "The commanded torque changed faster than 1,000 N m/s."] ControllerTorqueDiscontinuity = 32, "controller_torque_discontinuity";
        #[doc = "The planned motion needs more torque than there is."] JointP2pInsufficientTorqueForPlanning = 33, "joint_p2p_insufficient_torque_for_planning";
        #[doc = "A measured joint torque left the sensor's range."] TauJRangeViolation = 34, "tau_j_range_violation";
        #[doc = "The robot detected an instability."] InstabilityDetected = 35, "instability_detected";
        #[doc = "A joint beyond its limit moved further away from the permitted range."] JointMoveInWrongDirection = 36, "joint_move_in_wrong_direction";
        #[doc = "The Cartesian spline motion broke a limit."] CartesianSplineMotionGeneratorViolation = 37, "cartesian_spline_motion_generator_violation";
        #[doc = "A planned motion through via points leaves the joint limits."] JointViaMotionGeneratorPlanningJointLimitViolation = 38, "joint_via_motion_generator_planning_joint_limit_violation";
        #[doc = "The base's acceleration could not be measured in time."] BaseAccelerationInitializationTimeout = 39, "base_acceleration_initialization_timeout";
        #[doc = "The base's acceleration reads wrong."] BaseAccelerationInvalidReading = 40, "base_acceleration_invalid_reading";
    }
}

impl ErrorFlag {
    /// The number of the error's flag in a state.
    pub const fn bit(self) -> usize {
        self as usize
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
        ErrorFlag::ALL.iter().copied().filter(move |e| self.contains(*e))
    }

    /// Sets the error.
    pub const fn insert(&mut self, error: ErrorFlag) {
        self.0 |= Self::of(error).0;
    }

    /// Reads a flag from each byte; any value but 0 is set. A version with fewer flags has the first ones.
    pub(super) fn decode(bytes: &[u8]) -> Self {
        let mut set = Self::NONE;
        for (byte, error) in bytes.iter().zip(ErrorFlag::ALL.iter().copied()) {
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
