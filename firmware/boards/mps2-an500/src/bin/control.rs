//! The control path alone, linked with a panic handler that has an undefined
//! symbol: if any of it could panic, this image would not link.
//!
//! It is built, not run. Everything that a tick can reach is in it: the control
//! task with its queues, commands, the law, the phases, events and telemetry;
//! and the host link with its coding, once behind the queues and once in one
//! thread with the controller.
#![no_std]
#![no_main]

use core::hint::black_box;

use spherecal_m7 as _;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::Instant;
use spherecal_firmware::app::ports::{Beat, Clock, DrivePort, Probe};
use spherecal_firmware::app::{Bell, FromDrive, Post, Workspace, turn};
use spherecal_firmware::{HostLink, Node};
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};

unsafe extern "C" {
    fn the_control_path_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    // SAFETY: never linked.
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

/// No interrupts but the processor's own.
#[used]
#[unsafe(no_mangle)]
#[unsafe(link_section = ".vector_table.interrupts")]
pub static __INTERRUPTS: [usize; 32] = [0; 32];

/// The log goes nowhere: its sink is the board's.
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

/// A drive and a clock of which nothing is known.
struct Anything(Option<FromDrive>);

impl DrivePort for Anything {
    fn receive(&mut self) -> Option<FromDrive> {
        black_box(&mut self.0).take()
    }

    fn send(&mut self, command: &DriveCommand) {
        black_box(command);
    }
}

impl Probe for Anything {}

impl Clock for Anything {
    async fn next(&mut self) -> Beat {
        core::future::pending().await
    }

    fn time(&self, _: &Beat, drive_us: u64) -> Instant {
        Instant::from_micros(drive_us)
    }
}

/// The control task and the link, with queues between them.
#[inline(never)]
fn queued(down: &[u8], up: &mut [u8]) {
    let (mut post, bell) = (Post::new(), Bell::<CriticalSectionRawMutex>::new());
    let (mut host, mut desk) = post.split(&bell);
    let (mut link, mut work) = (HostLink::new("control", 7), Workspace::<7>::default());
    let (mut drive, clock) = (Anything(None), Anything(None));
    loop {
        link.receive(down, &mut desk);
        let beat = Beat {
            at: Instant::from_ticks(black_box(0)),
            missed: black_box(0),
        };
        if black_box(turn(&mut work, &clock, &beat, &mut drive, &mut host)).is_err() {
            return;
        }
        black_box(link.transmit(beat.at, up, &mut desk));
    }
}

/// Both in one thread.
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
        node.controller().missed(black_box(0));
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
