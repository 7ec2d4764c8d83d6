//! Simulates defects outside the chip. Also notes the motor's force and the motion.

use std::{f64::consts::TAU, sync::atomic::Ordering::Relaxed};

use super::World;

/// Defects of encoder, amplifier and converters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Defects {
    pub count: Option<CountDefect>,
    /// If set, the enabled amplifier gives this fraction of full scale for any command.
    pub stuck: Option<f64>,
    /// Offset of the DAC's output, as a fraction of full scale.
    pub dac: f64,
    /// Whether the converters give no result.
    pub converters_stand: bool,
}

/// A wrong count of the encoder. Each count is replaced by
/// `at + offset + ratio * (count - at) + per_sample * (sample - since)`, rounded down. `sample` is the number of the
/// present sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CountDefect {
    /// The count at which the defect began.
    pub at: i32,
    /// The sample at which the defect began.
    pub since: u64,
    /// Number of counts that are added at the beginning of the defect.
    pub offset: i32,
    /// The fraction of the motion that is counted.
    pub ratio: f64,
    /// Number of counts that are added in each sample.
    pub per_sample: f64,
}

/// A hand that swings the handle about a position. The force has no effect on this motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Swing {
    pub centre_m: f64,
    pub amplitude_m: f64,
    pub rate_hz: f64,
    /// Step of the plant at which the swing begins.
    pub since: u64,
}

/// Observations of one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// End of the sample, in cycles.
    pub at: u64,
    /// Position of the handle at the end of the sample, in m.
    pub position_m: f64,
    /// Whether a hand holds or moves the handle.
    pub held: bool,
    /// Mean force on the handle, as a fraction of full scale.
    pub force: f64,
    /// Whether enable was active at the end of the sample.
    pub enabled: bool,
    /// Cycle of the program's last write of a force.
    pub written_at: u64,
}

impl Defects {
    pub(super) fn given(&self, told: f64, enabled: bool) -> f64 {
        let told = if enabled { told + self.dac } else { told };
        self.stuck.filter(|_| enabled).unwrap_or(told)
    }

    pub(super) fn count(&self, count: i32, sample: u64) -> i32 {
        let Some(CountDefect { at, since, offset, ratio, per_sample }) = self.count else {
            return count;
        };
        #[expect(clippy::cast_precision_loss, reason = "a few seconds")]
        let moved = ratio * f64::from(count.wrapping_sub(at))
            + per_sample * sample.saturating_sub(since) as f64;
        #[expect(clippy::cast_possible_truncation, reason = "counts of a device")]
        let moved = moved.floor() as i32;
        at.wrapping_add(offset).wrapping_add(moved)
    }
}

impl Swing {
    #[expect(clippy::cast_precision_loss, reason = "a few seconds")]
    pub(super) fn place_m(&self, steps: u64, step_s: f64) -> f64 {
        self.centre_m
            + self.amplitude_m
                * (TAU * self.rate_hz * steps.saturating_sub(self.since) as f64 * step_s).sin()
    }
}

/// Time constant of the filter between the amplifier's current signal and the board, in s. Its cutoff is 1.6 kHz.
const SENSE_S: f64 = 1e-4;

impl World<'_> {
    /// Swings the handle about its present position, until a hand holds or moves the handle.
    pub fn swing(&mut self, amplitude_m: f64, rate_hz: f64) {
        let (centre_m, since) = (self.position_m(), self.steps * self.samples + self.stepped);
        self.swing = Some(Swing { centre_m, amplitude_m, rate_hz, since });
    }

    pub fn count_wrongly(&mut self, offset: i32, ratio: f64, per_sample: f64) {
        let at = self.encoder.count(self.shown_m());
        let defect = CountDefect { at, since: self.samples, offset, ratio, per_sample };
        self.defects.count = Some(defect);
    }

    /// Gives the converters the present force. A filter removes the ripple of the PWM from the amplifier's signal.
    pub(super) fn show(&mut self, given: f64) {
        self.filtered += (given - self.filtered) * (1.0 - (-self.step_s / SENSE_S).exp());
        let bench = self.powered.mcu.bench();
        #[expect(clippy::cast_possible_truncation, reason = "at most 4096")]
        let codes = |part: f64, range: f64| (part * range).round() as i32;
        bench.dac_error.store(codes(self.defects.dac, 2047.0), Relaxed);
        bench.converters_stand.store(self.defects.converters_stand, Relaxed);
        let current = self.current.rest + self.filtered * (self.current.full - self.current.rest);
        bench.current.store(codes(current, 4096.0).max(0).unsigned_abs(), Relaxed);
    }

    /// Notes the step that ends at cycle `at`.
    pub(super) fn note(&mut self, given: f64, at: u64) {
        #[expect(clippy::cast_precision_loss, reason = "10 or 50")]
        let part = given / self.steps as f64;
        let enabled = self.powered.amplifier.is_enabled();
        let written_at = self.powered.mcu.written_at();
        let (position_m, held) = (self.position_m(), self.held.is_some());
        let Some(seen) = &mut self.seen else { return };
        if self.stepped == 0 || seen.is_empty() {
            seen.push(Seen::default());
        }
        if let Some(last) = seen.last_mut() {
            *last = Seen { at, position_m, held, force: last.force + part, enabled, written_at };
        }
    }
}
