//! Both links on QEMU's standard streams, in lock-step turns.
//!
//! [`spherecal_shared::protocol::lockstep`] says what a turn is. Reading blocks
//! and virtual time stands still meanwhile, so the same host gives the same
//! run, to the bit and to the time stamp.

use heapless::Deque;
use spherecal_firmware::app::ports::{DrivePort, HostPort, Probe};
use spherecal_firmware::app::{DriveReceiver, FromDrive};
use spherecal_shared::protocol::drive::DriveCommand;
use spherecal_shared::protocol::frame;
use spherecal_shared::protocol::lockstep::{DOWN_HEADER, Down, MAX_DRIVE, MAX_HOST, MAX_TURN, UP_HEADER, Up};

use crate::semihosting::{File, Mode};
use crate::timer::stopwatch;

/// The pipe and its buffers.
pub struct Pipe {
    input: File,
    output: File,
    receiver: DriveReceiver,
    messages: Deque<FromDrive, 2>,
    /// The present turn, and what has come behind it.
    down: [u8; MAX_TURN],
    filled: usize,
    consumed: usize,
    host: core::ops::Range<usize>,
    up: [u8; MAX_TURN],
    drive_length: usize,
    sequence: u32,
    turn_open: bool,
    ended: bool,
    marks: [u32; 3],
}

impl Pipe {
    /// Opens the standard streams.
    pub fn open() -> Option<Self> {
        Some(Self {
            input: File::open(":tt\0", Mode::Read)?,
            output: File::open(":tt\0", Mode::Write)?,
            receiver: DriveReceiver::new(),
            messages: Deque::new(),
            down: [0; MAX_TURN],
            filled: 0,
            consumed: 0,
            host: 0..0,
            up: [0; MAX_TURN],
            drive_length: 0,
            sequence: 0,
            turn_open: false,
            ended: false,
            marks: [0; 3],
        })
    }

    /// Waits for a turn of the host.
    fn read_turn(&mut self) -> Option<()> {
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
        let drive = usize::from(header.drive);
        if drive == 0 {
            return None;
        }
        let need = DOWN_HEADER + header.body()?;
        self.consumed = need;
        let start = DOWN_HEADER + drive;
        self.host = start..need;
        let (receiver, messages) = (&mut self.receiver, &mut self.messages);
        receiver.receive(self.down.get(DOWN_HEADER..start)?, &mut |message| {
            // A turn has a hello and a state at most.
            let _ = messages.push_back(message);
        });
        Some(())
    }
}

impl DrivePort for Pipe {
    fn receive(&mut self) -> Option<FromDrive> {
        if !self.turn_open {
            self.turn_open = true;
            self.drive_length = 0;
            if self.read_turn().is_none() {
                self.ended = true;
            }
        }
        self.messages.pop_front()
    }

    fn send(&mut self, command: &DriveCommand) {
        let out = &mut self.up[UP_HEADER..UP_HEADER + MAX_DRIVE];
        self.drive_length = frame::encode(command, self.sequence, command.tick.wrapping_mul(1000), out).unwrap_or(0);
        self.sequence = self.sequence.wrapping_add(1);
    }

    fn ended(&self) -> bool {
        self.ended
    }
}

impl HostPort for Pipe {
    fn receive(&mut self, buffer: &mut [u8]) -> usize {
        let bytes = self.down.get(self.host.clone()).unwrap_or_default();
        let Some(target) = buffer.get_mut(..bytes.len()) else {
            return 0;
        };
        target.copy_from_slice(bytes);
        let length = bytes.len();
        self.host = 0..0;
        length
    }

    fn room(&self) -> usize {
        MAX_HOST
    }

    /// Ends the turn.
    fn send(&mut self, bytes: &[u8]) {
        let header = Up {
            drive: self.drive_length as u16,
            host: bytes.len() as u16,
            tick: stopwatch::between(self.marks[0], self.marks[1]),
            link: stopwatch::between(self.marks[1], self.marks[2]),
        };
        let start = UP_HEADER + self.drive_length;
        self.up[..UP_HEADER].copy_from_slice(&header.to_bytes());
        self.up[start..start + bytes.len()].copy_from_slice(bytes);
        if !self.output.write(&self.up[..start + bytes.len()]) {
            self.ended = true;
        }
        self.turn_open = false;
    }
}

impl Probe for Pipe {
    fn before_tick(&mut self) {
        self.marks[0] = stopwatch::read();
    }

    fn between(&mut self) {
        self.marks[1] = stopwatch::read();
    }

    fn after(&mut self) {
        self.marks[2] = stopwatch::read();
    }
}
