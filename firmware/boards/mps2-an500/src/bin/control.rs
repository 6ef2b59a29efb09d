//! The control path alone, linked with a panic handler that has an undefined
//! symbol: if any of it could panic, this image would not link.
//!
//! It is built, not run. Everything that a tick can reach is in it: the host
//! link with its decoding, commands, the law, the phases, events and telemetry.
#![no_std]
#![no_main]

use core::hint::black_box;

use spherecal_m7 as _;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use embassy_time::Instant;
use spherecal_firmware::Node;
use spherecal_shared::protocol::drive::{DriveHello, DriveState};

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

#[entry]
fn main() -> ! {
    let mut node = Node::<7>::new("control");
    let (mut state, mut down, mut up) = (DriveState::default(), [0u8; 256], [0u8; 4096]);
    let mut hello: Option<DriveHello> = None;
    loop {
        let now = Instant::from_ticks(black_box(0));
        black_box(&mut state);
        black_box(&mut down);
        if let Some(hello) = black_box(&mut hello) {
            let _ = black_box(node.controller().connect(hello));
        }
        node.controller().missed(black_box(0));
        black_box(node.exchange(now, &state, &down, &mut up));
        black_box(&mut up);
    }
}
