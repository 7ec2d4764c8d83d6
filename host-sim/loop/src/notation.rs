//! Numbers as text for people.

/// Thin space between groups of three digits. No language uses this space as a decimal sign.
const GROUP_SEPARATOR: char = '\u{2009}';
/// Smallest number of digits of a whole part that is grouped. Shorter numbers are easier to read in one piece.
const GROUPED_FROM_DIGITS: usize = 5;

/// A number with a true minus sign and grouped thousands, such as `−12 345.6`.
pub fn number(value: f64, decimals: usize) -> String {
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

/// The nearest number with this many digits.
pub fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// The number as text with three digits, but with at most two decimals.
pub fn three_digits(value: f64) -> String {
    let decimals = match value {
        v if v >= 99.95 => 0,
        v if v >= 9.995 => 1,
        _ => 2,
    };
    number(value, decimals)
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_are_grouped_from_five_digits() {
        assert_eq!(number(4000.0, 0), "4000");
        assert_eq!(number(-1_234_567.25, 1), "−1\u{2009}234\u{2009}567.2");
        assert_eq!(number(-0.001, 1), "0.0");
    }
}
