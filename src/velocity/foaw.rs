//! First-order adaptive windowing (Janabi-Sharifi, Hayward, Chen, IEEE TCST 8(6), 2000). The velocity is the slope over
//! a window. The window is the longest window in which all samples lie within the noise of one line through the newest
//! sample.
//!
//! With `s[j] = x[n] - x[n-j]`, the slope `v T` over a window of `i` samples is
//!
//! ```text
//! end fit:  s[i] / i
//! best fit: (2 sum j s[j] - i sum s[j]) / (i (i+1) (i+2) / 6),   sums over j = 1 .. i
//! ```
//!
//! The best fit is the least-squares fit of the window's `i + 1` samples. Windows are tried from `i = 1` up. The first
//! window with `|s[j] - j v T| > noise` for some `0 < j < i` ends the search, and the window before it is used. At
//! constant speed the window has its largest length. If the handle accelerates, the window shrinks to about
//! `sqrt(8 noise / a)` samples, with `a` in counts per sample^2. The estimate is late by half the used window.
//!
//! At constant speed a noise of 1 count never shortens the window of the end fit. Then the error is below `1 / window`
//! counts per sample. For the best fit, the checked line also passes through the newest sample, as in the published
//! code. So it is not the least-squares line, and quantisation alone may shorten the window.
//!
//! **Cost.** The literal search checks all samples of every window, so its cost is quadratic. But
//! `|s[j] - j v T| <= noise` means that the slope lies between `(s[j] - noise) / j` and `(s[j] + noise) / j`. So it is
//! enough to keep the largest lower bound and the smallest upper bound, in one pass. The bounds are compared as
//! fractions by cross-multiplication, which is exact. At the end there is one division, 32 bits wide.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::num::NonZeroU32;

use super::{Form, Senses, history::History, kept::Bytes};
use crate::{
    range::{SettingsError, within},
    units::Velocity,
};

/// The noise is stored in steps of 1/16 count.
const NOISE_STEPS: i32 = 16;
/// A bound that no slope reaches, in steps of the noise. Its product with the longest window fits into 32 bits.
const FREE: i32 = 1 << 25;

/// Parameters of the estimator. Made by [`new`](Self::new).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foaw {
    best: bool,
    window: u8,
    noise: i32,
}

/// A bound of the slope. Its value is `number / over`. The unit is one step of the noise per sample. The denominator is
/// 1 to 32.
#[derive(Clone, Copy)]
struct Bound {
    number: i32,
    over: i32,
}

impl Bound {
    /// Whether `self` is below `other`. Numerators are at most 2^25, so 32 bits are enough.
    #[inline]
    fn below(self, other: Self) -> bool {
        self.number * other.over < other.number * self.over
    }
}

impl Foaw {
    /// Longest accepted window, in samples.
    pub const WINDOW_MAX: u32 = 32;
    /// Largest accepted noise, in counts.
    pub const NOISE_MAX: f64 = 1000.0;

    /// Steps of the noise per count.
    pub const NOISE_STEPS: i32 = NOISE_STEPS;
    /// A bound that no slope reaches, in steps of the noise.
    pub const FREE: i32 = FREE;

    /// Length of the longest window, in samples.
    pub const fn window_samples(&self) -> u8 {
        self.window
    }

    /// The noise, in steps.
    pub const fn noise_steps(&self) -> i32 {
        self.noise
    }

    /// Makes the estimator with this longest window and this noise. The window has 1 to 32 samples. The noise is 0 to
    /// 1000 counts, rounded to 1/16.
    ///
    /// # Errors
    /// Names the parameter and its range.
    #[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
    pub fn new(best: bool, window_samples: u32, noise_counts: f64) -> Result<Self, SettingsError> {
        let range = 1.0..=f64::from(Self::WINDOW_MAX);
        within("window_samples", f64::from(window_samples), range)?;
        within("noise_counts", noise_counts, 0.0..=Self::NOISE_MAX)?;
        #[expect(clippy::cast_possible_truncation, reason = "within the ranges above")]
        let (window, noise) =
            (window_samples as u8, libm::round(noise_counts * f64::from(NOISE_STEPS)) as i32);
        Ok(Self { best, window, noise })
    }

