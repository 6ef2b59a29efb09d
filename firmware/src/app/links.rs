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
//! A board gives its UARTs as [`embedded_io_async`] streams.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::pipe::Pipe;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::{Read, Write};
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage, DriveReceiver};
use spherecal_shared::protocol::frame::{self, MAX_FRAME};

use super::LinkSide;
use super::ports::{Clock, DrivePort, Probe, Tick};
use crate::HostLink;

/// Messages of the drive that may wait for the control task.
const MESSAGES: usize = 4;
/// Bytes from the host that may wait: two of the largest frames.
const FROM_HOST: usize = 2 * MAX_FRAME;
/// Bytes to the host that may wait.
const TO_HOST: usize = 8 * MAX_FRAME;
/// Bytes moved into or out of a queue at once: interrupts are off meanwhile.
const CHUNK: usize = 64;
/// Pause after an error of a byte stream, so that a stream that fails at once
/// every time leaves the processor to the other link tasks.
const ERROR_PAUSE: Duration = Duration::from_millis(1);

/// The queues between the control task and the link tasks.
pub struct Links<M: RawMutex> {
    messages: Channel<M, DriveMessage, MESSAGES>,
    command: Signal<M, DriveCommand>,
    from_host: Pipe<M, FROM_HOST>,
    to_host: Pipe<M, TO_HOST>,
    dropped_messages: AtomicU32,
    dropped_bytes: AtomicU32,
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
            dropped_messages: AtomicU32::new(0),
            dropped_bytes: AtomicU32::new(0),
        }
    }

    /// Drive messages and host bytes that found no room.
    pub fn dropped(&self) -> (u32, u32) {
        (
            self.dropped_messages.load(Ordering::Relaxed),
            self.dropped_bytes.load(Ordering::Relaxed),
        )
    }

    /// Receives the drive's messages. A damaged byte is found by the frame's
    /// checksum, so errors of the stream are not examined.
    pub async fn drive_in(&self, reader: &mut impl Read) -> ! {
        let mut receiver = DriveReceiver::new();
        let mut buffer = [0; 256];
        loop {
            let length = read_some(reader, &mut buffer).await;
            receiver.receive(buffer.get(..length).unwrap_or_default(), &mut |message| {
                if self.messages.try_send(message).is_err() {
                    self.dropped_messages.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
    }

    /// Sends the newest command to the drive.
    pub async fn drive_out(&self, writer: &mut impl Write) -> ! {
        let mut sequence = 0u32;
        let mut out = [0; 256];
        loop {
            let command = self.command.wait().await;
            let time_us = Instant::now().as_micros();
            if let Ok(length) = frame::encode(&command, sequence, time_us, &mut out) {
                sequence = sequence.wrapping_add(1);
                write(writer, out.get(..length).unwrap_or_default()).await;
            }
        }
    }

    /// Receives the host's bytes.
    pub async fn host_in(&self, reader: &mut impl Read) -> ! {
        let mut buffer = [0; 256];
        loop {
            let length = read_some(reader, &mut buffer).await;
            self.put(&self.from_host, buffer.get(..length).unwrap_or_default());
        }
    }

    /// Runs the host link after every tick: passes the host's commands to the
    /// control task and the control task's events to the host. Frames are made
    /// in `buffer`; its length limits the bytes that one tick sends.
    pub async fn serve_host(&self, link: &mut HostLink, mailbox: &mut LinkSide<'_, M>, buffer: &mut [u8]) -> ! {
        let mut chunk = [0; CHUNK];
        loop {
            let now = mailbox.tick_finished().await;
            while let Ok(count) = self.from_host.try_read(&mut chunk) {
                link.receive(chunk.get(..count).unwrap_or_default(), mailbox);
            }
            let room = self.to_host.free_capacity().min(buffer.len());
            let length = link.transmit(now, buffer.get_mut(..room).unwrap_or_default(), mailbox);
            self.put(&self.to_host, buffer.get(..length).unwrap_or_default());
        }
    }

    /// Sends the bytes for the host.
    pub async fn host_out(&self, writer: &mut impl Write) -> ! {
        let mut buffer = [0; CHUNK];
        loop {
            let length = self.to_host.read(&mut buffer).await;
            write(writer, buffer.get(..length).unwrap_or_default()).await;
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

/// Waits for at least one byte; 0 after an error or the end of the stream.
async fn read_some(reader: &mut impl Read, buffer: &mut [u8]) -> usize {
    match reader.read(buffer).await {
        Ok(length) if length > 0 => length,
        _ => {
            Timer::after(ERROR_PAUSE).await;
            0
        }
    }
}

/// Sends all of `bytes`. After an error the rest is dropped: the receiver finds
/// the gap by the frame's checksum.
async fn write(writer: &mut impl Write, bytes: &[u8]) {
    if writer.write_all(bytes).await.is_err() {
        Timer::after(ERROR_PAUSE).await;
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
