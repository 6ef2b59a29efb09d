//! The two messages of the 1 kHz channel: the robot's state and the client's command.

use super::bytes::{FieldReader, FieldWriter};
use super::{ControllerMode, ErrorSet, MotionGeneratorMode, RobotMode, Version, WireError};
use crate::JOINTS;

/// The largest state of any version, bytes.
pub const MAX_STATE_SIZE: usize = 2373;
/// The largest command of any version, bytes.
pub const MAX_COMMAND_SIZE: usize = 371;

/// A field of numbers as a slice, whether it is one number or several.
trait NumberField {
    fn numbers(&self) -> &[f64];
    fn numbers_mut(&mut self) -> &mut [f64];
}

impl NumberField for f64 {
    fn numbers(&self) -> &[f64] {
        std::slice::from_ref(self)
    }
    fn numbers_mut(&mut self) -> &mut [f64] {
        std::slice::from_mut(self)
    }
}

impl<const N: usize> NumberField for [f64; N] {
    fn numbers(&self) -> &[f64] {
        self
    }
    fn numbers_mut(&mut self) -> &mut [f64] {
        self
    }
}

/// A field of numbers in the state: where it stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateField {
    /// The maker's name.
    pub name: &'static str,
    /// How many numbers the field has.
    pub count: usize,
    /// Whether a number that is not finite is refused.
    pub checked: bool,
    /// The first version that has the field.
    pub since: Version,
}

impl StateField {
    /// Whether a state of this version has the field.
    pub fn is_in(&self, version: Version) -> bool {
        version >= self.since
    }

    /// The field's first byte in a state of this version, or where it would stand.
    pub fn offset(&self, version: Version) -> usize {
        let size = if version.single_precision() { 4 } else { 8 };
        let before = RobotState::FIELDS.iter().take_while(|field| field.name != self.name);
        let numbers: usize = before.filter(|f| f.is_in(version)).map(|f| f.count).sum();
        8 + size * numbers
    }
}

/// Declares the fields of the state in their order on the wire.
macro_rules! state {
    ($($name:ident: $kind:ty, $count:literal, $checked:ident, $since:ident, $doc:literal;)+) => {
        /// What the robot measures and does, once each millisecond.
        ///
        /// Frames: O the robot's base, F the flange, NE the nominal end effector, EE the end effector, K the stiffness
        /// frame. `A_T_B` is the pose of frame B in frame A, a column-major 4 x 4 matrix.
        #[allow(non_snake_case, reason = "the names are those of the maker's documentation")]
        #[derive(Clone, Debug, PartialEq)]
        pub struct RobotState {
            /// The robot's clock, ms. The command that answers the state repeats it.
            pub message_id: u64,
            $(#[doc = $doc] pub $name: $kind,)+
            /// The motion generator that runs.
            pub motion_generator_mode: MotionGeneratorMode,
            /// The controller that runs.
            pub controller_mode: ControllerMode,
            /// The errors that are active now.
            pub errors: ErrorSet,
            /// The errors that ended the last motion.
            pub reflex_reason: ErrorSet,
            /// What the robot does as a whole.
            pub robot_mode: RobotMode,
            /// Share of the last 100 commands that arrived in time, 0 to 1; 0 while no motion runs.
            pub control_command_success_rate: f64,
        }

        impl RobotState {
            /// The fields of numbers, in the order of the wire.
            pub const FIELDS: &'static [StateField] = &[$(StateField {
                name: stringify!($name), count: $count, checked: $checked, since: Version::$since,
            }),+];

            /// The numbers of all fields, in the order of [`FIELDS`](Self::FIELDS).
            pub fn numbers(&self) -> [&[f64]; Self::FIELDS.len()] {
                [$(self.$name.numbers()),+]
            }

            /// The numbers of all fields, to be written.
            pub fn numbers_mut(&mut self) -> [&mut [f64]; Self::FIELDS.len()] {
                [$(self.$name.numbers_mut()),+]
            }
        }

        impl Default for RobotState {
            /// A robot that stands still in the zero pose with closed brakes: poses are the identity, numbers are 0.
            fn default() -> Self {
                let mut state = Self {
                    message_id: 0,
                    $($name: Default::default(),)+
                    motion_generator_mode: MotionGeneratorMode::Idle,
                    controller_mode: ControllerMode::Other,
                    errors: ErrorSet::NONE,
                    reflex_reason: ErrorSet::NONE,
                    robot_mode: RobotMode::Other,
                    control_command_success_rate: 0.0,
                };
                for numbers in state.numbers_mut() {
                    if let Ok(pose) = <&mut [f64; 16]>::try_from(numbers) {
                        *pose = IDENTITY;
                    }
                }
                state
            }
        }
    };
}

