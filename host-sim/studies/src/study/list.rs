//! Lists of numbers on a command line and in a study: `A,B,C` or `FROM:STEP:TO`.

use crate::scene::ranges::VALUES_MAX;

#[derive(Clone, Debug, PartialEq)]
pub struct List(pub Vec<f64>);

/// Reads `A,B,C` or `FROM:STEP:TO`. TO is included if a step reaches TO. An error says what is allowed.
pub fn parse(text: &str) -> Result<List, String> {
    let number = |part: &str| {
        let value: f64 = part.trim().parse().map_err(|_| format!("`{part}` is not a number"))?;
        if value.is_finite() { Ok(value) } else { Err(format!("`{part}` is not finite")) }
    };
    if text.trim().is_empty() {
        return Err("the list is empty, allowed A,B,C or FROM:STEP:TO".into());
    }
    let parts: Vec<&str> = text.split(':').collect();
    match parts[..] {
        [list] => match list.split(',').count() {
            values if values > VALUES_MAX => {
                Err(format!("the list has {values} values, allowed {VALUES_MAX}"))
            }
            _ => list.split(',').map(number).collect::<Result<_, _>>().map(List),
        },
        [from, step, to] => {
            let places = decimals(from).zip(decimals(step)).map(|(a, b)| a.max(b));
            range(number(from)?, number(step)?, number(to)?, places)
        }
        _ => Err(format!("`{text}` is neither A,B,C nor FROM:STEP:TO")),
    }
}

/// Number of digits that were typed after the point. `None` if there are too many for exact arithmetic.
fn decimals(text: &str) -> Option<i32> {
    let (digits, exponent) = text.trim().split_once(['e', 'E']).unwrap_or((text.trim(), "0"));
    let places = digits.split_once('.').map_or(0, |(_, places)| places.len());
    let places = i32::try_from(places).ok()?.checked_sub(exponent.parse().ok()?)?.max(0);
    (places <= 22).then_some(places) // powers of ten that are exact in f64
}

fn range(from: f64, step: f64, to: f64, places: Option<i32>) -> Result<List, String> {
    if step <= 0.0 {
        return Err(format!("the step is {step}, allowed above 0"));
    }
    if to < from {
        return Err(format!("the range {from} to {to} is empty"));
    }
    // The end is included if a step reaches it within a rounding error.
    let steps = ((to - from) / step * (1.0 + 4.0 * f64::EPSILON)).floor();
    if steps >= VALUES_MAX as f64 {
        return Err(format!("the list has {} values, allowed {VALUES_MAX}", steps + 1.0));
    }
    let indices = std::iter::successors(Some(0.0), |n| Some(n + 1.0));
    // In units of the last typed digit, the sum is exact. Dividing it by the unit gives exactly the number that a user
    // would type.
    let unit = places.map(|places| 10f64.powi(places));
    let exact = |value: f64| value.abs() < 2f64.powi(53);
    let value = |n: f64| match unit.map(|unit| ((from * unit).round(), (step * unit).round(), unit))
    {
        Some((from, step, unit)) if exact(from.abs() + n * step) => (from + n * step) / unit,
        _ => from + n * step,
    };
    Ok(List(indices.take_while(|&n| n <= steps).map(value).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_read() {
        assert_eq!(parse("50, 100,1.5e3").unwrap().0, [50.0, 100.0, 1500.0]);
        assert_eq!(parse("100:100:300").unwrap().0, [100.0, 200.0, 300.0]);
        assert_eq!(parse("0:0.1:0.3").unwrap().0, [0.0, 0.1, 0.2, 0.3]);
        assert_eq!(parse("1e-6:1e-6:4E-6").unwrap().0, [1e-6, 2e-6, 3e-6, 4e-6]);
        assert_eq!(parse("-0.35:0.05:0").unwrap().0[1], -0.3);
        let tenths = parse("0.1:0.1:999").unwrap().0;
        assert!(tenths.iter().zip(1u32..).all(|(value, n)| *value == f64::from(n) / 10.0));
        assert_eq!(parse("1:2:4").unwrap().0, [1.0, 3.0]);
    }

    #[test]
    fn what_cannot_be_a_list_is_refused_with_its_reason() {
        for (text, reason) in [
            ("", "empty"),
            ("1,,2", "not a number"),
            ("nan", "not finite"),
            ("1,inf", "not finite"),
            ("5:1:1", "empty"),
            ("1:0:5", "above 0"),
            ("1:2", "neither"),
            ("0:1e-9:1", "allowed 10000"),
            (&"1,".repeat(10_000), "10001 values, allowed 10000"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
