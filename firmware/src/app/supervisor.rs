//! Which tasks are alive: what a board's watchdog is fed by.
//!
//! A watchdog that the control task alone feeds does not see a link that hangs. So each
//! task of lower priority shows at least every [`BEAT`] that it runs, also when it has
//! nothing to do. The control task collects these signs and feeds the watchdog while
//! none is older than [`SILENT`].

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_time::Duration;

/// Longest time after which a task that waits shows that it is alive.
pub const BEAT: Duration = Duration::from_millis(5);
/// Longest time that one write to a byte stream may take. Then it is given up.
pub const WRITE: Duration = Duration::from_millis(10);
/// Time without a sign of life after which a task counts as dead: a write that is given
/// up, and two beats.
pub const SILENT: Duration = Duration::from_millis(20);

/// The tasks below the control task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Part {
    /// Receives the drive's messages.
    DriveIn,
    /// Sends commands to the drive.
    DriveOut,
    /// Receives the host's bytes.
    HostIn,
    /// Runs the host link.
    HostLink,
    /// Sends bytes to the host.
    HostOut,
    /// What the board runs in thread mode.
    Thread,
}

impl Part {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::DriveIn,
        Self::DriveOut,
        Self::HostIn,
        Self::HostLink,
        Self::HostOut,
        Self::Thread,
    ];
}

/// The signs of life since they were last collected.
#[derive(Debug, Default)]
pub struct Pulse(AtomicU32);

impl Pulse {
    /// No sign yet.
    pub const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// `part` is alive.
    pub fn beat(&self, part: Part) {
        self.0.fetch_or(1 << part as u32, Ordering::Relaxed);
    }

    fn collect(&self) -> u32 {
        self.0.swap(0, Ordering::Relaxed)
    }
}

/// Decides on every tick of the control task whether the watchdog is fed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Supervisor {
    /// When each part was last alive, in µs; `None` before the first tick.
    seen_us: Option<[u64; Part::ALL.len()]>,
}

impl Supervisor {
    /// Takes the signs of life at `now_us` (µs).
    ///
    /// # Errors
    /// The part that has been silent for longer than [`SILENT`]: do not feed the
    /// watchdog.
    pub fn check(&mut self, now_us: u64, pulse: &Pulse) -> Result<(), Part> {
        let signs = pulse.collect();
        let seen_us = self.seen_us.get_or_insert([now_us; Part::ALL.len()]);
        for (part, seen_us) in Part::ALL.into_iter().zip(seen_us) {
            if signs & 1 << part as u32 != 0 {
                *seen_us = now_us;
            }
            if now_us.saturating_sub(*seen_us) > SILENT.as_micros() {
                return Err(part);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a dead task is not named within its time and a tick, or if one that only
    // waits, or writes slowly, counts as dead.
    #[test]
    fn each_dead_task_is_named() {
        for dead in Part::ALL {
            let (pulse, mut supervisor) = (Pulse::new(), Supervisor::default());
            let mut named = None;
            for now_ms in 0..200u64 {
                for part in Part::ALL.into_iter().filter(|part| *part != dead || now_ms < 100) {
                    // The slowest: a write that is given up, then a beat.
                    if now_ms % 15 == part as u64 {
                        pulse.beat(part);
                    }
                }
                if let Err(part) = supervisor.check(1000 * now_ms, &pulse) {
                    named.get_or_insert((part, now_ms));
                }
            }
            let (part, at_ms) = named.expect("the dead task is noticed");
            assert_eq!(part, dead);
            assert!((105..=121).contains(&at_ms), "{part:?} at {at_ms} ms");
        }
    }

    // Fails if nothing is alive and the watchdog is fed for ever, or if tasks get no time
    // to start.
    #[test]
    fn a_start_without_tasks_is_noticed() {
        let (pulse, mut supervisor) = (Pulse::new(), Supervisor::default());
        assert_eq!(supervisor.check(5_000_000, &pulse), Ok(()));
        assert_eq!(supervisor.check(5_020_000, &pulse), Ok(()));
        assert_eq!(supervisor.check(5_021_000, &pulse), Err(Part::DriveIn));
    }
}