pub(crate) const IDENTITY: [f64; 16] = [
    1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
];

state! {
    O_T_EE: [f64; 16], 16, true, V4, "Measured pose of the end effector.";
    O_T_EE_d: [f64; 16], 16, false, V4, "Desired pose of the end effector.";
    F_T_EE: [f64; 16], 16, true, V4, "End effector in the flange frame.";
    EE_T_K: [f64; 16], 16, true, V4, "Stiffness frame in the end effector frame.";
    F_T_NE: [f64; 16], 16, true, V4, "Nominal end effector in the flange frame, as set in Desk.";
    NE_T_EE: [f64; 16], 16, true, V4, "End effector in the nominal end effector's frame.";
    m_ee: f64, 1, true, V4, "Mass of the end effector as set in Desk, kg.";
    I_ee: [f64; 9], 9, true, V4, "Inertia of the end effector about its centre of mass, kg m^2, column-major.";
    F_x_Cee: [f64; 3], 3, true, V4, "Centre of mass of the end effector in the flange frame, m.";
    m_load: f64, 1, true, V4, "Mass of the load as set by `SetLoad`, kg.";
    I_load: [f64; 9], 9, true, V4, "Inertia of the load about its centre of mass, kg m^2, column-major.";
    F_x_Cload: [f64; 3], 3, true, V4, "Centre of mass of the load in the flange frame, m.";
    elbow: [f64; 2], 2, false, V4, "Position of joint 3, rad, and sign of joint 4.";
    elbow_d: [f64; 2], 2, false, V4, "Desired elbow.";
    tau_J: [f64; 7], 7, true, V4, "Measured link-side joint torques, gravity included, N m.";
    tau_J_d: [f64; 7], 7, true, V4, "Desired joint torques, without gravity and friction, N m.";
    dtau_J: [f64; 7], 7, true, V4, "Derivative of the measured torques, N m/s.";
    q: [f64; 7], 7, true, V4, "Measured joint positions, motor side, rad.";
    q_d: [f64; 7], 7, true, V4, "Desired joint positions, rad.";
    dq: [f64; 7], 7, true, V4, "Measured joint velocities, rad/s.";
    dq_d: [f64; 7], 7, true, V4, "Desired joint velocities, rad/s.";
    ddq_d: [f64; 7], 7, false, V4, "Desired joint accelerations, rad/s^2.";
    joint_contact: [f64; 7], 7, false, V4, "1 where a joint torque exceeds its lower threshold (contact).";
    cartesian_contact: [f64; 6], 6, false, V4, "1 where a force exceeds its lower threshold (contact).";
    joint_collision: [f64; 7], 7, false, V4, "1 where a joint torque exceeds its upper threshold (collision).";
    cartesian_collision: [f64; 6], 6, false, V4, "1 where a force exceeds its upper threshold (collision).";
    tau_ext_hat_filtered: [f64; 7], 7, true, V4, "Estimate of the external joint torques, low-pass filtered, N m.";
    O_F_ext_hat_K: [f64; 6], 6, true, V4, "Estimate of the external wrench on K, in the base frame, N and N m.";
    K_F_ext_hat_K: [f64; 6], 6, true, V4, "The same in the frame K.";
    O_dP_EE_d: [f64; 6], 6, false, V4, "Desired twist of the end effector, m/s and rad/s.";
    O_ddP_O: [f64; 3], 3, false, V5, "Acceleration of the base, gravity included, m/s^2.";
    elbow_c: [f64; 2], 2, false, V4, "Commanded elbow.";
    delbow_c: [f64; 2], 2, false, V4, "Velocity of the commanded elbow.";
    ddelbow_c: [f64; 2], 2, false, V4, "Acceleration of the commanded elbow.";
    O_T_EE_c: [f64; 16], 16, false, V4, "Commanded pose of the end effector.";
    O_dP_EE_c: [f64; 6], 6, false, V4, "Commanded twist of the end effector, m/s and rad/s.";
    O_ddP_EE_c: [f64; 6], 6, false, V4, "Commanded acceleration of the end effector, m/s^2 and rad/s^2.";
    theta: [f64; 7], 7, true, V4, "Motor positions at the joint, rad.";
    dtheta: [f64; 7], 7, true, V4, "Motor velocities at the joint, rad/s.";
    accelerometer_top: [f64; 18], 18, false, V10, "Accelerations of the links 1 to 6 by their upper sensors, x, y and z of each, m/s^2.";
    accelerometer_bottom: [f64; 18], 18, false, V10, "The same by their lower sensors, m/s^2.";
}

