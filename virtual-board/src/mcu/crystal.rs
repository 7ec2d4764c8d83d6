//! Simulates a failure of the crystal, or of an external clock in its place, and the effect on the chip's clock.
//!
//! If a ready HSE fails while `CSSON` is set, the chip acts by RM0390 6.2.7 and RM0090 7.2.7. The chip sets `CSSF`.
//! This flag keeps the NMI active until `CSSC` is written. If `BKE` is set, the flag is also a break of TIM1. HSE and a
//! PLL that uses HSE are switched off. The core continues with HSI.
//!
//! Without `CSSON` the chip does not notice the failure. The manuals do not say what a PLL does without its input. In
//! this model the PLL's clock stops. With and without `CSSON` the failure lasts until a reset. After the reset the
//! crystal works again. The independent watchdog has its own clock and runs on.
//!
//! A core that sleeps with `SLEEPDEEP` also stops all clocks but the watchdog's (stop mode, chapter 5 of the manuals).
//! In this model only a reset ends this sleep.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering::Relaxed},
};

use super::{
    Mcu,
    bus::{Clock, Lazy, Port},
};

const HSI_MHZ: u64 = 16;
const CR: u64 = 0x00;
const PLLCFGR: u64 = 0x04;
const CFGR: u64 = 0x08;
const CIR: u64 = 0x0C;
const HSE_ON: u32 = 1 << 16;
const HSE_READY: u32 = 1 << 17;
const SECURITY_ON: u32 = 1 << 19;
const PLL_ON: u32 = 0b11 << 24;
const PLL_FROM_HSE: u32 = 1 << 22;
/// Bits of CFGR. `SW` has the requested clock, `SWS` the present clock.
const SWITCH: u32 = 0b1111;
const SECURITY_FLAG: u32 = 1 << 7;
const SECURITY_CLEAR: u32 = 1 << 23;
/// The bit of the core's system control register SCR that selects deep sleep.
const SLEEP_DEEP: u32 = 1 << 2;

#[derive(Debug, Default)]
pub(super) struct Crystal {
    pub(super) dead: AtomicBool,
    /// Whether the clock security system has switched HSE and PLL off.
    pub(super) switched: AtomicBool,
    /// Flag of the clock security system, `CSSF`.
    pub(super) flag: AtomicBool,
}

/// RCC's port.
#[derive(Debug)]
pub(super) struct ClockPort {
    pub(super) lazy: Lazy,
    pub(super) clock: Arc<Clock>,
    pub(super) crystal: Arc<Crystal>,
    /// The devices whose clocks RCC can switch off.
    pub(super) gated: Vec<Lazy>,
}

impl Port for ClockPort {
    fn before(&self) {
        self.lazy.advance_to(self.clock.now());
        self.gated.iter().for_each(Lazy::pay);
    }

    fn write(&self, offset: u64, value: u32) -> u32 {
        if offset == CIR && value & SECURITY_CLEAR != 0 {
            self.crystal.flag.store(false, Relaxed);
        }
        value
    }

    fn read(&self, offset: u64, value: u32) -> u32 {
        let Crystal { dead, switched, flag } = &*self.crystal;
        match offset {
            CR if switched.load(Relaxed) => value & !(HSE_ON | HSE_READY | PLL_ON),
            CR if dead.load(Relaxed) => value & !HSE_READY,
            CFGR if switched.load(Relaxed) => value & !SWITCH,
            CIR if flag.load(Relaxed) => value | SECURITY_FLAG,
            _ => value,
        }
    }
}

impl Mcu {
    /// Stops the crystal, or the external clock in its place, until the next reset.
    pub fn kill_hse(&mut self) {
        self.settle();
        self.service();
        let crystal = &self.soc.crystal;
        crystal.dead.store(true, Relaxed);
        let [control, pll, switch] =
            [CR, PLLCFGR, CFGR].map(|register| self.soc.rcc.peek(register));
        if control & HSE_READY == 0 {
            return;
        }
        let in_use = match switch >> 2 & 0b11 {
            0b01 => true,
            0b10 => pll & PLL_FROM_HSE != 0,
            _ => false,
        };
        let found = control & SECURITY_ON != 0;
        if found {
            crystal.switched.store(true, Relaxed);
            crystal.flag.store(true, Relaxed);
            self.soc.break_output();
        }
        if in_use {
            self.change_clock(if found { HSI_MHZ } else { 0 });
        }
        self.service();
    }

    /// Stops the clock of a core that sleeps with `SLEEPDEEP`.
    pub(super) fn stop_if_deep(&self) {
        if self.soc.cpu.with_sys(|sys| sys.scr & SLEEP_DEEP != 0) {
            self.change_clock(0);
        }
    }

    fn change_clock(&self, mhz: u64) {
        self.soc.lazies().for_each(Lazy::pay);
        self.clock.change(mhz, self.chip.core_hz / 1_000_000);
    }
}
