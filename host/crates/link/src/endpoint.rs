//! The host's end of the host link.
//!
//! Down: one command is in progress at a time. The endpoint sends it again, with the same number,
//! until the controller confirms it. If the command has a start time, the endpoint sends it again
//! from that time on (on the device's clock) until the reply arrives. Up: every numbered event is
//! delivered exactly once, in the order of the numbers, and is acknowledged only after the caller
//! has stored it. A repeated event is acknowledged again and dropped. An event that arrives early
//! waits for the events before it.
//!
//! Nothing here reads a clock. Every call passes the time in, so the endpoint behaves the same on a
//! virtual and on a real clock.

use std::collections::{BTreeMap, VecDeque};

use spherecal_shared::protocol::frame::{self, Accumulator, FrameError, LinkCounters, SequenceWatch};
use spherecal_shared::protocol::host::{Command, Downlink, Event, SessionId, Uplink};

use super::keep_alive::{KeepAlives, unnumbered};

/// Most events that may wait for an earlier one. Further events are dropped, and the controller
/// sends them again.
const EARLY_MOST: usize = 64;

/// A command that the controller has confirmed is sent again after this time at the latest, in µs.
const HELD_US: u64 = 1_000_000;

/// When the endpoint repeats itself, in µs of device time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// An unanswered command is sent again after this.
    pub repeat_us: u64,
    /// After this long without a frame a keep-alive is sent.
    pub keep_alive_us: u64,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            repeat_us: 5_000,
            keep_alive_us: 250_000,
        }
    }
}

/// An event from the controller, delivered once.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrival {
    /// Session in which it happened.
    pub session: SessionId,
    /// Number of the event; 0 for an event that is never repeated.
    pub event: u32,
    /// The sender's time when the frame was made, in µs.
    pub sent_us: u64,
    /// The event itself.
    pub body: Event,
}

struct PendingCommand {
    message: Downlink,
    sent_us: u64,
    /// Whether the controller has confirmed the command and waits for its start time.
    held: bool,
}

/// The host's end of the host link.
#[derive(Default)]
pub struct HostEndpoint {
    timing: Timing,
    accumulator: Accumulator,
    watch: SequenceWatch,
    counters: LinkCounters,
    foreign: u32,
    /// Random part of every session number; the count of handshakes is the other part.
    nonce: u32,
    handshakes: u32,
    lost_session: bool,
    /// Newest time that the controller has stated, in µs.
    device_us: u64,
    /// The host's time at that moment, and at the last transmission, in µs.
    device_at_us: u64,
    now_us: u64,
    line: KeepAlives,
    last_command: u32,
    queue: VecDeque<Downlink>,
    pending: Option<PendingCommand>,
    acknowledgements: VecDeque<u32>,
    /// Number of the next event; unknown until the banner has stated it.
    next_event: Option<u32>,
    early: BTreeMap<u32, Arrival>,
    fresh: Vec<Arrival>,
    last_sent_us: Option<u64>,
}

impl HostEndpoint {
    /// An endpoint that has sent nothing yet.
    pub fn new(timing: Timing) -> Self {
        let this = Self {
            timing,
            nonce: random_nonce(),
            ..Self::default()
        };
        this.line.begin(this.session());
        this
    }

    /// Makes keep-alives of this endpoint, in whatever thread.
    pub fn keep_alives(&self) -> &KeepAlives {
        &self.line
    }

    /// The session of the last handshake.
    pub fn session(&self) -> SessionId {
        self.session_of(self.handshakes)
    }

    fn session_of(&self, handshakes: u32) -> SessionId {
        self.nonce.wrapping_add(handshakes).to_le_bytes()
    }

    /// The session of the next handshake.
    pub fn next_session(&self) -> SessionId {
        self.session_of(self.handshakes.wrapping_add(1))
    }

    /// Whether the controller has said that it does not know this session: it was restarted, or
    /// another host has taken it over. True until the next Hello.
    pub fn lost_session(&self) -> bool {
        self.lost_session
    }

