//! NUCLEO-F446RE (MB1136): STM32F446RE at 180 MHz, force from DAC1.
//!
//! | signal          | pin  | on the board      | function                          |
//! |-----------------|------|-------------------|-----------------------------------|
//! | encoder A       | PA0  | A0, CN8-1         | TIM2_CH1                          |
//! | encoder B       | PA1  | A1, CN8-2         | TIM2_CH2                          |
//! | encoder A again | PA6  | D12, CN5-5        | TIM3_CH1, with `time-stamps` only |
//! | encoder B again | PA7  | D11, CN5-4        | TIM3_CH2, with `time-stamps` only |
//! | force           | PA4  | A2, CN8-3         | DAC_OUT1: 0.2 .. 3.1 V, zero 1.65 V; ADC1 reads it |
//! | motor's current | PB0  | A3, CN8-4         | ADC2_IN8, if the amplifier has it |
//! | enable          | PA10 | D2, CN9-3         | TIM1_CH3, active high, low in off |
//! | emergency stop  | PB12 | CN10-16           | TIM1_BKIN, closed to ground       |
//!
//! In reset all pins are inputs; 4.7 kOhm at the amplifier pull enable down. The code of zero force is 2048. Full scale
//! is 2047 codes away. A higher voltage pushes into the wall.
//!
//! Conflicts: LD2 and the shield pin D13 are on PA5. USART2 to the ST-LINK is on PA2 and PA3. All three pins stay free.
//! The clock is the ST-LINK's 8 MHz on MCO, with solder bridges SB16 and SB50 on (UM1724, 6.7.1). A board marked C-01
//! is delivered without that clock. Without the clock the board says so on RTT and stays off.

#[path = "f4/dac.rs"]
mod dac;
#[cfg(feature = "time-stamps")]
#[path = "f4/edges.rs"]
mod edges;
#[path = "f4/mod.rs"]
mod f4;

use f4::{Chip, F4, Peripherals, Wires, Wiring, encoder, pin};
use stm32f4xx_hal::{
    gpio::{Alternate, Pin, Pull},
    pac,
    prelude::*,
    rcc::Config,
};
#[cfg(feature = "time-stamps")]
use zwidth::contract::RATE_HZ;
use zwidth::{Output, contract::Parts, self_test::Found, velocity::Sense};

pub type Selected = F4<NucleoF446re>;

pub struct NucleoF446re;

/// The part of the encoder that measures edge times. It is empty in an image without the feature `time-stamps`.
#[cfg(feature = "time-stamps")]
type EdgeTimes = edges::Edges<{ NucleoF446re::CORE_HZ / 2 / RATE_HZ }>;
#[cfg(not(feature = "time-stamps"))]
type EdgeTimes = ();

impl Wiring for NucleoF446re {
    const NAME: &'static str = "nucleo-f446re";
    const CORE_HZ: u32 = 180_000_000;
    /// The detector reports a low supply below 2.85 to 2.99 V, and a good supply above 2.96 to 3.10 V (data sheet). The
    /// board gives 3.3 V.
    const SUPPLY_LEVEL: u8 = 0b110;
    const OUTPUT: Output = Output::Dac { bits: 12 };
    const ENABLE: pin::BoardPin = pin::BoardPin::new('A', 10);
    const STOP: pin::BoardPin = pin::BoardPin::new('B', 12);
    const CHIP: u32 = 0x421;
    /// The code of brown-out level 3. This level is below the level of the supply detector (docs/first-power-up.md).
    const BROWN_OUT_RESET: u32 = 0;
    const SWING: Option<[i32; 2]> = Some(dac::SWING);
    const SENSES: &'static [Sense] =
        if cfg!(feature = "time-stamps") { &[Sense::Force, Sense::Edge] } else { &[Sense::Force] };
    /// The command is in the DAC's register 8.5 us after the sample. On the virtual board, which has no wait states, it
    /// is there after 6.7 us. The DAC's buffer then settles in 3 us (data sheet, typical).
    const LATENCY_SAMPLES: f64 = 0.115;
    type Force = dac::Output;
    type Encoder = encoder::Encoder<EdgeTimes>;
    type StopInput = Pin<'B', 12, Alternate<1>>;

    fn test_output() -> Found {
        dac::test()
    }

    fn take(device: pac::Peripherals, core: cortex_m::Peripherals) -> Parts<Selected> {
        let clock = Config::hse(8.MHz())
            .bypass_hse_oscillator()
            .sysclk(Self::CORE_HZ.Hz())
            .pclk1(45.MHz())
            .pclk2(90.MHz());
        let mut chip = Chip::start::<Self>(device.RCC, clock, true, &device.DBGMCU, core);
        let rcc = &mut chip.rcc;
        let a = device.GPIOA.split(rcc);
        let b = device.GPIOB.split(rcc);
        let stop = b.pb12.into_alternate::<1>().internal_resistor(Pull::Up);
        let _current = b.pb0.into_analog();
        let _enable = a.pa10.into_alternate::<1>();
        let force = dac::Output::new(device.DAC, a.pa4.into_analog(), rcc);
        #[cfg(feature = "time-stamps")]
        let edges = EdgeTimes::new(device.TIM3, a.pa6, a.pa7, rcc);
        #[cfg(not(feature = "time-stamps"))]
        let edges = ();
        let encoder = encoder::Encoder::new(device.TIM2, a.pa0, a.pa1, edges, rcc);
        chip.finish(
            Wires { force, encoder, stop },
            Peripherals {
                tim5: device.TIM5,
                tim6: device.TIM6,
                tim8: device.TIM8,
                dma2: device.DMA2,
                pwr: device.PWR,
                exti: device.EXTI,
                flash: device.FLASH,
                iwdg: device.IWDG,
            },
        )
    }
}
