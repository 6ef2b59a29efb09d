//! The serial ports: byte streams of the host link and, with the feature `uart-drive`, of the drive link. DMA carries
//! the bytes both ways, so none is lost while the control task runs.
//!
//! A receiver's ring is filled by DMA without end. Its reader wakes when the line is idle
//! for one byte, and when DMA has written half of the ring. A transmitter's DMA reads from
//! the link task's memory, in AXI SRAM. DMA cannot reach the stack.

#[cfg(feature = "uart-drive")]
pub use drive_uart::{drive, drive_link};
use embassy_stm32::Peri;
use embassy_stm32::gpio::Pull;
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{DMA1_CH2, DMA1_CH3, PD8, PD9, USART3};
use embassy_stm32::usart::{Config, RingBufferedUartRx, Uart, UartTx};
use static_cell::ConstStaticCell;

use crate::Interrupts;

/// Baud rate of the host link: the highest that the ST-LINK's virtual COM port
/// carries reliably.
pub const HOST_BAUD: u32 = 921_600;
/// Size of each receiver's ring, in bytes: 6.8 ms at 3 Mbaud. A reader that comes
/// later than that finds an overrun.
const RING: usize = 2048;

/// A port's receiver.
pub type Receiver = RingBufferedUartRx<'static>;
/// A port's transmitter.
pub type Transmitter = UartTx<'static, Async>;
/// Receiver and transmitter of a port.
type Port = (Receiver, Transmitter);

/// The configuration of a port: 8 data bits, no parity, one stop bit.
fn at(baud: u32) -> Config {
    let mut config = Config::default();
    config.baudrate = baud;
    // A line that nobody drives is idle, and no stream of noise.
    config.rx_pull = Pull::Up;
    config
}

fn port(uart: Uart<'static, Async>, ring: &'static mut [u8]) -> Port {
    let (transmitter, receiver) = uart.split();
    (receiver.into_ring_buffered(ring), transmitter)
}

/// The host link; `None` when the clocks cannot give its baud rate.
pub fn host(
    usart: Peri<'static, USART3>,
    rx: Peri<'static, PD9>,
    tx: Peri<'static, PD8>,
    dma: (Peri<'static, DMA1_CH2>, Peri<'static, DMA1_CH3>),
) -> Option<Port> {
    static IN: ConstStaticCell<[u8; RING]> = ConstStaticCell::new([0; RING]);
    let uart = Uart::new(usart, rx, tx, dma.0, dma.1, Interrupts, at(HOST_BAUD)).ok()?;
    Some(port(uart, IN.take()))
}

/// The drive link.
#[cfg(feature = "uart-drive")]
mod drive_uart {
    use embassy_futures::join::join;
    use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH1, PD5, PD6, USART2};

    use super::{ConstStaticCell, Interrupts, Peri, Port, RING, Uart, at, port};
    use crate::LINKS;

    /// Baud rate of the drive link. A state of 7 joints has about 210 bytes, a
    /// command about 100; at 3 Mbaud a state takes 0.7 ms.
    const BAUD: u32 = 3_000_000;

    /// The drive link's port; `None` when the clocks cannot give its baud rate.
    pub fn drive(
        usart: Peri<'static, USART2>,
        rx: Peri<'static, PD6>,
        tx: Peri<'static, PD5>,
        dma: (Peri<'static, DMA1_CH0>, Peri<'static, DMA1_CH1>),
    ) -> Option<Port> {
        static IN: ConstStaticCell<[u8; RING]> = ConstStaticCell::new([0; RING]);
        let uart = Uart::new(usart, rx, tx, dma.0, dma.1, Interrupts, at(BAUD)).ok()?;
        Some(port(uart, IN.take()))
    }

    /// The drive link.
    #[embassy_executor::task]
    pub async fn drive_link(port: Port) {
        let (mut receiver, mut transmitter) = port;
        join(LINKS.drive_in(&mut receiver), LINKS.drive_out(&mut transmitter)).await;
    }
}
