//! Encoder counter to [`Position`]: the first stage, run for every sample.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use crate::units::Position;

/// Width of the hardware counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CounterWidth {
    /// A 16-bit timer. The handle must move less than 2^15 counts between two samples.
    Bits16,
    /// A 32-bit timer (TIM2, TIM5), and the simulator.
    Bits32,
}

/// Unwraps a counter that wraps around into positions whose differences are exact.
///
/// It remembers which count is position 0, and no position: nothing adds up, so that a flipped bit of a 32-bit
/// counter's last reading is gone with the next one. The origin is kept twice, see [`is_whole`](Self::is_whole). What a
/// 16-bit counter has counted beyond its 16 bits is kept once.
#[derive(Clone, Copy, Debug)]
pub struct Encoder {
    narrow: bool,
    /// The last reading, unwrapped.
    count: u32,
    /// The count at position 0.
    origin: u32,
    /// Complement of the origin.
    origin_check: u32,
}

impl Encoder {
    /// An encoder whose counter reads `counter` now; that reading, taken as signed, is its position.
    pub fn new(counter: u32, width: CounterWidth) -> Self {
        let narrow = width == CounterWidth::Bits16;
        let count = signed(counter, narrow).cast_unsigned();
        Self { narrow, count, origin: 0, origin_check: !0 }
    }

    /// Takes the counter's present reading and returns the position, in counts.
    #[inline]
    pub fn track(&mut self, counter: u32) -> Position {
        self.count = if self.narrow {
            cold_path();
            self.count.wrapping_add_signed(signed(counter.wrapping_sub(self.count), true))
        } else {
            counter
        };
        self.position()
    }

    /// Makes the place of the last reading position 0.
    pub fn zero(&mut self) {
        self.origin = self.count;
        self.origin_check = !self.count;
    }

    /// The position of the last reading.
    #[inline(always)]
    pub fn position(&self) -> Position {
        Position::from_counts(self.count.wrapping_sub(self.origin).cast_signed())
    }

    /// Whether position 0 is where it was put: with another one, walls would stand elsewhere.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.origin == !self.origin_check
    }
}

#[cfg(test)]
impl Encoder {
    /// A bit of the count at position 0 has flipped.
    pub(crate) fn spoil_origin(&mut self) {
        self.origin ^= 1 << 7;
    }
}

/// A reading as signed, of its lower half only if the counter is `narrow`.
#[inline]
fn signed(value: u32, narrow: bool) -> i32 {
    if narrow {
        #[expect(clippy::cast_possible_truncation, reason = "the lower half is meant")]
        return i32::from((value as u16).cast_signed());
    }
    value.cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_16_bit_counter_is_followed_across_its_wrap_in_both_directions() {
        let mut encoder = Encoder::new(0xFFFE, CounterWidth::Bits16);
        assert_eq!(encoder.position().counts(), -2);
        assert_eq!(encoder.track(0x0003).counts(), 3);
        assert_eq!(encoder.track(0xFFF0).counts(), -16);
    }

    #[test]
    fn a_32_bit_counter_starts_at_its_signed_reading() {
        let mut encoder = Encoder::new(u32::MAX, CounterWidth::Bits32);
        assert_eq!(encoder.position().counts(), -1);
        assert_eq!(encoder.track(1).counts(), 1);
    }

    /// A bit that flips in what it remembers is told, or is gone with the next reading, or moves no position.
    #[test]
    fn no_flipped_bit_of_a_32_bit_counter_s_memory_moves_the_origin_unnoticed() {
        let mut whole = Encoder::new(1 << 20, CounterWidth::Bits32);
        whole.zero();
        for bit in 0..32 {
            let flips: [fn(&mut Encoder) -> &mut u32; 3] =
                [|e| &mut e.count, |e| &mut e.origin, |e| &mut e.origin_check];
            for flipped in flips {
                let (mut encoder, mut broken) = (whole, whole);
                *flipped(&mut broken) ^= 1 << bit;
                let next = (1 << 20) + 17;
                let moved = broken.track(next) != encoder.track(next);
                assert!(!moved || !broken.is_whole(), "bit {bit}");
                broken.zero();
                assert!(broken.is_whole() && broken.position() == Position::default());
            }
        }
    }

    proptest! {
        #[test]
        fn any_walk_is_tracked_exactly(
            start in any::<u32>(),
            steps in prop::collection::vec(-32_768i32..=32_767, 1..200),
            narrow in any::<bool>(),
        ) {
            let width = if narrow { CounterWidth::Bits16 } else { CounterWidth::Bits32 };
            let mask = if narrow { 0xFFFF } else { u32::MAX };
            let mut counter = start & mask;
            let mut encoder = Encoder::new(counter, width);
            for step in steps {
                let before = encoder.position();
                counter = counter.wrapping_add_signed(step) & mask;
                prop_assert_eq!(encoder.track(counter).wrapping_since(before), step);
            }
        }
    }
}
