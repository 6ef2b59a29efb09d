//! Why a robot file was refused: which field, its value, and the remedy.

use spherecal_shared::MAX_JOINTS;
use spherecal_shared::robot::RobotError;

/// What can be wrong with a robot's name or file.
#[derive(Debug, thiserror::Error)]
pub enum RobotFileError {
    /// Neither a built-in name nor a file.
    #[error(
        "robot \"{spec}\" is neither built in nor a file: give one of {known}, or the path of a .toml or .urdf file"
    )]
    Unknown {
        /// What was asked for.
        spec: String,
        /// The built-in names.
        known: String,
    },
    /// The file could not be read.
    #[error("{path}: cannot be read ({source}): check the path and its permissions")]
    Read {
        /// File.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is larger than any robot description.
    #[error(
        "{path}: is {bytes} bytes long: a robot description has at most {limit}; give the URDF without meshes inside"
    )]
    TooLarge {
        /// File.
        path: String,
        /// Its size.
        bytes: u64,
        /// The most that is read.
        limit: u64,
    },
    /// The file's extension says nothing.
    #[error("{path}: the extension does not say what it is: name it .toml, .urdf or .xml")]
    Extension {
        /// File.
        path: String,
    },
    /// The text is not what its extension says.
    #[error("{path}: {message}")]
    Syntax {
        /// File.
        path: String,
        /// What is wrong and where.
        message: String,
    },
    /// A value of the file cannot be used.
    #[error("{path}: {field} is \"{value}\": {remedy}")]
    Value {
        /// File.
        path: String,
        /// Where in the file.
        field: String,
        /// What stands there.
        value: String,
        /// What to write instead.
        remedy: String,
    },
    /// The chain has no or too many moving joints.
    #[error(
        "{path}: the chain from {base} to {tip} has {joints} moving joints: between 1 and {MAX_JOINTS} are needed; \
         name another tip as {path}#LINK"
    )]
    Joints {
        /// File.
        path: String,
        /// First link.
        base: String,
        /// Last link.
        tip: String,
        /// How many were found.
        joints: usize,
    },
    /// The description is not a possible robot.
    #[error("{path}: {source}")]
    Robot {
        /// File.
        path: String,
        /// What is wrong with it.
        source: RobotError,
    },
}
