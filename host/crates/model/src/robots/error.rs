//! Why a robot file was refused: which field, its value, and the remedy.
//!
//! What comes from the user's file is escaped ([`printable`](crate::printable))
//! where it enters a message.

use spherecal_shared::MAX_CHAIN;
use spherecal_shared::robot::RobotError;

use crate::{FileError, TomlError, excerpt, printable};

/// What can be wrong with a robot's name or file.
#[derive(Debug, thiserror::Error)]
pub enum RobotFileError {
    /// Neither a built-in name nor a file.
    #[error(
        "robot \"{}\" is neither built in nor a file: {nearest}give one of {known}, or the path of a .toml, .urdf or .yaml file",
        excerpt(spec)
    )]
    Unknown {
        /// What was asked for.
        spec: String,
        /// Which built-in name may be meant, as the beginning of a sentence; may be empty.
        nearest: String,
        /// The built-in names.
        known: String,
    },
    /// The file could not be read, or is not text.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file's extension says nothing.
    #[error(
        "{}: its name does not say what it is: name it .toml, .urdf (or .xml), .yaml for joint origins, or .conf for the \
         calibration of a controller of Universal Robots",
        printable(path)
    )]
    Extension {
        /// File.
        path: String,
    },
    /// The text is not the TOML of a robot.
    #[error("{}: {source}", printable(path))]
    Toml {
        /// File.
        path: String,
        /// What is wrong and where.
        source: TomlError,
    },
    /// The text is not what its extension says.
    #[error("{}: {}", printable(path), printable(message))]
    Syntax {
        /// File.
        path: String,
        /// What is wrong and where.
        message: String,
    },
    /// A value of the file cannot be used.
    #[error(
        "{}: {} is \"{}\": {}",
        printable(path),
        printable(field),
        excerpt(value),
        printable(remedy)
    )]
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
    /// The chain has no or too many turning joints.
    #[error(
        "{}: the chain from {} to {} has {joints} turning joints: between 1 and {MAX_CHAIN} are needed; name another \
         base or tip as {}#BASE:TIP",
        printable(path),
        excerpt(base),
        excerpt(tip),
        printable(path)
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
    #[error("{}: {}", printable(path), words(source))]
    Robot {
        /// File.
        path: String,
        /// What is wrong with it.
        source: RobotError,
    },
}

/// The refusal of a description, with the tool called by its name.
fn words(error: &RobotError) -> String {
    let words = error.to_string();
    match words.strip_prefix("joint 0: ") {
        Some(rest) => format!("the tool: {rest}"),
        None => words,
    }
}