    /// Counters of the uplink; `resent` counts commands that were sent again.
    pub fn counters(&self) -> LinkCounters {
        self.counters
    }

    /// Frames that arrived whole but belong to another schema.
    pub fn foreign(&self) -> u32 {
        self.foreign
    }

    /// Queues a command that starts at once. Returns the number that its reply will carry.
    pub fn send(&mut self, command: Command) -> u32 {
        self.send_at(0, command)
    }

    /// Queues a command that starts at `start_us` of the controller's clock. Returns the number
    /// that its reply will carry.
    pub fn send_at(&mut self, start_us: u64, command: Command) -> u32 {
        let sequence = if matches!(command, Command::Hello) {
            // Hello restarts the count; commands queued before it are void.
            self.queue.clear();
            self.pending = None;
            self.next_event = None;
            self.early.clear();
            self.handshakes = self.handshakes.wrapping_add(1);
            self.line.begin(self.session());
            self.lost_session = false;
            1
        } else {
            self.last_command.wrapping_add(1).max(1)
        };
        self.last_command = sequence;
        self.queue.push_back(Downlink {
            session: self.session(),
            sequence,
            start_us,
            command,
        });
        sequence
    }

    /// Appends to `out` the bytes to send at `now_us`.
    ///
    /// # Errors
    /// When a command does not fit a frame.
    pub fn transmit(&mut self, now_us: u64, out: &mut Vec<u8>) -> Result<(), FrameError> {
        self.now_us = now_us;
        while let Some(event) = self.acknowledgements.pop_front() {
            self.unnumbered(Command::Acknowledge { event }, now_us, out)?;
        }
        let device_us = self.device_us.saturating_add(now_us.saturating_sub(self.device_at_us));
        if let Some(pending) = &mut self.pending {
            let waits = pending.held
                && device_us < pending.message.start_us.saturating_add(self.timing.repeat_us)
                && now_us.saturating_sub(pending.sent_us) < HELD_US;
            if !waits && now_us.saturating_sub(pending.sent_us) >= self.timing.repeat_us {
                pending.sent_us = now_us;
                let message = pending.message.clone();
                self.counters.resent = self.counters.resent.wrapping_add(1);
                self.frame(&message, now_us, out)?;
            }
        } else if let Some(message) = self.queue.pop_front() {
            self.frame(&message, now_us, out)?;
            self.pending = Some(PendingCommand {
                message,
                sent_us: now_us,
                held: false,
            });
        }
        let silent = self
            .last_sent_us
            .is_none_or(|last| now_us.saturating_sub(last) >= self.timing.keep_alive_us);
        if silent {
            self.unnumbered(Command::KeepAlive, now_us, out)?;
        }
        Ok(())
    }

    /// Takes the controller's bytes. Passes the numbered events that are due to `store` in one
    /// batch and acknowledges them if `store` succeeds. Then appends every event that arrived to
    /// `arrived`. If `store` fails, nothing is acknowledged, and the next call offers the batch
    /// again.
    ///
    /// # Errors
    /// What `store` reports.
    pub fn receive<E>(
        &mut self,
        bytes: &[u8],
        arrived: &mut Vec<Arrival>,
        store: impl FnOnce(&[Arrival]) -> Result<(), E>,
    ) -> Result<(), E> {
        if bytes.is_empty() && self.fresh.is_empty() {
            return Ok(());
        }
        let mut accumulator = std::mem::take(&mut self.accumulator);
        for &byte in bytes {
            accumulator.push(byte, &mut |frame| match frame.and_then(frame::decode::<Uplink>) {
                Ok((header, message)) => {
                    self.watch.record(header.sequence, &mut self.counters);
                    self.take(message, header.time_us, arrived);
                }
                Err(error) => {
                    self.counters.crc_errors = self.counters.crc_errors.wrapping_add(1);
                    if error == FrameError::Key {
                        self.foreign = self.foreign.wrapping_add(1);
                    }
                }
            });
        }
        self.accumulator = accumulator;
        if !self.fresh.is_empty() {
            store(&self.fresh)?;
            for arrival in self.fresh.drain(..) {
                self.acknowledgements.push_back(arrival.event);
                arrived.push(arrival);
            }
        }
        Ok(())
    }

