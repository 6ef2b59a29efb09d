//! The board's part of the vector table: which handler serves which interrupt.

use crate::hardware::Interrupt;
use crate::{executor, timer, uart};

/// An entry of the vector table.
type Handler = unsafe extern "C" fn();

unsafe extern "C" {
    fn DefaultHandler();
}

/// The board's part of the vector table.
#[used]
#[unsafe(no_mangle)]
#[unsafe(link_section = ".vector_table.interrupts")]
static __INTERRUPTS: [Handler; 32] = {
    let mut table: [Handler; 32] = [DefaultHandler; 32];
    table[Interrupt::DualTimer as usize] = timer::on_interrupt;
    table[Interrupt::Control as usize] = executor::on_control;
    table[Interrupt::Link as usize] = executor::on_link;
    table[Interrupt::Uart0Receive as usize] = uart::on_uart0_receive;
    table[Interrupt::Uart0Transmit as usize] = uart::on_uart0_transmit;
    table[Interrupt::Uart1Receive as usize] = uart::on_uart1_receive;
    table[Interrupt::Uart1Transmit as usize] = uart::on_uart1_transmit;
    table
};
