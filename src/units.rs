//! The quantities from the encoder to the command. The format of each quantity is in its type.
//!
//! | quantity     | unit                     | format  | LSB          | range                 | made by |
//! |--------------|--------------------------|---------|--------------|-----------------------|---------|
//! | [`Position`] | counts                   | `i32`   | 1 count      | +-2^30, then a fault  | [`Encoder::track`](crate::encoder::Encoder::track) |
//! | [`Velocity`] | counts per sample        | `Q16`   | 2^-16        | +-32767, saturating   | [`Estimator::update`](crate::velocity::Estimator::update) |
//! | [`Acceleration`] | counts per sample^2  | `Q24`   | 2^-24        | +-127, saturating     | an accelerometer |
//! | [`Demand`]   | fraction of full scale   | `Q30` in `i64` | 2^-30 | +-2^32                | [`Wall::demand`](crate::wall::Wall::demand) |
//! | [`Force`]    | fraction of full scale   | `Q30`   | 2^-30        | +-1, saturating       | [`Demand::saturate`] |
//! | [`OutputCode`]  | DAC or PWM code          | `i32`   | 1 code       | of the output         | [`Actuator::command`](crate::actuator::Actuator::command) |
//! | [`Gain`](crate::Gain) | force LSB per input LSB | 31 bits x 2^-shift | relative 2^-31 | 0, 2^-32 .. 2^54 | [`Settings::build`](crate::Settings::build) |
//! | filter coefficient | 1                  | `Q30`   | 2^-30        | -2 .. 2               | [`Settings::build`](crate::Settings::build) |
//!
//! If a format changes, change this table too. The test below compares the table with the types.
//!
//! At 1 um and 10 kHz one count per sample is already 10 mm/s. The output of the filter needs finer steps, so a
//! velocity has 16 fractional bits.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use dsp_fixedpoint::Q32;

/// Position in encoder counts. It does not wrap with the hardware counter. It rises into the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Position(i32);

impl Position {
    /// Largest magnitude, in counts. A position beyond it is a fault.
    pub const LIMIT: i32 = 1 << 30;

    /// Makes a position from a number of counts.
    #[inline]
    pub const fn from_counts(counts: i32) -> Self {
        Self(counts)
    }

    /// The position in counts.
    #[inline]
    pub const fn counts(self) -> i32 {
        self.0
    }

    /// Whether the position lies within +-[`LIMIT`](Self::LIMIT).
    #[inline]
    pub const fn in_range(self) -> bool {
        self.0 >= -Self::LIMIT && self.0 <= Self::LIMIT
    }

    /// This position plus `counts`. It wraps at the ends of `i32`, so that differences stay exact.
    #[inline]
    pub(crate) const fn wrapping_add(self, counts: i32) -> Self {
        Self(self.0.wrapping_add(counts))
    }

    /// Returns the counts from `earlier` to `self`. They are exact even if the position has wrapped.
    #[inline]
    pub(crate) const fn wrapping_since(self, earlier: Self) -> i32 {
        self.0.wrapping_sub(earlier.0)
    }

    /// Returns the counts from `origin` to `self`, limited to the range of `i32`.
    #[inline]
    pub(crate) const fn saturating_since(self, origin: Self) -> i32 {
        self.0.saturating_sub(origin.0)
    }
}

/// Velocity in counts per sample, with 16 fractional bits. It saturates at +-32767.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd)]
pub struct Velocity(Q32<16>);

impl Velocity {
    /// Fractional bits of a velocity.
    pub const FRACTION_BITS: u32 = 16;
    /// Largest magnitude, in whole counts per sample.
    pub const LIMIT: i32 = 32_767;
    /// The velocity at standstill.
    pub const ZERO: Self = Self(Q32::from_bits(0));
    /// Largest magnitude, in bits.
    pub(crate) const LIMIT_BITS: i32 = Self::LIMIT << Self::FRACTION_BITS;

    /// The velocity nearest to `counts` counts per sample.
    #[inline]
    pub fn saturating_from_counts(counts: i32) -> Self {
        // The value is nearly always in range, and a single comparison shows that.
        let inside =
            counts.wrapping_add(Self::LIMIT).cast_unsigned() <= 2 * Self::LIMIT.cast_unsigned();
        if inside {
            return Self(Q32::from_bits(counts << Self::FRACTION_BITS));
        }
        cold_path();
        Self(Q32::from_bits(if counts < 0 { -Self::LIMIT_BITS } else { Self::LIMIT_BITS }))
    }

