//! Compares the rate of the samples with a second clock.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

/// A block has `BLOCK` outputs, and a comparison has `BLOCKS` blocks.
const BLOCK: u32 = 8;
const BLOCKS: u32 = 8;

#[derive(Clone, Copy, Debug, Default)]
struct Ticks {
    passed: u32,
    due: u32,
}

impl Ticks {
    const fn and(self, other: Self) -> Self {
        Self {
            passed: self.passed.wrapping_add(other.passed),
            due: self.due.wrapping_add(other.due),
        }
    }

    const fn less(self, other: Self) -> Self {
        Self {
            passed: self.passed.wrapping_sub(other.passed),
            due: self.due.wrapping_sub(other.due),
        }
    }
}

/// Compares the samples with a clock that has `TICKS` ticks per sample. There is a comparison every 8 outputs. It
/// covers the last [`RateWatch::OUTPUTS`] outputs.
#[derive(Clone, Copy, Debug, Default)]
pub struct RateWatch<const TICKS: u32> {
    /// Ring buffer of the last blocks. `last` is their sum.
    blocks: [Ticks; BLOCKS as usize],
    last: Ticks,
    /// Number of full blocks since the comparison began anew.
    full: u32,
    /// The block that is being filled. `outputs` is the number of outputs in it.
    present: Ticks,
    outputs: u32,
    wrong: bool,
}

impl<const TICKS: u32> RateWatch<TICKS> {
    /// Outputs in a comparison. A wrong rate is found within this number of outputs and one more block.
    pub const OUTPUTS: u32 = BLOCKS * BLOCK;
    /// Number of ticks in which an error of one tick is allowed. This is 2 %.
    const PART: u32 = 50;

    /// Takes the ticks and the samples since the last output. `anew` says that time has passed without samples or
    /// without the clock. Such a gap is a fault of its own, so the comparison begins again.
    #[inline(always)]
    pub fn follow(&mut self, ticks: u32, samples: u32, anew: bool) {
        if anew {
            cold_path();
            *self = Self { wrong: self.wrong, ..Self::default() };
            return;
        }
        self.present = self.present.and(Ticks { passed: ticks, due: samples.wrapping_mul(TICKS) });
        self.outputs = self.outputs.wrapping_add(1);
        if self.outputs >= BLOCK {
            cold_path();
            self.close();
        }
    }

    /// Ends the present block, which is full.
    #[inline(never)] // so that the other outputs do not wait
    fn close(&mut self) {
        let block = &mut self.blocks[(self.full % BLOCKS) as usize];
        self.last = self.last.and(self.present).less(*block);
        *block = self.present;
        (self.full, self.outputs, self.present) = (self.full.wrapping_add(1), 0, Ticks::default());
        if self.full >= BLOCKS {
            let Ticks { passed, due } = self.last;
            self.wrong = passed.abs_diff(due) > due / Self::PART;
        }
    }

    /// Whether the last comparison found an error of more than 2 %.
    #[inline(always)]
    pub const fn is_wrong(&self) -> bool {
        self.wrong
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs outputs every `period` samples. The clock runs at `rate` times its right rate, and every other output is
    /// late by `late` samples. Returns the first output at which the rate is found wrong.
    fn found(period: u32, rate: f64, late: f64) -> Option<u32> {
        let mut watch = RateWatch::<4>::default();
        let mut before = 0u64;
        (0..3 * RateWatch::<4>::OUTPUTS).find(|output| {
            // every other output is late
            let samples = f64::from(output * period) + late * f64::from(output % 2);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small")]
            let ticks = (samples * 4.0 * rate) as u64;
            watch.follow(u32::try_from(ticks - before).unwrap(), period, *output == 0);
            before = ticks;
            watch.is_wrong()
        })
    }

    #[test]
    fn two_percent_are_found_from_both_sides_within_64_outputs() {
        for period in [1, 2, 5, 10] {
            for rate in [0.0, 0.5, 0.97, 1.03, 1.45, 2.0, 2.048] {
                assert_eq!(found(period, rate, 0.0), Some(64), "{period} {rate}");
            }
            for rate in [0.985, 1.0, 1.015] {
                assert_eq!(found(period, rate, 0.0), None, "{period} {rate}");
            }
            // The rate is not found wrong if an output is late by a period, or if outputs have different latencies.
            let latest = f64::from(period).min(1.0);
            assert_eq!(found(period, 1.0, latest), None, "{period}");
        }
    }

    /// The first output with a wrong clock may be any output.
    #[test]
    fn a_rate_that_becomes_wrong_is_found_within_a_block_more_than_64_outputs() {
        for (period, ticks) in [(10, 41), (10, 39), (10, 0), (10, 80), (1, 5), (1, 3)] {
            for onset in 64..200 {
                let mut watch = RateWatch::<4>::default();
                let found = (0..400).find(|&output| {
                    watch.follow(if output < onset { 4 * period } else { ticks }, period, false);
                    watch.is_wrong()
                });
                let after = found.unwrap() - onset + 1;
                assert!(after <= 64 + 8, "{period} {ticks} {onset}: {after}");
            }
        }
    }

    #[test]
    fn two_percent_themselves_are_right_and_a_tick_more_is_wrong() {
        let due = 64 * 10 * 4;
        for (extra, wrong) in [(due / 50, false), (due / 50 + 1, true)] {
            let mut watch = RateWatch::<4>::default();
            (0..64).for_each(|n| watch.follow(40 + if n == 0 { extra } else { 0 }, 10, false));
            assert_eq!(watch.is_wrong(), wrong, "{extra}");
            // A halt says nothing about the rate. So the last result stays until the next comparison.
            watch.follow(5000, 10, true);
            assert_eq!(watch.is_wrong(), wrong, "{extra}");
        }
    }

    #[test]
    fn a_halt_begins_anew_and_a_right_rate_is_right_again() {
        let mut watch = RateWatch::<4>::default();
        let mut run = |outputs: u32, step: u32, halted: Option<u32>| {
            for output in 0..outputs {
                let halt = halted == Some(output);
                watch.follow(if halt { 5000 } else { step }, 10, halt);
            }
            watch.is_wrong()
        };
        assert!(!run(100, 40, Some(60)));
        assert!(run(200, 39, None));
        assert!(!run(200, 40, None));
    }
}
