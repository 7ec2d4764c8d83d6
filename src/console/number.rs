//! Reads and writes decimal numbers. It needs no heap, and unlike the standard formatter its code contains no panic.

use core::fmt::{self, Write as _};

/// The largest number of significant digits that are read. Any integer of 15 digits is below 2^53, so `f64` has it
/// exactly.
const DIGITS: u32 = 15;

/// Powers of ten that are exact in `f64`.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// Reads a number such as `2000`, `-0.07` or `1.5e3`, with up to 15 significant digits. The number is an integer times
/// a power of ten, with an exponent within +-22. `f64` represents the integer and the power exactly, and one operation
/// rounds once. So the result is the nearest `f64`.
pub(super) fn parse(text: &[u8]) -> Option<f64> {
    let (negative, text) = match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, text),
    };
    let end = text.iter().position(|byte| matches!(byte, b'e' | b'E')).unwrap_or(text.len());
    let (digits, exponent) = text.split_at_checked(end)?;
    let mut exponent = match exponent {
        [] => 0,
        [_, b'-', rest @ ..] => -integer(rest)?,
        [_, b'+', rest @ ..] | [_, rest @ ..] => integer(rest)?,
    };
    let (mut mantissa, mut significant, mut any, mut point) = (0u64, 0, false, false);
    for &byte in digits {
        match byte {
            b'.' if !point => point = true,
            b'0'..=b'9' => {
                any = true;
                significant += u32::from(significant > 0 || byte != b'0');
                if significant > DIGITS {
                    return None;
                }
                mantissa = mantissa * 10 + u64::from(byte - b'0'); // below 10^15
                exponent -= i32::from(point);
            }
            _ => return None,
        }
    }
    if !any {
        return None;
    }
    if mantissa == 0 {
        return Some(0.0);
    }
    let value = decimal(mantissa, exponent)?;
    Some(if negative { -value } else { value })
}

/// Returns the `f64` nearest to `digits * 10^exponent`, for `digits` below 10^15. Returns `None` if [`POWERS`] does not
/// have the power of ten.
fn decimal(digits: u64, exponent: i32) -> Option<f64> {
    #[expect(clippy::cast_precision_loss, reason = "below 10^15, so exact")]
    let value = digits as f64;
    let power = POWERS.get(usize::try_from(exponent.unsigned_abs()).ok()?)?;
    Some(if exponent < 0 { value / power } else { value * power })
}

/// Rounds `value` to 15 digits, as the simulator rounds a scene's values. If [`POWERS`] lacks the needed power of ten,
/// `value` stays unchanged.
pub(super) fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    #[expect(clippy::cast_possible_truncation, reason = "-324 to 308")]
    let exponent = DIGITS.cast_signed() - 1 - libm::floor(libm::log10(libm::fabs(value))) as i32;
    let Some(power) =
        usize::try_from(exponent.unsigned_abs()).ok().and_then(|place| POWERS.get(place))
    else {
        return value;
    };
    let scaled = libm::fabs(value);
    let scaled = if exponent < 0 { scaled / power } else { scaled * power };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1e14 to 1e15")]
    let shown = decimal(libm::round(scaled) as u64, -exponent).unwrap_or(scaled);
    if value < 0.0 { -shown } else { shown }
}

/// Reads an integer of one to three digits.
fn integer(text: &[u8]) -> Option<i32> {
    if !(1..=3).contains(&text.len()) {
        return None;
    }
    text.iter().try_fold(0, |value, byte| match byte {
        b'0'..=b'9' => Some(value * 10 + i32::from(byte - b'0')),
        _ => None,
    })
}

/// A number as a reply prints it. It has up to 12 significant digits, without trailing zeros.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decimal(pub f64);

impl fmt::Display for Decimal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_decimal(f, self.0, 0)
    }
}

/// One end of an allowed range, as a reply prints it. It is rounded to 12 digits, towards the inside of the range. So
/// the board accepts this number when a person types it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// The lowest value that is allowed.
    Low(f64),
    /// The highest value that is allowed.
    High(f64),
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Low(limit) => write_decimal(f, limit, 1),
            Self::High(limit) => write_decimal(f, limit, -1),
        }
    }
}