    /// The velocity nearest to `bits` LSB of 2^-16 counts per sample.
    #[inline]
    pub fn saturating_from_bits(bits: i32) -> Self {
        let limit = Self::LIMIT_BITS;
        if bits.wrapping_add(limit).cast_unsigned() <= 2 * limit.cast_unsigned() {
            return Self(Q32::from_bits(bits));
        }
        cold_path();
        Self(Q32::from_bits(if bits < 0 { -limit } else { limit }))
    }

    /// A velocity of `bits` LSB, which must be in its range.
    #[inline(always)]
    pub(crate) fn from_bits_in_range(bits: i32) -> Self {
        debug_assert!(bits.unsigned_abs() <= Self::LIMIT_BITS.cast_unsigned());
        Self(Q32::from_bits(bits))
    }

    /// The velocity in LSB of 2^-16 counts per sample.
    #[inline]
    pub fn bits(self) -> i32 {
        self.0.into_bits()
    }
}

/// Acceleration in counts per sample^2, with 24 fractional bits. It saturates at +-127.
///
/// It is finer than [`Velocity`], because estimators sum it up. At 1 um and 10 kHz the LSB is 6e-6 m/s^2, and the range
/// is 12,700 m/s^2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd)]
pub struct Acceleration(Q32<24>);

impl Acceleration {
    /// Fractional bits of an acceleration.
    pub const FRACTION_BITS: u32 = 24;
    /// Largest magnitude, in counts per sample^2.
    pub const LIMIT: i32 = 127;
    /// No acceleration at all.
    pub const ZERO: Self = Self(Q32::from_bits(0));

    /// The acceleration nearest to `bits` LSB of 2^-24 counts per sample^2.
    #[inline]
    pub fn saturating_from_bits(bits: i32) -> Self {
        let limit = Self::LIMIT << Self::FRACTION_BITS;
        Self(Q32::from_bits(bits.clamp(-limit, limit)))
    }

    /// The acceleration in LSB of 2^-24 counts per sample^2.
    #[inline]
    pub fn bits(self) -> i32 {
        self.0.into_bits()
    }
}

/// Force as a fraction of the actuator's full scale, with 30 fractional bits. A positive force acts into the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd)]
pub struct Force(Q32<30>);

impl Force {
    /// Fractional bits of a force.
    pub const FRACTION_BITS: u32 = 30;
    /// No force at all.
    pub const ZERO: Self = Self(Q32::from_bits(0));
    /// The largest force of the actuator.
    pub const FULL_SCALE: Self = Self(Q32::from_bits(1 << Self::FRACTION_BITS));

    /// The force nearest to `bits` LSB of 2^-30 of full scale. It is limited to +-1 full scale.
    #[inline]
    pub fn saturating_from_bits(bits: i32) -> Self {
        let limit = 1 << Self::FRACTION_BITS;
        Self(Q32::from_bits(bits.clamp(-limit, limit)))
    }

    /// The force in LSB of 2^-30 of full scale.
    #[inline]
    pub fn bits(self) -> i32 {
        self.0.into_bits()
    }
}

/// A requested force, in the unit of [`Force`]. It may be far beyond full scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Demand {
    bits: i64,
    /// Whether the magnitude of `bits` is less than was requested.
    clipped: bool,
}

impl Demand {
    /// No force is requested.
    pub const ZERO: Self = Self::from_bits(0);

    /// A demand of `bits` LSB of 2^-30 of full scale.
    #[inline]
    pub const fn from_bits(bits: i64) -> Self {
        Self { bits, clipped: false }
    }

    /// Returns the same demand. If `clipped` is true, it is marked as less than was requested.
    #[inline]
    #[must_use]
    pub const fn clipped_if(self, clipped: bool) -> Self {
        Self { clipped: self.clipped || clipped, ..self }
    }

    /// The demand in LSB of 2^-30 of full scale.
    #[inline]
    pub const fn bits(self) -> i64 {
        self.bits
    }

    /// Returns `push` minus this demand, which is the net force for the actuator.
    #[inline]
    #[must_use]
    pub fn against(self, push: Force) -> Self {
        Self { bits: i64::from(push.bits()).saturating_sub(self.bits), ..self }
    }

