//! Why a bag was refused: topic, type, time, and the remedy.
//!
//! What comes from the bag is escaped where it enters a message.

use spherecal_model::{FileError, excerpt, printable};

/// What can be wrong with a bag.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// A file could not be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The folder or file is no bag that this program reads.
    #[error("{}: {what}: {remedy}", printable(path))]
    Kind {
        /// File or folder.
        path: String,
        /// What it is.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The file is damaged, or was not closed.
    #[error(
        "{}: is not a whole MCAP file ({what}): `mcap recover` repairs what a killed recorder leaves; damage needs \
         another copy",
        printable(path)
    )]
    Damaged {
        /// File.
        path: String,
        /// What was found.
        what: String,
    },
    /// A bag in SQLite that cannot be read.
    #[error(
        "{}: is not a whole bag in SQLite ({}): `sqlite3 FILE .recover` saves what a killed recorder leaves",
        printable(path),
        printable(what)
    )]
    Database {
        /// File.
        path: String,
        /// What SQLite said.
        what: String,
    },
    /// No topic, or several, could be meant.
    #[error("{}: {what}: {remedy}", printable(path))]
    Topics {
        /// Bag.
        path: String,
        /// What is wrong; printable.
        what: String,
        /// What to do; printable.
        remedy: String,
    },
    /// A message cannot be used.
    #[error(transparent)]
    Message(#[from] Box<BadMessage>),
    /// There is no pose in it.
    #[error("{}: {what}: {remedy}", printable(path))]
    NoPose {
        /// Bag.
        path: String,
        /// What was found; printable.
        what: String,
        /// What to do; printable.
        remedy: String,
    },
}

/// A message that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error(
    "{}: topic {} ({}), message {number}: {what}: {remedy}",
    printable(path),
    excerpt(topic),
    excerpt(kind)
)]
pub struct BadMessage {
    /// File.
    pub path: String,
    /// Topic.
    pub topic: String,
    /// Its type.
    pub kind: String,
    /// Number of the message on the topic, from 1.
    pub number: u64,
    /// What is wrong; printable.
    pub what: String,
    /// What to do; printable.
    pub remedy: String,
}
