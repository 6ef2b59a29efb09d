//! Registers, interrupts and the vector table of the board.

/// A 32-bit device register.
#[derive(Clone, Copy)]
pub struct Register(*mut u32);

impl Register {
    /// The register at `address`.
    pub const fn at(address: usize) -> Self {
        Self(address as *mut u32)
    }

    /// Reads the register.
    #[inline(always)]
    pub fn read(self) -> u32 {
        // SAFETY: this crate names only addresses of device registers.
        unsafe { self.0.read_volatile() }
    }

    /// Writes the register.
    #[inline(always)]
    pub fn write(self, value: u32) {
        // SAFETY: as in `read`.
        unsafe { self.0.write_volatile(value) }
    }
}

/// The interrupts in use, by number.
#[derive(Clone, Copy)]
pub enum Interrupt {
    /// UART0 has received a byte.
    Uart0Receive = 0,
    /// UART0 can take a byte.
    Uart0Transmit = 1,
    /// UART1 has received a byte.
    Uart1Receive = 2,
    /// UART1 can take a byte.
    Uart1Transmit = 3,
    /// One of the two timers has expired.
    DualTimer = 10,
    /// Pended by software: runs the link executor.
    Link = 30,
    /// Pended by software: runs the control executor.
    Control = 31,
}

/// Priority of an interrupt; a lower number interrupts a higher one.
#[derive(Clone, Copy)]
pub enum Priority {
    /// The timer. It is highest because it wakes the control task.
    Timer = 0x20,
    /// The control task.
    Control = 0x40,
    /// Bytes of the UARTs.
    Uart = 0x80,
    /// The link tasks.
    Links = 0xa0,
}

const NVIC_ISER: usize = 0xe000_e100;
const NVIC_ISPR: usize = 0xe000_e200;
const NVIC_IPR: usize = 0xe000_e400;

/// Sets the priority of `interrupt` and enables it.
pub fn enable(interrupt: Interrupt, priority: Priority) {
    let number = interrupt as usize;
    // SAFETY: byte access to the priority field of this interrupt.
    unsafe { ((NVIC_IPR + number) as *mut u8).write_volatile(priority as u8) };
    Register::at(NVIC_ISER).write(1 << number);
}

/// Pends `interrupt`: its handler runs as soon as its priority allows.
#[inline(always)]
pub fn pend(interrupt: Interrupt) {
    Register::at(NVIC_ISPR).write(1 << (interrupt as u32));
}
