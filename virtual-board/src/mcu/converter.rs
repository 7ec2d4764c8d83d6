//! Simulates ADC1 and ADC2. The program starts each conversion (RM0390 13.3.4, 13.4, 13.13; RM0090 13.3.4, 13.4,
//! 13.13).
//!
//! A conversion reads the voltage at the end of its sampling time. The result appears twelve converter cycles later.
//! Two inputs are wired. Input 4 is the DAC's pin, whose buffer gives 0.2 to 3.1 V. Input 8 is the amplifier's current
//! signal. Voltages of pins settle at once. Reading the data clears the flag.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use rsemu::core::space::{MemAttrs, MemOps, MemResult};

use super::{
    bench::Bench,
    bus::{Clock, Storage},
    gate::Block,
};

#[derive(Debug)]
pub(super) struct Converters {
    pub(super) registers: Arc<Storage>,
    pub(super) dac: Arc<Storage>,
    pub(super) written_at: Arc<AtomicU64>,
    pub(super) clock: Arc<Clock>,
    pub(super) bench: Arc<Bench>,
}

const SR: u64 = 0x00;
const DONE: u32 = 1 << 1;
const CR2: u64 = 0x08;
const ON: u32 = 1;
const START: u32 = 1 << 30;
const SMPR1: u64 = 0x0C;
const SMPR2: u64 = 0x10;
const SQR3: u64 = 0x34;
const DR: u64 = 0x4C;
/// Offsets of registers that only this model has. They store whether a conversion runs, its start time, and its input
/// at the start.
const GOES_ON: u64 = 0x60;
const BEGAN: [u64; 2] = [0x64, 0x68];
const THERE: u64 = 0x6C;
const SECOND: u64 = 0x100;
/// Control register of both converters.
const CCR: u64 = 0x304;
/// Sampling time in cycles of the converter's clock, by the value of its three bits.
const SAMPLING: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
const CONVERSION: u64 = 12;

impl Converters {
    /// Core cycles per cycle of the converter's clock. This clock is divided from APB2's clock, which is half the
    /// core's.
    fn divider(&self) -> u64 {
        2 * [2, 4, 6, 8][(self.registers.get(CCR) >> 16 & 3) as usize]
    }

    fn channel(&self, base: u64) -> u32 {
        self.registers.get(base + SQR3) & 31
    }

    /// Sampling time in core cycles.
    fn sampling(&self, base: u64) -> u64 {
        let channel = self.channel(base);
        let (register, place) =
            if channel < 10 { (SMPR2, channel) } else { (SMPR1, (channel - 10).min(8)) };
        let code = self.registers.get(base + register) >> (3 * place) & 7;
        SAMPLING[code as usize] * self.divider()
    }

    /// The present code of an input.
    fn input(&self, channel: u32) -> u32 {
        let error = |code: u32, error: i32| code.saturating_add_signed(error).min(4095);
        match channel {
            4 => {
                let on = self.dac.get(0x00) & 1 != 0;
                let code = if on { self.dac.get(0x08) & 0xFFF } else { 0 };
                let code = error(code, self.bench.dac_error.load(Relaxed)).clamp(248, 3847);
                error(code, self.bench.converter_error.load(Relaxed))
            }
            8 => self.bench.current.load(Relaxed).min(4095),
            _ => 0,
        }
    }

    fn begin(&self, base: u64) {
        let now = self.clock.now();
        self.registers.set(base + THERE, self.input(self.channel(base)));
        for (place, half) in BEGAN.into_iter().zip([now, now >> 32]) {
            #[expect(clippy::cast_possible_truncation, reason = "the lower half")]
            self.registers.set(base + place, half as u32);
        }
        self.registers.set(base + GOES_ON, 1);
    }

    /// Shows the result of a conversion that has ended.
    fn follow(&self, base: u64) {
        let stands = self.bench.converters_stand.load(Relaxed);
        if stands || self.registers.get(base + GOES_ON) == 0 {
            return;
        }
        let [low, high] = BEGAN.map(|place| u64::from(self.registers.get(base + place)));
        let (began, now) = (low | high << 32, self.clock.now());
        let sampled = began + self.sampling(base);
        if now < sampled + CONVERSION * self.divider() {
            return;
        }
        // If the input changed during the sampling time, the result is the new value.
        let changed = (began..=sampled).contains(&self.written_at.load(Relaxed));
        let code = if changed && began > 0 {
            self.input(self.channel(base))
        } else {
            self.registers.get(base + THERE)
        };
        self.registers.set(base + DR, code);
        self.registers.set(base + SR, self.registers.get(base + SR) | DONE);
        self.registers.set(base + GOES_ON, 0);
    }
}

impl Block for Converters {
    fn reset(&self) {
        self.registers.restore(&[0; 256]);
    }
}

impl MemOps for Converters {
    fn read(&self, offset: u64, into: &mut [u8], attributes: MemAttrs) -> MemResult {
        let (base, register) = (offset & SECOND, offset & 0xFC);
        if offset < 2 * SECOND {
            self.follow(base);
        }
        self.registers.read(offset, into, attributes)?;
        if offset < 2 * SECOND && register == DR && !attributes.debug {
            self.registers.set(base + SR, self.registers.get(base + SR) & !DONE);
        }
        Ok(())
    }

    fn write(&self, offset: u64, from: &[u8], attributes: MemAttrs) -> MemResult {
        self.registers.write(offset, from, attributes)?;
        let (base, register) = (offset & SECOND, offset & 0xFC);
        let control = self.registers.get(base + CR2);
        if offset < 2 * SECOND && register == CR2 && control & START != 0 {
            self.registers.set(base + CR2, control & !START);
            if control & ON != 0 {
                self.begin(base);
            }
        }
        Ok(())
    }
}
