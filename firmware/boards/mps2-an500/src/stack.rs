//! Measures the depth of the stack: [`paint`] fills the free stack with a
//! pattern, and memory that no longer holds the pattern was used.

use core::ptr;

const PAINT: u32 = 0x5ca1_ab1e;

unsafe extern "C" {
    static mut __sheap: u32;
    static _stack_start: u32;
}

/// Lowest address of the stack and the address of its end.
fn room() -> (*mut u32, *const u32) {
    // SAFETY: only the addresses of the linker's symbols are taken.
    (&raw mut __sheap, &raw const _stack_start)
}

/// Paints the free part of the stack except the last bytes below this frame.
#[inline(never)]
pub fn paint() {
    let (bottom, _) = room();
    let mut here = 0u32;
    let top = (&raw mut here).wrapping_sub(64);
    let mut at = bottom;
    while at < top {
        // SAFETY: only free stack lies between the end of static data and the
        // stack pointer.
        unsafe { ptr::write_volatile(at, PAINT) };
        at = at.wrapping_add(1);
    }
}

/// Bytes of stack used since [`paint`], and bytes available.
pub fn used() -> (usize, usize) {
    let (bottom, top) = room();
    let mut at = bottom.cast_const();
    // SAFETY: the whole stack is readable memory.
    while at < top && unsafe { ptr::read_volatile(at) } == PAINT {
        at = at.wrapping_add(1);
    }
    (top as usize - at as usize, top as usize - bottom as usize)
}
