//! The drive link over Ethernet: one UDP socket, each frame one datagram.
//!
//! ```text
//!   PHY ── ETH, its DMA ── run_stack (IP, ARP) ── socket ── drive_link: drive_in, drive_out, ask_drive
//! ```
//!
//! The board is the controller, so it speaks first, to one fixed drive, and hears nobody else. A drive over UDP sends to
//! whoever has sent it a valid frame.
//!
//! Descriptors, frames and the socket's buffers are statics in AXI SRAM: the DMA reaches it, and the MPU keeps it out of
//! the cache. The DMA cannot reach the stack.

use core::pin::pin;
use core::task::Context;

use embassy_executor::Spawner;
use embassy_futures::join::join3;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{Config, IpAddress, IpEndpoint, Ipv4Address, Ipv4Cidr, Runner, StackResources, StaticConfigV4};
use embassy_stm32::Peri;
use embassy_stm32::eth::{Ethernet, GenericPhy, PacketQueue, Phy, Sma};
use embassy_stm32::peripherals::{ETH, ETH_SMA, PA1, PA2, PA7, PB13, PC1, PC4, PC5, PG11, PG13};
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use spherecal_firmware::app::datagram::{Datagram, LONGEST};
use static_cell::{ConstStaticCell, StaticCell};

use crate::{Interrupts, LINKS};

/// The board's address on its own cable to the drive, and the length of the network's prefix.
const BOARD: Ipv4Cidr = Ipv4Cidr::new(Ipv4Address::new(192, 168, 10, 2), 24);
/// The port on which the board hears the drive.
const BOARD_PORT: u16 = 7404;
/// The drive: the gateway, or the computer with `spherecal plant --udp 192.168.10.1:7404`.
const DRIVE: IpEndpoint = IpEndpoint::new(IpAddress::v4(192, 168, 10, 1), 7404);
/// The board's Ethernet address, from the range that everybody may use.
const MAC: [u8; 6] = [0x02, 0, 0, 0x5c, 0xa1, 0x02];

/// Address of the board's LAN8742A on its management bus.
const PHY: u8 = 0;
/// How often the PHY is asked whether the cable is connected. Each question keeps the links waiting for 30 µs.
const LOOK: Duration = Duration::from_millis(100);

/// Frames that the DMA may send and receive without the processor. Eight states come in 8 ms, a little longer than the
/// UART's ring lasts.
const SENT: usize = 2;
const RECEIVED: usize = 8;

/// The network interface.
pub type Port = Ethernet<'static, ETH, PatientPhy>;

/// The pins to the PHY, as the board has them.
pub struct Pins {
    /// The clock of 50 MHz, from the PHY.
    pub ref_clk: Peri<'static, PA1>,
    /// The PHY receives.
    pub crs_dv: Peri<'static, PA7>,
    /// Two bits from the PHY.
    pub rxd: (Peri<'static, PC4>, Peri<'static, PC5>),
    /// Two bits to the PHY.
    pub txd: (Peri<'static, PG13>, Peri<'static, PB13>),
    /// The board sends.
    pub tx_en: Peri<'static, PG11>,
    /// Data of the management bus.
    pub mdio: Peri<'static, PA2>,
    /// Clock of the management bus.
    pub mdc: Peri<'static, PC1>,
}

/// A PHY that is asked for its link every [`LOOK`] only. The network stack asks on every frame, and waits for the answer.
pub struct PatientPhy {
    phy: GenericPhy<Sma<'static, ETH_SMA>>,
    next: Instant,
    is_up: bool,
}

impl Phy for PatientPhy {
    fn phy_reset(&mut self) {
        self.phy.phy_reset();
    }

    fn phy_init(&mut self) {
        self.phy.phy_init();
    }

    fn poll_link(&mut self, cx: &mut Context<'_>) -> bool {
        if Instant::now() >= self.next {
            let was_up = core::mem::replace(&mut self.is_up, self.phy.poll_link(cx));
            if self.is_up != was_up {
                defmt::info!("the Ethernet cable is connected: {}", self.is_up);
            }
            self.next = Instant::now() + LOOK;
        }
        // Wakes the stack for the next look.
        let _ = pin!(Timer::at(self.next)).poll(cx);
        self.is_up
    }
}

