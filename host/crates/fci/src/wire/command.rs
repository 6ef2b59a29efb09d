//! The commands of the TCP channel, their numbers, and the header.

use spherecal_cyclic::named_enum;

use super::{Version, WireError};

/// Size of a header, bytes.
pub const HEADER_SIZE: usize = 12;
/// The largest request that a robot side takes, bytes. The largest real one, `SetCollisionBehavior`, has 428.
pub const MAX_REQUEST: usize = 4096;

named_enum! {
    /// A command of the TCP channel. Those of a version keep this order, and are numbered from 0.
    CommandKind {
        /// Opens the session and names the client's UDP port.
        Connect, "Connect";
        /// Starts a motion.
        Move, "Move";
        /// Ends a motion.
        StopMove, "StopMove";
        /// Asks for a Cartesian limit (version 5 only).
        GetCartesianLimit, "GetCartesianLimit";
        /// Sets the thresholds of contact and collision.
        SetCollisionBehavior, "SetCollisionBehavior";
        /// Sets the stiffness of the robot's own joint impedance.
        SetJointImpedance, "SetJointImpedance";
        /// Sets the stiffness of the robot's own Cartesian impedance.
        SetCartesianImpedance, "SetCartesianImpedance";
        /// Sets which axes a person can guide.
        SetGuidingMode, "SetGuidingMode";
        /// Sets the stiffness frame.
        SetEeToK, "SetEEToK";
        /// Sets the end effector frame.
        SetNeToEe, "SetNEToEE";
        /// Sets the load's mass, centre of mass and inertia.
        SetLoad, "SetLoad";
        /// Sets the robot's filters (up to version 5).
        SetFilters, "SetFilters";
        /// Clears the errors of a reflex.
        AutomaticErrorRecovery, "AutomaticErrorRecovery";
        /// Asks for the model library (gone in version 10).
        LoadModelLibrary, "LoadModelLibrary";
        /// Asks for the robot model in URDF (version 8 and later).
        GetRobotModel, "GetRobotModel";
    }
}

impl CommandKind {
    /// The commands of this version, in the order of their numbers.
    pub fn all(version: Version) -> impl Iterator<Item = Self> {
        Self::ALL.iter().copied().filter(move |command| match command {
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
