//! Quantisation of positions to counts. In lanes, `Chunk::count` of the engine does the same. Tests compare the two.

use std::hint::cold_path;

use crate::scene::{Encoder, Rounding};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantiser {
    /// Length of a count, in m.
    pub resolution_m: f64,
    pub rounding: Rounding,
    /// Counts per metre: the reciprocal of the resolution.
    per_m: f64,
    /// [`ABOVE`], plus 1/2 if the encoder rounds to nearest. This number is added to a position in counts.
    above: f64,
}

/// Constant that is added to a number in the range of `i32`. The low 52 bits of the sum are the number plus 2^31, in
/// units of 2^-20.
const ABOVE: f64 = 1.5 * (1u64 << 32) as f64;
const FRACTION_BITS: u32 = 20;
/// Smallest distance to a whole number that is still safe, in units of 2^-20. If a sum is at least this far from every
/// whole number, sum and exact quotient have the same floor.
const CLOSE: u64 = 4;

impl Quantiser {
    pub fn of(encoder: &Encoder) -> Self {
        let (resolution_m, rounding) = (encoder.resolution_m, encoder.rounding);
        let above = ABOVE + if rounding == Rounding::Round { 0.5 } else { 0.0 };
        Self { resolution_m, rounding, per_m: 1.0 / resolution_m, above }
    }

    /// `position_m` in counts, as a real number. Each whole number is the border between two counts.
    #[inline]
    pub fn place(&self, position_m: f64) -> f64 {
        let exact = position_m / self.resolution_m;
        match self.rounding {
            Rounding::Floor => exact,
            Rounding::Round => exact + 0.5,
        }
    }

    /// The count of `position_m`: the floor of its [`place`](Self::place), saturated to the range of `i32`.
    ///
    /// Nearly all counts are computed without a division, because a division is slow. Below 2^31 counts, the product
    /// with the reciprocal differs from the quotient by at most 3 * 2^-53 * 2^31 < 2^-20. The two additions to the
    /// product add errors of 2^-21 and 2^-22. So the floors of sum and quotient can differ only if a whole number is
    /// closer than 4 * 2^-20.
    #[inline]
    pub fn count(&self, position_m: f64) -> i32 {
        let sum = position_m * self.per_m + self.above;
        let bits = sum.to_bits().wrapping_sub(((1u64 << 32) as f64).to_bits());
        let fraction = bits.wrapping_add(CLOSE) & ((1 << FRACTION_BITS) - 1);
        if bits < 1 << 52 && fraction >= 2 * CLOSE {
            #[expect(clippy::cast_possible_truncation, reason = "52 bits, less 20")]
            return ((bits >> FRACTION_BITS) as u32 ^ 1 << 31).cast_signed();
        }
        cold_path();
        floor(self.place(position_m))
    }
}

/// Constant that is added to a number below 2^51. The low bits of the sum are then the integer nearest to the number.
pub(crate) const INTEGER: f64 = 1.5 * (1u64 << 52) as f64;

/// The largest integer not above `value`, saturated to the range of `i32`. The sum with `INTEGER` gives the nearest
/// integer. If this integer is above `value`, 1 is subtracted. The function needs a third of the instructions of
/// `value.floor() as i32`.
#[inline]
pub fn floor(value: f64) -> i32 {
    let value = value.clamp(f64::from(i32::MIN), f64::from(i32::MAX));
    let sum = value + INTEGER;
    #[expect(clippy::cast_possible_truncation, reason = "the low 32 bits are the integer")]
    let nearest = (sum.to_bits() as u32).cast_signed();
    nearest.wrapping_sub(i32::from(sum - INTEGER > value)) // i32::MIN is never the result of rounding up
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn floor_is_the_floor_and_saturates() {
        let ends = [f64::from(i32::MIN), f64::from(i32::MAX)];
        let mut values = vec![0.0, -0.0, 0.5, -0.5, 1e-300, -1e-300, 1e300, -1e300];
        for whole in [-7.0, -1.0, 1.0, 2.0, 70_000.0].into_iter().chain(ends) {
            values.extend([whole, f64::next_down(whole), f64::next_up(whole), whole + 0.5]);
        }
        values.extend([f64::INFINITY, f64::NEG_INFINITY]);
        for value in values {
            #[expect(clippy::cast_possible_truncation, reason = "saturates, as it must")]
            let expected = value.floor() as i32;
            assert_eq!(floor(value), expected, "{value:e}");
        }
    }

    #[test]
    fn the_encoder_floors_or_rounds() {
        let count = |rounding, position_m| {
            Quantiser::of(&Encoder { resolution_m: 1e-6, rounding }).count(position_m)
        };
        for (position_m, floor, round) in
            [(2.4e-6, 2, 2), (2.6e-6, 2, 3), (-0.4e-6, -1, 0), (-0.6e-6, -1, -1), (0.0, 0, 0)]
        {
            assert_eq!(count(Rounding::Floor, position_m), floor, "{position_m}");
            assert_eq!(count(Rounding::Round, position_m), round, "{position_m}");
        }
    }

    /// The count is the floor of the place. Tested at and near borders, at the ends of the range, for NaN, and for
    /// random positions.
    #[test]
    fn a_count_is_the_floor_of_its_place() {
        let numbers = (0..).map(|n| random::uniform_with_zero(20_261_126, n));
        let mut numbers = numbers.map(|number| 2.0 * number - 1.0);
        for rounding in [Rounding::Floor, Rounding::Round] {
            for resolution_m in [1e-6, 2e-6, 3.7e-9, 1.0 / 3.0, 2f64.powi(-20), 1e-300, 1e300] {
                let quantiser = Quantiser::of(&Encoder { resolution_m, rounding });
                let check = |position_m: f64| {
                    let place = quantiser.place(position_m);
                    let count = quantiser.count(position_m);
                    assert_eq!(count, floor(place), "{position_m:e} m of {quantiser:?}");
                };
                for border in [0.0, 0.5, 1.0, 7.0, 4e5, 2f64.powi(30), 2f64.powi(31), 2f64.powi(33)]
                {
                    for position_m in [border * resolution_m, -border * resolution_m] {
                        check(position_m);
                        check(position_m.next_up());
                        check(position_m.next_down());
                    }
                }
                [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, f64::MAX].into_iter().for_each(check);
                for exponent in 0..35 {
                    for number in numbers.by_ref().take(300) {
                        let place = number * 2f64.powi(exponent);
                        check(place * resolution_m);
                        check(place.round() * resolution_m); // at a border, or beside it by the last digit
                    }
                }
            }
        }
    }
}
