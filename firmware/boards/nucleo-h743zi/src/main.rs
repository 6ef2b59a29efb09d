//! spherecal's controller on ST's NUCLEO-H743ZI: Cortex-M7 at 480 MHz.
//!
//! ```text
//!   drive ── USART2 (PD5/PD6, 3 Mbaud) ─┐
//!                                       ├─ links, priority 6 ─┐
//!   host ─── USART3 (ST-LINK's virtual ─┘                     ├─ control, 1 kHz, priority 2
//!            COM port, 921,600 baud)      log (RTT), thread ──┘
//! ```
//!
//! The independent watchdog is fed on every beat of the control task and by
//! nothing else: a controller that hangs is reset within 20 ms, and the drive,
//! which hears no command, closes its brakes. A hard fault, a panic and a
//! falling supply leave a record that outlives the reset ([`record`]).
#![no_std]
#![no_main]

mod clocks;
mod record;
mod serial;

use spherecal_m7 as _;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use defmt_rtt as _;
use embassy_executor::{Executor, InterruptExecutor};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::peripherals::{IWDG1, USART2, USART3};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUartRx, BufferedUartTx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, interrupt as vector};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::Instant;
use spherecal_firmware::HostLink;
use spherecal_firmware::app::links::Links;
use spherecal_firmware::app::ports::{Beat, Clock};
use spherecal_firmware::app::{Bell, ControlEnd, LinkEnd, Post, TickerClock, Workspace, run};
use static_cell::{ConstStaticCell, StaticCell};

use record::Cause;
use serial::{Reader, Writer};

/// Joints of the arm.
const JOINTS: usize = 7;
/// The watchdog's time, in µs.
const WATCHDOG_US: u32 = 20_000;
/// Bytes that one tick may say to the host: three of the largest frames.
const UP: usize = 8192;
/// What the banner says of the build.
const BUILD: &str = match option_env!("SPHERECAL_BUILD") {
    Some(build) => build,
    None => "unknown",
};

bind_interrupts!(struct Interrupts {
    USART2 => BufferedInterruptHandler<USART2>;
    USART3 => BufferedInterruptHandler<USART3>;
});

static CONTROL: InterruptExecutor = InterruptExecutor::new();
static LINKING: InterruptExecutor = InterruptExecutor::new();
static THREAD: StaticCell<Executor> = StaticCell::new();
static LINKS: Links<CriticalSectionRawMutex> = Links::new();

// Interrupts of peripherals that are not in use carry the two executors.
#[vector]
unsafe fn UART7() {
    // SAFETY: this is the interrupt that `CONTROL.start` was given.
    unsafe { CONTROL.on_interrupt() }
}

#[vector]
unsafe fn UART8() {
    // SAFETY: this is the interrupt that `LINKING.start` was given.
    unsafe { LINKING.on_interrupt() }
}

/// The beat of the ticker, which feeds the watchdog and looks at the supply.
struct WatchedClock {
    ticker: TickerClock,
    watchdog: IndependentWatchdog<'static, IWDG1>,
}

impl Clock for WatchedClock {
    async fn next(&mut self) -> Beat {
        let beat = self.ticker.next().await;
        if clocks::supply_is_low() {
            record::leave_and_reset(Cause::BrownOut, 0, 0);
        }
        self.watchdog.pet();
        beat
    }

    fn time(&self, beat: &Beat, drive_us: u64) -> Instant {
        self.ticker.time(beat, drive_us)
    }
}

#[embassy_executor::task]
async fn control(
    work: &'static mut Workspace<JOINTS>,
    mut host: ControlEnd<'static, CriticalSectionRawMutex>,
    mut watchdog: IndependentWatchdog<'static, IWDG1>,
) {
    watchdog.unleash();
    let mut clock = WatchedClock {
        ticker: TickerClock::start(),
        watchdog,
    };
    let ended = run(work, &mut clock, &mut &LINKS, &mut host).await;
    // The watchdog is no longer fed: the board starts again, and so may the drive.
    defmt::error!("control ended: {}", ended);
}

#[embassy_executor::task]
async fn drive_in(rx: BufferedUartRx<'static>) {
    LINKS.drive_in(&mut Reader(rx)).await
}

