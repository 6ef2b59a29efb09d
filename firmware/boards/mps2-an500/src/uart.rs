//! The CMSDK UARTs, by interrupt, with a ring buffer in each direction.
//!
//! The handler clears the receive interrupt first and takes the byte after. The
//! other order loses the interrupt of a byte that comes in between, and then no
//! byte is received any more.

use core::convert::Infallible;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embedded_io_async::{ErrorType, Read, Write};

use crate::hardware::{self, Interrupt, Priority, Register};

const DATA: usize = 0x00;
const STATE: usize = 0x04;
const CONTROL: usize = 0x08;
const CLEAR: usize = 0x0c;
const BAUD_DIVISOR: usize = 0x10;
const TX_FULL: u32 = 1 << 0;
const RX_FULL: u32 = 1 << 1;
const TRANSMIT: u32 = 1 << 0;
const RECEIVE: u32 = 1 << 1;
/// Transmitter, receiver and both interrupts.
const ALL: u32 = 0b1111;
/// 25 MHz divided by 27: 925,926 baud, 0.5 % above 921,600.
const DIVISOR: u32 = 27;

const RING: usize = 4096;

/// A CMSDK UART.
pub struct Uart {
    base: usize,
    transmit: Interrupt,
    receive: Interrupt,
    incoming: Pipe<CriticalSectionRawMutex, RING>,
    outgoing: Pipe<CriticalSectionRawMutex, RING>,
    overflow: AtomicU32,
}

/// The drive link.
pub static UART0: Uart = Uart::new(0x4000_4000, Interrupt::Uart0Transmit, Interrupt::Uart0Receive);
/// The host link.
pub static UART1: Uart = Uart::new(0x4000_5000, Interrupt::Uart1Transmit, Interrupt::Uart1Receive);

impl Uart {
    const fn new(base: usize, transmit: Interrupt, receive: Interrupt) -> Self {
        Self {
            base,
            transmit,
            receive,
            incoming: Pipe::new(),
            outgoing: Pipe::new(),
            overflow: AtomicU32::new(0),
        }
    }

    fn register(&self, offset: usize) -> Register {
        Register::at(self.base + offset)
    }

    /// Turns the UART on: 8 data bits, no parity, interrupts in both directions.
    pub fn start(&self) {
        self.register(BAUD_DIVISOR).write(DIVISOR);
        self.register(CONTROL).write(ALL);
        hardware::enable(self.receive, Priority::Uart);
        hardware::enable(self.transmit, Priority::Uart);
    }

    /// Received bytes that were lost because the ring buffer was full.
    pub fn overflow(&self) -> u32 {
        self.overflow.load(Ordering::Relaxed)
    }

    fn on_receive(&self) {
        self.register(CLEAR).write(RECEIVE);
        while self.register(STATE).read() & RX_FULL != 0 {
            let byte = self.register(DATA).read() as u8;
            if self.incoming.try_write(&[byte]).is_err() {
                self.overflow.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    fn on_transmit(&self) {
        self.register(CLEAR).write(TRANSMIT);
        let mut byte = [0];
        while self.register(STATE).read() & TX_FULL == 0 && self.outgoing.try_read(&mut byte).is_ok() {
            self.register(DATA).write(u32::from(byte[0]));
        }
    }
}

/// Handler of UART0's receive interrupt.
pub extern "C" fn on_uart0_receive() {
    UART0.on_receive();
}

/// Handler of UART0's transmit interrupt.
pub extern "C" fn on_uart0_transmit() {
    UART0.on_transmit();
}

/// Handler of UART1's receive interrupt.
pub extern "C" fn on_uart1_receive() {
    UART1.on_receive();
}

/// Handler of UART1's transmit interrupt.
pub extern "C" fn on_uart1_transmit() {
    UART1.on_transmit();
}

impl ErrorType for &Uart {
    type Error = Infallible;
}

impl Read for &Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Ok(self.incoming.read(buffer).await)
    }
}

impl Write for &Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let taken = self.outgoing.write(bytes).await;
        // The handler sends the first byte; the interrupt of each byte brings
        // the next.
        hardware::pend(self.transmit);
        Ok(taken)
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
