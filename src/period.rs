//! Output periods, and the estimators that leave enough time for them.

use core::fmt;

use crate::velocity::EstimatorName;

/// Longest time from output to output with force on, us. It is longer than two of the longest output periods. It is
/// shorter than 3 ms, within which the force must be off.
pub const OUTPUT_WATCHDOG_US: u32 = 2500;

/// Samples per output that a board can be set to.
pub const PERIODS: [u32; 4] = [1, 2, 5, 10];

/// Samples in a millisecond of every board.
pub const SAMPLES_PER_MS: u32 = 10;

/// Outputs in a millisecond; 1 if the outputs are farther apart.
pub fn outputs_per_ms(period: u32) -> u32 {
    SAMPLES_PER_MS.checked_div(period).unwrap_or_default().max(1)
}

/// Core cycles of a sample on the slowest board, 168 MHz.
const SAMPLE: u32 = 16_800;
/// Core cycles of a sample at period 1 (an output each sample): handler, guard and hand-over, but not the estimator.
pub const GUARD: u32 = 220;
/// Core cycles of a `render` with no order or a small one. Large orders are not given while the logger writes.
const RENDER: u32 = 3_600;
/// Most core cycles by which the logger delays `render`. The cycles of a sample during the delay are not included.
const MASK: u32 = 8_600;

/// Cycles per sample that the longest update of an estimator may take. The time between two outputs is reduced by a
/// fifth for wait states, and by a `render` that the logger has delayed. The rest is divided by the number of samples.
/// Then [`GUARD`] is subtracted.
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

/// An estimator that leaves no time for an output period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooSlow {
    /// Estimator that takes too long.
    pub estimator: EstimatorName,
    /// Cycles of its longest update.
    pub cycles: u32,
    /// Output period that is too short, samples.
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
