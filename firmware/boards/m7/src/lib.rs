//! Copies and clears memory on a Cortex-M7, eight words at a time.
//!
//! The compiler's run-time library moves one word in four instructions. A control
//! tick moves about 10 kB (the snapshot of the arm, frames, events), which took
//! 19,000 instructions. The load and store multiple instructions used here move
//! 32 bytes in four. The library's own symbols are weak, so linking this crate
//! replaces them: `use spherecal_m7 as _;`.
//!
//! ARMv7-M allows unaligned access to single words (with `CCR.UNALIGN_TRP` clear,
//! as after reset). Load and store multiple need aligned addresses.
#![no_std]

#[cfg(target_arch = "arm")]
core::arch::global_asm!(
    r#"
    .syntax unified
    .thumb
    .section .text.spherecal_m7,"ax",%progbits

    .global memcpy
    .type memcpy, %function
    .thumb_func
memcpy:
    push {{r0, lr}}
    bl __aeabi_memcpy
    pop {{r0, pc}}

    .global __aeabi_memcpy
    .type __aeabi_memcpy, %function
    .thumb_func
__aeabi_memcpy:
    orr r3, r0, r1
    tst r3, #3
    beq __aeabi_memcpy4
    subs r2, #8
    bmi 2f
1:  ldr r3, [r1], #4
    ldr r12, [r1], #4
    str r3, [r0], #4
    str r12, [r0], #4
    subs r2, #8
    bpl 1b
2:  adds r2, #8
    beq 4f
3:  ldrb r3, [r1], #1
    strb r3, [r0], #1
    subs r2, #1
    bne 3b
4:  bx lr

    .global __aeabi_memcpy4
    .type __aeabi_memcpy4, %function
    .global __aeabi_memcpy8
    .type __aeabi_memcpy8, %function
    .thumb_func
__aeabi_memcpy8:
    .thumb_func
__aeabi_memcpy4:
    subs r2, #32
    bmi 2f
    push {{r4-r10, lr}}
1:  ldmia r1!, {{r3-r10}}
    stmia r0!, {{r3-r10}}
    subs r2, #32
    bpl 1b
    pop {{r4-r10, lr}}
2:  adds r2, #28
    bmi 4f
3:  ldr r3, [r1], #4
    str r3, [r0], #4
    subs r2, #4
    bpl 3b
4:  adds r2, #4
    beq 6f
5:  ldrb r3, [r1], #1
    strb r3, [r0], #1
    subs r2, #1
    bne 5b
6:  bx lr

    .global __aeabi_memclr4
    .type __aeabi_memclr4, %function
    .global __aeabi_memclr8
    .type __aeabi_memclr8, %function
    .thumb_func
__aeabi_memclr8:
    .thumb_func
__aeabi_memclr4:
    movs r2, #0
    .global __aeabi_memset4
    .type __aeabi_memset4, %function
    .global __aeabi_memset8
    .type __aeabi_memset8, %function
    .thumb_func
__aeabi_memset8:
    .thumb_func
__aeabi_memset4:
    and r2, r2, #255
    orr r2, r2, r2, lsl #8
    orr r2, r2, r2, lsl #16
    subs r1, #32
    bmi 2f
    push {{r4-r9, lr}}
    mov r3, r2
    mov r4, r2
    mov r5, r2
    mov r6, r2
    mov r7, r2
    mov r8, r2
    mov r9, r2
1:  stmia r0!, {{r2-r9}}
    subs r1, #32
    bpl 1b
    pop {{r4-r9, lr}}
2:  adds r1, #28
    bmi 4f
3:  str r2, [r0], #4
    subs r1, #4
    bpl 3b
4:  adds r1, #4
    beq 6f
5:  strb r2, [r0], #1
    subs r1, #1
    bne 5b
6:  bx lr
"#
);
