//! spherecal's controller on the Cortex-M7 board that QEMU emulates: MPS2 with
//! FPGA image AN500. The same sources, built for a Cortex-M4F, run on MPS2 with AN386.
//!
//! One image holds every scenario; QEMU's `-semihosting-config arg=` selects one:
//!
//! | `arg=` | what runs |
//! |---|---|
//! | `pipe` | the controller on QEMU's standard streams, in lock-step |
//! | `steps` | the same with one tick per exchange, for cores that need more than a period |
//! | `hog` | the same while a thread-mode task occupies the processor for 20 ms at a time |
//! | `uart` | the controller on UART0 (drive) and UART1 (host) |
//! | `stages` | prints the cost of each stage of the control law, in instructions |
//! | `wrap` | the time driver across the wrap of its 32-bit counter |
//!
//! A second argument `log=FILE` names the file of the `defmt` log. The `EXIT_`
//! constants below are the exit codes.
#![no_std]
#![no_main]

mod arguments;
mod executor;
mod hardware;
mod log;
mod pipe;
mod scenarios;
mod semihosting;
mod stack;
mod stages;
mod timer;
mod uart;
mod vectors;

use spherecal_m7 as _;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use static_cell::StaticCell;

use arguments::{Arguments, Scenario};

/// No scenario was given, or an unknown one.
const EXIT_USAGE: u8 = 2;
/// The host's files or streams could not be opened.
const EXIT_HOST: u8 = 3;
/// The drive was refused.
const EXIT_DRIVE: u8 = 4;
/// A scenario has failed.
const EXIT_FAILED: u8 = 5;
/// A log message started inside another of the same priority.
const EXIT_LOGGER: u8 = 99;
/// A hard fault.
const EXIT_HARD_FAULT: u8 = 100;
/// A panic.
const EXIT_PANIC: u8 = 101;

#[entry]
fn main() -> ! {
    stack::paint();
    static TEXT: StaticCell<[u8; 512]> = StaticCell::new();
    let text = TEXT.init([0; 512]);
    let length = semihosting::arguments(text).len();
    let arguments = Arguments::parse(text, length);
    let Some(scenario) = arguments.scenario else {
        semihosting::exit(EXIT_USAGE);
    };
    let sink = log::Sink::open(arguments.log);
    timer::stopwatch::start();
    timer::start(if scenario == Scenario::Wrap {
        scenarios::COUNTS_TO_WRAP
    } else {
        0
    });
    defmt::info!(
        "spherecal {} on mps2-an500, build {}, scenario {}",
        env!("CARGO_PKG_VERSION"),
        scenarios::BUILD,
        scenario
    );
    scenarios::run(scenario, sink)
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    log::ending();
    defmt::error!("{}", defmt::Display2Format(info));
    log::last_words();
    semihosting::exit(EXIT_PANIC)
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    log::ending();
    defmt::error!("hard fault at {=u32:#x}, called from {=u32:#x}", frame.pc(), frame.lr());
    log::last_words();
    semihosting::exit(EXIT_HARD_FAULT)
}
