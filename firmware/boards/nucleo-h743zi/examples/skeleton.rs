//! The smallest board: two UARTs, two interrupt executors, the controller.
#![no_std]
#![no_main]

use defmt_rtt as _;
use embassy_executor::Executor;
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH1, DMA1_CH2, DMA1_CH3, USART2, USART3};
use embassy_stm32::usart::{self, Config, RingBufferedUartRx, Uart, UartTx};
use embassy_stm32::{bind_interrupts, dma, interrupt as vector};
use spherecal_board::{ConstStaticCell, ControlSide, ControlState, StaticCell, interrupt_executor};
use spherecal_firmware::app::{StateClock, run};
use spherecal_m7 as _; // Only on a Cortex-M7: faster memory copies.

// 1. The controller: number of joints, types of the links' byte streams.
spherecal_board::controller! {
    joints: 7,
    drive: (RingBufferedUartRx<'static>, UartTx<'static, Async>),
    host: (RingBufferedUartRx<'static>, UartTx<'static, Async>),
    tick_bytes: 4608,
}

// 2. Two executors: control above the links. Any two unused interrupts will do.
interrupt_executor! { #[vector] CONTROL, UART7 }
interrupt_executor! { #[vector] LINK_TASKS, UART8 }
static THREAD: StaticCell<Executor> = StaticCell::new();
static RINGS: [ConstStaticCell<[u8; 2048]>; 2] = [const { ConstStaticCell::new([0; 2048]) }; 2];

bind_interrupts!(struct Interrupts {
    USART2 => usart::InterruptHandler<USART2>;
    USART3 => usart::InterruptHandler<USART3>;
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    DMA1_STREAM1 => dma::InterruptHandler<DMA1_CH1>;
    DMA1_STREAM2 => dma::InterruptHandler<DMA1_CH2>;
    DMA1_STREAM3 => dma::InterruptHandler<DMA1_CH3>;
});

// 3. The control task. The drive's states start its cycles. A real board feeds its
//    watchdog in a clock of its own.
#[embassy_executor::task]
async fn control(state: &'static mut ControlState<7>, mut host: ControlSide) {
    let ended = run(state, &mut StateClock::new(&LINKS), &mut &LINKS, &mut host).await;
    defmt::error!("control ended: {}", ended);
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // 4. Clocks, UARTs and priorities of your board.
    let p = embassy_stm32::init(embassy_stm32::Config::default());
    let config = |baudrate| {
        let mut config = Config::default();
        config.baudrate = baudrate;
        config
    };
    let drive = Uart::new(
        p.USART2,
        p.PD6,
        p.PD5,
        p.DMA1_CH0,
        p.DMA1_CH1,
        Interrupts,
        config(3_000_000),
    );
    let host = Uart::new(
        p.USART3,
        p.PD9,
        p.PD8,
        p.DMA1_CH2,
        p.DMA1_CH3,
        Interrupts,
        config(921_600),
    );
    let (Ok(drive), Ok(host)) = (drive, host) else {
        defmt::panic!("the clocks cannot give the baud rates");
    };
    let ((drive_tx, drive_rx), (host_tx, host_rx)) = (drive.split(), host.split());
    let [drive_ring, host_ring] = RINGS.each_ref().map(|ring| ring.take().as_mut_slice());
    let (drive_rx, host_rx) = (
        drive_rx.into_ring_buffered(drive_ring),
        host_rx.into_ring_buffered(host_ring),
    );
    interrupt::UART7.set_priority(Priority::P2);
    interrupt::USART2.set_priority(Priority::P4);
    interrupt::USART3.set_priority(Priority::P5);
    interrupt::UART8.set_priority(Priority::P6);

    // 5. Start.
    let (control_side, link_side) = mailbox();
    let links = LINK_TASKS.start(interrupt::UART8);
    let link = host_link(|link| link.with_bandwidth(92_160));
    let (Ok(token), Ok(())) = (
        control(control_state(), control_side),
        spawn_links(&links, link, link_side, (drive_rx, drive_tx), (host_rx, host_tx)),
    ) else {
        defmt::panic!("a task is spawned twice");
    };
    CONTROL.start(interrupt::UART7).spawn(token);
    THREAD.init(Executor::new()).run(|_| {})
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    defmt::error!("{}", defmt::Display2Format(info));
    cortex_m::peripheral::SCB::sys_reset()
}
