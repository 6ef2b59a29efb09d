//! The clock that a QEMU must answer within.

use std::process::{Child, ExitStatus};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Ends a QEMU that does not answer.
pub(super) struct Watchdog {
    child: Arc<Mutex<Child>>,
    turns: Arc<AtomicU64>,
    expired: Arc<AtomicBool>,
    done: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Watchdog {
    pub(super) fn over(child: Child, patience: Duration) -> Self {
        let child = Arc::new(Mutex::new(child));
        let (turns, expired, done) = (
            Arc::new(AtomicU64::new(0)),
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicBool::new(false)),
        );
        let thread = std::thread::spawn({
            let (child, turns, expired, done) = (child.clone(), turns.clone(), expired.clone(), done.clone());
            move || {
                let (mut seen, mut since) = (0, Instant::now());
                while !done.load(Ordering::Acquire) {
                    std::thread::park_timeout(Duration::from_millis(100));
                    let now = turns.load(Ordering::Relaxed);
                    if now != seen {
                        (seen, since) = (now, Instant::now());
                    } else if since.elapsed() > patience && !done.load(Ordering::Acquire) {
                        expired.store(true, Ordering::Release);
                        let _ = child.lock().unwrap_or_else(PoisonError::into_inner).kill();
                        return;
                    }
                }
            }
        });
        Self {
            child,
            turns,
            expired,
            done,
            thread: Some(thread),
        }
    }

    pub(super) fn answered(&self) {
        self.turns.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn expired(&self) -> bool {
        self.expired.load(Ordering::Acquire)
    }

    /// Waits for the process, two seconds at most, and collects it.
    pub(super) fn end(&mut self) -> Option<ExitStatus> {
        self.done.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
        let mut child = self.child.lock().unwrap_or_else(PoisonError::into_inner);
        let until = Instant::now() + Duration::from_secs(2);
        while Instant::now() < until {
            if let Ok(Some(status)) = child.try_wait() {
                return Some(status);
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let _ = child.kill();
        let _ = child.wait();
        None
    }
}
