//! Ranges of what may be entered, and the one line that refuses a value.

use std::ops::RangeInclusive;

use zwidth::ends;

/// Refuses a value outside its range.
///
/// # Errors
/// The line of [`refused`].
pub fn within(key: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), String> {
    if range.contains(&value) { Ok(()) } else { Err(refused(key, value, &range)) }
}

/// The one line that says what is wrong with a value: key, value, allowed range.
pub fn refused(key: &str, value: f64, range: &RangeInclusive<f64>) -> String {
    let [low, high] = ends(range);
    format!("{key} is {value}, allowed {low} to {high}")
}
