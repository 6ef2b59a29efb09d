//! The two serial ports: byte streams of the drive link and the host link.

use embassy_stm32::Peri;
use embassy_stm32::peripherals::{PD5, PD6, PD8, PD9, USART2, USART3};
use embassy_stm32::usart::{BufferedUart, BufferedUartRx, BufferedUartTx, Config};
use static_cell::StaticCell;

use crate::Interrupts;

/// Baud rate of the drive link. A state of 7 joints has about 210 bytes, a
/// command about 100; at 3 Mbaud a state takes 0.7 ms of the 1 ms period.
const DRIVE_BAUD: u32 = 3_000_000;
/// Baud rate of the host link: the highest that the ST-LINK's virtual COM port
/// carries reliably.
const HOST_BAUD: u32 = 921_600;
/// Size of each port's ring buffers, in bytes.
const BUFFER: usize = 2048;

/// Receiver and transmitter of a port.
type Port = (BufferedUartRx<'static>, BufferedUartTx<'static>);

/// The configuration of a port: 8 data bits, no parity, one stop bit.
fn at(baud: u32) -> Config {
    let mut config = Config::default();
    config.baudrate = baud;
    config
}

/// The drive link; `None` when the clocks cannot give its baud rate.
pub fn drive(usart: Peri<'static, USART2>, rx: Peri<'static, PD6>, tx: Peri<'static, PD5>) -> Option<Port> {
    static OUT: StaticCell<[u8; BUFFER]> = StaticCell::new();
    static IN: StaticCell<[u8; BUFFER]> = StaticCell::new();
    let (out, incoming) = (OUT.init([0; BUFFER]), IN.init([0; BUFFER]));
    let uart = BufferedUart::new(usart, rx, tx, out, incoming, Interrupts, at(DRIVE_BAUD)).ok()?;
    let (tx, rx) = uart.split();
    Some((rx, tx))
}

/// The host link; `None` when the clocks cannot give its baud rate.
pub fn host(usart: Peri<'static, USART3>, rx: Peri<'static, PD9>, tx: Peri<'static, PD8>) -> Option<Port> {
    static OUT: StaticCell<[u8; BUFFER]> = StaticCell::new();
    static IN: StaticCell<[u8; BUFFER]> = StaticCell::new();
    let (out, incoming) = (OUT.init([0; BUFFER]), IN.init([0; BUFFER]));
    let uart = BufferedUart::new(usart, rx, tx, out, incoming, Interrupts, at(HOST_BAUD)).ok()?;
    let (tx, rx) = uart.split();
    Some((rx, tx))
}
