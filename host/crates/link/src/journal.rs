//! Where the events of a campaign are stored before they are acknowledged.

use spherecal_shared::protocol::host::SessionId;

use crate::Arrival;

/// Why a journal did not accept an event.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// It could not be written.
    #[error("{0}")]
    Store(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The run was repeated from its start, and a recording differs from the stored one.
    #[error(
        "pose {pose} (sphere {sphere}): repeating the run from its start gave another recording than the one that is \
         stored: it was begun by another version of this program, or its configuration has changed; begin a new run \
         without --resume. The stored recordings are as they were"
    )]
    Differs {
        /// Id of the sphere.
        sphere: u32,
        /// Id of the pose.
        pose: u32,
    },
}

impl JournalError {
    /// Wraps an error of the store behind a journal.
    pub fn store(source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Store(source.into())
    }
}

/// Stores events before they are acknowledged.
#[auto_impl::auto_impl(&mut, Box)]
pub trait Journal: Send {
    /// Announces a handshake under this session number. Events of this session and of earlier
    /// sessions of the same run are stored. Events of other sessions belong to another run and are
    /// skipped.
    ///
    /// # Errors
    /// When the announcement could not be stored.
    fn handshake(&mut self, session: SessionId) -> Result<(), JournalError> {
        let _ = session;
        Ok(())
    }

    /// Stores a batch of events durably. A recording that is already stored is skipped without an
    /// error.
    ///
    /// # Errors
    /// When nothing of the batch could be stored.
    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError>;

    /// Stores that a pose was given up.
    ///
    /// # Errors
    /// When it could not be stored.
    fn reject(&mut self, sphere: u32, pose: u32, reason: &str) -> Result<(), JournalError>;
}
