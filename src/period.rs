//! Output periods, and the estimators that leave enough time for them.

use core::fmt;

use crate::velocity::EstimatorName;

/// The longest time from output to output while the force is on, in us. It is longer than two of the longest output
/// periods. It is shorter than 3 ms, because within 3 ms the force must be off.
pub const OUTPUT_WATCHDOG_US: u32 = 2500;

/// Samples per output that a board can be set to.
pub const PERIODS: [u32; 4] = [1, 2, 5, 10];

/// Samples in a millisecond of every board.
pub const SAMPLES_PER_MS: u32 = 10;

/// Number of outputs in a millisecond. It is 1 if the outputs are farther apart.
pub fn outputs_per_ms(period: u32) -> u32 {
    SAMPLES_PER_MS.checked_div(period).unwrap_or_default().max(1)
}

/// Core cycles from one sample to the next on the slowest board, which runs at 168 MHz.
const SAMPLE: u32 = 16_800;
/// Core cycles that the task `sample` takes at period 1, with an output at every sample. They include handler, guard
/// and hand-over, but not the estimator.
pub const GUARD: u32 = 220;
/// Core cycles that the task `render` takes without an order or with a small one. Large orders are not given while the
/// logger writes.
const RENDER: u32 = 3_600;
/// The most core cycles by which the logger delays the task `render`. The cycles that samples take during this delay
/// are not included.
const MASK: u32 = 8_600;

/// Number of core cycles that an estimator's longest update may take. It is `between / period - GUARD`, see [`GUARD`].
/// `between` is the number of cycles between two outputs. A fifth of them is subtracted for wait states. The cycles of
/// a `render` that the logger has delayed are subtracted too.
pub const fn cycles_allowed(period: u32) -> u32 {
    let between = period.saturating_mul(SAMPLE / 5 * 4).saturating_sub(MASK + RENDER);
    match between.checked_div(period) {
        Some(each) => each.saturating_sub(GUARD),
        None => 0,
    }
}

/// Estimators whose longest update takes too long at some of the periods, with the measured cycles of this update
/// (docs/estimators.md). The updates of all other estimators take fewer cycles.
pub const SLOW: [(&str, u32); 6] = [
    ("least-squares-1", 1726),
    ("least-squares-2", 1726),
    ("foaw-end", 2592),
    ("foaw-best", 3311),
    ("time-stamps", 1715),
    ("window-difference", 3025),
];

/// An error: an estimator takes so long that an output period is too short.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooSlow {
    /// Estimator that takes too long.
    pub estimator: EstimatorName,
    /// Cycles of its longest update.
    pub cycles: u32,
    /// Output period that is too short, in samples.
    pub period: u32,
}

/// Checks that this estimator leaves the time for an output each `period` samples.
///
/// # Errors
/// The longest update of the estimator takes too long.
pub fn leaves_time(estimator: EstimatorName, period: u32) -> Result<(), TooSlow> {
    match SLOW.iter().find(|(name, _)| *name == estimator.text()) {
        Some(&(_, cycles)) if cycles > cycles_allowed(period) => {
            Err(TooSlow { estimator, cycles, period })
        }
        _ => Ok(()),
    }
}

impl fmt::Display for TooSlow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { estimator, cycles, period } = *self;
        let (name, most) = (estimator.text(), cycles_allowed(period));
        write!(f, "estimator {name} takes {cycles} cycles, at period {period} allowed {most}")?;
        let longer = PERIODS.into_iter().filter(|&period| leaves_time(estimator, period).is_ok());
        write!(f, ": use another, or period")?;
        longer.into_iter().try_for_each(|period| write!(f, " {period}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn slow_estimators_are_refused_where_there_is_no_time_and_told_where_there_is() {
        assert_eq!(PERIODS.map(cycles_allowed), [1020, 7120, 10_780, 12_000]);
        for &estimator in EstimatorName::ALL {
            let slow = SLOW.iter().any(|(name, _)| *name == estimator.text());
            let refused = PERIODS.map(|period| leaves_time(estimator, period).is_err());
            assert_eq!(refused, [slow, false, false, false], "{estimator:?}");
        }
        let slow = TooSlow { estimator: EstimatorName::Difference, cycles: 3556, period: 1 };
        let text = "estimator difference takes 3556 cycles, at period 1 allowed 1020: \
                    use another, or period 1 2 5 10";
        assert_eq!(slow.to_string(), text);
    }
}