    fn take(&mut self, message: Uplink, sent_us: u64, arrived: &mut Vec<Arrival>) {
        let ours = message.session == self.session();
        if ours {
            self.hear_time(sent_us);
        }
        let arrival = Arrival {
            session: message.session,
            event: message.event,
            sent_us,
            body: message.body,
        };
        if arrival.event == 0 {
            match &arrival.body {
                Event::Banner(banner) if ours => {
                    self.next_event.get_or_insert(banner.first_event);
                }
                Event::Banner(_) => {
                    // A late event of an earlier session of this endpoint says nothing new. Before
                    // the first session it may be all that a foreign controller says.
                    let late = (0..self.handshakes).any(|k| self.session_of(k) == message.session);
                    self.lost_session |= self.next_event.is_some() && !late;
                    if late {
                        return;
                    }
                }
                // It belongs to a session that is over.
                _ if !ours => return,
                Event::Held { sequence } => {
                    if let Some(pending) = self.pending.as_mut().filter(|p| p.message.sequence == *sequence) {
                        pending.held = true;
                    }
                    return;
                }
                _ => {}
            }
            if let Event::Reply { sequence, .. } = arrival.body {
                match &self.pending {
                    // The banner was lost: repeat the handshake until it arrives.
                    Some(pending) if self.next_event.is_none() && pending.message.command == Command::Hello => return,
                    Some(pending) if pending.message.sequence == sequence => self.pending = None,
                    // The answer to a repeated command whose first answer did arrive.
                    _ => {
                        self.counters.duplicates = self.counters.duplicates.wrapping_add(1);
                        return;
                    }
                }
            }
            arrived.push(arrival);
            return;
        }
        // Without the banner the order is unknown. The event will be sent again.
        let Some(next_event) = self.next_event else { return };
        let ahead = arrival.event.wrapping_sub(next_event);
        if ahead >= 1 << 31 {
            self.counters.duplicates = self.counters.duplicates.wrapping_add(1);
            // Not stored yet: the event is already in the waiting batch.
            if !self.fresh.iter().any(|f| f.event == arrival.event) {
                self.acknowledgements.push_back(arrival.event);
            }
        } else if ahead == 0 {
            self.advance(arrival);
            while let Some(next) = self.next_event.and_then(|n| self.early.remove(&n)) {
                self.advance(next);
            }
        } else if self.early.contains_key(&arrival.event) {
            self.counters.duplicates = self.counters.duplicates.wrapping_add(1);
        } else if self.early.len() < EARLY_MOST {
            self.early.insert(arrival.event, arrival);
        } else {
            self.counters.overflow = self.counters.overflow.wrapping_add(1);
        }
    }

    /// Updates the estimate of the controller's clock.
    fn hear_time(&mut self, sent_us: u64) {
        if sent_us >= self.device_us || self.next_event.is_none() {
            self.device_us = sent_us;
            self.device_at_us = self.now_us;
        }
    }

    fn advance(&mut self, arrival: Arrival) {
        // 0 means "not numbered", so the count skips it.
        self.next_event = Some(arrival.event.wrapping_add(1).max(1));
        self.fresh.push(arrival);
    }

    fn unnumbered(&mut self, command: Command, now_us: u64, out: &mut Vec<u8>) -> Result<(), FrameError> {
        self.frame(&unnumbered(self.session(), command), now_us, out)
    }

    fn frame(&mut self, message: &Downlink, now_us: u64, out: &mut Vec<u8>) -> Result<(), FrameError> {
        self.line.framed(message, now_us, out)?;
        self.last_sent_us = Some(now_us);
        Ok(())
    }
}

/// A number that no other host uses. It is random on purpose and takes no seed: it must differ
/// between runs and influences no result.
fn random_nonce() -> u32 {
    use std::hash::{BuildHasher as _, RandomState};
    RandomState::new().hash_one(std::process::id()) as u32
}

#[cfg(test)]
#[path = "endpoint_tests.rs"]
mod tests;
