//! Clocks and supply: 480 MHz from the ST-LINK's 8 MHz, or from the chip's own oscillator without them, and a check of
//! the supply voltage.

use embassy_stm32::Config;
use embassy_stm32::interrupt::Priority;
use embassy_stm32::pac;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk, VoltageScale,
};
use embassy_stm32::time::Hertz;

/// Frequency of the core, in Hz.
pub const CORE_HZ: u32 = 480_000_000;

/// Revision V of the chip: 480 MHz is beyond what the older ones are made for.
const REVISION_V: u16 = 0x2003;
/// Looks at the external clock before it is given up, at the 64 MHz of the start: some 10 ms.
const HSE_LOOKS: u32 = 100_000;

/// Whether the chip is made for [`CORE_HZ`].
pub fn chip_is_fast_enough() -> bool {
    pac::DBGMCU.idc().read().rev_id() >= REVISION_V
}

/// Whether the ST-LINK's clock of 8 MHz runs. It does not run if the ST-LINK has no power or other firmware.
pub fn has_external_clock() -> bool {
    pac::RCC.cr().modify(|w| w.set_hsebyp(true));
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    (0..HSE_LOOKS).any(|_| pac::RCC.cr().read().hserdy())
}

/// 480 MHz for the core, 240 MHz for the buses, 120 MHz for the peripherals; from the chip's own 64 MHz (within 1 %) where
/// there is no `external` clock.
pub fn configuration(external: bool) -> Config {
    let mut config = Config::default();
    config.rcc.hse = external.then_some(Hse {
        freq: Hertz(8_000_000),
        mode: HseMode::Bypass,
    });
    let (source, prediv) = if external {
        (PllSource::HSE, PllPreDiv::DIV1)
    } else {
        (PllSource::HSI, PllPreDiv::DIV8)
    };
    config.rcc.pll1 = Some(Pll {
        source,
        prediv,
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
