//! The link tasks: byte streams outside, queues towards the control task.
//!
//! ```text
//!   UART ─▶ drive_in ─▶ messages ───────────┐               ┌─▶ newest command ─▶ drive_out ─▶ UART
//!   UART ─▶ host_in ─▶ bytes ─▶ serve_host ─┴─ run (1 kHz) ─┴─▶ serve_host ─▶ bytes ─▶ host_out ─▶ UART
//! ```
//!
//! Framing of both links happens here, at lower priority than the control task.
//! Every queue is bounded. What does not fit is dropped and counted; the links'
//! sequence numbers show the gap, and the host link sends again what matters.
//!
//! A board gives its UARTs as [`embedded_io_async`] streams. No task waits for a stream
//! without end: a read that takes long is begun again, a write that takes long is given up.
//! So a stream whose wake-up is lost delays its link and does not stop it. Each task shows
//! that it is alive ([`Pulse`]).

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::pipe::Pipe;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_io_async::{Read, Write};
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage, DriveReceiver, NO_SESSION};
use spherecal_shared::protocol::frame::{self, LinkCounters, MAX_FRAME};

use super::LinkSide;
use super::ports::{Clock, DrivePort, Probe, Tick};
use super::supervisor::{BEAT, Part, Pulse, WRITE};
use crate::HostLink;

/// Messages of the drive that may wait for the control task.
const MESSAGES: usize = 4;
/// Bytes from the host that may wait: two of the largest frames.
const FROM_HOST: usize = 2 * MAX_FRAME;
/// Bytes to the host that may wait: two of the largest frames, 50 ms at 921,600 baud.
const TO_HOST: usize = 2 * MAX_FRAME;
/// Bytes moved into or out of a queue at once: interrupts are off meanwhile.
const CHUNK: usize = 64;
/// Pause after the second error in a row of a byte stream, so that a stream that fails at
/// once every time leaves the processor to the other link tasks. The first error is one
/// damaged byte: the next one is due in 3 µs.
const ERROR_PAUSE: Duration = Duration::from_millis(1);
/// How often a silent drive is asked for its hello.
const ASK: Duration = Duration::from_millis(200);

/// The queues between the control task and the link tasks.
pub struct Links<M: RawMutex> {
    messages: Channel<M, DriveMessage, MESSAGES>,
    command: Signal<M, DriveCommand>,
    from_host: Pipe<M, FROM_HOST>,
    to_host: Pipe<M, TO_HOST>,
    pulse: Pulse,
    /// Counters of the drive link.
    drive: Mutex<M, Cell<LinkCounters>>,
    dropped_messages: AtomicU32,
    dropped_bytes: AtomicU32,
    stream_errors: AtomicU32,
}

impl<M: RawMutex> Default for Links<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: RawMutex> Links<M> {
    /// Empty queues.
    pub const fn new() -> Self {
        Self {
            messages: Channel::new(),
            command: Signal::new(),
            from_host: Pipe::new(),
            to_host: Pipe::new(),
            pulse: Pulse::new(),
            drive: Mutex::new(Cell::new(LinkCounters::new())),
            dropped_messages: AtomicU32::new(0),
            dropped_bytes: AtomicU32::new(0),
            stream_errors: AtomicU32::new(0),
        }
    }

    /// Drive messages and host bytes that found no room, and errors of the byte streams
    /// with the writes that were given up.
    pub fn dropped(&self) -> (u32, u32, u32) {
        (
            self.dropped_messages.load(Ordering::Relaxed),
            self.dropped_bytes.load(Ordering::Relaxed),
            self.stream_errors.load(Ordering::Relaxed),
        )
    }

    /// The tasks' signs of life.
    pub fn pulse(&self) -> &Pulse {
        &self.pulse
    }

    /// Waits until a message of the drive is there.
    pub async fn message_arrived(&self) {
        self.messages.ready_to_receive().await;
    }

