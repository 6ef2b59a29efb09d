//! spherecal's controller on ST's NUCLEO-H743ZI: Cortex-M7 at 480 MHz.
//!
//! ```text
//!   drive ── USART2 (PD5/PD6, 3 Mbaud) ─┐
//!                                       ├─ links, priority 6 ─┐
//!   host ─── USART3 (ST-LINK's virtual ─┘                     ├─ control, 1 kHz, priority 2
//!            COM port, 921,600 baud)      log (RTT), thread ──┘
//! ```
//!
//! Only the control task feeds the independent watchdog, on every tick. A
//! controller that hangs is reset within 20 ms; the drive gets no command then
//! and closes its brakes. A hard fault, a panic and a falling supply leave a
//! record that survives the reset ([`record`]).
#![no_std]
#![no_main]

mod clocks;
mod record;
mod serial;

use spherecal_m7 as _;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::peripherals::{IWDG1, USART2, USART3};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUartRx, BufferedUartTx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, interrupt as vector};
use embassy_time::{Duration, Instant};
use spherecal_board::{ControlSide, ControlState, interrupt_executor};
use spherecal_firmware::app::ports::{Clock, Tick};
use spherecal_firmware::app::{TickerClock, run};
use static_cell::StaticCell;

use record::Cause;

/// Joints of the arm.
const JOINTS: usize = 7;
/// Timeout of the watchdog, in µs.
const WATCHDOG_US: u32 = 20_000;
/// Time after which an unacknowledged event is sent again. On this wire a
/// recording takes milliseconds to send.
const RESEND: Duration = Duration::from_millis(50);

spherecal_board::controller! {
    joints: JOINTS,
    drive: (BufferedUartRx<'static>, BufferedUartTx<'static>),
    host: (BufferedUartRx<'static>, BufferedUartTx<'static>),
    // Three of the largest frames.
    tick_bytes: 8192,
}

bind_interrupts!(struct Interrupts {
    USART2 => BufferedInterruptHandler<USART2>;
    USART3 => BufferedInterruptHandler<USART3>;
});

// The interrupts of two unused peripherals run the two interrupt executors.
interrupt_executor! { #[vector] CONTROL, UART7 }
interrupt_executor! { #[vector] LINK_TASKS, UART8 }
static THREAD: StaticCell<Executor> = StaticCell::new();

/// A ticker that feeds the watchdog and checks the supply on every tick.
struct WatchedClock {
    ticker: TickerClock,
    watchdog: IndependentWatchdog<'static, IWDG1>,
}

impl Clock for WatchedClock {
    fn start(&mut self) {
        self.watchdog.unleash();
        self.ticker.start();
    }

    fn set_period(&mut self, period: Duration) {
        self.ticker.set_period(period);
    }

    async fn next_tick(&mut self) -> Tick {
        let tick = self.ticker.next_tick().await;
        if clocks::supply_is_low() {
            record::leave_and_reset(Cause::LowSupply, 0, 0);
        }
        self.watchdog.pet();
        tick
    }

    fn device_time(&self, tick: &Tick, drive_us: u64) -> Instant {
        self.ticker.device_time(tick, drive_us)
    }
}

#[embassy_executor::task]
async fn control(
    state: &'static mut ControlState<JOINTS>,
    mut host: ControlSide,
    watchdog: IndependentWatchdog<'static, IWDG1>,
) {
    let ticker = TickerClock::new();
    let mut clock = WatchedClock { ticker, watchdog };
    let ended = run(state, &mut clock, &mut &LINKS, &mut host).await;
    // Nothing feeds the watchdog any more: it resets the board.
    defmt::error!("control ended: {}", ended);
}

#[embassy_executor::task]
async fn housekeeping() {
    spherecal_board::report_drops(&LINKS).await
}

#[entry]
fn main() -> ! {
    let p = embassy_stm32::init(clocks::configuration());
    defmt::info!(
        "spherecal {} on nucleo-h743zi, build {}",
        env!("CARGO_PKG_VERSION"),
        BUILD
    );
    record::log_last();
    clocks::watch_supply();

    let watchdog = IndependentWatchdog::new(p.IWDG1, WATCHDOG_US);
    let drive = serial::drive(p.USART2, p.PD6, p.PD5);
    let host = serial::host(p.USART3, p.PD9, p.PD8);
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
    let link = host_link(|link| link.resending_after(RESEND));
    let Ok(control) = control(control_state(), control_side, watchdog) else {
        defmt::panic!("the control task is spawned twice");
    };
    control_spawner.spawn(control);
    if spawn_links(&link_spawner, link, link_side, drive, host).is_err() {
        defmt::panic!("the link tasks are spawned twice");
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