/// The network interface. Waits for ever where the PHY gives no clock; the controller has not started then, and the
/// brakes are closed.
pub fn drive(eth: Peri<'static, ETH>, sma: Peri<'static, ETH_SMA>, pins: Pins) -> Port {
    static QUEUE: ConstStaticCell<PacketQueue<SENT, RECEIVED>> = ConstStaticCell::new(PacketQueue::new());
    defmt::info!("waiting for the clock of the Ethernet PHY");
    let phy = PatientPhy {
        phy: GenericPhy::new(Sma::new(sma, pins.mdio, pins.mdc), PHY),
        next: Instant::MIN,
        is_up: false,
    };
    let (rxd, txd) = (pins.rxd, pins.txd);
    Ethernet::new_with_phy(
        QUEUE.take(),
        eth,
        Interrupts,
        pins.ref_clk,
        pins.crs_dv,
        rxd.0,
        rxd.1,
        txd.0,
        txd.1,
        pins.tx_en,
        MAC,
        phy,
    )
}

/// The drive link.
///
/// A link that is down, or a drive that is gone, is no reset: reads and writes are given up after their times, and the
/// tasks go on. [`run_stack`] needs no sign of life of its own: it shares the executor, so one that hangs silences this
/// task, and a wake-up that it loses is made good by the next read, at the latest after a beat of 5 ms.
#[embassy_executor::task]
pub async fn drive_link(port: Port) {
    static RESOURCES: StaticCell<StackResources<1>> = StaticCell::new();
    let config = Config::ipv4_static(StaticConfigV4 {
        address: BOARD,
        gateway: None,
        dns_servers: Default::default(),
    });
    // The seed is for numbers of ports and packets; nothing here depends on them.
    let (stack, runner) = embassy_net::new(port, config, RESOURCES.init_with(StackResources::new), 1);
    // SAFETY: this is a task of embassy's executor. The stack is not `Send`: only from here can its tasks be started.
    let spawner = unsafe { Spawner::for_current_executor() }.await;
    let Ok(token) = run_stack(runner) else {
        // This task runs once.
        return;
    };
    spawner.spawn(token);

    let (mut in_meta, mut out_meta) = ([PacketMetadata::EMPTY; RECEIVED], [PacketMetadata::EMPTY; SENT]);
    let (mut in_bytes, mut out_bytes) = ([0; 4 * LONGEST], [0; SENT * 256]);
    let mut socket = UdpSocket::new(stack, &mut in_meta, &mut in_bytes, &mut out_meta, &mut out_bytes);
    if socket.bind(BOARD_PORT).is_err() {
        // A port of 0, or a socket that is bound: neither is possible.
        return;
    }
    let mut receiver = Receiver {
        socket: &socket,
        datagram: Datagram::default(),
    };
    join3(
        LINKS.drive_in(&mut receiver),
        LINKS.drive_out(&mut Transmitter(&socket)),
        LINKS.ask_drive(),
    )
    .await;
}

#[embassy_executor::task]
async fn run_stack(mut runner: Runner<'static, Port>) {
    runner.run().await
}

/// Reads the drive's datagrams as a stream.
struct Receiver<'a> {
    socket: &'a UdpSocket<'a>,
    datagram: Datagram,
}

impl ErrorType for Receiver<'_> {
    type Error = ErrorKind;
}

impl Read for Receiver<'_> {
    async fn read(&mut self, out: &mut [u8]) -> Result<usize, ErrorKind> {
        while self.datagram.is_read() {
            // One that does not fit is no message of a drive.
            if let Ok((length, from)) = self.socket.recv_from(self.datagram.room()).await
                && from.endpoint == DRIVE
            {
                self.datagram.filled(length);
            }
        }
        Ok(self.datagram.read(out))
    }
}

/// Sends each write to the drive as one datagram. `drive_out` writes whole frames.
struct Transmitter<'a>(&'a UdpSocket<'a>);

impl ErrorType for Transmitter<'_> {
    type Error = ErrorKind;
}

impl Write for Transmitter<'_> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        let sent = self.0.send_to(bytes, DRIVE).await;
        sent.map(|()| bytes.len()).map_err(|_| ErrorKind::NotConnected)
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}
