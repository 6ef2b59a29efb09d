//! The versions of the interface and what each changes.

use super::WireError;

/// A version of the interface. Client and robot must use the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Version {
    /// Panda with the system versions 4.0 to 4.2.0. States are read; this crate moves no such robot.
    V4 = 4,
    /// Panda with the system version 4.2.1 or newer.
    V5 = 5,
    /// FR3 with the system version 5.2 or newer. Torque motions run as those of version 5.
    V6 = 6,
    /// FR3 with the system version 5.5 or newer. Torque motions run without a generator and end by a flag of their own.
    V7 = 7,
    /// FR3 with the system version 5.7.0 or newer; adds the command `GetRobotModel`.
    V8 = 8,
    /// FR3 with the system version 5.7.2 or newer. Only the number differs from version 8.
    V9 = 9,
    /// FR3 with the system version 5.9 or newer; the state has 32-bit numbers, and two accelerometers of each link.
    V10 = 10,
}

impl Version {
    /// All versions, newest first: the order in which a client tries them.
    pub const ALL: [Self; 7] = [Self::V10, Self::V9, Self::V8, Self::V7, Self::V6, Self::V5, Self::V4];

    /// The number on the wire.
    pub const fn number(self) -> u16 {
        self as u16
    }

    /// The version with this number.
    ///
    /// # Errors
    /// [`WireError::UnknownVersion`] for a number that this crate does not speak.
    pub fn from_number(number: u16) -> Result<Self, WireError> {
        let version = Self::ALL.into_iter().find(|version| version.number() == number);
        version.ok_or(WireError::UnknownVersion(number))
    }

    /// Size of a state, bytes.
    pub const fn state_size(self) -> usize {
        match self {
            Self::V4 => 2341,
            Self::V10 => 1377,
            _ => 2373,
        }
    }

    /// Size of a UDP command, bytes.
    pub const fn command_size(self) -> usize {
        if self.has_torque_finished() { 371 } else { 370 }
    }

    /// Errors that the state has flags for.
    pub const fn error_flags(self) -> usize {
        match self {
            Self::V4 => 37,
            _ => 41,
        }
    }

    /// Whether this crate moves a robot of this version. It only reads the others.
    pub const fn can_move(self) -> bool {
        !matches!(self, Self::V4)
    }

    /// Whether the state's numbers are 32-bit floats. A joint angle of 3 rad then has a step of 2.4e-7 rad.
    pub const fn single_precision(self) -> bool {
        matches!(self, Self::V10)
    }

    /// Whether the command has the flag `torque_command_finished`.
    pub const fn has_torque_finished(self) -> bool {
        !matches!(self, Self::V4 | Self::V5 | Self::V6)
    }

    /// Whether the robot is a Panda. The other versions belong to the FR3.
    pub const fn is_panda(self) -> bool {
        matches!(self, Self::V4 | Self::V5)
    }

    /// The robot that speaks this version, by the name of its built-in file: one of [`ROBOTS`](Self::ROBOTS).
    pub const fn robot(self) -> &'static str {
        let [panda, fr3] = Self::ROBOTS;
        if self.is_panda() { panda } else { fr3 }
    }

    /// The robots that speak the Franka Control Interface, by the names of their built-in files.
    pub const ROBOTS: [&'static str; 2] = ["panda", "fr3"];
}

impl std::fmt::Display for Version {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.number())
    }
}
