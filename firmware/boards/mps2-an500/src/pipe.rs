//! Both links on QEMU's standard streams, in lock-step exchanges.
//!
//! [`spherecal_shared::protocol::lockstep`] defines an exchange. Reading blocks,
//! and virtual time stands still meanwhile. The same host therefore gives the
//! same run, to the bit and to the time stamp.
//!
//! The pipe runs at lower priority than the control task, as links do on every
//! board. It reads an exchange, decodes it into queues, waits for the end of the
//! tick and writes the answer.
//!
//! ```text
//!   stdin  ─▶ serve ─▶ messages, Mailbox ─▶ LockStep, run (1 kHz)
//!   stdout ◀─ serve ◀─ command, Mailbox  ◀──┘
//! ```

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use heapless::spsc::{Consumer, Producer, Queue};
use spherecal_board::LinkSide;
use spherecal_firmware::HostLink;
use spherecal_firmware::app::ports::{DrivePort, Probe};
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage, DriveReceiver};
use spherecal_shared::protocol::frame;
use spherecal_shared::protocol::lockstep::{DOWN_HEADER, Down, MAX_DRIVE, MAX_EXCHANGE, MAX_HOST, UP_HEADER, Up};

use static_cell::ConstStaticCell;

use crate::semihosting::{File, Mode};
use crate::timer::stopwatch;

/// Messages of one exchange: at most a handshake and a state. A queue of three
/// places holds two values.
pub type Messages = Queue<DriveMessage, 3>;

/// Set when an exchange has come and waits for its tick.
pub static EXCHANGE: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static COMMAND: Signal<CriticalSectionRawMutex, DriveCommand> = Signal::new();
static ENDED: AtomicBool = AtomicBool::new(false);
/// Cost of the last tick, in counts of the stopwatch.
static COST: AtomicU32 = AtomicU32::new(0);

/// The drive port of the control task.
pub struct LockStep {
    messages: Consumer<'static, DriveMessage>,
    started: u32,
}

impl LockStep {
    /// A port that takes the drive's messages from `messages`.
    pub fn new(messages: Consumer<'static, DriveMessage>) -> Self {
        Self { messages, started: 0 }
    }
}

impl DrivePort for LockStep {
    fn next_message(&mut self) -> Option<DriveMessage> {
        self.messages.dequeue()
    }

    fn send(&mut self, command: &DriveCommand) {
        COMMAND.signal(command.clone());
    }

    fn has_ended(&self) -> bool {
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
    messages: Producer<'static, DriveMessage>,
    link: &'static mut HostLink,
    /// The present exchange and the bytes that have come after it.
    down: &'static mut [u8; MAX_EXCHANGE],
    filled: usize,
    consumed: usize,
    up: &'static mut [u8; MAX_EXCHANGE],
    sequence: u32,
}

impl Pipe {
    /// Opens the standard streams; `None` when QEMU has none. The drive's
    /// messages go to `messages`, `link` talks to the host.
    pub fn open(messages: Producer<'static, DriveMessage>, link: &'static mut HostLink) -> Option<Self> {
        static DOWN: ConstStaticCell<[u8; MAX_EXCHANGE]> = ConstStaticCell::new([0; MAX_EXCHANGE]);
        static UP: ConstStaticCell<[u8; MAX_EXCHANGE]> = ConstStaticCell::new([0; MAX_EXCHANGE]);
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

    /// Serves exchanges until the host ends the conversation.
    pub async fn serve(&mut self, mailbox: &mut LinkSide) {
        let mut next = self.read_exchange(mailbox);
        while let Some(decoding) = next {
            EXCHANGE.signal(());
            let now = mailbox.tick_finished().await;
            let started = stopwatch::read();
            let drive = &mut self.up[UP_HEADER..UP_HEADER + MAX_DRIVE];
            let drive = COMMAND.try_take().map_or(0, |command| {
                frame::encode(&command, self.sequence, now.as_micros(), drive).unwrap_or(0)
            });
            self.sequence = self.sequence.wrapping_add(1);
            let start = UP_HEADER + drive;
            let host = &mut self.up[start..start + MAX_HOST];
            let host = self.link.transmit(now, host, mailbox);
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
            next = self.read_exchange(mailbox);
        }
        ENDED.store(true, Ordering::Release);
        EXCHANGE.signal(());
    }

    /// Waits for an exchange and decodes it. Returns the cost of decoding, in
    /// counts of the stopwatch; `None` at the end of the conversation.
    fn read_exchange(&mut self, mailbox: &mut LinkSide) -> Option<u32> {
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
        self.link.receive(self.down.get(start..need)?, mailbox);
        Some(stopwatch::between(started, stopwatch::read()))
    }
}
