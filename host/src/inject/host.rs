//! What the host's own computer suffers, told to whoever writes to its disk.
//!
//! The injecting device knows when; the journal has the file. Between them is
//! this handle: the device sets it, the journal looks at it before each write.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// What is amiss with the disk or the file on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ailment {
    /// The disk has no room for more than is on it.
    pub full: bool,
    /// Another program is to lock the file for so long, from now on.
    pub locked: Option<Duration>,
}

/// A handle to the ailments of the host's computer; copies share them.
#[derive(Clone, Debug, Default)]
pub struct Ailing(Arc<Mutex<Ailment>>);

impl Ailing {
    /// What is amiss now; a lock is told of once.
    pub fn now(&self) -> Ailment {
        let mut ailment = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Ailment {
            locked: ailment.locked.take(),
            ..*ailment
        }
    }

    /// The disk fills up, or somebody makes room.
    pub fn fill(&self, full: bool) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).full = full;
    }

    /// Another program locks the file for so long.
    pub fn lock(&self, time: Duration) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).locked = Some(time);
    }
}
