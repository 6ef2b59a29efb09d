//! The self-test at the start: clocks, memory of the stack, image in flash. What a check
//! means is in `spherecal_firmware::app::self_test`.

use core::ptr;

use cortex_m::peripheral::DWT;
use embassy_stm32::pac;
use embassy_stm32::pac::rcc::vals::Lptim1sel;
use spherecal_firmware::app::self_test::{Image, Memory, Seal, clocks_agree, march};

use crate::clocks::CORE_HZ;
use crate::memory::GUARD;

/// Frequency of the independent low-speed oscillator, in Hz, and how far it may be off over
/// temperature, in percent (data sheet: 29.8 to 33.6 kHz).
const LSI_HZ: u32 = 32_000;
const LSI_PERCENT: u32 = 10;
/// How long the clocks are compared, in cycles of the core: 10 ms.
const COMPARED: u32 = CORE_HZ / 100;
/// Bytes below the stack pointer that the test itself may use.
const IN_USE: u32 = 2048;
/// First address of flash, and the one behind it.
const FLASH: core::ops::Range<u32> = 0x0800_0000..0x0820_0000;

/// What `scripts/seal` writes into the image.
#[used]
#[unsafe(link_section = ".seal")]
static SEAL: Seal = Seal::NONE;

/// The free part of the stack, word by word.
struct FreeStack {
    start: *mut u32,
    words: usize,
}

impl Memory for FreeStack {
    fn words(&self) -> usize {
        self.words
    }

    fn write(&mut self, index: usize, value: u32) {
        // SAFETY: `march` keeps within `words`; nothing uses these addresses.
        unsafe { self.start.add(index).write_volatile(value) }
    }

    fn read(&self, index: usize) -> u32 {
        // SAFETY: as in `write`.
        unsafe { self.start.add(index).read_volatile() }
    }
}

/// Tests the free part of the stack, from the guard up to what is in use.
///
/// # Errors
/// The address of the first bad word.
#[inline(never)]
pub fn stack() -> Result<(), u32> {
    let top = cortex_m::register::msp::read() - IN_USE;
    let mut free = FreeStack {
        start: GUARD.end as *mut u32,
        words: (top - GUARD.end) as usize / 4,
    };
    // An interrupt would push its registers there.
    cortex_m::interrupt::free(|_| march(&mut free)).map_err(|word| GUARD.end + 4 * word as u32)
}

/// Whether the core's clock agrees with the independent oscillator. The cycle counter runs.
pub fn clocks() -> bool {
    pac::RCC.csr().modify(|w| w.set_lsion(true));
    let from = DWT::cycle_count();
    while !pac::RCC.csr().read().lsirdy() {
        if DWT::cycle_count().wrapping_sub(from) > COMPARED {
            return false;
        }
    }
    pac::RCC.d2ccip2r().modify(|w| w.set_lptim1sel(Lptim1sel::LSI));
    pac::RCC.apb1lenr().modify(|w| w.set_lptim1en(true));
    let timer = pac::LPTIM1;
    timer.cr().modify(|w| w.set_enable(true));
    timer.arr().write(|w| w.set_arr(u16::MAX));
    timer.cr().modify(|w| w.set_cntstrt(true));
    // The register is read in another clock domain: equal twice means right.
    let count = || loop {
        let (a, b) = (timer.cnt().read().cnt(), timer.cnt().read().cnt());
        if a == b {
            return u32::from(a);
        }
    };
    let (first, from) = (count(), DWT::cycle_count());
    while DWT::cycle_count().wrapping_sub(from) < COMPARED {}
    let (last, cycles) = (count(), DWT::cycle_count().wrapping_sub(from));
    timer.cr().modify(|w| w.set_enable(false));
    pac::RCC.apb1lenr().modify(|w| w.set_lptim1en(false));
    clocks_agree(cycles, CORE_HZ, last.wrapping_sub(first) & 0xffff, LSI_HZ, LSI_PERCENT)
}

/// Compares the image in flash with its seal.
pub fn image() -> Image {
    // SAFETY: a static of this program; volatile, because the seal is written after the
    // compiler has seen it.
    let seal = unsafe { ptr::read_volatile(&raw const SEAL) };
    seal.check(|at, length| {
        let end = at.checked_add(length)?;
        // SAFETY: flash is there, and nothing writes it while the program runs.
        (FLASH.contains(&at) && end <= FLASH.end)
            .then(|| unsafe { core::slice::from_raw_parts(at as *const u8, length as usize) })
    })
}
