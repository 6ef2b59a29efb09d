//! A device whose time does not wait, served by a thread of its own.
//!
//! ```text
//!   campaign ──bytes──▶ tray ──▶ thread: one period after the other ──▶ device
//!      ▲                 │         └ keep-alives while the campaign is held up
//!      └─── everything that came since the last step
//! ```
//!
//! A controller that hears nothing of its host for 2 s stops the arm. A program may be held up for longer: by a disk (8 s
//! were measured beside programs that write much), by the planning of a way, by a terminal that takes no more text. So
//! nothing but the exchange with the controller is done in this thread. It may still wait for a processor (16 s were measured
//! beside 40 busy programs on two processors). So it goes ahead of ordinary threads, where the system permits it.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::endpoint::Timing;
use super::keep_alive::KeepAlives;
use super::native::Monitor;
use super::{Device, LinkError};

/// How long the rest of the program may be held up. After that the controller hears no more, and stops the arm: no arm
/// is to wait on a sphere for a program that hangs. A store waits 10 s for a lock, and a slow disk took 8 s.
const PATIENCE: Duration = Duration::from_secs(if cfg!(test) { 4 } else { 30 });

/// A device that a thread serves. A device whose time [waits](Device::waits) has one period for each
/// [`step`](Device::step), as without the thread. Otherwise the periods pass by themselves from the first step on, and a
/// step waits for the next one and returns what has come since the last.
pub struct Attended {
    desk: Arc<Desk>,
    thread: Option<JoinHandle<()>>,
    /// Periods whose bytes were taken.
    taken: u64,
    monitor: Option<Monitor>,
    simulated: Option<bool>,
}

/// What both threads share.
#[derive(Default)]
struct Desk {
    tray: Mutex<Tray>,
    changed: Condvar,
}

#[derive(Default)]
struct Tray {
    keep_alives: Option<KeepAlives>,
    /// Bytes for the controller, and when the last of them were given; `None` before the first step.
    down: Vec<u8>,
    given: Option<Instant>,
    /// Whether a step waits for its period.
    asked: bool,
    /// Where the plate is to be moved, and whether it was.
    place: Option<u32>,
    moved: Option<bool>,
    /// Bytes of the controller that nobody has taken yet.
    up: Vec<u8>,
    periods: u64,
    now_us: u64,
    ticks: u64,
    waits: bool,
    failed: Option<LinkError>,
    /// The thread has ended.
    ended: bool,
    /// The thread is to end.
    dismissed: bool,
}

impl Desk {
    /// The tray. A thread that panicked has left it whole: each change is complete in itself.
    fn tray(&self) -> MutexGuard<'_, Tray> {
        self.tray.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, tray: MutexGuard<'a, Tray>) -> MutexGuard<'a, Tray> {
        self.changed.wait(tray).unwrap_or_else(PoisonError::into_inner)
    }
}

/// Tells that the thread has ended, also after a panic.
struct End(Arc<Desk>);

impl Drop for End {
    fn drop(&mut self) {
        self.0.tray().ended = true;
        self.0.changed.notify_all();
    }
}

impl Attended {
    /// Starts the thread of `device`. Nothing is exchanged before the first step.
    ///
    /// # Errors
    /// The thread does not start.
    pub fn start(device: impl Device + 'static) -> Result<Self, LinkError> {
        let desk = Arc::new(Desk::default());
        desk.tray().waits = device.waits();
        let (monitor, simulated) = (device.monitor(), device.simulated());
        let end = End(desk.clone());
        let thread = std::thread::Builder::new()
            .name("exchange".to_owned())
            .spawn(move || serve(&end.0, device))
            .map_err(|source| LinkError::Transport {
                link: "the thread of the exchange with the controller".to_owned(),
                source,
            })?;
        Ok(Self {
            desk,
            thread: Some(thread),
            taken: 0,
            monitor,
            simulated,
        })
    }
}

/// Carries out one period after the other, until the device fails or nobody needs it.
fn serve(desk: &Desk, mut device: impl Device) {
    let (mut down, mut up) = (Vec::new(), Vec::new());
    let mut sent = Instant::now();
    let quiet = Duration::from_micros(Timing::default().keep_alive_us);
    let mut ahead = false;
    loop {
        let mut tray = desk.tray();
        loop {
            if tray.dismissed {
                return;
            }
            if let Some(place) = tray.place.take() {
                tray.moved = Some(device.move_plate(place));
                desk.changed.notify_all();
            }
            let lives = tray.given.is_some_and(|given| given.elapsed() < PATIENCE);
            if tray.asked || (lives && !tray.waits) {
                break;
            }
            tray = desk.wait(tray);
        }
        tray.asked = false;
        down.clear();
        down.append(&mut tray.down);
        let mut stepped = Ok(());
        if down.is_empty()
            && !tray.waits
            && sent.elapsed() >= quiet
            && let Some(keep_alives) = &tray.keep_alives
        {
            stepped = keep_alives.frame(tray.now_us, &mut down).map_err(LinkError::from);
        }
        drop(tray);
        if !down.is_empty() {
            sent = Instant::now();
        }
        stepped = stepped.and_then(|()| device.step(&down, &mut up));
        let mut tray = desk.tray();
        tray.up.append(&mut up);
        (tray.now_us, tray.ticks, tray.waits) = (device.now_us(), device.ticks(), device.waits());
        tray.failed = stepped.err();
        if tray.failed.is_some() {
            return;
        }
        tray.periods += 1;
        let goes_ahead = !tray.waits && !ahead;
        desk.changed.notify_all();
        drop(tray);
        if goes_ahead {
            // A device in lock-step waits for this program, and its exchange takes as much of a processor as there is.
            spherecal_realtime::go_ahead();
            ahead = true;
        }
    }
}

impl Device for Attended {
    fn now_us(&self) -> u64 {
        self.desk.tray().now_us
    }

    fn ticks(&self) -> u64 {
        self.desk.tray().ticks
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let mut tray = self.desk.tray();
        tray.down.extend_from_slice(down);
        (tray.asked, tray.given) = (true, Some(Instant::now()));
        self.desk.changed.notify_all();
        while tray.periods == self.taken && !tray.ended {
            tray = self.desk.wait(tray);
        }
        if tray.periods == self.taken {
            return Err(tray.failed.take().unwrap_or_else(|| LinkError::Transport {
                link: "the exchange with the controller".to_owned(),
                source: std::io::ErrorKind::NotConnected.into(),
            }));
        }
        self.taken = tray.periods;
        up.append(&mut tray.up);
        Ok(())
    }

    fn move_plate(&mut self, place: u32) -> bool {
        let mut tray = self.desk.tray();
        (tray.place, tray.moved) = (Some(place), None);
        self.desk.changed.notify_all();
        while tray.moved.is_none() && !tray.ended {
            tray = self.desk.wait(tray);
        }
        tray.moved.unwrap_or_default()
    }

    fn monitor(&self) -> Option<Monitor> {
        self.monitor.clone()
    }

    fn simulated(&self) -> Option<bool> {
        self.simulated
    }

    fn waits(&self) -> bool {
        self.desk.tray().waits
    }

    fn keep_alive(&mut self, keep_alives: &KeepAlives) {
        self.desk.tray().keep_alives = Some(keep_alives.clone());
    }
}

impl Drop for Attended {
    fn drop(&mut self) {
        self.desk.tray().dismissed = true;
        self.desk.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
#[path = "attended_tests.rs"]
mod tests;