impl RobotState {
    /// Decodes a state of this version.
    ///
    /// # Errors
    /// - [`WireError::Length`] if the bytes are not exactly one state of this version;
    /// - [`WireError::UnknownValue`] for a mode without meaning;
    /// - [`WireError::NotFinite`] for a number that is not finite in a field that [`StateField::checked`] names:
    ///   everything measured or configured. The desired and commanded Cartesian fields are not checked, because the
    ///   robot may leave them unset and this crate does not use them.
    pub fn decode(version: Version, bytes: &[u8]) -> Result<Self, WireError> {
        if bytes.len() != version.state_size() {
            return Err(WireError::Length {
                message: "robot state",
                expected: version.state_size(),
                got: bytes.len(),
            });
        }
        let single = version.single_precision();
        let mut read = FieldReader::new("robot state", bytes);
        let mut state = Self {
            message_id: read.u64("message_id")?,
            ..Self::default()
        };
        let fields = Self::FIELDS.iter().zip(state.numbers_mut());
        for (field, numbers) in fields.filter(|(field, _)| field.is_in(version)) {
            for (index, number) in numbers.iter_mut().enumerate() {
                *number = if single {
                    read.f32(field.name)?
                } else {
                    read.f64(field.name)?
                };
                if field.checked && !number.is_finite() {
                    return Err(WireError::NotFinite {
                        field: field.name,
                        index,
                    });
                }
            }
        }
        state.motion_generator_mode = MotionGeneratorMode::from_number(read.u8("motion_generator_mode")?.into())?;
        state.controller_mode = ControllerMode::from_number(read.u8("controller_mode")?.into())?;
        for set in [&mut state.errors, &mut state.reflex_reason] {
            let flags = read.rest().get(..version.error_flags()).unwrap_or_default();
            *set = ErrorSet::decode(flags);
            read.skip(version.error_flags());
        }
        state.robot_mode = RobotMode::from_number(read.u8("robot_mode")?.into())?;
        let field = "control_command_success_rate";
        state.control_command_success_rate = if single { read.f32(field)? } else { read.f64(field)? };
        if !state.control_command_success_rate.is_finite() {
            return Err(WireError::NotFinite { field, index: 0 });
        }
        read.end()?;
        Ok(state)
    }

    /// Encodes the state for this version; returns its size in bytes.
    ///
    /// Version 10 rounds every number to 32 bits. Fields and errors that the version does not have are left out.
    pub fn encode(&self, version: Version, out: &mut [u8; MAX_STATE_SIZE]) -> usize {
        let single = version.single_precision();
        let mut write = FieldWriter::new(out);
        write.put(&self.message_id.to_le_bytes());
        let put = |write: &mut FieldWriter<'_>, numbers: &[f64]| {
            if single {
                write.f32s(numbers);
            } else {
                write.f64s(numbers);
            }
        };
        let fields = Self::FIELDS.iter().zip(self.numbers());
        for (_, numbers) in fields.filter(|(field, _)| field.is_in(version)) {
            put(&mut write, numbers);
        }
        write.put(&[
            self.motion_generator_mode.number() as u8,
            self.controller_mode.number() as u8,
        ]);
        for errors in [self.errors, self.reflex_reason] {
            write.put(errors.encode().get(..version.error_flags()).unwrap_or_default());
        }
        write.put(&[self.robot_mode.number() as u8]);
        put(&mut write, &[self.control_command_success_rate]);
        debug_assert_eq!(write.written(), version.state_size());
        write.written()
    }

    /// Whether a torque motion of this version runs: mode Move, external controller, the version's motion generator.
    pub fn torque_motion_runs(&self, version: Version) -> bool {
        let generator = if version.has_torque_finished() {
            MotionGeneratorMode::None
        } else {
            MotionGeneratorMode::JointVelocity
        };
        self.robot_mode == RobotMode::Move
            && self.controller_mode == ControllerMode::External
            && self.motion_generator_mode == generator
    }
}

