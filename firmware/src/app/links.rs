//! Links that run below the control task: queues in the middle, byte streams
//! outside.
//!
//! ```text
//!   UART ─▶ drive_in ─▶ messages ──────┐               ┌─▶ newest command ─▶ drive_out ─▶ UART
//!   UART ─▶ host_in ─▶ bytes ─▶ host ──┴─ run (1 kHz) ─┴─▶ host ─▶ bytes ─▶ host_out ─▶ UART
//! ```
//!
//! Framing of both links happens here, in tasks of lower priority. Every queue
//! is bounded; what does not fit is dropped and counted, and the links' own
//! numbering and repetition deal with the gap.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::pipe::Pipe;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use spherecal_shared::protocol::drive::DriveCommand;
use spherecal_shared::protocol::frame::{self, MAX_FRAME};

use super::ports::{Beat, Clock, DrivePort, Probe};
use super::{DriveReceiver, FromDrive, LinkEnd};
use crate::HostLink;

/// Messages of the drive that may wait for the control task.
const MESSAGES: usize = 4;
/// Bytes from the host that may wait: two of the largest frames.
const DOWN: usize = 2 * MAX_FRAME;
/// Bytes to the host that may wait.
const UP: usize = 8 * MAX_FRAME;
/// Bytes that enter or leave a queue at once: interrupts are off meanwhile.
const PIECE: usize = 64;

/// A stream of bytes, from one end.
pub trait ByteReader {
    /// Waits for at least one byte; returns how many were put into `buffer`.
    fn read(&mut self, buffer: &mut [u8]) -> impl Future<Output = usize>;
}

/// A stream of bytes, from the other end.
pub trait ByteWriter {
    /// Sends all of `bytes`.
    fn write(&mut self, bytes: &[u8]) -> impl Future<Output = ()>;
}

/// The queues between the control task and the links.
pub struct Links<M: RawMutex> {
    messages: Channel<M, FromDrive, MESSAGES>,
    command: Signal<M, DriveCommand>,
    down: Pipe<M, DOWN>,
    up: Pipe<M, UP>,
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
            down: Pipe::new(),
            up: Pipe::new(),
            dropped_messages: AtomicU32::new(0),
            dropped_bytes: AtomicU32::new(0),
        }
    }

    /// Messages of the drive and bytes of the host that found no room.
    pub fn dropped(&self) -> (u32, u32) {
        (
            self.dropped_messages.load(Ordering::Relaxed),
            self.dropped_bytes.load(Ordering::Relaxed),
        )
    }

    /// Reads the drive.
    pub async fn drive_in(&self, reader: &mut impl ByteReader) -> ! {
        let mut receiver = DriveReceiver::new();
        let mut buffer = [0; 256];
        loop {
            let length = reader.read(&mut buffer).await;
            receiver.receive(buffer.get(..length).unwrap_or_default(), &mut |message| {
                if self.messages.try_send(message).is_err() {
                    self.dropped_messages.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
    }

    /// Sends the newest command to the drive.
    pub async fn drive_out(&self, writer: &mut impl ByteWriter) -> ! {
        let mut sequence = 0u32;
        let mut out = [0; 256];
        loop {
            let command = self.command.wait().await;
            let time_us = Instant::now().as_micros();
            if let Ok(length) = frame::encode(&command, sequence, time_us, &mut out) {
                sequence = sequence.wrapping_add(1);
                writer.write(out.get(..length).unwrap_or_default()).await;
            }
        }
    }

    /// Reads the host.
    pub async fn host_in(&self, reader: &mut impl ByteReader) -> ! {
        let mut buffer = [0; 256];
        loop {
            let length = reader.read(&mut buffer).await;
            self.put(&self.down, buffer.get(..length).unwrap_or_default());
        }
    }

    /// Speaks the host link's protocol through `link` after every tick: hands
    /// the host's commands to the control path, and its events to the host.
    /// `up` is where frames are made; its length bounds what one tick may say.
    pub async fn host(&self, link: &mut HostLink, desk: &mut LinkEnd<'_, M>, up: &mut [u8]) -> ! {
        let mut piece = [0; PIECE];
        loop {
            let now = desk.ticked().await;
            while let Ok(count) = self.down.try_read(&mut piece) {
                link.receive(piece.get(..count).unwrap_or_default(), desk);
            }
            let room = self.up.free_capacity().min(up.len());
            let length = link.transmit(now, up.get_mut(..room).unwrap_or_default(), desk);
            self.put(&self.up, up.get(..length).unwrap_or_default());
        }
    }

    /// Sends to the host.
    pub async fn host_out(&self, writer: &mut impl ByteWriter) -> ! {
        let mut buffer = [0; PIECE];
        loop {
            let length = self.up.read(&mut buffer).await;
            writer.write(buffer.get(..length).unwrap_or_default()).await;
        }
    }

    /// Puts `bytes` into `pipe`, piece by piece, and counts what does not fit.
    fn put<const LENGTH: usize>(&self, pipe: &Pipe<M, LENGTH>, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let Ok(taken) = pipe.try_write(rest.get(..PIECE).unwrap_or(rest)) else {
                let lost = u32::try_from(rest.len()).unwrap_or(u32::MAX);
                self.dropped_bytes.fetch_add(lost, Ordering::Relaxed);
                return;
            };
            rest = rest.get(taken..).unwrap_or_default();
        }
    }
}

impl<M: RawMutex> DrivePort for &Links<M> {
    fn receive(&mut self) -> Option<FromDrive> {
        self.messages.try_receive().ok()
    }

    fn send(&mut self, command: &DriveCommand) {
        self.command.signal(command.clone());
    }
}

impl<M: RawMutex> Probe for &Links<M> {}

/// Beats when a message of the drive comes: lock-step with a drive that waits
/// behind a byte stream. The control path is told the drive's time.
pub struct DriveClock<'a, M: RawMutex>(pub &'a Links<M>);

impl<M: RawMutex> Clock for DriveClock<'_, M> {
    async fn next(&mut self) -> Beat {
        self.0.messages.ready_to_receive().await;
        Beat {
            at: Instant::now(),
            missed: 0,
        }
    }

    fn time(&self, _beat: &Beat, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}
