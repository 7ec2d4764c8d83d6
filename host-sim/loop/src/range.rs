//! Ranges of input values, and the message for a value out of range.

use std::ops::RangeInclusive;

use zwidth::ends;

/// Checks that a value is in its range.
///
/// # Errors
/// The error message of [`refused`].
pub fn within(key: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), String> {
    if range.contains(&value) { Ok(()) } else { Err(refused(key, value, &range)) }
}

/// The message for a value that is out of range. It is one line with key, value and allowed range.
pub fn refused(key: &str, value: f64, range: &RangeInclusive<f64>) -> String {
    let [low, high] = ends(range);
    format!("{key} is {value}, allowed {low} to {high}")
}
