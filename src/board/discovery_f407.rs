//! STM32F4DISCOVERY / STM32F407G-DISC1 (MB997): STM32F407VG at 168 MHz, force from TIM1's PWM.
//!
//! | signal          | pin  | on the board | function                            |
//! |-----------------|------|--------------|-------------------------------------|
//! | encoder A       | PA15 | P2           | TIM2_CH1                            |
//! | encoder B       | PA1  | P1           | TIM2_CH2                            |
//! | force magnitude | PE9  | P1           | TIM1_CH1, 40 kHz PWM                |
//! | force sign      | PE11 | P1           | TIM1_CH2, high: away from the wall  |
//! | motor's current | PB0  | P1           | ADC2_IN8, if the amplifier has it   |
//! | enable          | PE13 | P1           | TIM1_CH3, active high, low in off   |
//! | emergency stop  | PE15 | P1           | TIM1_BKIN, closed to ground         |
//!
//! In reset all pins are inputs; 4.7 kOhm at the amplifier pull enable down. The code of zero force is 0, full scale is
//! +-4200 codes.
//!
//! Conflicts: the user button B1 is on PA0, the usual TIM2_CH1. So encoder A is on PA15, which is free because only SWD
//! is used. The audio codec is on PA4, the DAC's pin, so the force is a PWM. The accelerometer uses PE0, PE1, PE3 and
//! PA5 to PA7; the firmware does not use these pins. The clock is the board's 8 MHz crystal X2.

#[path = "f4/mod.rs"]
mod f4;
#[path = "f4/pwm.rs"]
mod pwm;

use f4::{Chip, F4, Peripherals, Wires, Wiring, encoder, pin};
use stm32f4xx_hal::{
    gpio::{Alternate, Pin, Pull},
    pac,
    prelude::*,
    rcc::Config,
};
use zwidth::{
    Output,
    contract::{Parts, RATE_HZ},
    self_test::Found,
    velocity::Sense,
};

pub type Selected = F4<DiscoveryF407>;

pub struct DiscoveryF407;

impl DiscoveryF407 {
    /// Timer ticks per PWM period.
    #[expect(clippy::cast_possible_truncation, reason = "4200")]
    const STEPS: u16 = (Self::CORE_HZ / RATE_HZ / pwm::PER_SAMPLE) as u16;
}

// The count of the PWM timer starts at one PWM period minus `LEAD_CYCLES`, so the period must be longer.
const _: () = assert!(DiscoveryF407::STEPS as u32 > pwm::LEAD_CYCLES, "a PWM period is too short");

impl Wiring for DiscoveryF407 {
    const NAME: &'static str = "discovery-f407";
    const CORE_HZ: u32 = 168_000_000;
    /// The detector reports a low supply below 2.59 to 2.71 V, and a good supply above 2.69 to 2.82 V (data sheet). The
    /// board supplies 3.0 V, from a regulator of 3.3 V and a diode. With the highest levels, 3.0 V would be reported as
    /// low.
    const SUPPLY_LEVEL: u8 = 0b100;
    const OUTPUT: Output = Output::Pwm { steps: Self::STEPS as u32 };
    /// This board measures no edge times. TIM3 would capture them on PA6 and PA7, which the accelerometer uses.
    const ENABLE: pin::BoardPin = pin::BoardPin::new('E', 13);
    const STOP: pin::BoardPin = pin::BoardPin::new('E', 15);
    const CHIP: u32 = 0x413;
    /// The code of brown-out level 2. This level is below the level of the supply detector (docs/first-power-up.md).
    const BROWN_OUT_RESET: u32 = 1;
    const SWING: Option<[i32; 2]> = None;
    const SENSES: &'static [Sense] = &[Sense::Force];
    /// Time from the sample to the PWM period that uses the command. Each period begins with the pulse, so a small
    /// force acts up to half a PWM period (0.125 samples) sooner than this number says. docs/firmware.md has the
    /// measurement.
    const LATENCY_SAMPLES: f64 = pwm::LEAD_CYCLES as f64 / (Self::CORE_HZ / RATE_HZ) as f64;
    type Force = pwm::Output;
    type Encoder = encoder::Encoder;
    type StopInput = Pin<'E', 15, Alternate<1>>;

    fn test_output() -> Found {
        pwm::test()
    }

    fn take(device: pac::Peripherals, core: cortex_m::Peripherals) -> Parts<Selected> {
        let clock = Config::hse(8.MHz()).sysclk(Self::CORE_HZ.Hz()).pclk1(42.MHz()).pclk2(84.MHz());
        let mut chip = Chip::start::<Self>(device.RCC, clock, false, &device.DBGMCU, core);
        // One wait state more than the HAL sets, for 2.4 to 2.7 V (reference manual RM0090, table 10). At 2.59 V the
        // supply detector may still report a good supply.
        device.FLASH.acr().modify(|_, w| w.latency().ws6());
        let rcc = &mut chip.rcc;
        let a = device.GPIOA.split(rcc);
        let e = device.GPIOE.split(rcc);
        let _current = device.GPIOB.split(rcc).pb0.into_analog();
        let stop = e.pe15.into_alternate::<1>().internal_resistor(Pull::Up);
        let force = pwm::Output::new(e.pe9, e.pe11, Self::STEPS);
        let _enable = e.pe13.into_alternate::<1>();
        let encoder = encoder::Encoder::new(
            device.TIM2,
            a.pa15.into_alternate::<1>().internal_resistor(Pull::None),
            a.pa1,
            (),
            rcc,
        );
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
