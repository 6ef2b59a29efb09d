//! What the host link sends: replies, events until they are acknowledged, telemetry,
//! statistics.

use embassy_time::{Duration, Instant};
use heapless::Vec;
use spherecal_shared::protocol::frame::{self, MAX_FRAME};
use spherecal_shared::protocol::host::{Event, MAX_BATCH, Uplink};

use super::{CommandOutcome, CommandPort, HostLink, Pending, Reply};

/// Interval of the statistics.
const STATISTICS: Duration = Duration::from_millis(1000);

impl HostLink {
    /// Writes what is to be sent to `out`, in complete frames, and returns the
    /// number of bytes. Sends nothing before a host has spoken.
    pub fn transmit(&mut self, now: Instant, out: &mut [u8], port: &mut impl CommandPort) -> usize {
        self.collect_outcomes(port);
        if !self.host_known {
            return 0;
        }
        let mut used = 0;
        while let Some(reply) = self.replies.front() {
            let body = match *reply {
                Reply::Banner { period_us } => Event::Banner(self.banner(period_us)),
                Reply::Held { sequence } => Event::Held { sequence },
                Reply::Outcome(CommandOutcome { sequence, result }) => Event::Reply { sequence, result },
            };
            let Some(length) = self.write_unnumbered(body, now, out, used) else {
                return used;
            };
            used += length;
            self.replies.pop_front();
        }
        self.take_events(port);
        used = self.send_pending(now, out, used);
        used = self.send_samples(now, out, used, port);
        let due = self
            .last_statistics
            .is_none_or(|last| now.saturating_duration_since(last) >= STATISTICS);
        if due {
            let mut statistics = port.statistics();
            let overflow = statistics.link.overflow;
            statistics.link = self.counters;
            statistics.drive = self.drive;
            statistics.link.overflow = statistics.link.overflow.saturating_add(overflow);
            if let Some(length) = self.write_unnumbered(Event::Statistics(statistics), now, out, used) {
                used += length;
                self.last_statistics = Some(now);
            }
        }
        used
    }

    /// Numbers new events while there is room among the unacknowledged ones.
    pub(super) fn take_events(&mut self, port: &mut impl CommandPort) {
        while !self.pending.is_full() {
            let Some(report) = port.next_report() else { break };
            let entry = Pending {
                session: self.session(),
                event: self.next_event,
                report,
                sent: None,
            };
            self.next_event = self.next_event.wrapping_add(1).max(1);
            let _ = self.pending.push_back(entry);
        }
    }

    fn send_pending(&mut self, now: Instant, out: &mut [u8], mut used: usize) -> usize {
        for _ in 0..self.pending.len() {
            // Takes and returns each entry, so that no borrow of the queue lasts.
            let Some(mut entry) = self.pending.pop_front() else {
                break;
            };
            let due = entry
                .sent
                .is_none_or(|sent| now.saturating_duration_since(sent) >= self.resend);
            if due && let Some(length) = self.write_pending(&entry, now, out, used) {
                used += length;
                if entry.sent.is_some() {
                    self.counters.resent = self.counters.resent.saturating_add(1);
                }
                entry.sent = Some(now);
            }
            let _ = self.pending.push_back(entry);
        }
        used
    }

    fn send_samples(&mut self, now: Instant, out: &mut [u8], mut used: usize, port: &mut impl CommandPort) -> usize {
        while port.samples_waiting() >= MAX_BATCH {
            // Starts only if a complete batch certainly fits.
            if out.len().saturating_sub(used) < MAX_FRAME {
                return used;
            }
            let mut batch = Vec::new();
            while !batch.is_full() {
                let Some(sample) = port.next_sample() else { break };
                let _ = batch.push(sample);
            }
            match self.write_unnumbered(Event::Telemetry(batch), now, out, used) {
                Some(length) => used += length,
                None => return used,
            }
        }
        used
    }

    // Not inlined: the wire's event takes 1.6 kB of stack, once.
    #[inline(never)]
    fn write_pending(&mut self, entry: &Pending, now: Instant, out: &mut [u8], used: usize) -> Option<usize> {
        let uplink = Uplink {
            session: entry.session,
            event: entry.event,
            body: entry.report.clone().into(),
        };
        self.write(&uplink, now, out, used)
    }

    /// Encodes a message that is sent once, after the first `used` bytes of `out`.
    #[inline(never)]
    fn write_unnumbered(&mut self, body: Event, now: Instant, out: &mut [u8], used: usize) -> Option<usize> {
        let uplink = Uplink {
            session: self.session(),
            event: 0,
            body,
        };
        self.write(&uplink, now, out, used)
    }

    /// Encodes one frame after the first `used` bytes of `out`.
    fn write(&mut self, uplink: &Uplink, now: Instant, out: &mut [u8], used: usize) -> Option<usize> {
        let rest = out.get_mut(used..)?;
        let length = frame::encode(uplink, self.sequence, now.as_micros(), rest).ok()?;
        self.sequence = self.sequence.wrapping_add(1);
        Some(length)
    }
}
