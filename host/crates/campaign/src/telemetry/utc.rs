//! From device time to the time of day.
//!
//! A controller counts from its start. Viewers put files beside each other, so telemetry carries
//! Coordinated Universal Time (UTC). One offset per controller session ties the two: it is set at
//! the first sample from the clock of this computer, and device time runs on from there. A
//! simulation may run faster than the day; its times follow device time.

use std::time::{SystemTime, UNIX_EPOCH};

/// One instant in both times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Moment {
    /// UTC, in ns since 1970.
    pub utc_ns: u64,
    /// Device time, in µs.
    pub device_us: u64,
}

impl Moment {
    /// UTC of the device time `device_us` near this instant, in ns since 1970.
    pub(super) const fn utc_ns_of(self, device_us: u64) -> u64 {
        let later = device_us.saturating_sub(self.device_us).saturating_mul(1000);
        let earlier = self.device_us.saturating_sub(device_us).saturating_mul(1000);
        self.utc_ns.saturating_add(later).saturating_sub(earlier)
    }
}

/// Ties device time to UTC. Its times never go back.
#[derive(Clone, Copy, Debug)]
pub(super) struct UtcClock {
    /// UTC at device time 0, in ns; `None` before the first sample.
    start_ns: Option<u64>,
    /// The latest time that was given.
    last: Moment,
}

impl UtcClock {
    /// A clock whose times begin at `now_ns` (ns since 1970).
    pub(super) fn new(now_ns: u64) -> Self {
        Self {
            start_ns: None,
            last: Moment {
                utc_ns: now_ns,
                device_us: 0,
            },
        }
    }

    /// The instant of device time `device_us`, where this computer's clock shows `now_ns` (ns since
    /// 1970). Device time that goes back is a controller that started anew: the offset is set again.
    pub(super) fn at(&mut self, device_us: u64, now_ns: u64) -> Moment {
        let device_ns = device_us.saturating_mul(1000);
        if device_us < self.last.device_us {
            self.start_ns = None;
        }
        let start_ns = *self
            .start_ns
            .get_or_insert_with(|| now_ns.max(self.last.utc_ns).saturating_sub(device_ns));
        self.last = Moment {
            // A clock of 1970 or a wrong device time must not bring times back.
            utc_ns: start_ns.saturating_add(device_ns).max(self.last.utc_ns),
            device_us,
        };
        self.last
    }

    /// The latest instant; before the first sample the time of this computer's clock.
    pub(super) fn latest(&self, now_ns: u64) -> Moment {
        match self.start_ns {
            Some(_) => self.last,
            None => Moment {
                utc_ns: now_ns.max(self.last.utc_ns),
                device_us: self.last.device_us,
            },
        }
    }
}

/// The clock of this computer, in ns since 1970.
pub(super) fn now_ns() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |d| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the first sample does not get the time of day, if later ones do not follow device
    // time, or if a controller that starts anew takes times back.
    #[test]
    fn device_time_runs_on_from_the_time_of_day() {
        let mut clock = UtcClock::new(50);
        assert_eq!(clock.latest(70).utc_ns, 70);
        assert_eq!(clock.latest(40).utc_ns, 50);
        let day = 1_800_000_000_000_000_000;
        assert_eq!(clock.at(5_000_000, day).utc_ns, day);
        assert_eq!(clock.at(5_002_000, day + 999).utc_ns, day + 2_000_000);
        assert_eq!(clock.latest(0).utc_ns, day + 2_000_000);
        // A new start, 1 s later by the day.
        assert_eq!(clock.at(1_000, day + 1_000_000_000).utc_ns, day + 1_000_000_000);
        assert_eq!(clock.at(2_000, 0).utc_ns, day + 1_001_000_000);
        // A new start under a clock that was set back.
        assert_eq!(clock.at(500, 0).utc_ns, day + 1_001_000_000);
        assert_eq!(clock.at(1_500, 0).utc_ns, day + 1_002_000_000);
    }
}
