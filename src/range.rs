//! The allowed ranges of the settings. A check of a value against its range gives an error with the parameter's name
//! and the range.

use core::{fmt, ops::RangeInclusive};

/// Accepted ranges, in SI units. The simulator checks its scenes with the same ranges.
pub mod limits {
    use core::ops::RangeInclusive;

    /// Rate of the samples, in Hz.
    pub const RATE_HZ: RangeInclusive<f64> = 1e3..=5e4;
    /// Encoder resolution, in m per count.
    pub const RESOLUTION_M: RangeInclusive<f64> = 1e-8..=1e-3;
    /// Force at full command, in N.
    pub const FULL_SCALE_N: RangeInclusive<f64> = 1e-3..=1e5;
    /// Samples from output to output.
    pub const PERIOD: RangeInclusive<u32> = 1..=1000;
    /// Wall stiffness K, in N/m.
    pub const STIFFNESS_N_PER_M: RangeInclusive<f64> = 0.0..=1e7;
    /// Wall damping B, in N s/m.
    pub const DAMPING_N_S_PER_M: RangeInclusive<f64> = 0.0..=1e4;
    /// Samples before the window of a hit, and samples in the window.
    pub const PHASE_SAMPLES: RangeInclusive<u32> = 1..=1 << 24;
    /// RMS limit of a hit, in counts.
    pub const RMS_COUNTS: RangeInclusive<f64> = 1e-3..=65_535.0;
}

/// A parameter that is out of range.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingsError {
    /// Name of the parameter. It is the name of a field, for example of [`Settings`](crate::Settings),
    /// [`Design`](crate::Design) or [`HitSettings`](crate::HitSettings).
    pub parameter: &'static str,
    /// The refused value.
    pub value: f64,
    /// Allowed range, with both ends.
    pub range: RangeInclusive<f64>,
}

impl fmt::Display for SettingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = ends(&self.range);
        write!(f, "{} is {}, allowed {low} to {high}", self.parameter, self.value)
    }
}

/// The ends of a range, as they are shown to people. They are rounded to few digits, but never to the outside of the
/// range. So the board accepts both ends when a person types them.
pub fn ends(range: &RangeInclusive<f64>) -> [f64; 2] {
    [(*range.start(), 1.0), (*range.end(), -1.0)].map(|(end, inwards)| {
        let short = [0.0, inwards].map(|digits| shortened(end, digits));
        short.into_iter().find(|short| range.contains(short)).unwrap_or(end)
    })
}

/// Rounds `value` to nine digits, so that a product like 3.5e-5 * 1000 is printed as 0.035.
pub fn shorten(value: f64) -> f64 {
    shortened(value, 0.0)
}

/// Rounds `value` to nine digits, and adds `moved` to the last digit.
fn shortened(value: f64, moved: f64) -> f64 {
    const DIGITS: f64 = 9.0;
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let exponent = DIGITS - 1.0 - libm::floor(libm::log10(libm::fabs(value)));
    if exponent >= 0.0 {
        let scale = libm::exp10(exponent);
        (libm::round(value * scale) + moved) / scale
    } else {
        let scale = libm::exp10(-exponent);
        (libm::round(value / scale) + moved) * scale
    }
}

impl core::error::Error for SettingsError {}

/// Returns `value` if it lies in `range`. NaN lies in no range.
///
/// # Errors
/// Names the parameter and the range.
pub fn within(
    parameter: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
) -> Result<f64, SettingsError> {
    if range.contains(&value) { Ok(value) } else { Err(SettingsError { parameter, value, range }) }
}

pub(crate) fn widen(range: &RangeInclusive<u32>) -> RangeInclusive<f64> {
    f64::from(*range.start())..=f64::from(*range.end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_printed_limit_is_accepted_when_it_is_typed() {
        assert_eq!(ends(&(3.5e-5 * 1000.0..=1e-1_f64.next_down())), [0.035, 0.099_999_999]);
        assert_eq!(ends(&(1.0 / 3.0..=2.0 / 3.0)), [0.333_333_334, 0.666_666_666]);
        assert_eq!(ends(&(-2e9 / 3.0..=-1e9 / 3.0)), [-666_666_666.0, -333_333_334.0]);
        assert_eq!(ends(&(1e300 / 3.0..=1e300 / 3.0)), [1e300 / 3.0; 2]);
        assert_eq!(ends(&(0.25..=0.125 * 3.0)), [0.25, 0.375]);
    }

    #[test]
    fn limits_print_without_the_digits_of_their_arithmetic() {
        assert_eq!(shorten(3.5e-5 * 1000.0), 0.035);
        assert_eq!(shorten(-1_234.567_891_234), -1_234.567_89);
        assert_eq!(shorten(0.0), 0.0);
        assert_eq!(shorten(1e300 * 1.000_000_000_01), 1e300);
        assert!(shorten(f64::NAN).is_nan());
    }
}
