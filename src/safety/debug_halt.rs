//! Finds out whether the core stood still. If it did, time has passed without samples.

/// Compares, from output to output, the number of samples with a clock that runs on while the core is halted.
#[derive(Clone, Copy, Debug, Default)]
pub struct HaltWatch {
    ticks: u16,
    sample: u64,
}

impl HaltWatch {
    /// Ticks of the clock per sample. The clock wraps after 2^16 ticks, 1.6 s at 10 kHz. A halt that lasts a multiple
    /// of this time, give or take an output period, is not found here. But during such a halt the output watchdog has
    /// switched enable off, and the next output finds that.
    pub const TICKS_PER_SAMPLE: u32 = 4;
    /// Ticks beyond an output period that do not count as a halt yet. They are two samples.
    const SLACK: u32 = 2 * Self::TICKS_PER_SAMPLE;

    /// The clock and the number of the sample at the last output.
    #[inline(always)]
    pub fn last(&self) -> (u16, u64) {
        (self.ticks, self.sample)
    }

    /// Whether the core stood still for longer than an output period and two samples since the last call.
    ///
    /// `ticks` is the clock now, `sample` the number of the output's sample, and `period` the number of samples from
    /// output to output. An output that is late by less than a period is no halt. An output that is even later belongs
    /// to a later sample.
    #[inline]
    pub fn found(&mut self, ticks: u16, sample: u64, period: u32) -> bool {
        let passed = ticks.wrapping_sub(self.ticks);
        #[expect(clippy::cast_possible_truncation, reason = "modulo the clock's range")]
        let sampled =
            (sample.wrapping_sub(self.sample) as u32).wrapping_mul(Self::TICKS_PER_SAMPLE) as u16;
        (self.ticks, self.sample) = (ticks, sample);
        // If the previous output was late, the difference is negative. A negative difference is at the upper end of the
        // range, as the type is unsigned.
        let still = u32::from(passed.wrapping_sub(sampled));
        let slack = period * Self::TICKS_PER_SAMPLE + Self::SLACK;
        (slack + 1..u32::from(u16::MAX) - slack).contains(&still)
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// Runs outputs. For each one, `each` has its delay, and the time for which the core stood still before it. Both
    /// are in samples. Returns for each output after the first whether a halt was found.
    fn outputs(period: u32, each: &[(f64, f64)]) -> Vec<bool> {
        let mut watch = HaltWatch::default();
        let mut still = 0.0;
        let found = each.iter().zip(100_000u64..).map(|(&(late, halted), number)| {
            still += halted;
            let sample = number * u64::from(period);
            #[expect(clippy::cast_precision_loss, reason = "small")]
            let time = (sample as f64 + still + late) * f64::from(HaltWatch::TICKS_PER_SAMPLE);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it wraps")]
            watch.found(time as u64 as u16, sample, period)
        });
        found.skip(1).collect()
    }

    #[test]
    fn late_outputs_are_no_halt() {
        for period in [1, 10, 100] {
            let latest = f64::from(period) - 0.01;
            for pair in [[0.0, latest], [latest, 0.0], [0.3, latest], [latest, latest]] {
                let each = [(0.0, 0.0), (pair[0], 0.0), (pair[1], 0.0), (0.0, 0.0)];
                assert_eq!(outputs(period, &each), [false; 3], "{period} {pair:?}");
            }
        }
    }

    #[test]
    fn a_halt_is_found_once_wherever_it_falls() {
        for period in [1, 10] {
            let shortest = f64::from(2 * period) + 2.3;
            for halted in [shortest, 40.7, 300.0, 2_000.5, 9_000.0, 16_000.0] {
                for late in [0.0, 0.4, f64::from(period) - 0.01] {
                    let each = [(late, 0.0), (0.0, halted), (late, 0.0), (0.0, 0.0)];
                    let found = outputs(period, &each);
                    assert_eq!(found, [true, false, false], "{period} {halted} {late}");
                }
            }
            let each = [(0.0, 0.0), (0.0, f64::from(period) + 2.3), (0.0, 0.0)];
            assert_eq!(outputs(period, &each), [true, false]);
            let each = [(0.0, 0.0), (0.0, f64::from(period) + 1.9), (0.0, 0.0)];
            assert_eq!(outputs(period, &each), [false, false], "two samples are none");
            let each = [(0.0, 0.0), (0.0, 1.9), (0.0, 0.0)];
            assert_eq!(outputs(period, &each), [false, false]);
        }
    }

    /// Tests to the tick how much time beyond the samples is no halt yet, at both ends of the clock's range.
    #[test]
    fn an_output_period_and_two_samples_are_no_halt_to_the_tick() {
        let still = |ticks: u16| {
            let mut watch = HaltWatch::default();
            watch.found(0, 0, 10);
            watch.found(40u16.wrapping_add(ticks), 10, 10)
        };
        assert!(!still(48) && still(49));
        assert!(!still(49u16.wrapping_neg()) && still(50u16.wrapping_neg()));
    }

    #[test]
    fn it_keeps_clock_and_sample_of_the_last_output() {
        let mut watch = HaltWatch::default();
        watch.found(7, 1234, 10);
        assert_eq!(watch.last(), (7, 1234));
        watch.found(47, 1244, 10);
        assert_eq!(watch.last(), (47, 1244));
    }
}
