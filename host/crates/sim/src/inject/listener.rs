//! Reads the controller's phases from the host link, as any listener may.

use std::collections::HashMap;

use spherecal_shared::protocol::frame::{self, Accumulator};
use spherecal_shared::protocol::host::{Event, Phase, Uplink};

/// The phases that the controller has reported.
#[derive(Default)]
pub(super) struct PhaseListener {
    accumulator: Accumulator,
    last_event: u32,
    phase: Phase,
    entries: HashMap<Phase, u32>,
}

impl PhaseListener {
    /// Takes the controller's bytes. Calls `entered` with each phase that begins and with its
    /// count.
    pub(super) fn hear(&mut self, bytes: &[u8], mut entered: impl FnMut(Phase, u32)) {
        let Self {
            accumulator,
            last_event,
            phase,
            entries,
        } = self;
        for &byte in bytes {
            accumulator.push(byte, &mut |frame| {
                let Ok((_, Uplink { event, body, .. })) = frame.and_then(frame::decode::<Uplink>) else {
                    return;
                };
                // A repeated event was already handled.
                if event != 0 && event.wrapping_sub(*last_event) >= 1 << 31 || event == *last_event {
                    return;
                }
                if event != 0 {
                    *last_event = event;
                }
                if let Event::Phase(change) = body {
                    *phase = change.phase;
                    let count = entries.entry(change.phase).or_default();
                    *count += 1;
                    entered(change.phase, *count);
                }
            });
        }
    }

    /// A controller that restarts counts its events from 1 again.
    pub(super) fn restarted(&mut self) {
        self.last_event = 0;
        self.phase = Phase::Idle;
    }

    /// The last reported phase.
    pub(super) fn phase(&self) -> Phase {
        self.phase
    }
}
