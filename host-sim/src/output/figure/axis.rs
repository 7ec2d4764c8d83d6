//! Ticks at round numbers, and their labels.

use std::ops::Range;

use crate::notation::number;
use plotters::coord::{
    ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter},
    types::RangedCoordf64,
};

/// Largest number of ticks. Without this limit, a short axis far from 0 might never end: the next round number may be
/// the same float.
const MOST_VALUES: u16 = 32;
const MOST_DECIMALS: usize = 15;
/// Largest shift of a tick by rounding, as a fraction of a step.
const SLACK: f64 = 1e-6;
/// Powers of ten that are written out in the labels of ticks. Other powers are part of the unit.
const PLAIN_EXPONENTS: std::ops::RangeInclusive<i32> = -2..=3;

/// Ticks and range of a linear axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ticks {
    pub values: Vec<f64>,
    pub decimals: usize,
    pub low: f64,
    pub high: f64,
}

impl Ticks {
    /// Makes ticks at round numbers. The range is extended to the next ticks outside.
    pub(super) fn around(low: f64, high: f64, at_most: usize) -> Self {
        let inside = Self::within(low, high, at_most);
        let (Some(step), Some(first)) = (inside.step(), inside.values.first()) else {
            return inside;
        };
        // Ticks are multiples of the step, except for rounding.
        let first = (first / step).round();
        let first = if low < (first - SLACK) * step { first - 1.0 } else { first };
        let last = (high / step - SLACK).ceil();
        let counts = (0..MOST_VALUES).map(f64::from);
        let values = counts
            .map(|count| (first + count) * step)
            .take_while(|value| *value <= (last + SLACK) * step);
        Self { values: values.collect(), low: first * step, high: last * step, ..inside }
    }

    /// Ticks at round numbers within a fixed range.
    pub(super) fn within(low: f64, high: f64, at_most: usize) -> Self {
        let mut ticks = Self {
            values: RangedCoordf64::from(low..high).key_points(at_most),
            decimals: 0,
            low,
            high,
        };
        let digits = ticks.step().map_or(0.0, |step| -step.log10());
        let smallest_fitting = |decimals: &usize| *decimals as f64 >= digits - SLACK;
        ticks.decimals = (0..MOST_DECIMALS).find(smallest_fitting).unwrap_or(MOST_DECIMALS);
        ticks
    }

    /// The axis for data that is 0 everywhere. It has one tick.
    pub(super) fn nothing() -> Self {
        Self { values: vec![0.0], decimals: 0, low: 0.0, high: 1.0 }
    }

    /// The same range without ticks and labels.
    pub(super) fn bare(self) -> Self {
        Self { values: vec![], ..self }
    }

    fn step(&self) -> Option<f64> {
        match self.values[..] {
            [first, second, ..] if second > first => Some(second - first),
            _ => None,
        }
    }
}

/// The interface that plotters needs for an axis.
impl Ranged for Ticks {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        if self.low < self.high {
            RangedCoordf64::from(self.range()).map(value, (from, to))
        } else {
            i32::midpoint(from, to)
        }
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { vec![] } else { self.values.clone() }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Ticks {
    fn format_ext(&self, value: &f64) -> String {
        number(*value, self.decimals)
    }
}

/// A frequency with about four digits, without trailing zeros: `0.5`, `49.96`, `496`, `1785.7`.
pub(crate) fn hertz(value: f64) -> String {
    let decimals = match value {
        v if v >= 1000.0 => 1,
        v if v >= 10.0 => 2,
        _ => 3,
    };
    let text = number(value, decimals);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Finds a power of ten for values up to `largest`. Returns the divisor, and the unit with the power of ten: `10⁷ N²
/// s/m²`.
pub(crate) fn scaled_unit(largest: f64, unit: &str) -> (f64, String) {
    if largest <= 0.0 || !largest.is_finite() {
        return (1.0, unit.to_owned());
    }
    // The printed form has the exact exponent, also for a number just below a power of ten.
    let exponent: i32 = format!("{largest:e}")
        .split_once('e')
        .and_then(|(_, exponent)| exponent.parse().ok())
        .unwrap_or(0);
    if PLAIN_EXPONENTS.contains(&exponent) {
        return (1.0, unit.to_owned());
    }
    let raised: String = exponent.to_string().chars().map(superscript).collect();
    (10_f64.powi(exponent), format!("10{raised} {unit}"))
}

pub(super) fn superscript(digit: char) -> char {
    match digit {
        '-' => '⁻',
        '0' => '⁰',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '4' => '⁴',
        '5' => '⁵',
        '6' => '⁶',
        '7' => '⁷',
        '8' => '⁸',
        '9' => '⁹',
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &Ticks) -> Vec<String> {
        let values = ticks.values.iter();
        values.map(|value| ticks.format_ext(value)).collect()
    }

    #[test]
    fn ticks_are_round_and_cover_the_range() {
        let ticks = Ticks::around(0.0, 760.0, 9);
        assert_eq!((ticks.low, ticks.high), (0.0, 800.0));
        assert_eq!(labels(&ticks)[1], "100");
        let ticks = Ticks::around(-0.31, 0.25, 7);
        assert!(ticks.low <= -0.31 && ticks.high >= 0.25);
        assert!(labels(&ticks).contains(&"0.0".to_owned()));
        let ticks = Ticks::within(0.03, 0.97, 5);
        assert_eq!(labels(&ticks), ["0.2", "0.4", "0.6", "0.8"]);
    }

    #[test]
    fn ticks_of_short_ranges_end() {
        assert_eq!(Ticks::around(3.0, 3.0, 5).values, [3.0]);
        for (low, high) in [(1e15, 1e15 + 0.125), (0.0, 1e-15), (-1e15, 1e15)] {
            let ticks = Ticks::around(low, high, 6);
            assert!(ticks.values.len() < usize::from(MOST_VALUES));
            assert!(ticks.low <= low && high <= ticks.high);
        }
    }

    #[test]
    fn frequencies_have_as_many_digits_as_they_need() {
        assert_eq!(hertz(1785.66), "1785.7");
        assert_eq!(hertz(1500.0), "1500");
        assert_eq!(hertz(49.96), "49.96");
    }

    #[test]
    fn the_unit_takes_the_power_of_ten() {
        assert_eq!(scaled_unit(4.74e7, "N² s/m²"), (1e7, "10⁷ N² s/m²".to_owned()));
        assert_eq!(scaled_unit(9999.0, "N"), (1.0, "N".to_owned()));
        assert_eq!(scaled_unit(0.0, "N"), (1.0, "N".to_owned()));
        assert_eq!(scaled_unit(5e-4, "m").1, "10⁻⁴ m");
    }
}
