//! Faults of the host's own computer, passed to the journal that writes to its disk.
//!
//! The faulty cell knows the time of a fault; the journal has the file. A handle ([`HostFaults`])
//! connects them: the cell sets it, and a journal around the real one ([`HostFaultJournal`]) checks
//! it before each write. The store does not know of the faults: a full disk is a write that fails
//! before it reaches the store, and a locked file is locked from outside.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use spherecal_link::{Arrival, Journal, JournalError, LinkError};
use spherecal_shared::protocol::host::SessionId;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct DiskFaults {
    /// The disk has no room for more than is on it.
    full: bool,
    /// Another program locks the file for this time, from now on.
    locked: Option<Duration>,
}

/// A handle to the faults of the host's computer; copies share them.
#[derive(Clone, Debug, Default)]
pub struct HostFaults(Arc<Mutex<DiskFaults>>);

impl HostFaults {
    /// Present faults; a lock is reported once.
    fn now(&self) -> DiskFaults {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        DiskFaults {
            locked: state.locked.take(),
            ..*state
        }
    }

    /// The disk becomes full, or space is freed.
    pub fn fill(&self, full: bool) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).full = full;
    }

    /// Another program locks the file for so long.
    pub fn lock(&self, time: Duration) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).locked = Some(time);
    }
}

/// Locks the journal's file from outside for a time; returns when it is locked.
pub type FileLock = Box<dyn FnMut(Duration) -> Result<(), JournalError> + Send>;

/// A write that found no room.
#[derive(Clone, Debug, thiserror::Error)]
#[error(
    "{path} cannot be written (--inject simulates a full disk): free space on the disk, then continue with \
     --resume; nothing that was acknowledged is lost",
    path = path.display()
)]
struct DiskFull {
    path: PathBuf,
}

/// A journal whose file is affected by the faults of the host's computer.
pub struct HostFaultJournal<J> {
    inner: J,
    faults: HostFaults,
    path: PathBuf,
    lock: FileLock,
}

impl<J: Journal> HostFaultJournal<J> {
    /// A journal around `inner`, whose file is at `path` and can be locked by `lock`.
    pub fn new(inner: J, faults: HostFaults, path: PathBuf, lock: FileLock) -> Self {
        Self {
            inner,
            faults,
            path,
            lock,
        }
    }

    /// The journal inside.
    pub fn into_inner(self) -> J {
        self.inner
    }

    fn suffer(&mut self) -> Result<(), JournalError> {
        let state = self.faults.now();
        if let Some(time) = state.locked {
            (self.lock)(time)?;
        }
        if state.full {
            return Err(JournalError::store(DiskFull {
                path: self.path.clone(),
            }));
        }
        Ok(())
    }
}

impl<J: Journal> Journal for HostFaultJournal<J> {
    fn handshake(&mut self, session: SessionId) -> Result<(), JournalError> {
        self.suffer()?;
        self.inner.handshake(session)
    }

    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError> {
        self.suffer()?;
        self.inner.append(events)
    }

    fn reject(&mut self, sphere: u32, pose: u32, reason: &str) -> Result<(), JournalError> {
        self.suffer()?;
        self.inner.reject(sphere, pose, reason)
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Counting(usize);

    impl Journal for Counting {
        fn append(&mut self, _: &[Arrival]) -> Result<(), JournalError> {
            self.0 += 1;
            Ok(())
        }

        fn reject(&mut self, _: u32, _: u32, _: &str) -> Result<(), JournalError> {
            self.0 += 1;
            Ok(())
        }
    }

    // Fails if a write reaches the journal while the disk is full, if a write does not reach it
    // after space is free again, or if a lock is taken more than once.
    #[test]
    fn a_full_disk_takes_nothing_and_a_lock_is_taken_once() {
        let faults = HostFaults::default();
        let locks = Arc::new(Mutex::new(Vec::new()));
        let taken = Arc::clone(&locks);
        let lock: FileLock = Box::new(move |time| {
            taken.lock().unwrap_or_else(PoisonError::into_inner).push(time);
            Ok(())
        });
        let mut journal = HostFaultJournal::new(Counting::default(), faults.clone(), PathBuf::from("run.db"), lock);
        journal.append(&[]).expect("room");
        faults.fill(true);
        let refused = journal.append(&[]).expect_err("no room").to_string();
        assert!(
            refused.starts_with("run.db cannot be written") && refused.contains("--resume"),
            "{refused}"
        );
        assert!(journal.reject(1, 2, "").is_err() && journal.handshake(SessionId::default()).is_err());
        faults.fill(false);
        faults.lock(Duration::from_secs(1));
        journal.append(&[]).expect("room again");
        journal.append(&[]).expect("no lock any more");
        assert_eq!(
            *locks.lock().unwrap_or_else(PoisonError::into_inner),
            [Duration::from_secs(1)]
        );
        assert_eq!(journal.into_inner().0, 3);
    }
}
