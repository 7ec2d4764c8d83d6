//! Scales, ticks and the numbers beside them.

/// Thin space: groups thousands without looking like a decimal sign in any language.
const GROUP_SEPARATOR: char = '\u{2009}';
/// Numbers of fewer digits are easier to read in one piece.
const GROUPED_FROM_DIGITS: usize = 5;
/// Steps that read well, as parts of a power of ten.
const STEPS: [f64; 4] = [1.0, 2.0, 5.0, 10.0];
/// An axis far from 0 may be so short that the next round number is the same number.
const MOST_VALUES: u16 = 32;
/// Powers of ten that stay in the ticks; others go to the unit.
const PLAIN_EXPONENTS: std::ops::RangeInclusive<i32> = -2..=3;

/// Maps `low..high` to positions `from..to`, linearly or by the logarithm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    logarithmic: bool,
}

impl Scale {
    pub(super) fn linear(low: f64, high: f64) -> Self {
        Self { low, high, from: 0.0, to: 1.0, logarithmic: false }
    }

    pub(super) fn logarithmic(low: f64, high: f64) -> Self {
        Self { low: low.ln(), high: high.ln(), logarithmic: true, ..Self::linear(low, high) }
    }

    /// The same scale over other positions.
    pub(super) fn across(self, from: f64, to: f64) -> Self {
        Self { from, to, ..self }
    }

    pub(super) fn at(&self, value: f64) -> f64 {
        let value = if self.logarithmic { value.ln() } else { value };
        let span = self.high - self.low;
        // Too short to be told from a point: everything is in its middle.
        let share = if span > 0.0 { (value - self.low) / span } else { 0.5 };
        self.from + share * (self.to - self.from)
    }
}

/// Where an axis has its ticks, and over what range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ticks {
    pub values: Vec<f64>,
    pub decimals: usize,
    pub low: f64,
    pub high: f64,
}

impl Ticks {
    /// At most about `at_most` ticks at round numbers; the range grows to the next ticks outside.
    pub(super) fn around(low: f64, high: f64, at_most: usize) -> Self {
        let step = step(high - low, at_most);
        Self::of((low / step).floor(), (high / step).ceil(), step)
    }

    /// Ticks at round numbers inside a range that stays as it is.
    pub(super) fn within(low: f64, high: f64, at_most: usize) -> Self {
        let step = step(high - low, at_most);
        let inside = Self::of((low / step).ceil(), (high / step).floor(), step);
        Self { low, high, ..inside }
    }

    /// The axis of data that is all 0: one tick.
    pub(super) fn nothing() -> Self {
        Self { values: vec![0.0], decimals: 0, low: 0.0, high: 1.0 }
    }

    fn of(first: f64, last: f64, step: f64) -> Self {
        let values = (0..MOST_VALUES)
            .map(|count| first + f64::from(count))
            .take_while(|index| *index <= last)
            .map(|index| index * step);
        Self {
            values: values.collect(),
            decimals: decimals(step),
            low: first * step,
            high: last * step,
        }
    }

    pub(super) fn labels(&self) -> Vec<String> {
        self.values.iter().map(|value| number(*value, self.decimals)).collect()
    }
}

/// The smallest round step with at most `at_most` intervals in `span`.
fn step(span: f64, at_most: usize) -> f64 {
    let wanted = span / at_most.max(1) as f64;
    if !(wanted > 0.0 && wanted.is_finite()) {
        return 1.0;
    }
    let decade = 10_f64.powf(wanted.log10().floor());
    let factor = STEPS.into_iter().find(|factor| factor * decade >= wanted * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * decade
}

fn decimals(step: f64) -> usize {
    let mut scaled = step;
    let mut count = 0;
    while scaled < 1.0 - 1e-9 && count < 15 {
        scaled *= 10.0;
        count += 1;
    }
    count
}

/// A number with a true minus sign and grouped thousands, such as `−12 345.6`.
pub(crate) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let (whole, fraction) = text.split_once('.').unwrap_or((&text, ""));
    let mut out = String::new();
    if value < 0.0 && text.bytes().any(|b| (b'1'..=b'9').contains(&b)) {
        out.push('−');
    }
    for (index, digit) in whole.chars().enumerate() {
        let left = whole.len() - index;
        if whole.len() >= GROUPED_FROM_DIGITS && index > 0 && left.is_multiple_of(3) {
            out.push(GROUP_SEPARATOR);
        }
        out.push(digit);
    }
    if !fraction.is_empty() {
        out.push('.');
        out.push_str(fraction);
    }
    out
}

/// A frequency to about four digits, without idle zeros: `0.5`, `49.96`, `496`, `1785.7`.
pub(crate) fn hertz(value: f64) -> String {
    let decimals = match value {
        v if v >= 1000.0 => 1,
        v if v >= 10.0 => 2,
        _ => 3,
    };
    let text = number(value, decimals);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The factor by which values up to `largest` are divided, and the unit with it: `10⁷ N² s/m²`.
pub(crate) fn scaled_unit(largest: f64, unit: &str) -> (f64, String) {
    if largest <= 0.0 || !largest.is_finite() {
        return (1.0, unit.to_owned());
    }
    // The printed form gives the exponent exactly, also just below a power of ten.
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

fn superscript(digit: char) -> char {
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

    #[test]
    fn ticks_are_round_and_cover_the_range() {
        let ticks = Ticks::around(0.0, 760.0, 8);
        assert_eq!(ticks.high, 800.0);
        assert_eq!(ticks.labels()[1], "100");
        let ticks = Ticks::around(-0.3, 0.25, 6);
        assert_eq!(ticks.labels().first().unwrap(), "−0.3");
        assert_eq!(ticks.labels()[3], "0.0");
        let ticks = Ticks::within(0.03, 0.97, 5);
        assert_eq!(ticks.labels(), ["0.2", "0.4", "0.6", "0.8"]);
    }

    #[test]
    fn ticks_of_an_empty_range_exist() {
        assert_eq!(Ticks::around(3.0, 3.0, 5).values, [3.0]);
    }

    #[test]
    fn numbers_are_grouped_from_five_digits() {
        assert_eq!(number(4000.0, 0), "4000");
        assert_eq!(number(-1_234_567.25, 1), "−1\u{2009}234\u{2009}567.2");
        assert_eq!(number(-0.001, 1), "0.0");
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

    #[test]
    fn a_scale_maps_its_ends() {
        let scale = Scale::logarithmic(10.0, 1000.0).across(0.0, 100.0);
        assert!((scale.at(100.0) - 50.0).abs() < 1e-9);
        let scale = Scale::linear(0.0, 4.0).across(200.0, 100.0);
        assert_eq!(scale.at(1.0), 175.0);
    }
}
