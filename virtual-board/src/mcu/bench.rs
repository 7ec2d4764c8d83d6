//! Values that only a self-test measures. They are option bytes, the watchdog's oscillator, errors of DAC and
//! converter, and the amplifier's current signal. Two wires may also connect output pins to the encoder's inputs.
//! Neither a reset nor a loss of supply changes these values.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicI32, AtomicU32, AtomicU64, Ordering::Relaxed},
};

use rsemu::core::wire::{Level, WireId, WireSink};

use super::{
    bus::{Clock, Lazy, Port},
    encoder::EncoderInput,
};

#[derive(Debug)]
pub struct Bench {
    /// Whether wires connect PC6 to A and PC8 to B. The encoder is then not connected.
    pub wires: AtomicBool,
    /// Level of the brown-out reset (`BOR_LEV`). It is 3 in a new chip.
    pub brown_out_reset: AtomicU32,
    /// Frequency of the watchdog's oscillator, in Hz. It is 0 if the oscillator is stopped.
    pub oscillator_hz: AtomicU64,
    /// Error of the converter in codes. It is the reading minus the true value.
    pub converter_error: AtomicI32,
    /// Error of the DAC in codes. It is the output minus the command.
    pub dac_error: AtomicI32,
    /// Whether the converters give no result.
    pub converters_stand: AtomicBool,
    /// The amplifier's current signal, in codes of the converter.
    pub current: AtomicU32,
}

impl Default for Bench {
    fn default() -> Self {
        Self {
            wires: AtomicBool::new(false),
            brown_out_reset: AtomicU32::new(3),
            oscillator_hz: AtomicU64::new(32_000),
            converter_error: AtomicI32::new(0),
            dac_error: AtomicI32::new(0),
            converters_stand: AtomicBool::new(false),
            current: AtomicU32::new(0),
        }
    }
}

/// Port index and number of the pins at which the wires begin. The first wire goes to A, the second to B.
pub(super) const WIRES: [(usize, u32); 2] = [(2, 6), (2, 8)];

pub(super) struct Wire {
    pub(super) encoder: Arc<EncoderInput>,
    pub(super) channel: usize,
    pub(super) clock: Arc<Clock>,
    pub(super) bench: Arc<Bench>,
}

impl std::fmt::Debug for Wire {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wire").finish_non_exhaustive()
    }
}

impl WireSink for Wire {
    fn set_level(&self, _: WireId, _: u32, level: Level) {
        if self.bench.wires.load(Relaxed) {
            self.encoder.set_level(self.channel, level.is_high(), self.clock.now());
        }
    }
}

/// The flash controller's port. The port counts the accesses. The register OPTCR shows `BOR_LEV`.
#[derive(Debug)]
pub(super) struct FlashPort {
    pub(super) lazy: Lazy,
    pub(super) clock: Arc<Clock>,
    pub(super) touched: Arc<AtomicU64>,
    pub(super) bench: Arc<Bench>,
}

impl Port for FlashPort {
    fn before(&self) {
        self.touched.fetch_add(1, Relaxed);
        self.lazy.advance_to(self.clock.now());
    }

    fn read(&self, offset: u64, value: u32) -> u32 {
        let level = self.bench.brown_out_reset.load(Relaxed) & 3;
        if offset == 0x14 { value & !(3 << 2) | level << 2 } else { value }
    }
}

/// TIM5's port. Channel 4 captures the rising edges of the oscillator LSI (`TI4_RMP` = 01).
#[derive(Debug)]
pub(super) struct PacePort {
    pub(super) lazy: Lazy,
    pub(super) clock: Arc<Clock>,
    pub(super) bench: Arc<Bench>,
    pub(super) core_hz: u64,
    /// The option register OR. `read` is the number of the edge that was read last.
    pub(super) option: AtomicU32,
    pub(super) read: AtomicU64,
}

const SR: u64 = 0x10;
const CCER: u64 = 0x20;
const CNT: u64 = 0x24;
const ARR: u64 = 0x2C;
const CCR4: u64 = 0x40;
const OR: u64 = 0x50;
const CAPTURED: u32 = 1 << 4;
const CAPTURE_ON: u32 = 1 << 12;

impl PacePort {
    /// Number of the oscillator's last edge, and the number of cycles since that edge.
    #[expect(clippy::cast_possible_truncation, reason = "edges and cycles of one run")]
    fn edge(&self) -> Option<(u64, u64)> {
        let hz = self.bench.oscillator_hz.load(Relaxed);
        let on = self.option.load(Relaxed) >> 6 & 3 == 1 && self.lazy.peek(CCER) & CAPTURE_ON != 0;
        let now = u128::from(self.clock.now());
        let number = (now * u128::from(hz) / u128::from(self.core_hz)) as u64;
        let at = (u128::from(number) * u128::from(self.core_hz)).div_ceil(u128::from(hz.max(1)));
        (on && hz > 0).then(|| (number, now.saturating_sub(at) as u64))
    }
}

impl Port for PacePort {
    fn before(&self) {
        self.lazy.advance_to(self.clock.now());
    }

    fn write(&self, offset: u64, value: u32) -> u32 {
        if offset == OR {
            self.option.store(value, Relaxed);
        }
        value
    }

    fn read(&self, offset: u64, value: u32) -> u32 {
        if let (CCR4, Some((number, _))) = (offset, self.edge()) {
            self.read.store(number, Relaxed);
        }
        self.look(offset, value)
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "a count is less than the period, 2^32 at most"
    )]
    fn look(&self, offset: u64, value: u32) -> u32 {
        match (offset, self.edge()) {
            (OR, _) => self.option.load(Relaxed),
            (SR, Some((number, _))) if number > self.read.load(Relaxed) => value | CAPTURED,
            (CCR4, Some((_, since))) => {
                let period = u64::from(self.lazy.peek(ARR)) + 1;
                let count = u64::from(self.lazy.peek(CNT)) + period;
                // The timer has half the core's clock, and the last edge is at most a few timer periods old.
                ((count - since / 2 % period) % period) as u32
            }
            _ => value,
        }
    }
}
