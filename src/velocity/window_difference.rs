//! The difference over a window. The velocity is the number of counts in the last N samples, divided by their time. The
//! drivers of CHAI3D and Force Dimension use this estimator too.
//!
//! ```text
//! v T = (x[n] - x[n-N]) / N
//! ```
//!
//! The velocity is late by N / 2 samples. Its steps are 1 / N counts per sample. The sum of the last differences is
//! stored, exact in integers. So a long window takes no more time than a short one.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{
    Form, Senses,
    history::Ring,
    kept::{Bytes, kept},
};
use crate::{
    range::{SettingsError, within},
    units::Velocity,
};

/// Longest accepted window, in samples.
pub const DIFFERENCE_WINDOW_MAX: u8 = 255;

const LENGTH: usize = 256;
/// Number of fractional bits of the factor beyond those of a velocity. With them, the rounding of the factor causes an
/// error of at most a quarter of an LSB.
const FACTOR_BITS: u32 = 24;

/// Difference over a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowDifference {
    window: u8,
    factor: i64,
}

/// The last differences, and the sum of the differences in the window.
#[derive(Clone, Copy, Debug)]
pub(super) struct WindowState {
    ring: Ring<LENGTH>,
    sum: i32,
}

kept!(WindowState { ring, sum });

impl WindowDifference {
    /// Makes a difference over this number of samples, 1 to [`DIFFERENCE_WINDOW_MAX`].
    ///
    /// # Errors
    /// The window is out of range.
    pub fn new(window_samples: u32) -> Result<Self, SettingsError> {
        let range = 1.0..=f64::from(DIFFERENCE_WINDOW_MAX);
        within("window_samples", f64::from(window_samples), range)?;
        let window = u8::try_from(window_samples).unwrap_or(DIFFERENCE_WINDOW_MAX);
        let one = 1i64 << (Velocity::FRACTION_BITS + FACTOR_BITS);
        Ok(Self { window, factor: (one + i64::from(window) / 2) / i64::from(window) })
    }

    /// Samples of the window.
    pub const fn window_samples(&self) -> u8 {
        self.window
    }

    /// The factor 1 / window. Its LSB is that of a velocity with [`FACTOR_BITS`](Self::FACTOR_BITS) further fractional
    /// bits.
    pub const fn factor(&self) -> i64 {
        self.factor
    }

    /// Fractional bits of the factor beyond those of a velocity.
    pub const FACTOR_BITS: u32 = FACTOR_BITS;
}

impl Form for WindowDifference {
    type State = WindowState;
    const REST: WindowState = WindowState { ring: Ring::REST, sum: 0 };

    fn at(&self, velocity: Velocity) -> WindowState {
        let ring = Ring::at(velocity);
        WindowState { ring, sum: (0..self.window).map(|age| ring.back(age)).sum() }
    }

    fn put(&self, state: &WindowState, bytes: &mut Bytes<'_>) {
        state.ring.put_last(self.window, bytes);
    }

    fn take(&self, rest: &mut &[u8]) -> Option<WindowState> {
        let ring = Ring::take_last(self.window, rest)?;
        Some(WindowState { ring, sum: (0..self.window).map(|age| ring.back(age)).sum() })
    }

    #[inline]
    fn step(&self, state: &mut WindowState, difference: i32, _: &Senses) -> Velocity {
        let leaves = state.ring.back(self.window.wrapping_sub(1));
        state.ring.push(difference);
        state.sum += state.ring.back(0) - leaves;
        // The product is at most 255 * 32767 * 2^40 / 255, which is below 2^56.
        let mean = (i64::from(state.sum) * self.factor + (1 << (FACTOR_BITS - 1))) >> FACTOR_BITS;
        #[expect(clippy::cast_possible_truncation, reason = "a mean of differences in range")]
        Velocity::saturating_from_bits(mean as i32)
    }
}

#[cfg(test)]
#[cfg(feature = "estimators")]
mod tests {
    use super::*;
    use crate::{
        design::tests::DESIGN,
        units::Position,
        velocity::{EstimatorName, State},
    };

    const LSB: f64 = (1u32 << Velocity::FRACTION_BITS) as f64;

    /// Computes the velocities at these positions, in counts per sample. The handle rests at the first position.
    fn velocities(window: u32, positions: &[i32]) -> std::vec::Vec<f64> {
        let settings = EstimatorName::WindowDifference.defaults().with_tuning(window.into());
        let estimator = settings.build(&DESIGN).unwrap();
        let mut state = State::at_rest(Position::from_counts(positions[0]));
        let each = positions.iter().map(|now| {
            let now = Position::from_counts(*now);
            f64::from(estimator.update(&mut state, now, &Senses::NONE).bits()) / LSB
        });
        each.collect()
    }

    #[test]
    fn it_is_the_counts_of_the_window_over_its_length_to_within_an_lsb() {
        let positions: std::vec::Vec<i32> =
            (0..900i32).map(|n| (n * n / 50 - 40 * (n % 37)).wrapping_add(i32::MAX - 99)).collect();
        for window in [1, 2, 3, 64, 150, 200, 255] {
            for (n, found) in velocities(window, &positions).iter().enumerate() {
                let before = positions[n.saturating_sub(window as usize)];
                let exact = f64::from(positions[n].wrapping_sub(before)) / f64::from(window);
                assert!((found - exact).abs() <= 1.0 / LSB, "{window} {n}: {found} {exact}");
            }
        }
    }

    #[test]
    fn a_handle_that_stops_reads_zero_after_the_window() {
        let mut positions = [7; 400];
        positions[0] = 0;
        let found = velocities(200, &positions);
        assert_eq!((found[199] > 0.0, found[200] > 0.0, found[201]), (true, true, 0.0));
    }

    #[test]
    fn full_scale_neither_overflows_nor_drifts() {
        for window in [1, 255] {
            let mut position = 0i32;
            let mut positions = std::vec![0];
            for n in 0..2000 {
                let step = if n < 1000 { i32::MAX } else { 0 };
                position = position.wrapping_add(step);
                positions.push(position);
            }
            let found = velocities(window, &positions);
            assert_eq!(found[1000], f64::from(Velocity::LIMIT));
            assert_eq!(found[2000], 0.0);
        }
    }

    #[test]
    fn other_windows_are_refused() {
        for (window, is_good) in [(0, false), (1, true), (255, true), (256, false)] {
            assert_eq!(WindowDifference::new(window).is_ok(), is_good);
        }
    }
}
