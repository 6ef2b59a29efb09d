//! spherecal's controller on ST's NUCLEO-H743ZI: Cortex-M7 at 480 MHz.
//!
//! ```text
//!   drive ── Ethernet (UDP, DMA) ────────────┐
//!                                            ├─ links, priority 6 ─┐
//!   host ─── USART3 (ST-LINK's virtual COM ──┘                     ├─ control, priority 2
//!            port, 921,600 baud, DMA)          log (RTT), thread ──┘
//! ```
//!
//! With the feature `uart-drive` the drive is on USART2 (PD5/PD6, 3 Mbaud, DMA) instead.
//!
//! The drive's states start the control cycles; a timer does when none comes. The control
//! task feeds the independent watchdog on every tick, while all tasks below it show that
//! they are alive. A controller that hangs is reset within 20 ms; a link or an executor
//! that hangs, within 40 ms. The drive gets no command then and closes its brakes. A hard
//! fault, a panic, a stack overflow, a silent task and a falling supply leave a record that
//! survives the reset ([`record`]).
#![no_std]
#![no_main]

mod checks;
mod clocks;
#[cfg(not(feature = "uart-drive"))]
mod ethernet;
mod memory;
mod record;
mod serial;

use spherecal_m7 as _;

use cortex_m::peripheral::DWT;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
#[cfg(feature = "uart-drive")]
use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH1, USART2};
use embassy_stm32::peripherals::{DMA1_CH2, DMA1_CH3, IWDG1, USART3};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, dma, interrupt as vector, usart};
use embassy_time::{Duration, Instant};
use spherecal_board::{ControlSide, ControlState, Lock, interrupt_executor};
use spherecal_firmware::Stopwatch;
use spherecal_firmware::app::ports::{Clock, Tick};
use spherecal_firmware::app::self_test::Image;
use spherecal_firmware::app::supervisor::Supervisor;
use spherecal_firmware::app::{StateClock, run};
use static_cell::StaticCell;

#[cfg(not(feature = "uart-drive"))]
use ethernet::drive_link;
use record::Cause;
#[cfg(feature = "uart-drive")]
use serial::drive_link;

/// Joints of the arm.
const JOINTS: usize = 7;
/// Timeout of the watchdog, in µs.
const WATCHDOG_US: u32 = 20_000;
/// Time after which an unacknowledged event is sent again. On this wire a
/// recording takes milliseconds to send.
const RESEND: Duration = Duration::from_millis(50);

spherecal_board::controller! {
    joints: JOINTS,
    host: (serial::Receiver, serial::Transmitter),
    // Two of the largest frames, as many as may wait.
    tick_bytes: 2 * 2304,
    control_section: ".dtcm.control",
}

bind_interrupts!(struct Interrupts {
    #[cfg(not(feature = "uart-drive"))]
    ETH => embassy_stm32::eth::InterruptHandler;
    #[cfg(feature = "uart-drive")]
    USART2 => usart::InterruptHandler<USART2>;
    USART3 => usart::InterruptHandler<USART3>;
    #[cfg(feature = "uart-drive")]
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    #[cfg(feature = "uart-drive")]
    DMA1_STREAM1 => dma::InterruptHandler<DMA1_CH1>;
    DMA1_STREAM2 => dma::InterruptHandler<DMA1_CH2>;
    DMA1_STREAM3 => dma::InterruptHandler<DMA1_CH3>;
});