    /// Receives the drive's messages. A damaged byte is found by the frame's
    /// checksum, so errors of the stream are only counted.
    pub async fn drive_in(&self, reader: &mut impl Read) -> ! {
        let mut receiver = DriveReceiver::new();
        let (mut buffer, mut failed) = ([0; 256], false);
        loop {
            self.pulse.beat(Part::DriveIn);
            let length = self.read_some(reader, &mut buffer, &mut failed).await;
            receiver.receive(buffer.get(..length).unwrap_or_default(), &mut |message| {
                if self.messages.try_send(message).is_err() {
                    self.dropped_messages.fetch_add(1, Ordering::Relaxed);
                }
            });
            let mut counters = receiver.counters();
            counters.overflow = self.dropped_messages.load(Ordering::Relaxed);
            self.drive.lock(|drive| drive.set(counters));
        }
    }

    /// Sends the newest command to the drive.
    pub async fn drive_out(&self, writer: &mut impl Write) -> ! {
        let mut sequence = 0u32;
        let mut out = [0; 256];
        loop {
            self.pulse.beat(Part::DriveOut);
            let Ok(command) = with_timeout(BEAT, self.command.wait()).await else {
                continue;
            };
            let time_us = Instant::now().as_micros();
            if let Ok(length) = frame::encode(&command, sequence, time_us, &mut out) {
                sequence = sequence.wrapping_add(1);
                self.write(writer, out.get(..length).unwrap_or_default()).await;
            }
        }
    }

    /// Asks the drive for its hello while no frame comes from it: for a link over UDP, where a drive speaks only to a
    /// controller that it has heard.
    pub async fn ask_drive(&self) -> ! {
        let mut heard = 0;
        loop {
            Timer::after(ASK).await;
            let frames = self.drive.lock(Cell::get).frames;
            if frames == heard {
                self.command.signal(DriveCommand {
                    session: NO_SESSION,
                    ..DriveCommand::default()
                });
            }
            heard = frames;
        }
    }

    /// Receives the host's bytes.
    pub async fn host_in(&self, reader: &mut impl Read) -> ! {
        let (mut buffer, mut failed) = ([0; 256], false);
        loop {
            self.pulse.beat(Part::HostIn);
            let length = self.read_some(reader, &mut buffer, &mut failed).await;
            self.put(&self.from_host, buffer.get(..length).unwrap_or_default());
        }
    }

    /// Runs the host link after every tick: passes the host's commands to the
    /// control task and the control task's events to the host. Frames are made
    /// in `buffer`; its length limits the bytes that one tick sends.
    pub async fn serve_host(&self, link: &mut HostLink, mailbox: &mut LinkSide<'_, M>, buffer: &mut [u8]) -> ! {
        let mut chunk = [0; CHUNK];
        mailbox.limit_samples(link.samples_per_s());
        loop {
            self.pulse.beat(Part::HostLink);
            let Ok(now) = with_timeout(BEAT, mailbox.tick_finished()).await else {
                continue;
            };
            while let Ok(count) = self.from_host.try_read(&mut chunk) {
                link.receive(chunk.get(..count).unwrap_or_default(), mailbox);
            }
            link.set_drive_counters(self.drive.lock(Cell::get));
            let room = self.to_host.free_capacity().min(buffer.len());
            let length = link.transmit(now, buffer.get_mut(..room).unwrap_or_default(), mailbox);
            self.put(&self.to_host, buffer.get(..length).unwrap_or_default());
        }
    }

    /// Sends the bytes for the host.
    pub async fn host_out(&self, writer: &mut impl Write) -> ! {
        let mut buffer = [0; CHUNK];
        loop {
            self.pulse.beat(Part::HostOut);
            if let Ok(length) = with_timeout(BEAT, self.to_host.read(&mut buffer)).await {
                self.write(writer, buffer.get(..length).unwrap_or_default()).await;
            }
        }
    }

    /// Waits for at least one byte; 0 after a beat without one, an error, or the end of
    /// the stream. `failed` says whether the call before ended with an error.
    async fn read_some(&self, reader: &mut impl Read, buffer: &mut [u8], failed: &mut bool) -> usize {
        match with_timeout(BEAT, reader.read(buffer)).await {
            Ok(Ok(length)) if length > 0 => {
                *failed = false;
                length
            }
            Ok(_) => {
                self.stream_errors.fetch_add(1, Ordering::Relaxed);
                if *failed {
                    Timer::after(ERROR_PAUSE).await;
                }
                *failed = true;
                0
            }
            Err(_) => 0,
        }
    }

