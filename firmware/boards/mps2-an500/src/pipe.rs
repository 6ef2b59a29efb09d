//! Both links on QEMU's standard streams, in lock-step turns.
//!
//! [`spherecal_shared::protocol::lockstep`] says what a turn is. Reading blocks
//! and virtual time stands still meanwhile, so the same host gives the same
//! run, to the bit and to the time stamp.
//!
//! The pipe runs below the control task, as links do on every board: it reads a
//! turn, decodes it into queues, waits for the control task's tick and writes
//! the answer.
//!
//! ```text
//!   stdin  ─▶ serve ─▶ messages, Post ─▶ LockStep, run (1 kHz)
//!   stdout ◀─ serve ◀─ command, Post  ◀──┘
//! ```

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use heapless::spsc::{Consumer, Producer, Queue};
use spherecal_firmware::HostLink;
use spherecal_firmware::app::ports::{DrivePort, Probe};
use spherecal_firmware::app::{DriveReceiver, FromDrive, LinkEnd};
use spherecal_shared::protocol::drive::DriveCommand;
use spherecal_shared::protocol::frame;
use spherecal_shared::protocol::lockstep::{DOWN_HEADER, Down, MAX_DRIVE, MAX_HOST, MAX_TURN, UP_HEADER, Up};

use static_cell::ConstStaticCell;

use crate::semihosting::{File, Mode};
use crate::timer::stopwatch;

/// The host link's end of the queues, with this board's lock.
pub type Desk = LinkEnd<'static, CriticalSectionRawMutex>;

/// A turn has a hello and a state at most; one place is free.
pub type Messages = Queue<FromDrive, 3>;

/// A turn has come and waits for its tick.
pub static TURN: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static COMMAND: Signal<CriticalSectionRawMutex, DriveCommand> = Signal::new();
static ENDED: AtomicBool = AtomicBool::new(false);
/// What the last tick cost, in counts of the stopwatch.
static COST: AtomicU32 = AtomicU32::new(0);

/// The control task's end.
pub struct LockStep {
    messages: Consumer<'static, FromDrive>,
    started: u32,
}

impl LockStep {
    /// Takes messages from `messages`.
    pub fn new(messages: Consumer<'static, FromDrive>) -> Self {
        Self { messages, started: 0 }
    }
}

impl DrivePort for LockStep {
    fn receive(&mut self) -> Option<FromDrive> {
        self.messages.dequeue()
    }

    fn send(&mut self, command: &DriveCommand) {
        COMMAND.signal(command.clone());
    }

    fn ended(&self) -> bool {
        ENDED.load(Ordering::Acquire)
    }
}

impl Probe for LockStep {
    fn before_tick(&mut self) {
        self.started = stopwatch::read();
    }

    fn after_tick(&mut self) {
        COST.store(stopwatch::between(self.started, stopwatch::read()), Ordering::Relaxed);
    }
}

/// The pipe and its buffers.
pub struct Pipe {
    input: File,
    output: File,
    receiver: DriveReceiver,
    messages: Producer<'static, FromDrive>,
    link: &'static mut HostLink,
    /// The present turn, and what has come behind it.
    down: &'static mut [u8; MAX_TURN],
    filled: usize,
    consumed: usize,
    up: &'static mut [u8; MAX_TURN],
    sequence: u32,
}

impl Pipe {
    /// Opens the standard streams; drive messages go to `messages`, `link`
    /// speaks with the host.
    pub fn open(messages: Producer<'static, FromDrive>, link: &'static mut HostLink) -> Option<Self> {
        static DOWN: ConstStaticCell<[u8; MAX_TURN]> = ConstStaticCell::new([0; MAX_TURN]);
        static UP: ConstStaticCell<[u8; MAX_TURN]> = ConstStaticCell::new([0; MAX_TURN]);
        Some(Self {
            input: File::open(":tt\0", Mode::Read)?,
            output: File::open(":tt\0", Mode::Write)?,
            receiver: DriveReceiver::new(),
            messages,
            link,
            down: DOWN.take(),
            filled: 0,
            consumed: 0,
            up: UP.take(),
            sequence: 0,
        })
    }

    /// Serves turns until there are no more.
    pub async fn serve(&mut self, desk: &mut Desk) {
        let mut next = self.read_turn(desk);
        while let Some(decoding) = next {
            TURN.signal(());
            let now = desk.ticked().await;
            let started = stopwatch::read();
            let drive = &mut self.up[UP_HEADER..UP_HEADER + MAX_DRIVE];
            let drive = COMMAND.try_take().map_or(0, |command| {
                frame::encode(&command, self.sequence, now.as_micros(), drive).unwrap_or(0)
            });
            self.sequence = self.sequence.wrapping_add(1);
            let start = UP_HEADER + drive;
            let host = &mut self.up[start..start + MAX_HOST];
            let host = self.link.transmit(now, host, desk);
            let encoding = stopwatch::between(started, stopwatch::read());
            let header = Up {
                drive: drive as u16,
                host: host as u16,
                tick: COST.load(Ordering::Relaxed),
                link: decoding + encoding,
            };
            self.up[..UP_HEADER].copy_from_slice(&header.to_bytes());
            if !self.output.write(&self.up[..start + host]) {
                break;
            }
            next = self.read_turn(desk);
        }
        ENDED.store(true, Ordering::Release);
        TURN.signal(());
    }

    /// Waits for a turn of the host and decodes it; returns what that cost, in
    /// counts of the stopwatch.
    fn read_turn(&mut self, desk: &mut Desk) -> Option<u32> {
        self.down.copy_within(self.consumed..self.filled, 0);
        self.filled -= self.consumed;
        self.consumed = 0;
        let header = loop {
            if let Some(bytes) = self.down.get(..self.filled)?.first_chunk() {
                let header = Down::from_bytes(*bytes);
                if self.filled >= DOWN_HEADER + header.body()? {
                    break header;
                }
            }
            let count = self.input.read(self.down.get_mut(self.filled..)?);
            if count == 0 {
                return None;
            }
            self.filled += count;
        };
        let started = stopwatch::read();
        let drive = usize::from(header.drive);
        if drive == 0 {
            return None;
        }
        let need = DOWN_HEADER + header.body()?;
        self.consumed = need;
        let start = DOWN_HEADER + drive;
        let messages = &mut self.messages;
        self.receiver
            .receive(self.down.get(DOWN_HEADER..start)?, &mut |message| {
                let _ = messages.enqueue(message);
            });
        self.link.receive(self.down.get(start..need)?, desk);
        Some(stopwatch::between(started, stopwatch::read()))
    }
}