// The interrupts of two unused peripherals run the two interrupt executors.
interrupt_executor! { #[vector] CONTROL, UART7 }
interrupt_executor! { #[vector] LINK_TASKS, UART8 }
static THREAD: StaticCell<Executor> = StaticCell::new();

defmt::timestamp!("{=u64:us}", Instant::now().as_micros());

/// The clock of the drive's states, which feeds the watchdog and checks the supply on every
/// tick.
struct WatchedClock {
    clock: StateClock<'static, Lock>,
    supervisor: Supervisor,
    watchdog: IndependentWatchdog<'static, IWDG1>,
}

impl Clock for WatchedClock {
    fn start(&mut self) {
        self.watchdog.unleash();
        self.clock.start();
    }

    fn set_period(&mut self, period: Duration) {
        self.clock.set_period(period);
    }

    async fn next_tick(&mut self) -> Tick {
        let tick = self.clock.next_tick().await;
        if clocks::supply_is_low() {
            record::leave_and_reset(Cause::LowSupply, 0, 0);
        }
        if let Err(part) = self.supervisor.check(tick.at.as_micros(), LINKS.pulse()) {
            record::leave_and_reset(Cause::Silent, part as u32, 0);
        }
        self.watchdog.pet();
        tick
    }

    fn device_time(&self, tick: &Tick, drive_us: u64) -> Instant {
        self.clock.device_time(tick, drive_us)
    }
}

#[embassy_executor::task]
async fn control(
    state: &'static mut ControlState<JOINTS>,
    mut host: ControlSide,
    watchdog: IndependentWatchdog<'static, IWDG1>,
) {
    let mut clock = WatchedClock {
        clock: StateClock::new(&LINKS),
        supervisor: Supervisor::default(),
        watchdog,
    };
    let ended = run(state, &mut clock, &mut &LINKS, &mut host).await;
    // Nothing feeds the watchdog any more: it resets the board.
    defmt::error!("control ended: {}", ended);
}

#[embassy_executor::task]
async fn housekeeping() {
    spherecal_board::keep_house(&LINKS).await
}

#[entry]
fn main() -> ! {
    let Some(mut core) = cortex_m::Peripherals::take() else {
        // The entry runs once.
        cortex_m::peripheral::SCB::sys_reset()
    };
    memory::protect(&mut core.MPU, &mut core.SCB, &mut core.CPUID);
    core.DCB.enable_trace();
    DWT::unlock();
    core.DWT.enable_cycle_counter();
    if !clocks::chip_is_fast_enough() {
        defmt::panic!("480 MHz needs revision V of the STM32H743; this chip is an older one");
    }
    let external = clocks::has_external_clock();
    let p = embassy_stm32::init(clocks::configuration(external));
    defmt::info!(
        "spherecal {} on nucleo-h743zi, build {}",
        env!("CARGO_PKG_VERSION"),
        BUILD
    );
    if !external {
        defmt::warn!("the ST-LINK gives no clock: the chip's own oscillator runs the board");
    }
    record::log_last();
    clocks::watch_supply();
    self_test();

    let watchdog = IndependentWatchdog::new(p.IWDG1, WATCHDOG_US);
    #[cfg(not(feature = "uart-drive"))]
    let drive = {
        // Before the driver enables the interrupt.
        interrupt::ETH.set_priority(Priority::P4);
        let pins = ethernet::Pins {
            ref_clk: p.PA1,
            crs_dv: p.PA7,
            rxd: (p.PC4, p.PC5),
            txd: (p.PG13, p.PB13),
            tx_en: p.PG11,
            mdio: p.PA2,
            mdc: p.PC1,
        };
        Some(ethernet::drive(p.ETH, p.ETH_SMA, pins))
    };
    #[cfg(feature = "uart-drive")]
    let drive = serial::drive(p.USART2, p.PD6, p.PD5, (p.DMA1_CH0, p.DMA1_CH1));
    let host = serial::host(p.USART3, p.PD9, p.PD8, (p.DMA1_CH2, p.DMA1_CH3));
    let (Some(drive), Some(host)) = (drive, host) else {
        // The clocks cannot give one of the baud rates: an error in `clocks`.
        defmt::panic!("the clocks cannot give the baud rates of the serial ports");
    };

    interrupt::USART2.set_priority(Priority::P4);
    interrupt::USART3.set_priority(Priority::P5);
    interrupt::UART7.set_priority(Priority::P2);
    interrupt::UART8.set_priority(Priority::P6);
    let control_spawner = CONTROL.start(interrupt::UART7);
    let link_spawner = LINK_TASKS.start(interrupt::UART8);
    let (control_side, link_side) = mailbox();
    // A byte takes ten bits on the wire.
    let link = host_link(|link| link.resending_after(RESEND).with_bandwidth(serial::HOST_BAUD / 10));
    let state = control_state();
    state.controller.set_stopwatch(Stopwatch {
        read: DWT::cycle_count,
        hz: clocks::CORE_HZ,
        last: u32::MAX,
    });
    let Ok(control) = control(state, control_side, watchdog) else {
        defmt::panic!("the control task is spawned twice");
    };
    control_spawner.spawn(control);
    let (Ok(drive), Ok(())) = (drive_link(drive), spawn_links(&link_spawner, link, link_side, host)) else {
        defmt::panic!("the link tasks are spawned twice");
    };
    link_spawner.spawn(drive);
    THREAD.init(Executor::new()).run(|spawner| {
        if let Ok(token) = housekeeping() {
            spawner.spawn(token);
        }
    })
}

/// Tests clocks, memory and image. Without a sound clock, stack or image the board does not
/// start: the drive gets no command and keeps its brakes closed.
fn self_test() {
    if !checks::clocks() {
        defmt::panic!("the clock of the core does not agree with the low-speed oscillator");
    }
    if let Err(at) = checks::stack() {
        record::leave_and_reset(Cause::Memory, at, 0);
    }
    match checks::image() {
        Image::Whole => defmt::info!("self-test passed: clocks, stack, image"),
        Image::NotSealed => defmt::warn!("self-test passed: clocks, stack; the image is not sealed (scripts/seal)"),
        Image::Damaged { at } => defmt::panic!("the image in flash is damaged at {=u32:#x}", at),
    }
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
