//! Designs estimators that are the derivative of a polynomial. The polynomial goes through the last samples (Taylor
//! expansions), or fits these samples best (least squares).
//!
//! A sum `v T = h0 x[n] + h1 x[n-1] + ..` whose weights add up to zero is also a sum of differences
//! `d[n] = x[n] - x[n-1]`, with the weights `g[i] = h[0] + .. + h[i]`. If the sum is exact for a ramp, the weights `g`
//! add up to one. So [`Fir`] can compute it.
//!
//! **Taylor** (Brown, Schneider, Mulligan, IEEE TIE 39(1), 1992) is the derivative at `x[n]` of the polynomial through
//! the last samples: two (order 1, the finite difference), three or four.
//!
//! ```text
//! order 2: v T = (3 x[n] - 4 x[n-1] + x[n-2]) / 2                   g = [3, -1] / 2
//! order 3: v T = (11 x[n] - 18 x[n-1] + 9 x[n-2] - 2 x[n-3]) / 6    g = [11, -7, 2] / 6
//! ```
//!
//! **Least squares** (the same paper) is the derivative at `x[n]` of the polynomial of degree 1 or 2 that fits the last
//! `window + 1` samples best. With `s = i - m`, `m = window / 2`, and `S2 = sum s^2`, `S4 = sum s^4` over
//! `i = 0 .. window`:
//!
//! ```text
//! degree 1: h[i] = -s / S2
//! degree 2: h[i] = -s / S2 + 2 m (s^2 - S2 / M) / (S4 - S2^2 / M),   M = window + 1
//! ```
//!
//! Degree 1 is late by half its window. Degree 2 follows a constant acceleration without delay.

use super::{
    fir::{FRACTION_BITS, Fir},
    history::{LENGTH, WINDOW_MAX},
};
use crate::range::{SettingsError, within};

/// Exact weights of the last differences, newest first. They add up to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirDesign {
    weights: [f64; LENGTH],
    window: u32,
}

impl FirDesign {
    /// Designs the Taylor expansion of this order, 1 to 3. It uses this number of differences.
    ///
    /// # Errors
    /// The order is out of range.
    pub fn taylor(order: u32) -> Result<Self, SettingsError> {
        within("order", f64::from(order), 1.0..=3.0)?;
        Ok(Self::of(match order {
            1 => &[1.0],
            2 => &[1.5, -0.5],
            _ => &[11.0 / 6.0, -7.0 / 6.0, 2.0 / 6.0],
        }))
    }

    /// Makes a design of these weights, newest first. There must be at most [`WINDOW_MAX`], each below 2, and they must
    /// add up to one.
    pub(super) fn of(exact: &[f64]) -> Self {
        let mut weights = [0.0; LENGTH];
        for (weight, exact) in weights.iter_mut().zip(exact) {
            *weight = *exact;
        }
        #[expect(clippy::cast_possible_truncation, reason = "at most WINDOW_MAX")]
        Self { weights, window: exact.len().min(LENGTH) as u32 }
    }

    /// The weights in use, newest first.
    pub fn weights(&self) -> &[f64] {
        self.weights.get(..self.window as usize).unwrap_or(&self.weights)
    }

    /// Designs the least-squares fit of a polynomial of `degree` 1 or 2 over the last `window` differences. `window`
    /// must be at least `degree` and at most [`WINDOW_MAX`].
    ///
    /// # Errors
    /// Names the parameter and its range.
    pub fn least_squares(degree: u32, window: u32) -> Result<Self, SettingsError> {
        within("degree", f64::from(degree), 1.0..=2.0)?;
        let range = f64::from(degree)..=f64::from(WINDOW_MAX);
        within("window_samples", f64::from(window), range)?;
        let middle = f64::from(window) / 2.0;
        let samples = f64::from(window) + 1.0;
        let offset = |i: u32| f64::from(i) - middle;
        let s2: f64 = (0..=window).map(|i| offset(i) * offset(i)).sum();
        let s4: f64 = (0..=window).map(|i| offset(i) * offset(i) * offset(i) * offset(i)).sum();
        let curvature = s4 - s2 * s2 / samples;
        let mut weights = [0.0; LENGTH];
        let mut sum = 0.0;
        for (i, weight) in (0..window).zip(&mut weights) {
            let s = offset(i);
            sum -= s / s2;
            if degree == 2 {
                sum += 2.0 * middle * (s * s - s2 / samples) / curvature;
            }
            *weight = sum;
        }
        Ok(Self { weights, window })
    }

    /// Rounds the weights to LSB of 2^-30. The remainder is added to the largest weight, so that all weights add up to
    /// exactly 2^30.
    pub fn quantise(&self) -> Fir {
        let one = 1i32 << FRACTION_BITS;
        let mut weights = [0; LENGTH];
        let mut rest = one;
        for (weight, exact) in weights.iter_mut().zip(self.weights()) {
            #[expect(clippy::cast_possible_truncation, reason = "|weight| is below 2")]
            let bits = libm::round(exact * f64::from(one)) as i32;
            *weight = bits;
            rest = rest.wrapping_sub(bits);
        }
        if let Some(largest) = weights.iter_mut().max_by_key(|weight| weight.unsigned_abs()) {
            *largest = largest.wrapping_add(rest);
        }
        Fir { weights, window: self.window }
    }
}
