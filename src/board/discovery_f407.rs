//! STM32F4DISCOVERY / STM32F407G-DISC1 (MB997): STM32F407VG at 168 MHz, force from TIM1's PWM.
//!
//! | signal          | pin  | on the board | function                            |
//! |-----------------|------|--------------|-------------------------------------|
//! | encoder A       | PA15 | P2           | TIM2_CH1                            |
//! | encoder B       | PA1  | P1           | TIM2_CH2                            |
//! | force magnitude | PE9  | P1           | TIM1_CH1, 40 kHz PWM                |
//! | force sign      | PE11 | P1           | TIM1_CH2, high: away from the wall  |
//! | enable          | PE13 | P1           | TIM1_CH3, active high, low in off   |
//! | emergency stop  | PE15 | P1           | TIM1_BKIN, closed to ground         |
//!
//! In reset all pins are inputs: 4.7 kOhm at the amplifier pull enable down. Zero code 0, +-4200 codes to full
//! scale.
//!
//! Conflicts: the user button B1 pulls PA0 about, the usual TIM2_CH1, hence PA15 (free, as only SWD
//! is used); the audio codec hangs on PA4, the DAC's pin, hence PWM; the accelerometer keeps PE0,
//! PE1, PE3 and PA5 to PA7, which stay free. The clock is the board's 8 MHz crystal X2.

use stm32f4xx_hal::{gpio::Pull, pac, prelude::*, rcc::Config};
use zwidth::velocity::Sense;

pub(super) use super::f4::pwm::{Output, start, zero};
use super::{
    Board, Drive, EmergencyStop, Encoder, FaultMemory, Halts, RATE_HZ, SampleTimer, SettingsFlash,
    Supply, Watchdog,
    common::rtt,
    f4::{debugger, enable, pwm, reset},
};

/// Name, as in `--board` and in the feature.
pub const NAME: &str = "discovery-f407";
/// Core clock, Hz.
pub const CORE_HZ: u32 = 168_000_000;
/// Timer ticks per PWM period.
#[expect(clippy::cast_possible_truncation, reason = "4200")]
const STEPS: u16 = (CORE_HZ / RATE_HZ / pwm::PER_SAMPLE) as u16;
/// Level of the supply detector: found low below 2.59 to 2.71 V, good again above 2.69 to 2.82 V (data
/// sheet). The board gives 3.0 V, a regulator of 3.3 V behind a diode: the highest levels never call that good.
const SUPPLY_LEVEL: u8 = 0b100;
/// From the counter's reading to the force, samples: to the PWM period that takes the command over.
/// A pulse stands at the beginning of its period, so a small force acts up to half a period
/// (0.125) sooner; docs/firmware.md has the measurement.
pub const LATENCY_SAMPLES: f64 = pwm::LEAD_CYCLES as f64 / (CORE_HZ / RATE_HZ) as f64;
/// What the force output makes of a force.
pub const OUTPUT: zwidth::Output = zwidth::Output::Pwm { steps: STEPS as u32 };
/// What an estimator can look at beside the count. No edge times: PA6 and PA7, where TIM3 would
/// capture them, are the accelerometer's.
pub const SENSES: &[Sense] = &[Sense::Force];

/// Sets the board up, outputs off first. The timers do not run yet.
pub fn take(device: pac::Peripherals, mut core: cortex_m::Peripherals) -> Board {
    let reset_cause = reset::cause(&device.RCC);
    let mut rcc = device
        .RCC
        .freeze(Config::hse(8.MHz()).sysclk(CORE_HZ.Hz()).pclk1(42.MHz()).pclk2(84.MHz()));
    // One more than the HAL sets, for 2.4 to 2.7 V (reference manual RM0090, table 10): the supply detector
    // may find 2.59 V still good.
    device.FLASH.acr().modify(|_, w| w.latency().ws6());
    super::watch_clock();
    debugger::set_up(&device.DBGMCU);
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    let a = device.GPIOA.split(&mut rcc);
    let e = device.GPIOE.split(&mut rcc);
    let mut stop = e.pe15.into_alternate::<1>();
    stop.set_internal_resistor(Pull::Up);
    super::power_tim1(&mut rcc);
    enable::init();
    let drive = Drive { output: Output::new(e.pe9, e.pe11, STEPS) };
    let _enable = e.pe13.into_alternate::<1>();
    let sample_timer = SampleTimer::new(device.TIM5, CORE_HZ / 2 / RATE_HZ, &mut rcc);
    let encoder = Encoder::new(device.TIM2, a.pa15.into_alternate::<1>(), a.pa1, &mut rcc);
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
    unsafe { &*pac::GPIOE::ptr() }.idr().read().idr15().bit_is_clear()
}