/// The client's answer to a state.
#[allow(non_snake_case, reason = "the names are those of the maker's documentation")]
#[derive(Clone, Debug, PartialEq)]
pub struct RobotCommand {
    /// The `message_id` of the state that this answers.
    pub message_id: u64,
    /// Commanded joint positions, rad.
    pub q_c: [f64; JOINTS],
    /// Commanded joint velocities, rad/s.
    pub dq_c: [f64; JOINTS],
    /// Commanded pose of the end effector.
    pub O_T_EE_c: [f64; 16],
    /// Commanded twist of the end effector, m/s and rad/s.
    pub O_dP_EE_c: [f64; 6],
    /// Commanded elbow.
    pub elbow_c: [f64; 2],
    /// Whether `elbow_c` is to be used.
    pub valid_elbow: bool,
    /// Ends the motion generator's motion. Torque motions end with it before version 7.
    pub motion_generation_finished: bool,
    /// Desired joint torques, without gravity and friction, N m.
    pub tau_J_d: [f64; JOINTS],
    /// Ends a torque motion. On the wire from version 7 on.
    pub torque_command_finished: bool,
}

impl RobotCommand {
    /// A torque command that answers the state `message_id`. All other fields are 0, as the official clients send them.
    pub const fn torque(message_id: u64, torque: [f64; JOINTS]) -> Self {
        Self {
            message_id,
            q_c: [0.0; JOINTS],
            dq_c: [0.0; JOINTS],
            O_T_EE_c: [0.0; 16],
            O_dP_EE_c: [0.0; 6],
            elbow_c: [0.0; 2],
            valid_elbow: false,
            motion_generation_finished: false,
            tau_J_d: torque,
            torque_command_finished: false,
        }
    }

    /// The same command with the flag that ends a torque motion in this version.
    #[must_use]
    pub const fn finished(mut self, version: Version) -> Self {
        if version.has_torque_finished() {
            self.torque_command_finished = true;
        } else {
            self.motion_generation_finished = true;
        }
        self
    }

    /// Whether the command ends a torque motion.
    pub const fn finishes(&self) -> bool {
        self.torque_command_finished || self.motion_generation_finished
    }

    /// Decodes a command of this version.
    ///
    /// # Errors
    /// [`WireError::Length`] for another size, [`WireError::NotFinite`] for a number that is not finite.
    pub fn decode(version: Version, bytes: &[u8]) -> Result<Self, WireError> {
        if bytes.len() != version.command_size() {
            return Err(WireError::Length {
                message: "robot command",
                expected: version.command_size(),
                got: bytes.len(),
            });
        }
        let mut read = FieldReader::new("robot command", bytes);
        let command = Self {
            message_id: read.u64("message_id")?,
            q_c: read.finite("q_c")?,
            dq_c: read.finite("dq_c")?,
            O_T_EE_c: read.finite("O_T_EE_c")?,
            O_dP_EE_c: read.finite("O_dP_EE_c")?,
            elbow_c: read.finite("elbow_c")?,
            valid_elbow: read.bool("valid_elbow")?,
            motion_generation_finished: read.bool("motion_generation_finished")?,
            tau_J_d: read.finite("tau_J_d")?,
            torque_command_finished: version.has_torque_finished() && read.bool("torque_command_finished")?,
        };
        read.end()?;
        Ok(command)
    }

    /// Encodes the command for this version; returns its size in bytes.
    pub fn encode(&self, version: Version, out: &mut [u8; MAX_COMMAND_SIZE]) -> usize {
        let mut write = FieldWriter::new(out);
        write.put(&self.message_id.to_le_bytes());
        write.f64s(&self.q_c);
        write.f64s(&self.dq_c);
        write.f64s(&self.O_T_EE_c);
        write.f64s(&self.O_dP_EE_c);
        write.f64s(&self.elbow_c);
        write.put(&[self.valid_elbow.into(), self.motion_generation_finished.into()]);
        write.f64s(&self.tau_J_d);
        if version.has_torque_finished() {
            write.put(&[self.torque_command_finished.into()]);
        }
        debug_assert_eq!(write.written(), version.command_size());
        write.written()
    }
}
