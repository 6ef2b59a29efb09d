//! A record of why the program reset the board and where it was.
//!
//! The record lies in memory that the start-up code does not write. It survives
//! every reset except a loss of power, and the next start logs it. `probe-rs`
//! can read it as symbol `RECORD`.

use core::mem::MaybeUninit;
use core::ptr;

use embassy_stm32::pac;
use spherecal_firmware::app::self_test::stack_overflowed;
use spherecal_firmware::app::supervisor::Part;

use crate::memory::GUARD;

const MAGIC: u32 = 0x5bec_a1ed;
const SCB_CFSR: *const u32 = 0xe000_ed28 as *const u32;
const SCB_HFSR: *const u32 = 0xe000_ed2c as *const u32;
const SCB_MMFAR: *const u32 = 0xe000_ed34 as *const u32;
const SCB_BFAR: *const u32 = 0xe000_ed38 as *const u32;

/// Why the program reset the board.
#[derive(Clone, Copy)]
#[repr(u32)]
pub enum Cause {
    /// A hard fault; `at` and `from` are the program counter and the link register.
    HardFault = 1,
    /// A panic; `at` is the line.
    Panic = 2,
    /// The supply fell below 2.85 V.
    LowSupply = 3,
    /// A task gave no sign of life; `at` is the [`Part`].
    Silent = 4,
    /// The self-test found bad memory; `at` is its address.
    Memory = 5,
}

#[derive(Clone, Copy)]
#[repr(C)]
struct Record {
    magic: u32,
    cause: u32,
    at: u32,
    from: u32,
    cfsr: u32,
    hfsr: u32,
    mmfar: u32,
    bfar: u32,
    uptime_ms: u32,
}

// In DTCM: no cache holds it back, and each word has its own check bits, so the last one is
// not lost in a write buffer.
#[unsafe(link_section = ".kept")]
#[unsafe(no_mangle)]
static mut RECORD: MaybeUninit<Record> = MaybeUninit::uninit();

/// Writes the record and resets the board.
pub fn leave_and_reset(cause: Cause, at: u32, from: u32) -> ! {
    // SAFETY: registers of the system control block, readable at any time.
    let [cfsr, hfsr, mmfar, bfar] = unsafe {
        [
            SCB_CFSR.read_volatile(),
            SCB_HFSR.read_volatile(),
            SCB_MMFAR.read_volatile(),
            SCB_BFAR.read_volatile(),
        ]
    };
    let record = Record {
        magic: MAGIC,
        cause: cause as u32,
        at,
        from,
        cfsr,
        hfsr,
        mmfar,
        bfar,
        uptime_ms: embassy_time::Instant::now().as_millis() as u32,
    };
    // SAFETY: only the reset runs after this.
    unsafe { ptr::write_volatile((&raw mut RECORD).cast(), record) };
    cortex_m::asm::dsb();
    cortex_m::peripheral::SCB::sys_reset()
}

/// Logs the cause of the last reset and the record, and clears both.
pub fn log_last() {
    let flags = pac::RCC.rsr().read();
    defmt::info!(
        "last reset: power {}, brown-out {}, watchdog {}, pin {}, software {}",
        flags.porrstf(),
        flags.borrstf(),
        flags.iwdg1rstf(),
        flags.pinrstf(),
        flags.sftrstf()
    );
    pac::RCC.rsr().modify(|w| w.set_rmvf(true));
    // SAFETY: called once, before anything else uses the record; any bits are a
    // valid `Record`.
    let record: Record = unsafe { ptr::read_volatile((&raw const RECORD).cast()) };
    if record.magic != MAGIC {
        return;
    }
    // SAFETY: as above.
    unsafe { ptr::write_volatile((&raw mut RECORD).cast::<u32>(), 0) };
    let overflow = stack_overflowed(record.cfsr, record.mmfar, GUARD);
    let cause = match record.cause {
        1 if overflow => "stack overflow",
        1 => "hard fault",
        2 => "panic",
        3 => "supply below 2.85 V",
        4 => "a task that gave no sign of life",
        5 => "bad memory",
        _ => "unknown",
    };
    defmt::error!(
        "the last run ended after {} ms by: {=str}, at {=u32:#x}, called from {=u32:#x}, CFSR {=u32:#x} HFSR {=u32:#x} MMFAR {=u32:#x} BFAR {=u32:#x}",
        record.uptime_ms,
        cause,
        record.at,
        record.from,
        record.cfsr,
        record.hfsr,
        record.mmfar,
        record.bfar
    );
    if record.cause == Cause::Silent as u32
        && let Some(part) = Part::ALL.get(record.at as usize)
    {
        defmt::error!("the silent task: {}", part);
    }
}
