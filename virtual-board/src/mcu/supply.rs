//! The registers of PWR, with the supply and its voltage detector. The emulator has no input for the supply.

use std::sync::{
    Arc, OnceLock,
    atomic::{AtomicU32, Ordering::Relaxed},
};

use rsemu::core::{
    device::SinkPin,
    wire::{Level, WireId},
};

use super::bus::{Clock, Lazy, Port};

/// Thresholds of the detector for each level PLS, in mV. The first is for a rising supply, the second for a falling
/// supply. A supply up to the threshold is treated as low. The thresholds are the largest values of the data sheet of
/// the STM32F446, section 6.3.5. The STM32F407 has the same values.
const LEVELS_MV: [[u32; 2]; 8] = [
    [2190, 2080],
    [2370, 2260],
    [2510, 2390],
    [2650, 2560],
    [2820, 2710],
    [2990, 2890],
    [3100, 2990],
    [3210, 3090],
];

#[derive(Debug)]
pub(super) struct Supply {
    mv: AtomicU32,
    /// The register CR as the program has written it. It has the level and the enable bit.
    control: AtomicU32,
    low: AtomicU32,
    /// Line of EXTI that the detector drives.
    line: OnceLock<(WireId, SinkPin)>,
}

const CR: u64 = 0;
const CSR: u64 = 4;
const PVDE: u32 = 1 << 4;
const PVDO: u32 = 1 << 2;

impl Supply {
    pub(super) fn of_mv(mv: u32) -> Arc<Self> {
        Arc::new(Self {
            mv: AtomicU32::new(mv),
            control: AtomicU32::new(0),
            low: AtomicU32::new(PVDO),
            line: OnceLock::new(),
        })
    }

    pub(super) fn mv(&self) -> u32 {
        self.mv.load(Relaxed)
    }

    pub(super) fn set_mv(&self, mv: u32) {
        self.mv.store(mv, Relaxed);
        self.compare();
    }

    /// Compares the supply with the thresholds. The detector's bit becomes clear only above the rising threshold.
    fn compare(&self) {
        let level = (self.control.load(Relaxed) >> 5 & 7) as usize;
        let [rising, falling] = LEVELS_MV[level];
        let limit = if self.low.load(Relaxed) == 0 { falling } else { rising };
        self.low.store(if self.mv() <= limit { PVDO } else { 0 }, Relaxed);
        self.tell();
    }

    fn tell(&self) {
        if let Some((id, pin)) = self.line.get() {
            pin.sink.set_level(*id, pin.line, Level::from_bool(self.output() != 0));
        }
    }

    /// The detector's bit of CSR.
    fn output(&self) -> u32 {
        let enabled = self.control.load(Relaxed) & PVDE != 0;
        if enabled { self.low.load(Relaxed) } else { 0 }
    }

    pub(super) fn state(&self) -> [u32; 3] {
        [&self.mv, &self.control, &self.low].map(|word| word.load(Relaxed))
    }

    /// Restores the state. Devices that see the detector's output must be restored after this call.
    pub(super) fn restore(&self, from: [u32; 3]) {
        for (to, from) in [&self.mv, &self.control, &self.low].into_iter().zip(from) {
            to.store(from, Relaxed);
        }
        self.tell();
    }

    pub(super) fn connect(&self, id: WireId, pin: SinkPin) {
        let _ = self.line.set((id, pin)); // the chip sets it once
    }
}

/// PWR's port.
#[derive(Debug)]
pub(super) struct PowerPort {
    pub(super) lazy: Lazy,
    pub(super) clock: Arc<Clock>,
    pub(super) supply: Arc<Supply>,
}

impl Port for PowerPort {
    fn before(&self) {
        self.lazy.advance_to(self.clock.now());
    }

    fn write(&self, offset: u64, value: u32) -> u32 {
        if offset == CR {
            self.supply.control.store(value, Relaxed);
            self.supply.compare();
        }
        value
    }

    fn read(&self, offset: u64, value: u32) -> u32 {
        if offset == CSR { value & !PVDO | self.supply.output() } else { value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_detector_has_a_threshold_for_each_level_and_a_hysteresis() {
        let supply = Supply::of_mv(3000);
        let low = |level: u32, mv: u32| {
            supply.control.store(level << 5 | PVDE, Relaxed);
            supply.set_mv(mv);
            supply.low.load(Relaxed) != 0
        };
        assert!(low(7, 3000), "a board at 3.0 V never gets above level 7");
        assert!(!low(4, 3000));
        assert!(!low(4, 2750), "between the thresholds it stays");
        assert!(low(4, 2700));
        assert!(low(4, 2750), "between the thresholds it stays");
        assert!(!low(4, 2900));
    }
}
