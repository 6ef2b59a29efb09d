//! The requests of the TCP channel with their arguments.

use super::bytes::FieldReader;
use super::command::{CommandHeader, CommandKind, HEADER_SIZE};
use super::{MoveControllerMode, MoveGeneratorMode, Status, Version, WireError};
use crate::JOINTS;

/// How far a motion may leave its path or goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Translation, m.
    pub translation: f64,
    /// Rotation, rad.
    pub rotation: f64,
    /// Elbow, rad.
    pub elbow: f64,
}

impl Deviation {
    /// What the official clients send with a torque motion: no deviation ends it.
    pub const UNLIMITED: Self = Self {
        translation: 10.0,
        rotation: 3.12,
        elbow: 2.0 * std::f64::consts::PI,
    };
}

/// Asks for a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoveRequest {
    /// Who computes the torques.
    pub controller: MoveControllerMode,
    /// Who computes the motion.
    pub generator: MoveGeneratorMode,
    /// How far the arm may leave the path.
    pub path: Deviation,
    /// How far the arm may miss the goal.
    pub goal: Deviation,
}

impl MoveRequest {
    /// A torque motion: the client's torques; no generator, or before version 7 a joint velocity generator with zeros.
    pub const fn torque(version: Version) -> Self {
        Self {
            controller: MoveControllerMode::External,
            generator: if version.has_torque_finished() {
                MoveGeneratorMode::None
            } else {
                MoveGeneratorMode::JointVelocity
            },
            path: Deviation::UNLIMITED,
            goal: Deviation::UNLIMITED,
        }
    }
}

/// Thresholds of contact (lower) and collision (upper). A collision is a reflex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CollisionBehavior {
    /// Contact while the arm accelerates, by joint, N m.
    pub lower_torque_acceleration: [f64; JOINTS],
    /// Collision while the arm accelerates, by joint, N m.
    pub upper_torque_acceleration: [f64; JOINTS],
    /// Contact at constant velocity, by joint, N m.
    pub lower_torque_nominal: [f64; JOINTS],
    /// Collision at constant velocity, by joint, N m.
    pub upper_torque_nominal: [f64; JOINTS],
    /// Contact while the arm accelerates: x, y, z in N; about x, y, z in N m.
    pub lower_force_acceleration: [f64; 6],
    /// Collision while the arm accelerates: x, y, z in N; about x, y, z in N m.
    pub upper_force_acceleration: [f64; 6],
    /// Contact at constant velocity: x, y, z in N; about x, y, z in N m.
    pub lower_force_nominal: [f64; 6],
    /// Collision at constant velocity: x, y, z in N; about x, y, z in N m.
    pub upper_force_nominal: [f64; 6],
}

impl CollisionBehavior {
    /// The same thresholds at constant velocity and while accelerating.
    pub const fn uniform(
        lower_torque: [f64; JOINTS],
        upper_torque: [f64; JOINTS],
        lower_force: [f64; 6],
        upper_force: [f64; 6],
    ) -> Self {
        Self {
            lower_torque_acceleration: lower_torque,
            upper_torque_acceleration: upper_torque,
            lower_torque_nominal: lower_torque,
            upper_torque_nominal: upper_torque,
            lower_force_acceleration: lower_force,
            upper_force_acceleration: upper_force,
            lower_force_nominal: lower_force,
            upper_force_nominal: upper_force,
        }
    }
}

/// The load at the flange: what the robot's gravity compensation adds to the arm and the end effector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangeLoad {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the flange frame, m.
    pub centre_of_mass: [f64; 3],
    /// Inertia about the centre of mass, column-major, kg m^2.
    pub inertia: [f64; 9],
}

/// A request with its arguments.
#[allow(
    clippy::large_enum_variant,
    reason = "requests are few and short-lived; a box would cost each an allocation"
)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Opens the session.
    Connect {
        /// The version that the client speaks; any number, so that a robot side can refuse it.
        version: u16,
        /// The port to which the robot sends its states.
        udp_port: u16,
    },
    /// Starts a motion.
    Move(MoveRequest),
    /// Ends a motion.
    StopMove,
    /// Asks for a Cartesian limit.
    GetCartesianLimit {
        /// Which one.
        id: i32,
    },
    /// Sets the thresholds of contact and collision.
    SetCollisionBehavior(CollisionBehavior),
    /// Sets the joint stiffness, N m/rad.
    SetJointImpedance([f64; JOINTS]),
    /// Sets the Cartesian stiffness, N/m and N m/rad.
    SetCartesianImpedance([f64; 6]),
    /// Sets which axes a person can guide.
    SetGuidingMode {
        /// x, y, z, about x, about y, about z.
        axes: [bool; 6],
        /// The elbow.
        nullspace: bool,
    },
    /// Sets the stiffness frame in the end effector frame.
    SetEeToK([f64; 16]),
    /// Sets the end effector in the nominal end effector's frame.
    SetNeToEe([f64; 16]),
    /// Sets the load.
    SetLoad(FlangeLoad),
    /// Sets the cut-off frequencies of the robot's filters, Hz.
    SetFilters([f64; 5]),
    /// Clears the errors of a reflex.
    AutomaticErrorRecovery,
    /// Asks for the model library.
    LoadModelLibrary {
        /// The client's processor.
        architecture: u8,
        /// The client's system.
        system: u8,
    },
    /// Asks for the robot model.
    GetRobotModel,
}

