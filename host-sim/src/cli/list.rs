//! Lists of numbers: `A,B,C` or `FROM:STEP:TO`.

use crate::scene::ranges::VALUES_MAX;

/// A list of numbers from the command line.
#[derive(Clone, Debug, PartialEq)]
pub struct List(pub Vec<f64>);

/// Reads `A,B,C` or `FROM:STEP:TO` (TO included if a step falls on it).
///
/// # Errors
/// One line that says what is wrong.
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
        [from, step, to] => range(number(from)?, number(step)?, number(to)?),
        _ => Err(format!("`{text}` is neither A,B,C nor FROM:STEP:TO")),
    }
}

fn range(from: f64, step: f64, to: f64) -> Result<List, String> {
    if step <= 0.0 {
        return Err(format!("the step is {step}, allowed above 0"));
    }
    if to < from {
        return Err(format!("the range {from} to {to} is empty"));
    }
    // The end counts if it is reached but for rounding.
    let steps = ((to - from) / step * (1.0 + 4.0 * f64::EPSILON)).floor();
    if steps >= VALUES_MAX as f64 {
        return Err(format!("the list has {} values, allowed {VALUES_MAX}", steps + 1.0));
    }
    let indices = std::iter::successors(Some(0.0), |n| Some(n + 1.0));
    Ok(List(indices.take_while(|&n| n <= steps).map(|n| from + n * step).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_read() {
        assert_eq!(parse("50, 100,1.5e3").unwrap().0, [50.0, 100.0, 1500.0]);
        assert_eq!(parse("100:100:300").unwrap().0, [100.0, 200.0, 300.0]);
        assert_eq!(parse("0:0.1:0.3").unwrap().0.len(), 4);
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
