//! The controller's end of the host link: bytes to commands, events to bytes.
//!
//! It knows the control path as a [`CommandPort`] only: at hand in one thread
//! ([`Node`](crate::Node)), or behind queues on a board, where the link runs
//! below the control task ([`app`](crate::app)).
//!
//! Commands are carried out once, however often they come; events are sent
//! again until the host acknowledges them, in order. Telemetry, replies and
//! statistics are sent once: the host asks again if it misses a reply.
//!
//! Only the host that greeted last is obeyed. Whoever else speaks is told who
//! is here, in a banner of the present session: so a host learns that the
//! controller was restarted, or that another host has taken over.

use embassy_time::{Duration, Instant};
use heapless::{Deque, String, Vec};
use spherecal_shared::protocol::frame::{self, Accumulator, FrameError, LinkCounters, MAX_FRAME, SequenceWatch};
use spherecal_shared::protocol::host::{
    Banner, Command, Downlink, Event, MAX_BATCH, Refusal, Sample, SessionId, Statistics, Uplink,
};
use spherecal_shared::protocol::{PROTOCOL_VERSION, SCHEMA};

/// Events sent and not yet acknowledged, at most.
const PENDING: usize = 8;
/// Answers waiting to be sent, at most.
const REPLIES: usize = 4;
/// After which an unacknowledged event is sent again, where the board says
/// nothing else: a host that keeps up answers within two periods.
const RESEND: Duration = Duration::from_millis(5);
/// How often statistics are sent.
const STATISTICS: Duration = Duration::from_millis(1000);

/// What became of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandOutcome {
    /// Number of the command.
    pub sequence: u32,
    /// Whether it is being carried out.
    pub result: Result<(), Refusal>,
}

/// The control path, as the host link sees it.
pub trait CommandPort {
    /// Notes that the host was heard.
    fn host_heard(&mut self);

    /// Takes a command that is to be carried out at `start_us` (device time, in
    /// µs); `false` when there is no room: the host sends it again.
    fn queue_command(&mut self, sequence: u32, start_us: u64, command: Command) -> bool;

    /// What became of the oldest command whose verdict was not asked for yet.
    fn command_outcome(&mut self) -> Option<CommandOutcome>;

    /// The next event for the host.
    fn next_event(&mut self) -> Option<Event>;

    /// Telemetry samples that wait.
    fn samples_waiting(&self) -> usize;

    /// The next telemetry sample.
    fn next_sample(&mut self) -> Option<Sample>;

    /// Counters of the control path; the link adds its own.
    fn statistics(&self) -> Statistics;
}

/// An event that the host has not acknowledged.
#[derive(Clone, Debug)]
struct Pending {
    uplink: Uplink,
    /// When it was last sent; `None` before the first time.
    sent: Option<Instant>,
}

/// The answer to the last command, for when it comes again; none while the
/// control path has not said.
#[derive(Clone, Copy, Debug)]
struct Answer {
    sequence: u32,
    result: Option<Result<(), Refusal>>,
}

/// The controller's end of the host link.
#[derive(Clone, Debug)]
pub struct HostLink {
    accumulator: Accumulator,
    watch: SequenceWatch,
    counters: LinkCounters,
    build: String<24>,
    joints: u8,
    resend: Duration,
    session: Option<SessionId>,
    /// The session before: a late repeat of its greeting does not bring it back.
    previous: Option<SessionId>,
    /// Whether there is anyone to speak to.
    greeted: bool,
    answered: Option<Answer>,
    replies: Deque<Event, REPLIES>,
    pending: Deque<Pending, PENDING>,
    next_event: u32,
    sequence: u32,
    last_statistics: Option<Instant>,
}

impl HostLink {
    /// A link that says `build` in its banner (cut to 24 bytes) and speaks for
    /// a controller of `joints` joints.
    pub fn new(build: &str, joints: usize) -> Self {
        let mut text = String::new();
        for c in build.chars() {
            if text.push(c).is_err() {
                break;
            }
        }
        Self {
            accumulator: Accumulator::new(),
            watch: SequenceWatch::default(),
            counters: LinkCounters::default(),
            build: text,
            joints: u8::try_from(joints).unwrap_or(u8::MAX),
            resend: RESEND,
            session: None,
            previous: None,
            greeted: false,
            answered: None,
            replies: Deque::new(),
            pending: Deque::new(),
            next_event: 1,
            sequence: 0,
            last_statistics: None,
        }
    }

    /// The same link with another time after which an unacknowledged event is
    /// sent again: for wires on which a frame takes long.
    pub fn resending_after(mut self, resend: Duration) -> Self {
        self.resend = resend;
        self
    }

    /// What this end has received.
    pub fn counters(&self) -> &LinkCounters {
        &self.counters
    }

    /// Takes bytes from the host; whole commands go to the control path.
    pub fn receive(&mut self, bytes: &[u8], port: &mut impl CommandPort) {
        for byte in bytes {
            let mut received = None;
            self.accumulator.push(*byte, &mut |frame| {
                received = Some(frame.and_then(frame::decode::<Downlink>));
            });
            match received {
                None => {}
                Some(Ok((header, downlink))) => {
                    self.watch.record(header.sequence, &mut self.counters);
                    self.take(downlink, port);
                }
                Some(Err(error)) => {
                    self.counters.crc_errors = self.counters.crc_errors.saturating_add(1);
                    if error == FrameError::Key {
                        // A host of another schema: it cannot be understood,
                        // but it can be told to whom it speaks.
                        self.introduce();
                    }
                }
            }
        }
    }