/// What the official client of version 10 adds to a Move request: zeros.
const MOVE_TAIL_V10: usize = 57;
const MOVE_SIZE: usize = 56;

impl Request {
    /// Which command this is.
    pub const fn command(&self) -> CommandKind {
        match self {
            Self::Connect { .. } => CommandKind::Connect,
            Self::Move(_) => CommandKind::Move,
            Self::StopMove => CommandKind::StopMove,
            Self::GetCartesianLimit { .. } => CommandKind::GetCartesianLimit,
            Self::SetCollisionBehavior(_) => CommandKind::SetCollisionBehavior,
            Self::SetJointImpedance(_) => CommandKind::SetJointImpedance,
            Self::SetCartesianImpedance(_) => CommandKind::SetCartesianImpedance,
            Self::SetGuidingMode { .. } => CommandKind::SetGuidingMode,
            Self::SetEeToK(_) => CommandKind::SetEeToK,
            Self::SetNeToEe(_) => CommandKind::SetNeToEe,
            Self::SetLoad(_) => CommandKind::SetLoad,
            Self::SetFilters(_) => CommandKind::SetFilters,
            Self::AutomaticErrorRecovery => CommandKind::AutomaticErrorRecovery,
            Self::LoadModelLibrary { .. } => CommandKind::LoadModelLibrary,
            Self::GetRobotModel => CommandKind::GetRobotModel,
        }
    }

    /// Decodes the request with this command number from its payload.
    ///
    /// # Errors
    /// A [`WireError`] if the number has no meaning in this version, the size is wrong, a number is not finite or a
    /// mode has no meaning.
    pub fn decode(version: Version, command: u32, payload: &[u8]) -> Result<Self, WireError> {
        let command = CommandKind::from_number(command, version)?;
        let mut read = FieldReader::new(command.name(), payload);
        let r = &mut read;
        let request = match command {
            CommandKind::Connect => Self::Connect {
                version: r.u16("version")?,
                udp_port: r.u16("udp_port")?,
            },
            CommandKind::Move => {
                let request = MoveRequest {
                    controller: MoveControllerMode::from_number(r.u32("controller_mode")?)?,
                    generator: MoveGeneratorMode::from_number(r.u32("motion_generator_mode")?)?,
                    path: deviation(r, "maximum_path_deviation")?,
                    goal: deviation(r, "maximum_goal_pose_deviation")?,
                };
                // What follows in version 10 concerns motions that this crate does not command.
                if version == Version::V10 && payload.len() == MOVE_SIZE + MOVE_TAIL_V10 {
                    r.skip(MOVE_TAIL_V10);
                }
                Self::Move(request)
            }
            CommandKind::StopMove => Self::StopMove,
            CommandKind::GetCartesianLimit => Self::GetCartesianLimit {
                id: i32::from_le_bytes(r.u32("id")?.to_le_bytes()),
            },
            CommandKind::SetCollisionBehavior => Self::SetCollisionBehavior(CollisionBehavior {
                lower_torque_acceleration: r.finite("lower_torque_thresholds_acceleration")?,
                upper_torque_acceleration: r.finite("upper_torque_thresholds_acceleration")?,
                lower_torque_nominal: r.finite("lower_torque_thresholds_nominal")?,
                upper_torque_nominal: r.finite("upper_torque_thresholds_nominal")?,
                lower_force_acceleration: r.finite("lower_force_thresholds_acceleration")?,
                upper_force_acceleration: r.finite("upper_force_thresholds_acceleration")?,
                lower_force_nominal: r.finite("lower_force_thresholds_nominal")?,
                upper_force_nominal: r.finite("upper_force_thresholds_nominal")?,
            }),
            CommandKind::SetJointImpedance => Self::SetJointImpedance(r.finite("K_theta")?),
            CommandKind::SetCartesianImpedance => Self::SetCartesianImpedance(r.finite("K_x")?),
            CommandKind::SetGuidingMode => {
                let mut axes = [false; 6];
                for axis in &mut axes {
                    *axis = r.bool("guiding_mode")?;
                }
                let nullspace = r.bool("nullspace")?;
                Self::SetGuidingMode { axes, nullspace }
            }
            CommandKind::SetEeToK => Self::SetEeToK(r.finite("EE_T_K")?),
            CommandKind::SetNeToEe => Self::SetNeToEe(r.finite("NE_T_EE")?),
            CommandKind::SetLoad => Self::SetLoad(FlangeLoad {
                mass: r.finite::<1>("m_load")?[0],
                centre_of_mass: r.finite("F_x_Cload")?,
                inertia: r.finite("I_load")?,
            }),
            CommandKind::SetFilters => Self::SetFilters(r.finite("filter_frequencies")?),
            CommandKind::AutomaticErrorRecovery => Self::AutomaticErrorRecovery,
            CommandKind::LoadModelLibrary => Self::LoadModelLibrary {
                architecture: r.u8("architecture")?,
                system: r.u8("system")?,
            },
            CommandKind::GetRobotModel => Self::GetRobotModel,
        };
        read.end()?;
        Ok(request)
    }

