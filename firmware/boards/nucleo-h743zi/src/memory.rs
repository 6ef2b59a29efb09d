//! The memories: what is copied and cleared before the program starts, which addresses the
//! MPU closes, and the caches.

use core::arch::global_asm;

use cortex_m::peripheral::{CPUID, MPU, SCB};

// Runs before any static is initialised, with the stack only: copies the control path to
// ITCM and clears the control task's part of DTCM.
global_asm!(
    r#"
    .syntax unified
    .thumb
    .section .text.__pre_init,"ax",%progbits
    .global __pre_init
    .type __pre_init, %function
    .thumb_func
__pre_init:
    ldr r0, =__sitcm
    ldr r1, =__eitcm
    ldr r2, =__siitcm
1:  cmp r0, r1
    bhs 2f
    ldm r2!, {{r3}}
    stm r0!, {{r3}}
    b 1b
2:  ldr r0, =__sdtcm
    ldr r1, =__edtcm
    movs r3, #0
3:  cmp r0, r1
    bhs 4f
    stm r0!, {{r3}}
    b 3b
4:  dsb
    isb
    bx lr
    .pool
"#
);

/// The lowest addresses of the stack, which nothing may use.
pub const GUARD: core::ops::Range<u32> = 0x2000_0000..0x2000_0400;

/// No access, never executed.
const CLOSED: u32 = 1 << 28;
/// Read and executed, never written; normal memory without cache.
const CODE: u32 = 0b110 << 24 | 0b001 << 19;
/// Read and written, never executed; normal memory without cache, shared with DMA.
const SHARED: u32 = 1 << 28 | 0b011 << 24 | 0b001 << 19 | 1 << 18;

/// Closes the null page and the stack's guard, write-protects the code in ITCM, keeps the
/// AXI SRAM out of the cache, and turns the caches on. Flash is cached.
pub fn protect(mpu: &mut MPU, scb: &mut SCB, cpuid: &mut CPUID) {
    // Where regions overlap, the higher number counts.
    let regions = [
        (0x0000_0000, 16, CODE),
        (0x0000_0000, 8, CLOSED),
        (GUARD.start, 10, CLOSED),
        (0x2400_0000, 19, SHARED),
    ];
    cortex_m::asm::dmb();
    for (number, (base, log2_bytes, attributes)) in (0u32..).zip(regions) {
        // SAFETY: nothing uses the closed addresses; the attributes of the others fit their use.
        unsafe {
            mpu.rnr.write(number);
            mpu.rbar.write(base);
            mpu.rasr.write(attributes | (log2_bytes - 1) << 1 | 1);
        }
    }
    // SAFETY: the default map stays in force everywhere else (PRIVDEFENA). A hard fault runs
    // without the MPU, so its handler may use the guard as stack.
    unsafe { mpu.ctrl.write(0b101) };
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    scb.enable_icache();
    scb.enable_dcache(cpuid);
}