    fn take(&mut self, downlink: Downlink, port: &mut impl CommandPort) {
        let Downlink {
            session,
            sequence,
            start_us,
            command,
        } = downlink;
        let hello = matches!(command, Command::Hello);
        if hello && self.session != Some(session) && self.previous != Some(session) {
            // What happened until now belongs to the session that ends here.
            self.take_events(port);
            self.previous = self.session.replace(session);
            self.answered = None;
            self.replies.clear();
        } else if self.session != Some(session) {
            self.introduce();
            return;
        }
        port.host_heard();
        match command {
            Command::KeepAlive => return,
            Command::Acknowledge { event } => {
                for _ in 0..self.pending.len() {
                    let Some(entry) = self.pending.pop_front() else { break };
                    if entry.uplink.event != event {
                        let _ = self.pending.push_back(entry);
                    }
                }
                return;
            }
            _ => {}
        }
        self.collect(port);
        if hello {
            self.introduce();
        }
        if let Some(last) = self.answered {
            // A repeat: of the last command, which is answered again, or of one
            // that was overtaken, which was answered before the last was sent.
            let overtaken = sequence.wrapping_sub(last.sequence) >= 1 << 31;
            if overtaken || sequence == last.sequence {
                self.counters.duplicates = self.counters.duplicates.saturating_add(1);
                match last.result {
                    _ if overtaken => {}
                    Some(result) => self.reply(Event::Reply { sequence, result }),
                    None => self.reply(Event::Held { sequence }),
                }
                return;
            }
        }
        if port.queue_command(sequence, start_us, command) {
            self.answered = Some(Answer { sequence, result: None });
            if start_us > 0 {
                self.reply(Event::Held { sequence });
            }
        } else {
            self.counters.overflow = self.counters.overflow.saturating_add(1);
        }
    }

    /// Turns what the control path says of commands into replies.
    fn collect(&mut self, port: &mut impl CommandPort) {
        while !self.replies.is_full()
            && let Some(CommandOutcome { sequence, result }) = port.command_outcome()
        {
            if let Some(answered) = self.answered.as_mut().filter(|a| a.sequence == sequence) {
                answered.result = Some(result);
            }
            self.reply(Event::Reply { sequence, result });
        }
    }

    fn introduce(&mut self) {
        self.greeted = true;
        let banner = self.banner();
        self.reply(Event::Banner(banner));
    }

    fn session(&self) -> SessionId {
        self.session.unwrap_or_default()
    }

    fn reply(&mut self, event: Event) {
        if self.replies.push_back(event).is_err() {
            self.counters.overflow = self.counters.overflow.saturating_add(1);
        }
    }

    fn banner(&self) -> Banner {
        let mut version = String::new();
        let _ = version.push_str(env!("CARGO_PKG_VERSION"));
        Banner {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA,
            version,
            build: self.build.clone(),
            joints: self.joints,
            period_us: 1000,
            first_event: self.pending.front().map_or(self.next_event, |p| p.uplink.event),
        }
    }

    /// Writes what there is to say into `out`, whole frames only; returns the
    /// number of bytes. Nothing is said before the host's first Hello.
    pub fn transmit(&mut self, now: Instant, out: &mut [u8], port: &mut impl CommandPort) -> usize {
        self.collect(port);
        if !self.greeted {
            return 0;
        }
        let mut used = 0;
        while let Some(event) = self.replies.front() {
            let uplink = Uplink {
                session: self.session(),
                event: 0,
                body: event.clone(),
            };
            let Some(length) = self.write(&uplink, now, out, used) else {
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
            statistics.link.overflow = statistics.link.overflow.saturating_add(overflow);
            if let Some(length) = self.write(
                &Uplink {
                    session: self.session(),
                    event: 0,
                    body: Event::Statistics(statistics),
                },
                now,
                out,
                used,
            ) {
                used += length;
                self.last_statistics = Some(now);
            }
        }
        used
    }

    /// Numbers events for as many as may wait for their acknowledgement.
    fn take_events(&mut self, port: &mut impl CommandPort) {
        while !self.pending.is_full() {
            let Some(body) = port.next_event() else { break };
            let uplink = Uplink {
                session: self.session(),
                event: self.next_event,
                body,
            };
            self.next_event = self.next_event.wrapping_add(1).max(1);
            let _ = self.pending.push_back(Pending { uplink, sent: None });
        }
    }

    fn send_pending(&mut self, now: Instant, out: &mut [u8], mut used: usize) -> usize {
        for _ in 0..self.pending.len() {
            // The queue is turned once around, so that no borrow of it lasts.
            let Some(mut entry) = self.pending.pop_front() else {
                break;
            };
            let due = entry
                .sent
                .is_none_or(|sent| now.saturating_duration_since(sent) >= self.resend);
            if due && let Some(length) = self.write(&entry.uplink, now, out, used) {
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
            // Only started when a whole batch surely fits.
            if out.len().saturating_sub(used) < MAX_FRAME {
                return used;
            }
            let mut batch = Vec::new();
            while !batch.is_full() {
                let Some(sample) = port.next_sample() else { break };
                let _ = batch.push(sample);
            }
            match self.write(
                &Uplink {
                    session: self.session(),
                    event: 0,
                    body: Event::Telemetry(batch),
                },
                now,
                out,
                used,
            ) {
                Some(length) => used += length,
                None => return used,
            }
        }
        used
    }

    /// Encodes one frame behind the first `used` bytes of `out`.
    fn write(&mut self, uplink: &Uplink, now: Instant, out: &mut [u8], used: usize) -> Option<usize> {
        let rest = out.get_mut(used..)?;
        let length = frame::encode(uplink, self.sequence, now.as_micros(), rest).ok()?;
        self.sequence = self.sequence.wrapping_add(1);
        Some(length)
    }
}

#[cfg(test)]
mod tests;
