//! What a response says: its status. The numbers depend on command and version.

use spherecal_cyclic::named_enum;

use super::command::{CommandHeader, CommandKind, HEADER_SIZE};
use super::{Version, WireError};

named_enum! {
    /// The status of a response.
    Status {
        /// Done. For a Move: the motion ended as the client wished.
        Success, "success";
        /// Connect: the robot speaks another version.
        IncompatibleVersion, "incompatible version";
        /// Move: the motion began. A second response follows when it ends.
        MotionStarted, "motion started";
        /// Move: ended by a StopMove or by another motion.
        Preempted, "preempted";
        /// Move: ended by a safety function.
        PreemptedBySafetyFunction, "preempted by a safety function";
        /// Refused while a safety function is active.
        RejectedBySafetyFunction, "rejected: a safety function is active";
        /// Refused in the robot's present mode.
        NotPossible, "rejected: not possible in the robot's present mode";
        /// Move: refused at a singular pose.
        StartAtSingularPose, "rejected: the pose is singular";
        /// Refused because an argument is out of range.
        InvalidArgument, "rejected: an argument is out of range";
        /// AutomaticErrorRecovery: a person must move the arm first.
        ManualRecoveryRequired, "rejected: a person must move the arm first";
        /// Ended by a reflex.
        ReflexAborted, "aborted by a reflex";
        /// Ended by the user stop.
        EmergencyAborted, "aborted by the user stop";
        /// Move: ended by an invalid command.
        InputErrorAborted, "aborted: invalid command";
        /// Ended for another reason.
        Aborted, "aborted";
        /// LoadModelLibrary: there is no library for the client's machine.
        Failed, "failed";
    }
}

use Status as S;

impl Status {
    /// The statuses that a response to this command can have, in the order of their numbers.
    pub fn all(command: CommandKind, version: Version) -> impl Iterator<Item = Self> {
        let all: &[Self] = match command {
            CommandKind::Connect => &[S::Success, S::IncompatibleVersion],
            CommandKind::Move => &[
                S::Success,
                S::MotionStarted,
                S::Preempted,
                S::PreemptedBySafetyFunction,
                S::RejectedBySafetyFunction,
                S::NotPossible,
                S::StartAtSingularPose,
                S::InvalidArgument,
                S::ReflexAborted,
                S::EmergencyAborted,
                S::InputErrorAborted,
                S::Aborted,
            ],
            CommandKind::StopMove => &[
                S::Success,
                S::NotPossible,
                S::RejectedBySafetyFunction,
                S::EmergencyAborted,
                S::ReflexAborted,
                S::Aborted,
            ],
            CommandKind::AutomaticErrorRecovery => &[
                S::Success,
                S::NotPossible,
                S::RejectedBySafetyFunction,
                S::ManualRecoveryRequired,
                S::ReflexAborted,
                S::EmergencyAborted,
                S::Aborted,
            ],
            CommandKind::LoadModelLibrary => &[S::Success, S::Failed],
            CommandKind::GetRobotModel => &[S::Success, S::NotPossible, S::RejectedBySafetyFunction],
            _ => &[
                S::Success,
                S::NotPossible,
                S::InvalidArgument,
                S::RejectedBySafetyFunction,
            ],
        };
        // A Panda has no safety functions.
        let is_safety = |status: &Self| matches!(status, S::PreemptedBySafetyFunction | S::RejectedBySafetyFunction);
        let all = all.iter().copied();
        all.filter(move |status| !version.is_panda() || !is_safety(status))
    }

    /// The status with this number.
    ///
    /// # Errors
    /// [`WireError::UnknownValue`] for a number without meaning.
    pub fn from_number(number: u8, command: CommandKind, version: Version) -> Result<Self, WireError> {
        let status = Self::all(command, version).nth(number.into());
        status.ok_or(WireError::UnknownValue {
            field: "status",
            value: number.into(),
        })
    }

    /// The number of this status in a response to `command`. A status that the command does not have in this version
    /// becomes the next more general one.
    pub fn number(self, command: CommandKind, version: Version) -> u8 {
        let place = |status| Self::all(command, version).position(|s| s == status);
        let general = match self {
            Self::PreemptedBySafetyFunction => Self::Preempted,
            _ => Self::NotPossible,
        };
        place(self).or_else(|| place(general)).unwrap_or(1) as u8
    }
}

/// A response of the TCP channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Response<'a> {
    /// The command that it answers.
    pub command: CommandKind,
    /// The id of the request.
    pub id: u32,
    /// What became of the request.
    pub status: Status,
    /// What follows the status: the robot model, for example.
    pub body: &'a [u8],
}

impl<'a> Response<'a> {
    /// Decodes a response from its header and its payload.
    ///
    /// # Errors
    /// A [`WireError`] if the payload has not the announced size, or command or status have no meaning.
    pub fn decode(version: Version, header: CommandHeader, payload: &'a [u8]) -> Result<Self, WireError> {
        if payload.len() != header.payload() {
            return Err(WireError::Length {
                message: "response",
                expected: header.size as usize,
                got: payload.len() + HEADER_SIZE,
            });
        }
        let command = CommandKind::from_number(header.command, version)?;
        let (status, body) = payload.split_first().ok_or(WireError::Short {
            message: "response",
            field: "status",
            got: 0,
        })?;
        Ok(Self {
            command,
            id: header.id,
            status: Status::from_number(*status, command, version)?,
            body,
        })
    }

    /// Appends the response to `out`.
    ///
    /// # Errors
    /// [`WireError::NotInVersion`] if the version does not have the command.
    pub fn encode(&self, version: Version, out: &mut Vec<u8>) -> Result<(), WireError> {
        let header = CommandHeader {
            command: self.command.number(version)?,
            id: self.id,
            size: (HEADER_SIZE + 1 + self.body.len()) as u32,
        };
        out.extend_from_slice(&header.encode());
        out.push(self.status.number(self.command, version));
        out.extend_from_slice(self.body);
        Ok(())
    }

    /// The robot model of a response to `GetRobotModel`: URDF.
    ///
    /// # Errors
    /// [`WireError::NotText`] if the body is not UTF-8.
    pub fn robot_model(&self) -> Result<&'a str, WireError> {
        std::str::from_utf8(self.body).map_err(|_| WireError::NotText)
    }
}
