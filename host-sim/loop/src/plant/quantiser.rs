//! The encoder's scale: positions to counts. The lanes' text of it is
//! `Chunk::count` of the engine, which tests hold to this one.

use crate::scene::{Encoder, Rounding};

/// How an encoder makes a count of a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantiser {
    /// m per count.
    pub resolution_m: f64,
    /// Which count a position between two borders becomes.
    pub rounding: Rounding,
}

impl Quantiser {
    /// That of a scene's encoder.
    pub fn of(encoder: &Encoder) -> Self {
        Self { resolution_m: encoder.resolution_m, rounding: encoder.rounding }
    }

    /// The place of `position_m` on the scale whose whole numbers are the borders of the counts.
    #[inline]
    pub fn place(&self, position_m: f64) -> f64 {
        let exact = position_m / self.resolution_m;
        match self.rounding {
            Rounding::Floor => exact,
            Rounding::Round => exact + 0.5,
        }
    }

    /// The count of `position_m`. Saturates at the ends of `i32`.
    #[inline]
    pub fn count(&self, position_m: f64) -> i32 {
        floor(self.place(position_m))
    }
}

/// Adding it to a number below 2^51 leaves the nearest integer in the low bits of the sum.
pub(crate) const INTEGER: f64 = 1.5 * (1u64 << 52) as f64;

/// The largest integer not above `value`, saturating at the ends of `i32`: `INTEGER` gives the nearest one, and a
/// rounding up is taken back. A third of the instructions of `value.floor() as i32`.
#[inline]
pub fn floor(value: f64) -> i32 {
    let value = value.clamp(f64::from(i32::MIN), f64::from(i32::MAX));
    let sum = value + INTEGER;
    #[expect(clippy::cast_possible_truncation, reason = "the low 32 bits are the integer")]
    let nearest = (sum.to_bits() as u32).cast_signed();
    nearest.wrapping_sub(i32::from(sum - INTEGER > value)) // i32::MIN is not rounded up to
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let count =
            |rounding, position_m| Quantiser { resolution_m: 1e-6, rounding }.count(position_m);
        for (position_m, floor, round) in
            [(2.4e-6, 2, 2), (2.6e-6, 2, 3), (-0.4e-6, -1, 0), (-0.6e-6, -1, -1), (0.0, 0, 0)]
        {
            assert_eq!(count(Rounding::Floor, position_m), floor, "{position_m}");
            assert_eq!(count(Rounding::Round, position_m), round, "{position_m}");
        }
    }
}