    /// Returns the nearest force that the actuator can give, and whether it is less than was requested.
    #[inline]
    pub fn saturate(self) -> (Force, bool) {
        let limit = 1i64 << Force::FRACTION_BITS;
        let given = self.bits.clamp(-limit, limit);
        #[expect(clippy::cast_possible_truncation, reason = "clamped in the line above")]
        let force = Force(Q32::from_bits(given as i32));
        (force, self.clipped || given != self.bits)
    }
}

/// Command for the output hardware: a DAC code, or a signed PWM compare value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct OutputCode(pub(crate) i32);

impl OutputCode {
    /// The code as a number.
    #[inline]
    pub const fn code(self) -> i32 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{format, string::String};

    /// Returns the row for `quantity` in the table at the head of this file.
    fn row(quantity: &str) -> String {
        let wanted = format!("//! | {quantity} ");
        include_str!("units.rs")
            .lines()
            .find(|line| line.starts_with(&wanted))
            .map(String::from)
            .unwrap_or_else(|| panic!("the table has no row {quantity}"))
    }

    #[test]
    fn the_table_states_the_formats_of_the_types() {
        let velocity = row("[`Velocity`]");
        assert!(velocity.contains(&format!("`Q{}`", Velocity::FRACTION_BITS)));
        assert!(velocity.contains(&format!("2^-{}", Velocity::FRACTION_BITS)));
        assert!(velocity.contains(&format!("+-{}", Velocity::LIMIT)));
        assert_eq!(f64::from(Q32::<16>::DELTA), 2f64.powi(-16));
        let acceleration = row("[`Acceleration`]");
        assert!(acceleration.contains(&format!("`Q{}`", Acceleration::FRACTION_BITS)));
        assert!(acceleration.contains(&format!("2^-{}", Acceleration::FRACTION_BITS)));
        assert!(acceleration.contains(&format!("+-{}", Acceleration::LIMIT)));
        assert_eq!(f64::from(Q32::<24>::DELTA), 2f64.powi(-24));
        assert_eq!(Acceleration::saturating_from_bits(i32::MIN).bits(), -(127 << 24));
        let force = row("[`Force`]");
        assert!(force.contains(&format!("`Q{}`", Force::FRACTION_BITS)));
        assert!(force.contains(&format!("2^-{}", Force::FRACTION_BITS)));
        assert_eq!(f64::from(Q32::<30>::DELTA), 2f64.powi(-30));
        assert_eq!(Position::LIMIT, 1 << 30);
        assert!(row("[`Position`]").contains("+-2^30"));
        let coefficient = row("filter coefficient");
        assert!(coefficient.contains(&format!("`Q{}`", crate::velocity::Biquad::FRACTION_BITS)));
        assert!(row("[`Gain`](crate::Gain)").contains("0, 2^-32 .. 2^54"));
    }

    #[test]
    fn velocity_saturates_at_its_documented_limit() {
        assert_eq!(Velocity::saturating_from_counts(i32::MAX).bits(), 32_767 << 16);
        assert_eq!(Velocity::saturating_from_counts(i32::MIN).bits(), -(32_767 << 16));
        assert_eq!(Velocity::saturating_from_counts(-3).bits(), -3 << 16);
        assert_eq!(Velocity::saturating_from_bits(i32::MIN).bits(), -(32_767 << 16));
    }

    #[test]
    fn a_demand_saturates_to_full_scale_and_says_so() {
        let full = 1i64 << 30;
        for (bits, given, saturated) in [
            (i64::MIN, -full, true),
            (-full - 1, -full, true),
            (-full, -full, false),
            (0, 0, false),
            (full, full, false),
            (full + 1, full, true),
            (i64::MAX, full, true),
        ] {
            let (force, less) = Demand::from_bits(bits).saturate();
            assert_eq!((i64::from(force.bits()), less), (given, saturated));
            assert_eq!(Demand::from_bits(given).saturate(), (force, false), "idempotent");
        }
        assert_eq!(Demand::from_bits(full + 5).against(Force::FULL_SCALE).bits(), -5);
        assert_eq!(Demand::from_bits(i64::MIN).against(Force::FULL_SCALE).bits(), i64::MAX);
        assert_eq!(Force::saturating_from_bits(i32::MIN).bits(), -(1 << 30));
    }

    #[test]
    fn positions_report_leaving_their_range() {
        assert!(Position::from_counts(1 << 30).in_range());
        assert!(!Position::from_counts((1 << 30) + 1).in_range());
        assert!(Position::from_counts(-(1 << 30)).in_range());
        assert!(!Position::from_counts(i32::MIN).in_range());
    }
}
