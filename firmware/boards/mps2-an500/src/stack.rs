//! How deep the stack has been: everything below the stack pointer is painted
//! at the start, and what has lost its paint was used.

use core::ptr;

const PAINT: u32 = 0x5ca1_ab1e;

unsafe extern "C" {
    static mut __sheap: u32;
    static _stack_start: u32;
}

/// Lowest address of the stack's room and its end.
fn room() -> (*mut u32, *const u32) {
    // SAFETY: only the addresses of the linker's symbols are taken.
    (&raw mut __sheap, &raw const _stack_start)
}

/// Paints the free part of the stack, but for the last bytes below this frame.
#[inline(never)]
pub fn paint() {
    let (bottom, _) = room();
    let mut here = 0u32;
    let top = (&raw mut here).wrapping_sub(64);
    let mut at = bottom;
    while at < top {
        // SAFETY: between the end of static data and the stack pointer there is
        // nothing but free stack.
        unsafe { ptr::write_volatile(at, PAINT) };
        at = at.wrapping_add(1);
    }
}

/// Bytes of stack used since [`paint`], and bytes of room.
pub fn used() -> (usize, usize) {
    let (bottom, top) = room();
    let mut at = bottom.cast_const();
    // SAFETY: all of the room is readable memory.
    while at < top && unsafe { ptr::read_volatile(at) } == PAINT {
        at = at.wrapping_add(1);
    }
    (top as usize - at as usize, top as usize - bottom as usize)
}
