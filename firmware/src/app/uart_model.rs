//! UARTs as bad as real ones, and the time of a test.
//!
//! While the control task runs, no interrupt of a UART runs. A UART with a FIFO of 16 bytes
//! then loses what does not fit. A UART with DMA loses nothing, but wakes its reader only when
//! the line is idle or half of the ring is written. A transmitter may lose its wake-up, as
//! that of a HAL did.

use core::cell::{Cell, RefCell};
use core::task::{Poll, Waker};

use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use std::collections::VecDeque;
use std::rc::Rc;
use std::vec::Vec;

std::thread_local! {
    /// The time of a test, in µs: each test has a thread of its own.
    pub(super) static NOW_US: Cell<u64> = const { Cell::new(0) };
}

/// The time of the test. Nothing is woken: all tasks are polled.
struct TestTime;

impl embassy_time_driver::Driver for TestTime {
    fn now(&self) -> u64 {
        NOW_US.get()
    }

    fn schedule_wake(&self, _at: u64, _waker: &Waker) {}
}

embassy_time_driver::time_driver_impl!(static TIME: TestTime = TestTime);

/// Resolution of the simulation, in µs.
pub(super) const STEP_US: u64 = 20;
/// Bytes of a receiver's hardware FIFO.
const FIFO: usize = 16;
/// Bytes of a receiver's ring in memory.
const RING: usize = 2048;

/// How a receiver brings its bytes into memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Carrier {
    /// An interrupt empties a FIFO of 16 bytes.
    Fifo,
    /// DMA.
    Dma,
}

/// A stream has lost bytes.
#[derive(Debug)]
pub(super) struct Overrun;

impl core::fmt::Display for Overrun {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("overrun")
    }
}

impl core::error::Error for Overrun {}

impl embedded_io_async::Error for Overrun {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// The wire to a receiver, its FIFO and its ring.
pub(super) struct Receiver {
    carrier: Carrier,
    byte_us: f64,
    /// Bytes on the wire, with the times at which they are complete.
    wire: VecDeque<(f64, u8)>,
    /// When the wire is free again.
    free_us: f64,
    fifo: VecDeque<u8>,
    ring: VecDeque<u8>,
    /// Bytes that DMA has written so far.
    written: usize,
    last_us: f64,
    idle_told: bool,
    /// An interrupt that wakes the reader waits.
    woken: bool,
    overrun: bool,
    pub(super) lost: usize,
}

pub(super) type Shared<T> = Rc<RefCell<T>>;

impl Receiver {
    pub(super) fn new(carrier: Carrier, baud: u32) -> Shared<Self> {
        Rc::new(RefCell::new(Self {
            carrier,
            byte_us: 1e7 / f64::from(baud),
            wire: VecDeque::new(),
            free_us: 0.0,
            fifo: VecDeque::new(),
            ring: VecDeque::new(),
            written: 0,
            last_us: 0.0,
            idle_told: true,
            woken: false,
            overrun: false,
            lost: 0,
        }))
    }

    /// The other side begins to send at `at_us`, or when the wire is free.
    pub(super) fn send(&mut self, at_us: f64, bytes: &[u8]) {
        let mut end = at_us.max(self.free_us);
        for byte in bytes {
            end += self.byte_us;
            self.wire.push_back((end, *byte));
        }
        self.free_us = end;
    }

    /// The hardware until `now_us`. `blocked`: the core serves no interrupt.
    pub(super) fn advance(&mut self, now_us: f64, blocked: bool) {
        while let Some((end, byte)) = self.wire.front().copied().filter(|(end, _)| *end <= now_us) {
            self.wire.pop_front();
            self.last_us = end;
            self.idle_told = false;
            match self.carrier {
                Carrier::Fifo if self.fifo.len() < FIFO => self.fifo.push_back(byte),
                Carrier::Fifo => self.lost += 1,
                Carrier::Dma => {
                    self.ring.push_back(byte);
                    self.written += 1;
                    self.woken |= self.written.is_multiple_of(RING / 2);
                    if self.ring.len() > RING {
                        self.overrun = true;
                    }
                }
            }
        }
        if !self.idle_told && now_us - self.last_us > self.byte_us {
            self.idle_told = true;
            self.woken = true;
        }
        if self.carrier == Carrier::Fifo && !blocked {
            self.ring.extend(self.fifo.drain(..));
            self.woken |= !self.ring.is_empty();
        }
    }
}

/// The reader of a [`Receiver`].
pub(super) struct Reader(pub(super) Shared<Receiver>);

impl ErrorType for Reader {
    type Error = Overrun;
}

impl Read for Reader {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Overrun> {
        core::future::poll_fn(|_| {
            let mut port = self.0.borrow_mut();
            if port.overrun {
                port.overrun = false;
                port.lost += port.ring.len();
                port.ring.clear();
                return Poll::Ready(Err(Overrun));
            }
            if !port.woken || port.ring.is_empty() {
                return Poll::Pending;
            }
            let count = buffer.len().min(port.ring.len());
            for slot in &mut buffer[..count] {
                *slot = port.ring.pop_front().unwrap_or(0);
            }
            port.woken = !port.ring.is_empty();
            Poll::Ready(Ok(count))
        })
        .await
    }
}

/// A transmitter's wire: when it is free, and what went over it.
pub(super) struct Transmitter {
    byte_us: f64,
    free_us: f64,
    pub(super) sent: Vec<u8>,
    /// Writes that lose their wake-up: they never end.
    pub(super) hang: Option<core::ops::Range<u64>>,
}

impl Transmitter {
    pub(super) fn new(baud: u32) -> Shared<Self> {
        Rc::new(RefCell::new(Self {
            byte_us: 1e7 / f64::from(baud),
            free_us: 0.0,
            sent: Vec::new(),
            hang: None,
        }))
    }
}

/// The writer of a [`Transmitter`]: a write ends when DMA has sent it.
pub(super) struct Writer(pub(super) Shared<Transmitter>);

impl ErrorType for Writer {
    type Error = Overrun;
}

impl Write for Writer {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Overrun> {
        let end_us = {
            let mut port = self.0.borrow_mut();
            let now = NOW_US.get();
            if port.hang.as_ref().is_some_and(|hang| hang.contains(&now)) {
                f64::INFINITY
            } else {
                port.free_us = port.free_us.max(now as f64) + port.byte_us * bytes.len() as f64;
                port.sent.extend_from_slice(bytes);
                port.free_us
            }
        };
        core::future::poll_fn(|_| {
            if NOW_US.get() as f64 >= end_us {
                Poll::Ready(Ok(bytes.len()))
            } else {
                Poll::Pending
            }
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Overrun> {
        Ok(())
    }
}
