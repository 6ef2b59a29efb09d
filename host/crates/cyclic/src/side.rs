//! A simulated robot side that runs on a thread of its own.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// What the thread of a robot side shares with its owner: controls `C` in, statistics `S` out.
#[derive(Debug)]
pub struct Published<C, S> {
    /// What persons and safety functions do.
    pub controls: C,
    statistics: Mutex<S>,
    end: AtomicBool,
}

impl<C, S: Copy> Published<C, S> {
    /// Whether the owner wants the thread to end.
    pub fn has_ended(&self) -> bool {
        self.end.load(Ordering::Relaxed)
    }

    /// Lets the owner see these statistics.
    pub fn publish(&self, statistics: S) {
        *self.statistics.lock().unwrap_or_else(PoisonError::into_inner) = statistics;
    }

    fn statistics(&self) -> S {
        *self.statistics.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A running robot side. It ends when it is dropped.
#[derive(Debug)]
pub struct Side<C, S> {
    shared: Arc<Published<C, S>>,
    thread: Option<JoinHandle<()>>,
}

impl<C, S> Side<C, S>
where
    C: Default + Send + Sync + 'static,
    S: Copy + Default + Send + 'static,
{
    /// Starts `run` on a thread with this name. It must return soon after [`Published::has_ended`] comes true.
    ///
    /// # Errors
    /// What the system says if no thread can be started.
    pub fn start(name: &str, run: impl FnOnce(Arc<Published<C, S>>) + Send + 'static) -> std::io::Result<Self> {
        let shared = Arc::new(Published {
            controls: C::default(),
            statistics: Mutex::new(S::default()),
            end: AtomicBool::new(false),
        });
        let theirs = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name(name.into())
            .spawn(move || run(theirs))?;
        Ok(Self {
            shared,
            thread: Some(thread),
        })
    }
}

impl<C, S: Copy> Side<C, S> {
    /// What persons and safety functions do.
    pub fn controls(&self) -> &C {
        &self.shared.controls
    }

    /// The statistics of the last period.
    pub fn statistics(&self) -> S {
        self.shared.statistics()
    }

    /// Ends the thread and waits for it.
    pub fn shut_down(mut self) -> S {
        self.join();
        self.statistics()
    }
}

impl<C, S> Side<C, S> {
    fn join(&mut self) {
        self.shared.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed already.
            let _ = thread.join();
        }
    }
}

impl<C, S> Drop for Side<C, S> {
    fn drop(&mut self) {
        self.join();
    }
}
