//! The rate of the samples, against a second clock.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use super::HaltWatch;

/// Compares samples with a clock of [`HaltWatch::TICKS_PER_SAMPLE`] ticks each, over [`RateWatch::OUTPUTS`] outputs.
#[derive(Clone, Copy, Debug, Default)]
pub struct RateWatch {
    /// Clock and sample at the beginning.
    ticks: u16,
    sample: u32,
    /// Outputs since; 0: there is no beginning yet.
    outputs: u8,
    wrong: bool,
}

impl RateWatch {
    /// Outputs from one comparison to the next.
    pub const OUTPUTS: u8 = 64;
    /// Of so many ticks one may be too many or too few: 2 %.
    const PART: u32 = 50;

    /// Takes clock and sample at an output. `halted`: time has passed without samples since the last one, which has a
    /// fault of its own; it begins anew then. Whether the last comparison was off by more than 2 %.
    #[inline]
    pub fn follow(&mut self, ticks: u16, sample: u64, halted: bool) -> bool {
        #[expect(clippy::cast_possible_truncation, reason = "they differ by less than 2^16")]
        let sample = sample as u32;
        if self.outputs > 0 && self.outputs < Self::OUTPUTS && !halted {
            self.outputs += 1;
            return self.wrong;
        }
        cold_path();
        if !halted && self.outputs > 0 {
            let passed = u32::from(ticks.wrapping_sub(self.ticks));
            let due = sample.wrapping_sub(self.sample).wrapping_mul(HaltWatch::TICKS_PER_SAMPLE);
            self.wrong = passed.abs_diff(due) > due / Self::PART;
        }
        (self.ticks, self.sample, self.outputs) = (ticks, sample, 1);
        self.wrong
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Outputs each `period` samples, the clock at `rate` times what it should be: the first output at which it is wrong.
    fn found(period: u32, rate: f64, late: f64) -> Option<u32> {
        let mut watch = RateWatch::default();
        (0..3 * u32::from(RateWatch::OUTPUTS)).find(|output| {
            // every other output is late
            let samples = f64::from(output * period) + late * f64::from(output % 2);
            let ticks = samples * f64::from(HaltWatch::TICKS_PER_SAMPLE) * rate;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it wraps")]
            watch.follow(ticks as u64 as u16, u64::from(output * period), false)
        })
    }

    #[test]
    fn two_percent_are_found_from_both_sides_within_64_outputs() {
        for period in [1, 2, 5, 10] {
            for rate in [0.0, 0.5, 0.97, 1.03, 1.45, 2.0] {
                assert_eq!(found(period, rate, 0.0), Some(64), "{period} {rate}");
            }
            for rate in [0.985, 1.0, 1.015] {
                assert_eq!(found(period, rate, 0.0), None, "{period} {rate}");
            }
            // An output that is late by a period is none, nor are latencies that differ.
            let latest = f64::from(period).min(1.0);
            assert_eq!(found(period, 1.0, latest), None, "{period}");
        }
    }

    #[test]
    fn a_halt_begins_anew_and_a_right_rate_is_right_again() {
        let mut watch = RateWatch::default();
        let mut ticks = 0u16;
        let mut run = |outputs: std::ops::Range<u64>, step: u16, halted: Option<u64>| {
            let mut wrong = false;
            for output in outputs {
                let halt = halted == Some(output);
                ticks = ticks.wrapping_add(if halt { 5000 } else { step });
                wrong = watch.follow(ticks, 10 * output, halt);
            }
            wrong
        };
        assert!(!run(0..100, 40, Some(60)));
        assert!(run(100..300, 39, None));
        assert!(!run(300..500, 40, None));
    }
}
