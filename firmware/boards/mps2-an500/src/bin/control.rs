//! Proof that the control path cannot panic. The image holds the control path
//! alone, and its panic handler calls an undefined symbol: if any code could
//! panic, the image would not link.
//!
//! The image is built, not run. It holds everything that a tick can reach: the
//! control task with its queues, commands, law, phases, events and telemetry,
//! and the host link with its encoding, once behind the queues and once in one
//! thread with the controller.
#![no_std]
#![no_main]

use core::hint::black_box;

use spherecal_m7 as _;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::Instant;
use spherecal_firmware::app::ports::{Clock, DrivePort, Probe, Tick};
use spherecal_firmware::app::{ControlState, Mailbox, MailboxSignal, run_cycle};
use spherecal_firmware::{HostLink, Node};
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveMessage, DriveState};

unsafe extern "C" {
    fn the_control_path_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    // SAFETY: never called: an image that holds this call does not link.
    unsafe { the_control_path_can_panic() }
}

#[exception]
unsafe fn HardFault(_: &ExceptionFrame) -> ! {
    loop {
        cortex_m::asm::nop();
    }
}

#[exception]
unsafe fn DefaultHandler(_: i16) {
    cortex_m::asm::nop();
}

/// The board's part of the vector table: no interrupts.
#[used]
#[unsafe(no_mangle)]
#[unsafe(link_section = ".vector_table.interrupts")]
pub static __INTERRUPTS: [usize; 32] = [0; 32];

/// Discards the log: where it goes is the board's matter.
#[defmt::global_logger]
struct Nowhere;

// SAFETY: does nothing.
unsafe impl defmt::Logger for Nowhere {
    fn acquire() {}
    unsafe fn flush() {}
    unsafe fn release() {}
    unsafe fn write(bytes: &[u8]) {
        black_box(bytes);
    }
}

/// A drive and a clock about which the compiler knows nothing.
struct Anything(Option<DriveMessage>);

impl DrivePort for Anything {
    fn next_message(&mut self) -> Option<DriveMessage> {
        black_box(&mut self.0).take()
    }

    fn send(&mut self, command: &DriveCommand) {
        black_box(command);
    }
}

impl Probe for Anything {}

impl Clock for Anything {
    async fn next_tick(&mut self) -> Tick {
        core::future::pending().await
    }

    fn device_time(&self, _: &Tick, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}

/// Control task and host link with queues between them.
#[inline(never)]
fn queued(down: &[u8], up: &mut [u8]) {
    let (mut mailbox, signal) = (Mailbox::new(), MailboxSignal::<CriticalSectionRawMutex>::new());
    let (mut host, mut port) = mailbox.split(&signal);
    let (mut link, mut state) = (HostLink::new("control", 7), ControlState::<7>::default());
    let (mut drive, clock) = (Anything(None), Anything(None));
    loop {
        link.receive(down, &mut port);
        let tick = Tick {
            at: Instant::from_ticks(black_box(0)),
            missed: black_box(0),
        };
        if black_box(run_cycle(&mut state, &clock, &tick, &mut drive, &mut host)).is_err() {
            return;
        }
        black_box(link.transmit(tick.at, up, &mut port));
    }
}

/// Controller and host link in one thread.
#[inline(never)]
fn direct(down: &[u8], up: &mut [u8]) {
    let mut node = Node::<7>::new("control");
    let mut state = DriveState::default();
    let mut hello: Option<DriveHello> = None;
    while black_box(true) {
        let now = Instant::from_ticks(black_box(0));
        black_box(&mut state);
        if let Some(hello) = black_box(&mut hello) {
            let _ = black_box(node.controller().connect(hello));
        }
        node.controller().record_missed(black_box(0));
        black_box(node.exchange(now, &state, down, up));
    }
}

#[entry]
fn main() -> ! {
    let (mut down, mut up) = ([0u8; 256], [0u8; 4096]);
    loop {
        black_box(&mut down);
        queued(&down, &mut up);
        direct(&down, &mut up);
        black_box(&mut up);
    }
}