    /// Sends all of `bytes`. After an error, or when it takes too long, the rest is
    /// dropped: the receiver finds the gap by the frame's checksum.
    async fn write(&self, writer: &mut impl Write, bytes: &[u8]) {
        match with_timeout(WRITE, writer.write_all(bytes)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) => {
                self.stream_errors.fetch_add(1, Ordering::Relaxed);
                Timer::after(ERROR_PAUSE).await;
            }
            Err(_) => {
                self.stream_errors.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Puts `bytes` into `pipe` in chunks and counts what does not fit.
    fn put<const LENGTH: usize>(&self, pipe: &Pipe<M, LENGTH>, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let Ok(taken) = pipe.try_write(rest.get(..CHUNK).unwrap_or(rest)) else {
                let lost = u32::try_from(rest.len()).unwrap_or(u32::MAX);
                self.dropped_bytes.fetch_add(lost, Ordering::Relaxed);
                return;
            };
            rest = rest.get(taken..).unwrap_or_default();
        }
    }
}

impl<M: RawMutex> DrivePort for &Links<M> {
    fn next_message(&mut self) -> Option<DriveMessage> {
        self.messages.try_receive().ok()
    }

    fn send(&mut self, command: &DriveCommand) {
        self.command.signal(command.clone());
    }
}

impl<M: RawMutex> Probe for &Links<M> {}

/// A clock that ticks when a message of the drive comes: lock-step with a drive
/// behind a byte stream. The control path is given the drive's time.
pub struct DriveClock<'a, M: RawMutex>(pub &'a Links<M>);

impl<M: RawMutex> Clock for DriveClock<'_, M> {
    async fn next_tick(&mut self) -> Tick {
        self.0.messages.ready_to_receive().await;
        Tick {
            at: Instant::now(),
            missed: 0,
        }
    }

    fn device_time(&self, _tick: &Tick, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}

#[cfg(test)]
mod tests {
    use core::pin::pin;
    use core::task::{Context, Waker};

    use embassy_sync::blocking_mutex::raw::NoopRawMutex;
    use spherecal_shared::protocol::drive::DriveState;
    use spherecal_shared::protocol::frame::{Accumulator, decode};
    use std::vec::Vec;

    use super::super::uart_model::{Carrier, NOW_US, Reader, Receiver, STEP_US, Transmitter, Writer};
    use super::*;

    // Fails if a silent drive is not asked for its hello five times a second, if one that speaks is asked, or if one
    // that falls silent again is not: it would never hear a controller whose cable was pulled at the start.
    #[test]
    fn a_silent_drive_is_asked() {
        NOW_US.set(0);
        let links = Links::<NoopRawMutex>::new();
        let (from_drive, to_drive) = (Receiver::new(Carrier::Dma, 3_000_000), Transmitter::new(3_000_000));
        let (mut reader, mut writer) = (Reader(from_drive.clone()), Writer(to_drive.clone()));
        let mut read = pin!(links.drive_in(&mut reader));
        let mut write = pin!(links.drive_out(&mut writer));
        let mut ask = pin!(links.ask_drive());
        let mut context = Context::from_waker(Waker::noop());
        let mut asked = Vec::new();
        for second in 0..3u64 {
            for step in 0..1_000_000 / STEP_US {
                let now_us = 1_000_000 * second + STEP_US * step;
                NOW_US.set(now_us);
                if second == 1 && now_us.is_multiple_of(1000) {
                    let mut out = [0; MAX_FRAME];
                    let length = frame::encode(&DriveState::default(), step as u32, now_us, &mut out).expect("it fits");
                    from_drive.borrow_mut().send(now_us as f64, &out[..length]);
                }
                from_drive.borrow_mut().advance(now_us as f64, false);
                let _ = read.as_mut().poll(&mut context);
                let _ = ask.as_mut().poll(&mut context);
                let _ = write.as_mut().poll(&mut context);
            }
            let (mut accumulator, mut questions) = (Accumulator::new(), 0);
            for byte in to_drive.borrow_mut().sent.drain(..) {
                accumulator.push(byte, &mut |frame| {
                    let (_, command) = frame.and_then(decode::<DriveCommand>).expect("a whole frame");
                    questions += u32::from(command.session == NO_SESSION && !command.enable);
                });
            }
            asked.push(questions);
        }
        assert!(asked[0] >= 4 && asked[1] <= 1 && asked[2] >= 4, "{asked:?}");
    }
}