/// Writes 12 digits. The shown number is never below `value` if `inwards` is 1, and never above it if `inwards` is -1.
fn write_decimal(f: &mut fmt::Formatter<'_>, value: f64, inwards: i8) -> fmt::Result {
    if value.is_nan() {
        return f.write_str("nan");
    }
    if value < 0.0 {
        f.write_char('-')?;
    }
    let mut scaled = value.abs();
    if scaled == 0.0 {
        return f.write_char('0');
    }
    if scaled.is_infinite() {
        return f.write_str("inf");
    }
    // value = scaled * 10^exponent, with 12 digits before the point.
    let mut exponent = 0i32;
    while scaled >= 1e12 {
        scaled /= 10.0;
        exponent += 1;
    }
    while scaled < 1e11 {
        scaled *= 10.0;
        exponent -= 1;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1e11 to 1e12")]
    let mut digits = libm::round(scaled) as u64;
    // Whether the magnitude must grow. A larger magnitude makes a negative number smaller.
    let up = (inwards > 0) == (value > 0.0);
    if inwards != 0 {
        match decimal(digits, exponent) {
            Some(shown) if up && shown < value.abs() => digits += 1,
            Some(shown) if !up && shown > value.abs() => digits -= 1,
            Some(_) => {}
            // Without an exact power of ten `scaled` itself may be rounded. So the last digit changes by one in any
            // case. There are 12 digits, one more than needed.
            None if up => digits += 1,
            None => digits -= 1,
        }
    }
    while digits.is_multiple_of(10) && digits > 0 {
        digits /= 10;
        exponent += 1;
    }
    write_digits(f, digits, exponent)
}

/// Writes `digits * 10^exponent`. The last digit of `digits` must not be zero.
fn write_digits(f: &mut fmt::Formatter<'_>, digits: u64, exponent: i32) -> fmt::Result {
    let count = digits.checked_ilog10().map_or(1, |log| log.cast_signed() + 1);
    let point = count + exponent; // digits before the point
    let digit = |n: i32| {
        let place = u32::try_from(count - 1 - n).unwrap_or_default();
        let value = digits / 10u64.saturating_pow(place) % 10;
        char::from(b'0' + u8::try_from(value).unwrap_or_default())
    };
    if !(-5..=15).contains(&point) {
        f.write_char(digit(0))?;
        if count > 1 {
            f.write_char('.')?;
        }
        for n in 1..count {
            f.write_char(digit(n))?;
        }
        return write!(f, "e{}", point - 1);
    }
    if point <= 0 {
        f.write_str("0.")?;
        for _ in point..0 {
            f.write_char('0')?;
        }
    }
    for n in 0..count {
        if n > 0 && n == point {
            f.write_char('.')?;
        }
        f.write_char(digit(n))?;
    }
    for _ in count..point {
        f.write_char('0')?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::{format, string::ToString};

    #[test]
    fn usual_numbers_are_read_exactly() {
        for text in [
            "2000",
            "0.07",
            "-1.5e3",
            "+5",
            "1e-6",
            ".5",
            "5.",
            "2.835",
            "1E22",
            "0e999",
            "007",
            "123456789012345",
        ] {
            assert_eq!(parse(text.as_bytes()), text.parse().ok(), "{text}");
        }
    }

    #[test]
    fn what_is_no_number_is_none() {
        for text in [
            "",
            "-",
            ".",
            "e5",
            "1e",
            "1e+",
            "1e1000",
            "1..2",
            "1,5",
            "0x10",
            "nan",
            "inf",
            "--1",
            "1 2",
            "1234567890123456",
            "1e23",
            "1e-23",
            "5N",
            "\u{7f}",
            "1e5e5",
        ] {
            assert_eq!(parse(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn replies_show_plain_decimals() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (2000.0, "2000"),
            (0.07, "0.07"),
            (-1.5, "-1.5"),
            (1e-6, "0.000001"),
            (1e-7, "1e-7"),
            (0.000_012, "0.000012"),
            (1e15, "1e15"),
            (123_456.789, "123456.789"),
            (1.0 / 3.0, "0.333333333333"),
            (999_999_999_999.9, "1000000000000"),
            (1e7, "10000000"),
            (2.835, "2.835"),
            (1e300, "1e300"),
            (f64::NAN, "nan"),
            (f64::NEG_INFINITY, "-inf"),
            (1.25e-9, "1.25e-9"),
            (5e-324, "4.94065645841e-324"),
        ] {
            assert_eq!(Decimal(value).to_string(), text);
        }
    }

    proptest! {
        #[test]
        fn reading_agrees_with_the_standard_library(
            mantissa in 0u64..1_000_000_000_000_000, places in 0usize..18, exponent in -8i32..8, negative in any::<bool>()
        ) {
            let digits = format!("{mantissa:018}");
            let (whole, rest) = digits.split_at(18 - places);
            let sign = if negative { "-" } else { "" };
            let text = format!("{sign}{whole}.{rest}e{exponent}");
            if let Some(value) = parse(text.as_bytes()) {
                prop_assert_eq!(value, text.parse::<f64>().unwrap());
            } else {
                prop_assert!(exponent - i32::try_from(places).unwrap() < -22);
            }
        }

        #[test]
        fn a_limit_is_accepted_when_it_is_typed(part in 0.0..1.0f64, exponent in -4i32..8) {
            // Like a limit between two points of the envelope, the number may have any digits.
            let limit = part * 10f64.powi(exponent);
            for limit in [limit, -limit] {
                let typed = |shown: Limit| parse(shown.to_string().as_bytes()).unwrap();
                let (low, high) = (typed(Limit::Low(limit)), typed(Limit::High(limit)));
                prop_assert!(low >= limit && high <= limit, "{low} {limit} {high}");
                let near = 1e-11 * limit.abs();
                prop_assert!(low - limit <= near && limit - high <= near, "{low} {limit} {high}");
            }
        }

        #[test]
        fn what_is_shown_is_within_half_of_the_12th_digit(value in any::<f64>()) {
            let shown: f64 = Decimal(value).to_string().to_lowercase().parse().unwrap();
            let normal = value.abs() > 1e-300 && value.is_finite();
            prop_assert!(!normal || (shown / value - 1.0).abs() < 5.1e-12, "{value} {shown}");
        }
    }
}
