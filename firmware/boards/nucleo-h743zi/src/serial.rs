//! The two serial ports as the links' byte streams.

use embassy_stm32::Peri;
use embassy_stm32::peripherals::{PD5, PD6, PD8, PD9, USART2, USART3};
use embassy_stm32::usart::{BufferedUart, BufferedUartRx, BufferedUartTx, Config};
use embedded_io_async::{Read, Write};
use spherecal_firmware::app::links::{ByteReader, ByteWriter};
use static_cell::StaticCell;

use crate::Interrupts;

/// A state of 7 joints is about 210 bytes and a command about 100: 3 Mbaud
/// carry both in a third of a period.
const DRIVE_BAUD: u32 = 3_000_000;
/// What the ST-LINK's virtual COM port carries reliably.
const HOST_BAUD: u32 = 921_600;
const BUFFER: usize = 2048;

type Port = (BufferedUartTx<'static>, BufferedUartRx<'static>);

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
    Some(uart.split())
}

/// The host link; `None` when the clocks cannot give its baud rate.
pub fn host(usart: Peri<'static, USART3>, rx: Peri<'static, PD9>, tx: Peri<'static, PD8>) -> Option<Port> {
    static OUT: StaticCell<[u8; BUFFER]> = StaticCell::new();
    static IN: StaticCell<[u8; BUFFER]> = StaticCell::new();
    let (out, incoming) = (OUT.init([0; BUFFER]), IN.init([0; BUFFER]));
    let uart = BufferedUart::new(usart, rx, tx, out, incoming, Interrupts, at(HOST_BAUD)).ok()?;
    Some(uart.split())
}

/// The receiving half.
pub struct Reader(pub BufferedUartRx<'static>);

/// The sending half.
pub struct Writer(pub BufferedUartTx<'static>);

impl ByteReader for Reader {
    async fn read(&mut self, buffer: &mut [u8]) -> usize {
        // Noise, framing and overrun errors of the line: the frame's checksum
        // finds what they did to it.
        self.0.read(buffer).await.unwrap_or(0)
    }
}

impl ByteWriter for Writer {
    async fn write(&mut self, bytes: &[u8]) {
        // The only errors are of receivers.
        let _ = self.0.write_all(bytes).await;
    }
}
