//! Where the events of a campaign go before they are acknowledged.

use spherecal_shared::protocol::host::SessionId;

use crate::Arrival;

/// Why a journal did not take what came.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// It could not be written.
    #[error("{0}")]
    Store(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// A run that is repeated from its start measured something else.
    #[error(
        "sphere {sphere}, pose {pose}: repeating the run from its start gave another recording than the one that is \
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
    /// What the store behind a journal says.
    pub fn store(source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Store(source.into())
    }
}

/// Where events go before they are acknowledged.
pub trait Journal {
    /// Notes that the controller is about to be greeted (handshake) under this number:
    /// events of this session and of earlier ones of the same run are to be
    /// kept; others are those of another run, and are to be passed over.
    ///
    /// # Errors
    /// When it could not be noted.
    fn handshake(&mut self, _session: SessionId) -> Result<(), JournalError> {
        Ok(())
    }

    /// Makes a batch of events durable. A recording that is already there is
    /// not stored again, and that is no error.
    ///
    /// # Errors
    /// When nothing of the batch could be stored.
    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError>;

    /// Notes that a pose was given up.
    ///
    /// # Errors
    /// When it could not be noted.
    fn reject(&mut self, sphere: u32, pose: u32, reason: &str) -> Result<(), JournalError>;
}

impl<J: Journal + ?Sized> Journal for &mut J {
    fn handshake(&mut self, session: SessionId) -> Result<(), JournalError> {
        (**self).handshake(session)
    }

    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError> {
        (**self).append(events)
    }

    fn reject(&mut self, sphere: u32, pose: u32, reason: &str) -> Result<(), JournalError> {
        (**self).reject(sphere, pose, reason)
    }
}

impl<J: Journal + ?Sized> Journal for Box<J> {
    fn handshake(&mut self, session: SessionId) -> Result<(), JournalError> {
        (**self).handshake(session)
    }

    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError> {
        (**self).append(events)
    }

    fn reject(&mut self, sphere: u32, pose: u32, reason: &str) -> Result<(), JournalError> {
        (**self).reject(sphere, pose, reason)
    }
}
