//! Turns the count of the encoder into a [`Position`]. This is the first stage of the loop, and it runs for every
//! sample.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use crate::units::Position;

/// Width of the hardware counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CounterWidth {
    /// A 16-bit timer. The handle must move less than 2^15 counts between two samples.
    Bits16,
    /// A 32-bit timer, such as TIM2 or TIM5. The simulator uses it too.
    Bits32,
}

/// The width of a counter, as a value or as a type. Code that knows the type does not need to look up the width.
pub trait Width: Copy {
    /// The width as a value.
    fn value(self) -> CounterWidth;
}

impl Width for CounterWidth {
    #[inline(always)]
    fn value(self) -> CounterWidth {
        self
    }
}

/// [`CounterWidth::Bits32`] as a type.
#[derive(Clone, Copy, Debug)]
pub struct Bits32;

impl Width for Bits32 {
    #[inline(always)]
    fn value(self) -> CounterWidth {
        CounterWidth::Bits32
    }
}

/// Turns the readings of a wrapping counter into positions whose differences are exact.
///
/// The count at position 0 follows from the last count and the last position. The count at position 0 is also stored,
/// for a check: see [`is_whole`](Self::is_whole).
#[derive(Clone, Copy, Debug)]
pub struct Encoder<W = CounterWidth> {
    width: W,
    /// The last reading, in 32 bits also for a narrow counter.
    count: u32,
    position: Position,
    /// The count at position 0.
    origin: u32,
}

impl<W: Width> Encoder<W> {
    /// Begins with a counter that reads `counter` now. The position is this reading as a signed number.
    pub fn new(counter: u32, width: W) -> Self {
        let position = Position::from_counts(signed(counter, width));
        Self { width, count: position.counts().cast_unsigned(), position, origin: 0 }
    }

    /// This encoder with the counter's width as a value instead of a type.
    pub(crate) fn of_any_width(self) -> Encoder {
        let Self { width, count, position, origin } = self;
        Encoder { width: width.value(), count, position, origin }
    }

    /// Takes the counter's present reading and returns the position, in counts.
    #[inline]
    pub fn track(&mut self, counter: u32) -> Position {
        let moved = signed(counter.wrapping_sub(self.count), self.width);
        self.count = self.count.wrapping_add_signed(moved);
        self.position = self.position.wrapping_add(moved);
        self.position
    }

    /// Begins several readings. Each reading then returns the counts since the previous reading. Call
    /// [`moved`](Self::moved) after the last reading.
    #[inline]
    pub(crate) fn moves(&self) -> Moves<W> {
        Moves { width: self.width, count: self.count }
    }

    /// Takes over the count after these readings, and changes the position by the difference.
    #[inline]
    pub(crate) fn moved(&mut self, moves: &Moves<W>) {
        let moved = moves.count.wrapping_sub(self.count).cast_signed();
        self.count = moves.count;
        self.position = self.position.wrapping_add(moved);
    }

    /// Makes the last reading position 0.
    pub fn zero(&mut self) {
        self.position = Position::default();
        self.origin = self.count;
    }

    /// The position of the last reading.
    pub fn position(&self) -> Position {
        self.position
    }

    /// Whether the count at position 0 is unchanged. It is `false` if a bit of count, position or origin has flipped.
    /// Then every wall would be at another place.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.count.wrapping_add_signed(self.position.counts().wrapping_neg()) == self.origin
    }
}

/// The counter of an encoder during several readings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moves<W> {
    width: W,
    count: u32,
}

impl<W: Width> Moves<W> {
    /// Counts from the last reading to this reading. They are negative for a motion backwards.
    #[inline(always)]
    pub(crate) fn to(&mut self, counter: i32) -> i32 {
        let moved = signed(counter.cast_unsigned().wrapping_sub(self.count), self.width);
        self.count = self.count.wrapping_add_signed(moved);
        moved
    }
}

#[cfg(test)]
impl<W> Encoder<W> {
    pub(crate) fn spoil_origin(&mut self) {
        self.origin ^= 1 << 7;
    }
}

/// Returns a reading as a signed number. For a counter of 16 bits only the lower half is used.
#[inline]
fn signed(value: u32, width: impl Width) -> i32 {
    if width.value() == CounterWidth::Bits16 {
        cold_path();
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

    #[test]
    fn any_flipped_bit_of_what_it_remembers_is_told_until_the_next_zero() {
        for width in [CounterWidth::Bits16, CounterWidth::Bits32] {
            let mut whole = Encoder::new(0x5A5A, width);
            whole.zero();
            whole.track(0x5A5A - 300);
            for bit in 0..32 {
                let bit = 1u32 << bit;
                let mut broken = [whole; 3];
                broken[0].count ^= bit;
                broken[1].position =
                    Position::from_counts(whole.position.counts() ^ bit.cast_signed());
                broken[2].origin ^= bit;
                for mut broken in broken {
                    broken.track(0x5A5A + 17);
                    assert!(!broken.is_whole(), "{bit:#x} of {whole:?}: {broken:?}");
                    broken.zero();
                    assert!(broken.is_whole() && broken.position() == Position::default());
                }
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
            let mut typed = Encoder::new(counter, Bits32);
            for step in steps {
                let before = encoder.position();
                counter = counter.wrapping_add_signed(step) & mask;
                let position = encoder.track(counter);
                prop_assert_eq!(position.wrapping_since(before), step);
                prop_assert!(encoder.is_whole());
                prop_assert!(narrow || typed.track(counter) == position);
            }
            prop_assert!(narrow || typed.of_any_width().position() == encoder.position());
        }
    }
}
