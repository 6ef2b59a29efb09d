//! Ends the host's own process if a fault plan asks for it.

use spherecal_link::LinkError;

/// The host's program was killed by a fault plan.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the host was killed by --inject: continue with --resume")]
pub struct HostKilled;

impl HostKilled {
    /// Whether this is why a link failed.
    pub fn is_cause_of(error: &LinkError) -> bool {
        matches!(error, LinkError::Device { source, .. } if source.is::<Self>())
    }
}

/// Ends this process as `kill -9` does: nothing is closed, flushed or reported.
pub(super) fn end_process() {
    #[cfg(unix)]
    // A process may always kill itself.
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    #[cfg(not(unix))]
    std::process::abort();
}
