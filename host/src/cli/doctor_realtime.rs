//! `spherecal doctor --realtime`: can this machine hold 1 kHz?

use std::fmt::Write as _;
use std::time::Duration;

use serde::Serialize;

use super::exit::CliError;
use spherecal_link::native::WakeUps;

/// Lateness that 99.9 % of the wake-ups may not exceed, in µs. A Franka robot wants its command
/// 300 µs after the state; the rest is for the network and the control law.
const GOOD_US: u32 = 200;
/// Lateness that no wake-up may exceed, in µs: a whole period.
const WORST_US: u32 = 1000;

#[derive(Clone, Debug, Serialize)]
pub(super) struct RealTimeCheck {
    /// Whether this machine can hold 1 kHz.
    pub(super) holds_1_khz: bool,
    /// The measurement's length, in s.
    pub(super) seconds: f64,
    wake_ups: u64,
    /// Periods that were overslept wholly.
    missed: u64,
    /// Lateness that half of the wake-ups do not exceed, in µs.
    p50_us: u32,
    /// The same for 99 %.
    p99_us: u32,
    /// The same for 99.9 %.
    p999_us: u32,
    /// The latest wake-up, in µs.
    max_us: u32,
    /// Whether the thread had a fixed priority.
    priority: bool,
    memory_locked: bool,
    #[serde(skip)]
    words: String,
}

impl RealTimeCheck {
    pub(super) fn measure(seconds: f64) -> Result<Self, CliError> {
        if !(0.1..=3600.0).contains(&seconds) {
            return Err(CliError::input(format!(
                "--realtime={seconds}: give 0.1 to 3600 seconds"
            )));
        }
        let found = WakeUps::measure(Duration::from_secs_f64(seconds)).map_err(CliError::job)?;
        let late = &found.lateness;
        Ok(Self {
            holds_1_khz: late.percentile_us(0.999) <= GOOD_US && late.max_us() <= WORST_US,
            seconds,
            wake_ups: late.count(),
            missed: found.missed,
            p50_us: late.percentile_us(0.5),
            p99_us: late.percentile_us(0.99),
            p999_us: late.percentile_us(0.999),
            max_us: late.max_us(),
            priority: found.granted.priority,
            memory_locked: found.granted.memory_locked,
            words: found.granted.to_string(),
        })
    }

    /// For people.
    pub(super) fn text(&self) -> String {
        let mut out = String::new();
        let _ = writeln!(out, "\nWake-ups at 1 kHz for {} s", self.seconds);
        let _ = writeln!(out, "  {}", self.words);
        let _ = writeln!(
            out,
            "  late by {} us (median), {} us (99 %), {} us (99.9 %), {} us (worst); {} of {} periods overslept",
            self.p50_us,
            self.p99_us,
            self.p999_us,
            self.max_us,
            self.missed,
            self.wake_ups + self.missed
        );
        let _ = if self.holds_1_khz {
            writeln!(out, "  This machine can hold 1 kHz, under the load that it has now.")
        } else {
            writeln!(
                out,
                "  This machine cannot hold 1 kHz under the load that it has now: 99.9 % must be below {GOOD_US} us and \
                 all below {WORST_US} us. Stop other programs, use a PREEMPT_RT kernel, and see docs/robots/franka.md, \
                 \"The computer\"."
            )
        };
        out
    }
}
