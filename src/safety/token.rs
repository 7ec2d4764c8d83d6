//! Requests with a number, so that a flipped bit cannot look like a request.

/// A request with a number. The upper half has the number in 16 bits, the lower half its complement. A token is a
/// request if its number differs from the last number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token(u32);

/// The bits in which a turned [`Token`] differs from the token itself. With these bits it is turned back without a
/// branch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Turn(u32);

impl Turn {
    pub(super) const NONE: Self = Self(0);
    pub(super) const HALF: Self = Self(0xFFFF);
}

impl Token {
    /// Number 0, before the first request.
    pub const FIRST: Self = Self::of(0);

    const fn of(number: u16) -> Self {
        Self((number as u32) << 16 | !number as u32)
    }

    /// Returns the token of the next request. Its number wraps.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "16 bits")]
    pub const fn next(self) -> Self {
        Self::of((self.number() as u16).wrapping_add(1))
    }

    /// Number of the request, 16 bits.
    #[inline(always)]
    pub const fn number(self) -> u32 {
        self.0 >> 16
    }

    /// Whether this token requests something new after `last`. Two valid tokens differ in the same bits of both halves.
    /// A flipped bit makes a difference in only one half.
    #[inline(always)]
    pub const fn asks_after(self, last: Self) -> bool {
        let differs = self.0 ^ last.0;
        self.number() != last.number() && differs == differs.rotate_right(16)
    }

    /// Returns this token with its number in both halves. The result is not a valid request and equals none. A second
    /// turn restores the token.
    #[must_use]
    #[inline(always)]
    pub const fn turned(self) -> Self {
        self.by(Turn::HALF)
    }

    /// Returns this token with these bits inverted.
    #[must_use]
    #[inline(always)]
    pub(super) const fn by(self, turn: Turn) -> Self {
        Self(self.0 ^ turn.0)
    }

    /// The bits for [`by`](Self::by) that turn this token back, or no bits if it is not turned.
    #[inline(always)]
    pub(super) const fn turn(self) -> Turn {
        if self.is_turned() { Turn::HALF } else { Turn::NONE }
    }

    /// Whether this token is turned, so that its two halves are equal.
    #[inline(always)]
    pub const fn is_turned(self) -> bool {
        self.0 == self.0.rotate_right(16)
    }
}

#[cfg(test)]
impl Token {
    pub(super) const fn flipped(self, bit: u32) -> Self {
        Self(self.0 ^ 1 << bit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of requests that are tried. They are all numbers of a token.
    const NUMBERS: u32 = if cfg!(miri) { 100 } else { 0x1_0000 };

    #[test]
    fn each_asks_once_and_no_flipped_bit_does() {
        let mut token = Token::FIRST;
        for number in 0..=NUMBERS {
            let next = token.next();
            assert_eq!(token.number(), number & 0xFFFF);
            let turned = token.turned();
            assert_eq!((token.turn(), turned.turn()), (Turn::NONE, Turn::HALF));
            assert_eq!((turned.number(), turned.by(turned.turn())), (token.number(), token));
            assert!(next.asks_after(token) && !token.asks_after(token));
            for bit in 0..32 {
                let flipped = token.flipped(bit);
                assert!(!flipped.asks_after(token) && !token.asks_after(flipped), "{number} {bit}");
            }
            token = next;
        }
        assert_eq!(token.number(), (NUMBERS + 1) & 0xFFFF);
    }

    /// If the memory contains no valid token, nothing is requested.
    #[test]
    fn a_word_of_equal_bits_asks_for_nothing() {
        for bits in [0, u32::MAX] {
            assert!(!Token(bits).asks_after(Token::FIRST), "{bits:#x}");
        }
    }
}
