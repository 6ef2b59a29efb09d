//! The end of the host's own process, where a fault plan asks for it.

use spherecal_link::LinkError;

/// The host's program was killed on purpose, at a moment that a fault plan chose.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the host was killed, as --inject asked for: go on with --resume")]
pub struct HostKilled;

impl HostKilled {
    /// Whether this is why a link failed.
    pub fn is_cause_of(error: &LinkError) -> bool {
        matches!(error, LinkError::Device { source, .. } if source.is::<Self>())
    }
}

/// Ends this process as `kill -9` does: nothing is closed, flushed or told.
pub(super) fn end_process() {
    #[cfg(unix)]
    // It cannot be refused to a process that kills itself.
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    #[cfg(not(unix))]
    std::process::abort();
}