#[embassy_executor::task]
async fn drive_out(tx: BufferedUartTx<'static>) {
    LINKS.drive_out(&mut Writer(tx)).await
}

#[embassy_executor::task]
async fn host_in(rx: BufferedUartRx<'static>) {
    LINKS.host_in(&mut Reader(rx)).await
}

#[embassy_executor::task]
async fn speak(link: &'static mut HostLink, mut desk: LinkEnd<'static, CriticalSectionRawMutex>) {
    static BYTES: ConstStaticCell<[u8; UP]> = ConstStaticCell::new([0; UP]);
    LINKS.host(link, &mut desk, BYTES.take()).await
}

#[embassy_executor::task]
async fn host_out(tx: BufferedUartTx<'static>) {
    LINKS.host_out(&mut Writer(tx)).await
}

/// Says once a second what the links have dropped, when they have.
#[embassy_executor::task]
async fn housekeeping() {
    let mut told = (0, 0);
    loop {
        embassy_time::Timer::after_secs(1).await;
        let dropped = LINKS.dropped();
        if dropped != told {
            told = dropped;
            defmt::warn!(
                "links: {} drive messages and {} host bytes dropped so far",
                dropped.0,
                dropped.1
            );
        }
    }
}

#[entry]
fn main() -> ! {
    let p = embassy_stm32::init(clocks::configuration());
    defmt::info!(
        "spherecal {} on nucleo-h743zi, build {}",
        env!("CARGO_PKG_VERSION"),
        BUILD
    );
    record::tell();
    clocks::watch_supply();

    static WORK: StaticCell<Workspace<JOINTS>> = StaticCell::new();
    let work = WORK.init_with(Workspace::default);
    static POST: StaticCell<Post> = StaticCell::new();
    static BELL: Bell<CriticalSectionRawMutex> = Bell::new();
    let (host_end, desk) = POST.init_with(Post::new).split(&BELL);
    static LINK: StaticCell<HostLink> = StaticCell::new();
    let link = LINK.init_with(|| {
        // A recording takes milliseconds on this wire: it is not sent again sooner.
        HostLink::new(BUILD, JOINTS).resending_after(embassy_time::Duration::from_millis(50))
    });
    let watchdog = IndependentWatchdog::new(p.IWDG1, WATCHDOG_US);
    let drive = serial::drive(p.USART2, p.PD6, p.PD5);
    let host = serial::host(p.USART3, p.PD9, p.PD8);
    let (Some((drive_tx, drive_rx)), Some((host_tx, host_rx))) = (drive, host) else {
        // A baud rate that these clocks cannot give: a mistake in `clocks`.
        defmt::panic!("the serial ports cannot be set up");
    };

    interrupt::USART2.set_priority(Priority::P4);
    interrupt::USART3.set_priority(Priority::P5);
    interrupt::UART7.set_priority(Priority::P2);
    interrupt::UART8.set_priority(Priority::P6);
    let control_spawner = CONTROL.start(interrupt::UART7);
    let link_spawner = LINKING.start(interrupt::UART8);
    // Each task is spawned once, so its place is free.
    if let Ok(token) = control(work, host_end, watchdog) {
        control_spawner.spawn(token);
    }
    if let Ok(token) = drive_in(drive_rx) {
        link_spawner.spawn(token);
    }
    if let Ok(token) = drive_out(drive_tx) {
        link_spawner.spawn(token);
    }
    if let Ok(token) = host_in(host_rx) {
        link_spawner.spawn(token);
    }
    if let Ok(token) = speak(link, desk) {
        link_spawner.spawn(token);
    }
    if let Ok(token) = host_out(host_tx) {
        link_spawner.spawn(token);
    }
    THREAD.init(Executor::new()).run(|spawner| {
        if let Ok(token) = housekeeping() {
            spawner.spawn(token);
        }
    })
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    defmt::error!("{}", defmt::Display2Format(info));
    let line = info.location().map_or(0, core::panic::Location::line);
    record::leave_and_reset(Cause::Panic, line, 0)
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    record::leave_and_reset(Cause::HardFault, frame.pc(), frame.lr())
}
