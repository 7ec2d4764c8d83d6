//! NUCLEO-F446RE (MB1136): STM32F446RE at 180 MHz, force from DAC1.
//!
//! | signal          | pin  | on the board      | function                          |
//! |-----------------|------|-------------------|-----------------------------------|
//! | encoder A       | PA0  | A0, CN8-1         | TIM2_CH1                          |
//! | encoder B       | PA1  | A1, CN8-2         | TIM2_CH2                          |
//! | encoder A again | PA6  | D12, CN5-5        | TIM3_CH1, with `time-stamps` only |
//! | encoder B again | PA7  | D11, CN5-4        | TIM3_CH2, with `time-stamps` only |
//! | force           | PA4  | A2, CN8-3         | DAC_OUT1: 0.2 .. 3.1 V, zero 1.65 V |
//! | enable          | PA10 | D2, CN9-3         | TIM1_CH3, active high, low in off |
//! | emergency stop  | PB12 | CN10-16           | TIM1_BKIN, closed to ground       |
//!
//! In reset all pins are inputs: 4.7 kOhm at the amplifier pull enable down. Zero code 2048, 2047 codes to full
//! scale; a higher voltage pushes into the wall.
//!
//! Conflicts: LD2 and the shield pin D13 sit on PA5, which stays free; USART2 to the ST-LINK on
//! PA2, PA3 stays free. The clock is the ST-LINK's 8 MHz on MCO (solder bridge SB50 closed, SB16
//! open, as delivered): without the ST-LINK powered the chip waits in the clock set-up with its
//! outputs off.

use stm32f4xx_hal::{gpio::Pull, pac, prelude::*, rcc::Config};
use zwidth::velocity::Sense;

pub(super) use super::f4::dac::{Output, start, zero};
use super::{
    Board, Drive, EmergencyStop, Encoder, FaultMemory, Halts, RATE_HZ, SampleTimer, SettingsFlash,
    Supply, Watchdog,
    common::rtt,
    f4::{debugger, enable, reset},
};

/// Name, as in `--board` and in the feature.
pub const NAME: &str = "nucleo-f446re";
/// Core clock, Hz.
pub const CORE_HZ: u32 = 180_000_000;
/// Level of the supply detector: found low below 2.85 to 2.99 V, good again above 2.96 to 3.10 V (data
/// sheet). The board gives 3.3 V.
const SUPPLY_LEVEL: u8 = 0b110;
/// From the sampling event to the force, samples: 8.5 us to the DAC's register (1524 cycles on the
/// virtual board), 3 us for its buffer to settle (data sheet, typical).
pub const LATENCY_SAMPLES: f64 = 0.115;
/// What the force output makes of a force.
pub const OUTPUT: zwidth::Output = zwidth::Output::Dac { bits: 12 };
/// What an estimator can look at beside the count.
pub const SENSES: &[Sense] = &[
    Sense::Force,
    #[cfg(feature = "time-stamps")]
    Sense::Edge,
];

/// Sets the board up, outputs off first. The timers do not run yet.
pub fn take(device: pac::Peripherals, mut core: cortex_m::Peripherals) -> Board {
    let reset_cause = reset::cause(&device.RCC);
    let mut rcc = device.RCC.freeze(
        Config::hse(8.MHz())
            .bypass_hse_oscillator()
            .sysclk(CORE_HZ.Hz())
            .pclk1(45.MHz())
            .pclk2(90.MHz()),
    );
    super::watch_clock();
    debugger::set_up(&device.DBGMCU);
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    let a = device.GPIOA.split(&mut rcc);
    let b = device.GPIOB.split(&mut rcc);
    let mut stop = b.pb12.into_alternate::<1>();
    stop.set_internal_resistor(Pull::Up);
    super::power_tim1(&mut rcc);
    enable::init();
    let _enable = a.pa10.into_alternate::<1>();
    let drive = Drive { output: Output::new(device.DAC, a.pa4.into_analog(), &mut rcc) };
    let sample_timer = SampleTimer::new(device.TIM5, CORE_HZ / 2 / RATE_HZ, &mut rcc);
    #[cfg(feature = "time-stamps")]
    let edges = super::f4::edges::Edges::new(device.TIM3, a.pa6, a.pa7, &mut rcc);
    let encoder = Encoder::new(
        device.TIM2,
        a.pa0,
        a.pa1,
        #[cfg(feature = "time-stamps")]
        edges,
        &mut rcc,
    );
    let supply = Supply::new(device.PWR, &device.EXTI, SUPPLY_LEVEL, &mut rcc);
    let halts = Halts::new(device.TIM6, CORE_HZ / 2, RATE_HZ, &mut rcc);
    let memory = FaultMemory::new(&supply, &mut rcc);
    let settings = SettingsFlash::new(device.FLASH);
    let link = rtt::init();
    let watchdog = Watchdog::start(device.IWDG);
    Board {
        encoder,
        sample_timer,
        drive,
        stop: EmergencyStop(()),
        supply,
        halts,
        watchdog,
        memory,
        reset_cause,
        settings,
        link,
    }
}

#[inline(always)]
pub(super) fn stop_input_is_low() -> bool {
    // SAFETY: reading the input register has no side effect.
    unsafe { &*pac::GPIOB::ptr() }.idr().read().idr12().bit_is_clear()
}
