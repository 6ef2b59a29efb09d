//! A simulated robot side that runs as a process of its own.

use std::sync::{Arc, Mutex, PoisonError};

use super::machine::{Machine, Process, Running};

/// What the process of a robot side shares with its owner: controls `C` in, statistics `S` out.
#[derive(Debug)]
pub struct Published<C, S> {
    /// What persons and safety functions do.
    pub controls: C,
    statistics: Mutex<S>,
}

impl<C, S: Copy> Published<C, S> {
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
    running: Running,
}

impl<C: Default, S: Copy + Default> Side<C, S> {
    /// Starts the process that `make` makes, under this name.
    ///
    /// # Errors
    /// What the system says if no thread can be started.
    pub fn start<P: Process + 'static>(
        machine: &dyn Machine,
        name: &str,
        make: impl FnOnce(Arc<Published<C, S>>) -> P,
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Published {
            controls: C::default(),
            statistics: Mutex::new(S::default()),
        });
        let running = machine.run(name, Box::new(make(Arc::clone(&shared))))?;
        Ok(Self { shared, running })
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

    /// Ends the process and waits for it.
    pub fn shut_down(self) -> S {
        drop(self.running);
        self.shared.statistics()
    }
}
