//! The commands of the TCP channel, their numbers, and the header.

use super::{Version, WireError};

/// Size of a header, bytes.
pub const HEADER_SIZE: usize = 12;
/// The largest request that a robot side takes, bytes. The largest real one, `SetCollisionBehavior`, has 428.
pub const MAX_REQUEST: usize = 4096;

/// A command of the TCP channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CommandKind {
    /// Opens the session and names the client's UDP port.
    Connect,
    /// Starts a motion.
    Move,
    /// Ends a motion.
    StopMove,
    /// Asks for a Cartesian limit (version 5 only).
    GetCartesianLimit,
    /// Sets the thresholds of contact and collision.
    SetCollisionBehavior,
    /// Sets the stiffness of the robot's own joint impedance.
    SetJointImpedance,
    /// Sets the stiffness of the robot's own Cartesian impedance.
    SetCartesianImpedance,
    /// Sets which axes a person can guide.
    SetGuidingMode,
    /// Sets the stiffness frame.
    SetEeToK,
    /// Sets the end effector frame.
    SetNeToEe,
    /// Sets the load's mass, centre of mass and inertia.
    SetLoad,
    /// Sets the robot's filters (up to version 5).
    SetFilters,
    /// Clears the errors of a reflex.
    AutomaticErrorRecovery,
    /// Asks for the model library (gone in version 10).
    LoadModelLibrary,
    /// Asks for the robot model in URDF (version 8 and later).
    GetRobotModel,
}

impl CommandKind {
    /// All commands. Those of a version keep this order, and are numbered from 0.
    const ALL: [Self; 15] = [
        Self::Connect,
        Self::Move,
        Self::StopMove,
        Self::GetCartesianLimit,
        Self::SetCollisionBehavior,
        Self::SetJointImpedance,
        Self::SetCartesianImpedance,
        Self::SetGuidingMode,
        Self::SetEeToK,
        Self::SetNeToEe,
        Self::SetLoad,
        Self::SetFilters,
        Self::AutomaticErrorRecovery,
        Self::LoadModelLibrary,
        Self::GetRobotModel,
    ];

    /// The commands of this version, in the order of their numbers.
    pub fn all(version: Version) -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(move |command| match command {
            Self::GetCartesianLimit | Self::SetFilters => version.is_panda(),
            Self::LoadModelLibrary => version < Version::V10,
            Self::GetRobotModel => version >= Version::V8,
            _ => true,
        })
    }

    /// The command's number in this version.
    ///
    /// # Errors
    /// [`WireError::NotInVersion`] if the version does not have it.
    pub fn number(self, version: Version) -> Result<u32, WireError> {
        let place = Self::all(version).position(|command| command == self);
        place.map(|p| p as u32).ok_or(WireError::NotInVersion {
            command: self.name(),
            version,
        })
    }

    /// The command with this number in this version.
    ///
    /// # Errors
    /// [`WireError::UnknownCommand`] for a number without meaning.
    pub fn from_number(number: u32, version: Version) -> Result<Self, WireError> {
        let command = usize::try_from(number).ok().and_then(|n| Self::all(version).nth(n));
        command.ok_or(WireError::UnknownCommand { number, version })
    }

    /// The maker's name of the command.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Connect => "Connect",
            Self::Move => "Move",
            Self::StopMove => "StopMove",
            Self::GetCartesianLimit => "GetCartesianLimit",
            Self::SetCollisionBehavior => "SetCollisionBehavior",
            Self::SetJointImpedance => "SetJointImpedance",
            Self::SetCartesianImpedance => "SetCartesianImpedance",
            Self::SetGuidingMode => "SetGuidingMode",
            Self::SetEeToK => "SetEEToK",
            Self::SetNeToEe => "SetNEToEE",
            Self::SetLoad => "SetLoad",
            Self::SetFilters => "SetFilters",
            Self::AutomaticErrorRecovery => "AutomaticErrorRecovery",
            Self::LoadModelLibrary => "LoadModelLibrary",
            Self::GetRobotModel => "GetRobotModel",
        }
    }
}

impl std::fmt::Display for CommandKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The head of every request and response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandHeader {
    /// The command's number; what it means depends on the version.
    pub command: u32,
    /// Chosen by the client; the response repeats it.
    pub id: u32,
    /// Size of the whole message, this header included, bytes.
    pub size: u32,
}

impl CommandHeader {
    /// Decodes a header. `most` is the largest message that the receiver takes, bytes.
    ///
    /// # Errors
    /// [`WireError::Short`] for fewer than 12 bytes, [`WireError::Size`] for an impossible size.
    pub fn decode(bytes: &[u8], most: usize) -> Result<Self, WireError> {
        let mut read = super::bytes::FieldReader::new("header", bytes);
        let header = Self {
            command: read.u32("command")?,
            id: read.u32("command_id")?,
            size: read.u32("size")?,
        };
        if (HEADER_SIZE..=most).contains(&(header.size as usize)) {
            Ok(header)
        } else {
            Err(WireError::Size {
                size: header.size,
                most,
            })
        }
    }

    /// The 12 bytes.
    pub fn encode(&self) -> [u8; HEADER_SIZE] {
        let mut out = [0; HEADER_SIZE];
        let mut write = super::bytes::FieldWriter::new(&mut out);
        for number in [self.command, self.id, self.size] {
            write.put(&number.to_le_bytes());
        }
        out
    }

    /// Size of what follows the header, bytes.
    pub const fn payload(&self) -> usize {
        (self.size as usize).saturating_sub(HEADER_SIZE)
    }
}