    /// Returns the slope over the longest window that fits, as numerator and denominator. The function is compiled in
    /// two forms, because the loop of the end fit needs no sums and only 32 bits.
    #[inline(always)] // in a call the fraction would go through memory
    fn slope<const BEST: bool>(&self, history: &History) -> (i32, NonZeroU32) {
        let mut low = Bound { number: -FREE, over: 1 };
        let mut high = Bound { number: FREE, over: 1 };
        let mut longest = (0, 1);
        let (mut s, mut sum, mut moment) = (0, 0, 0);
        // `triangle` is 1 + .. + i. `pyramid` is the sum of these numbers, i (i+1) (i+2) / 6.
        let (mut triangle, mut pyramid) = (0, 0);
        for age in 0..self.window {
            let i = i32::from(age) + 1;
            s += history.back(age); // at most 2^20
            let centre = s * NOISE_STEPS;
            let slope = if BEST {
                sum += s;
                moment += i * s; // at most 2^15 * 11440 < 2^29
                triangle += i;
                pyramid += triangle;
                let slope = (2 * moment - i * sum, pyramid); // at most 2^15 * 5984 over 5984
                let times = |a: i32, b: i32| i64::from(a) * i64::from(b);
                let [least, most] = [low, high].map(|bound| times(bound.number, slope.1));
                if times(slope.0, low.over * NOISE_STEPS) < least
                    || times(slope.0, high.over * NOISE_STEPS) > most
                {
                    break;
                }
                slope
            } else {
                let slope = Bound { number: centre, over: i };
                if slope.below(low) || high.below(slope) {
                    break;
                }
                (s, i)
            };
            longest = slope;
            let lower = Bound { number: centre - self.noise, over: i };
            if low.below(lower) {
                low = lower;
            }
            let upper = Bound { number: centre + self.noise, over: i };
            if upper.below(high) {
                high = upper;
            }
        }
        let (number, over) = longest;
        (number, NonZeroU32::new(over.unsigned_abs()).unwrap_or(NonZeroU32::MIN))
    }
}

impl Form for Foaw {
    type State = History;
    const REST: History = History::REST;

    fn at(&self, velocity: Velocity) -> History {
        History::at(velocity)
    }

    fn put(&self, history: &History, bytes: &mut Bytes<'_>) {
        history.put_last(self.window, bytes);
    }

    fn take(&self, rest: &mut &[u8]) -> Option<History> {
        History::take_last(self.window, rest)
    }

    /// Takes a difference, and returns the slope, rounded to the nearest LSB.
    #[inline]
    fn step(&self, history: &mut History, difference: i32, _: &Senses) -> Velocity {
        history.push(difference);
        let (number, over) =
            if self.best { self.slope::<true>(history) } else { self.slope::<false>(history) };
        quotient(number, over)
    }
}

/// Returns `number / over` as a velocity, rounded to nearest. Halves round away from zero. `over` must be below 2^13.
#[inline]
fn quotient(number: i32, over: NonZeroU32) -> Velocity {
    let magnitude = number.unsigned_abs();
    let (whole, rest) = (magnitude / over, magnitude % over);
    let fraction = ((rest << Velocity::FRACTION_BITS) + over.get() / 2) / over;
    let whole = whole.min(Velocity::LIMIT.unsigned_abs()) << Velocity::FRACTION_BITS;
    let bits = (whole + fraction).min(Velocity::LIMIT_BITS.unsigned_abs()).cast_signed();
    Velocity::saturating_from_bits(if number < 0 { -bits } else { bits })
}

#[cfg(test)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "a test fails loudly"
)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The search as it was published, in integers. For every window it checks all samples.
    fn literal(foaw: &Foaw, history: &History) -> Velocity {
        let mut s = std::vec![0i64];
        for age in 0..foaw.window {
            s.push(s[usize::from(age)] + i64::from(history.back(age)));
        }
        let mut best = (0, 1);
        for i in 1..s.len() {
            let n = i as i64;
            let (number, over) = if foaw.best {
                let positions = (0..=i).map(|j| -s[j]);
                let weights = (0..=n).map(|j| n - 2 * j);
                (positions.zip(weights).map(|(x, w)| x * w).sum(), n * (n + 1) * (n + 2) / 6)
            } else {
                (s[i], n)
            };
            let within = (1..i).all(|j| {
                let off = s[j] * over - number * j as i64;
                off.abs() * i64::from(NOISE_STEPS) <= i64::from(foaw.noise) * over
            });
            if !within {
                break;
            }
            best = (number, over);
        }
        let bits = (best.0 as f64 / best.1 as f64 * 65536.0).round();
        Velocity::saturating_from_bits(bits as i32)
    }

    proptest! {
        #[test]
        fn one_pass_finds_the_window_of_the_literal_search(
            best in any::<bool>(),
            window in 1u32..=32,
            noise in 0u32..80,
            speed in -40_000i32..40_000,
            spread in 0i32..6,
            steps in proptest::collection::vec(-1f64..1.0, if cfg!(miri) { 12 } else { 200 }),
        ) {
            let foaw = Foaw::new(best, window, f64::from(noise) / 16.0).unwrap();
            let mut history = History::REST;
            for step in steps {
                let difference = speed + (step * f64::from(spread)).round() as i32;
                let velocity = foaw.step(&mut history, difference, &Senses::NONE);
                prop_assert_eq!(velocity, literal(&foaw, &history));
            }
        }
    }

    #[test]
    fn what_is_out_of_range_is_refused_by_name() {
        for (window, noise, parameter) in [
            (0, 1.0, "window_samples"),
            (33, 1.0, "window_samples"),
            (16, -0.1, "noise_counts"),
            (16, 1000.1, "noise_counts"),
            (16, f64::NAN, "noise_counts"),
        ] {
            let error = Foaw::new(false, window, noise).unwrap_err();
            assert_eq!(error.parameter, parameter);
        }
    }
}
