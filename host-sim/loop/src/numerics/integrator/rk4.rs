//! The classical Runge-Kutta method.

use super::Field;

/// The state moved along `rate` for a time h: `z + h rate`.
#[inline]
pub(super) fn along<const N: usize>(z: &[f64; N], h: f64, rate: &[f64; N]) -> [f64; N] {
    core::array::from_fn(|i| z[i] + h * rate[i])
}

/// One step of length h.
#[inline]
pub fn step<const N: usize>(field: &impl Field<N>, z: &[f64; N], h: f64) -> [f64; N] {
    let first = field.rate(z);
    let second = field.rate(&along(z, 0.5 * h, &first));
    let third = field.rate(&along(z, 0.5 * h, &second));
    let fourth = field.rate(&along(z, h, &third));
    core::array::from_fn(|i| z[i] + h / 6.0 * (first[i] + 2.0 * (second[i] + third[i]) + fourth[i]))
}