    /// Appends header and payload of the request to `out`.
    ///
    /// # Errors
    /// [`WireError::NotInVersion`] if the version does not have the command.
    pub fn encode(&self, version: Version, id: u32, out: &mut Vec<u8>) -> Result<(), WireError> {
        let command = self.command().number(version)?;
        let start = out.len();
        out.extend_from_slice(&[0; HEADER_SIZE]);
        self.payload(version, out);
        let size = (out.len() - start) as u32;
        out[start..start + HEADER_SIZE].copy_from_slice(&CommandHeader { command, id, size }.encode());
        Ok(())
    }

    fn payload(&self, version: Version, out: &mut Vec<u8>) {
        match self {
            Self::Connect { version, udp_port } => {
                out.extend_from_slice(&version.to_le_bytes());
                out.extend_from_slice(&udp_port.to_le_bytes());
            }
            Self::Move(request) => {
                out.extend_from_slice(&request.controller.number().to_le_bytes());
                out.extend_from_slice(&request.generator.number().to_le_bytes());
                for deviation in [&request.path, &request.goal] {
                    numbers(out, &[deviation.translation, deviation.rotation, deviation.elbow]);
                }
                if version == Version::V10 {
                    out.extend_from_slice(&[0; MOVE_TAIL_V10]);
                }
            }
            Self::GetCartesianLimit { id } => out.extend_from_slice(&id.to_le_bytes()),
            Self::SetCollisionBehavior(b) => {
                numbers(out, &b.lower_torque_acceleration);
                numbers(out, &b.upper_torque_acceleration);
                numbers(out, &b.lower_torque_nominal);
                numbers(out, &b.upper_torque_nominal);
                numbers(out, &b.lower_force_acceleration);
                numbers(out, &b.upper_force_acceleration);
                numbers(out, &b.lower_force_nominal);
                numbers(out, &b.upper_force_nominal);
            }
            Self::SetJointImpedance(stiffness) => numbers(out, stiffness),
            Self::SetCartesianImpedance(stiffness) => numbers(out, stiffness),
            Self::SetGuidingMode { axes, nullspace } => {
                out.extend(axes.iter().map(|a| u8::from(*a)));
                out.push((*nullspace).into());
            }
            Self::SetEeToK(pose) | Self::SetNeToEe(pose) => numbers(out, pose),
            Self::SetLoad(load) => {
                numbers(out, &[load.mass]);
                numbers(out, &load.centre_of_mass);
                numbers(out, &load.inertia);
            }
            Self::SetFilters(frequencies) => numbers(out, frequencies),
            Self::LoadModelLibrary { architecture, system } => out.extend_from_slice(&[*architecture, *system]),
            Self::StopMove | Self::AutomaticErrorRecovery | Self::GetRobotModel => {}
        }
    }
}

fn deviation(read: &mut FieldReader<'_>, field: &'static str) -> Result<Deviation, WireError> {
    let [translation, rotation, elbow] = read.finite(field)?;
    Ok(Deviation {
        translation,
        rotation,
        elbow,
    })
}

fn numbers(out: &mut Vec<u8>, values: &[f64]) {
    for value in values {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

/// The answer to Connect. It is decoded without a version, because it is what the version is agreed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectAnswer {
    /// Whether the robot accepts the client.
    pub status: Status,
    /// The version that the robot speaks; any number.
    pub version: u16,
}

impl ConnectAnswer {
    /// Decodes the payload: 3 bytes.
    ///
    /// # Errors
    /// A [`WireError`] for another length or a status without meaning.
    pub fn decode(payload: &[u8]) -> Result<Self, WireError> {
        let mut read = FieldReader::new("Connect response", payload);
        // The statuses of Connect are the same in every version.
        let status = Status::from_number(read.u8("status")?, CommandKind::Connect, Version::V10)?;
        let version = read.u16("version")?;
        read.end()?;
        Ok(Self { status, version })
    }

    /// The bytes after the status: what the robot side sends as the body of its response.
    pub const fn body(&self) -> [u8; 2] {
        self.version.to_le_bytes()
    }
}
