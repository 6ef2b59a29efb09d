//! Clocks and supply: 480 MHz from the ST-LINK's 8 MHz, and a check of the
//! supply voltage.

use embassy_stm32::Config;
use embassy_stm32::interrupt::Priority;
use embassy_stm32::pac;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk, VoltageScale,
};
use embassy_stm32::time::Hertz;

/// Frequency of the core, in Hz.
pub const CORE_HZ: u32 = 480_000_000;

/// 480 MHz for the core, 240 MHz for the buses, 120 MHz for the peripherals.
pub fn configuration() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(Hse {
        freq: Hertz(8_000_000),
        mode: HseMode::Bypass,
    });
    config.rcc.pll1 = Some(Pll {
        source: PllSource::HSE,
        prediv: PllPreDiv::DIV1,
        mul: PllMul::MUL120,
        fracn: None,
        divp: Some(PllDiv::DIV2),
        divq: None,
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.d1c_pre = AHBPrescaler::DIV1;
    config.rcc.ahb_pre = AHBPrescaler::DIV2;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.rcc.apb3_pre = APBPrescaler::DIV2;
    config.rcc.apb4_pre = APBPrescaler::DIV2;
    config.rcc.voltage_scale = VoltageScale::Scale0;
    // Below the control task, as the UARTs: a wake-up takes some µs.
    config.dma_interrupt_priority = Priority::P4;
    config
}

/// Starts the programmable voltage detector at its highest level, 2.85 V. That
/// is well above the brown-out reset, so there is time to write a record.
pub fn watch_supply() {
    pac::PWR.cr1().modify(|w| {
        w.set_pls(0b110);
        w.set_pvde(true);
    });
}

/// Whether the supply is below the detector's level.
pub fn supply_is_low() -> bool {
    pac::PWR.csr1().read().pvdo()
}
