//! Semihosting: files, standard streams, arguments and the exit code of the
//! process that runs the image (QEMU).
//!
//! A call stops the processor until the host has answered, and virtual time
//! stands still meanwhile. This makes the lock-step pipe deterministic.

use core::arch::asm;

const SYS_OPEN: usize = 0x01;
const SYS_WRITE: usize = 0x05;
const SYS_READ: usize = 0x06;
const SYS_GET_CMDLINE: usize = 0x15;
const SYS_EXIT_EXTENDED: usize = 0x20;
const ADP_STOPPED_APPLICATION_EXIT: usize = 0x2_0026;

/// Mode of opening a file: the index of C's mode string in the semihosting
/// standard.
#[derive(Clone, Copy)]
pub enum Mode {
    /// `rb`
    Read = 1,
    /// `wb`
    Write = 5,
}

/// A file, or a standard stream, of the host.
#[derive(Clone, Copy)]
pub struct File(usize);

fn call(operation: usize, argument: usize) -> usize {
    let result;
    // SAFETY: `bkpt 0xAB` is the semihosting call of M-profile processors.
    // `argument` is a value or points to a block that outlives the call.
    unsafe {
        asm!("bkpt 0xAB", inout("r0") operation => result, in("r1") argument, options(nostack));
    }
    result
}

fn block<const N: usize>(operation: usize, block: &mut [usize; N]) -> usize {
    call(operation, block.as_mut_ptr() as usize)
}

impl File {
    /// Opens `path`, which ends with a zero byte; `:tt` is standard input or
    /// output.
    pub fn open(path: &str, mode: Mode) -> Option<Self> {
        let length = path.len().checked_sub(1)?;
        if path.as_bytes()[length] != 0 {
            return None;
        }
        let handle = block(SYS_OPEN, &mut [path.as_ptr() as usize, mode as usize, length]);
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Writes all of `bytes`; `false` when the host did not take them.
    pub fn write(self, bytes: &[u8]) -> bool {
        bytes.is_empty() || block(SYS_WRITE, &mut [self.0, bytes.as_ptr() as usize, bytes.len()]) == 0
    }

    /// Waits for at least one byte. Returns the number of bytes; 0 at the end.
    pub fn read(self, buffer: &mut [u8]) -> usize {
        let left = block(SYS_READ, &mut [self.0, buffer.as_mut_ptr() as usize, buffer.len()]);
        buffer.len().saturating_sub(left)
    }
}

/// The arguments that QEMU was given (`arg=...`), separated by blanks.
pub fn arguments(buffer: &mut [u8]) -> &str {
    let mut parameters = [buffer.as_mut_ptr() as usize, buffer.len()];
    if block(SYS_GET_CMDLINE, &mut parameters) != 0 {
        return "";
    }
    let length = parameters[1].min(buffer.len());
    let text = buffer.split_at(length).0;
    core::str::from_utf8(text).unwrap_or("").trim_end_matches('\0')
}

/// Ends the process with `code`.
pub fn exit(code: u8) -> ! {
    block(
        SYS_EXIT_EXTENDED,
        &mut [ADP_STOPPED_APPLICATION_EXIT, usize::from(code)],
    );
    loop {
        cortex_m::asm::nop();
    }
}
