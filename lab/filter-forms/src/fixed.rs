//! Direct forms in fixed point, with or without error feedback. They follow the rules of the core. For Q15 each word is
//! half as wide.
//!
//! A coefficient has two bits before the point, because `|a1|` reaches 1.98. The other bits are after the point: 30
//! bits in a 32-bit word, 14 bits in Q15. The core's rule makes the DC gain exactly one. This is the best that these
//! words allow. Without this rule each coefficient would be rounded separately. Then Q15 at 20 Hz and 10 kHz would have
//! `b0 = 1` and `1 + a1 + a2 = 2` LSB, which is a DC gain of 2.
//!
//! A sum of products fits into the wide word with the same margin as in the core: `|b0| + .. + |a2| < 4`.

use zwidth::velocity::Shaping;

use crate::{
    Prototype, Refused, Signal, Step,
    word::{Wide as _, Word},
};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients<W> {
    /// The coefficients of the numerator, b0, b1 and b2.
    pub b: [W; 3],
    /// The coefficients of the denominator, a1 and a2.
    pub a: [W; 2],
}

/// Number of fractional bits of a coefficient, if a word has `word_bits` bits.
pub const fn fraction(word_bits: u32) -> u32 {
    word_bits - 2
}

/// Rounds to the nearest integer, ties away from zero, without `std`.
pub(crate) fn round(value: f64) -> f64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "below 2^53")]
    let whole = (value + if value < 0.0 { -0.5 } else { 0.5 }) as i64 as f64;
    whole
}

impl<W: Word> Coefficients<W> {
    /// Coefficients by the core's rule: `b0`, `a2` and the DC sum `4 b0` are rounded. `a1` and `b1` follow from these
    /// values.
    ///
    /// # Errors
    /// The DC sum rounds to 0. The output could then never change.
    pub fn exact_at_dc(p: &Prototype) -> Result<Self, Refused> {
        #[expect(clippy::cast_precision_loss, reason = "a power of two")]
        let one = (1u64 << fraction(W::BITS)) as f64;
        let (a2, b0, dc_sum) =
            (round(p.a2() * one), round(p.b0() * one), round(4.0 * p.b0() * one));
        if dc_sum == 0.0 {
            return Err(Refused::Zero { coefficient: "1 + a1 + a2", fraction: fraction(W::BITS) });
        }
        let (a1, b1) = (dc_sum - one - a2, dc_sum - 2.0 * b0);
        Ok(Self { b: [b0, b1, b0].map(W::of_f64), a: [a1, a2].map(W::of_f64) })
    }
}

/// Computes `b0 x + b1 x1 + b2 x2 - a1 y1 - a2 y2`.
#[inline]
fn sum<W: Word>(c: &Coefficients<W>, x: [W; 3], y: [W; 2]) -> W::Wide {
    c.b[0].times(x[0]) + c.b[1].times(x[1]) + c.b[2].times(x[2])
        - c.a[0].times(y[0])
        - c.a[1].times(y[1])
}

/// Direct form 1 without error feedback. The output saturates as in the core.
#[derive(Clone, Copy, Debug)]
pub struct Direct1<W: Word> {
    c: Coefficients<W>,
    x: [W; 2],
    y: [W; 2],
}

impl<W: Word> Direct1<W> {
    pub fn new(c: Coefficients<W>) -> Self {
        Self { c, x: [W::ZERO; 2], y: [W::ZERO; 2] }
    }
}

impl<W: Word + Signal> Step for Direct1<W> {
    type Signal = W;

    #[inline]
    fn step(&mut self, x: W) -> W {
        let bits = fraction(W::BITS);
        let sum = sum(&self.c, [x, self.x[0], self.x[1]], self.y);
        let y = W::clipped((sum + (W::Wide::ONE << (bits - 1))) >> bits);
        self.x = [x, self.x[0]];
        self.y = [y, self.y[0]];
        y
    }
}

/// Direct form 1 with the core's error feedback.
#[derive(Clone, Copy, Debug)]
pub struct Direct1Feedback<W: Word> {
    c: Coefficients<W>,
    shaping: Shaping,
    x: [W; 2],
    y: [W; 2],
    e: [W::Wide; 2],
}

impl<W: Word> Direct1Feedback<W> {
    pub fn new(c: Coefficients<W>, shaping: Shaping) -> Self {
        Self { c, shaping, x: [W::ZERO; 2], y: [W::ZERO; 2], e: [W::Wide::ZERO; 2] }
    }
}

impl<W: Word + Signal> Step for Direct1Feedback<W> {
    type Signal = W;

    #[inline]
    fn step(&mut self, x: W) -> W {
        let bits = fraction(W::BITS);
        let half = W::Wide::ONE << (bits - 1);
        let [e1, e2] = self.e;
        let carried = match self.shaping {
            Shaping::First => e1,
            Shaping::Second => e1 + (e1 - e2),
        };
        let total = sum(&self.c, [x, self.x[0], self.x[1]], self.y) + carried + half;
        let y = W::clipped(total >> bits);
        self.e = [(total & ((W::Wide::ONE << bits) - W::Wide::ONE)) - half, e1];
        self.x = [x, self.x[0]];
        self.y = [y, self.y[0]];
        y
    }
}

/// Transposed direct form 2. Its two sums are wide words, so only the output is rounded. The sums are those of direct
/// form 1 in another order. Without saturation the outputs of both forms are equal to the bit.
#[derive(Clone, Copy, Debug)]
pub struct Direct2Transposed<W: Word> {
    c: Coefficients<W>,
    s: [W::Wide; 2],
}

impl<W: Word> Direct2Transposed<W> {
    pub fn new(c: Coefficients<W>) -> Self {
        Self { c, s: [W::Wide::ZERO; 2] }
    }
}

impl<W: Word + Signal> Step for Direct2Transposed<W> {
    type Signal = W;

    #[inline]
    fn step(&mut self, x: W) -> W {
        let bits = fraction(W::BITS);
        let Coefficients { b, a } = self.c;
        let total = b[0].times(x) + self.s[0] + (W::Wide::ONE << (bits - 1));
        let y = W::clipped(total >> bits);
        self.s[0] = b[1].times(x) - a[0].times(y) + self.s[1];
        self.s[1] = b[2].times(x) - a[1].times(y);
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zwidth::{
        units::Velocity,
        velocity::{BiquadState, ButterworthDesign},
    };

    /// Speed of a hand at sample `n`, in LSB. The motion is fast, slow, backwards and zero in turn.
    fn speeds(n: i32) -> i32 {
        let seed = n.wrapping_mul(1_103_515_245).wrapping_add(12_345);
        match n / 500 % 4 {
            0 => (seed >> 8) % 200_000_000,
            1 => (seed >> 16) % 70_000,
            2 => -150_000_000,
            _ => 0,
        }
    }

    #[test]
    fn with_words_of_32_bits_it_is_the_core_to_the_bit() {
        for cutoff_hz in [0.35, 1.0, 20.0, 200.0, 639.0, 641.0, 2000.0, 4990.0] {
            let core = ButterworthDesign::new(cutoff_hz, 1e4, false).unwrap().quantise();
            let c = Coefficients::<i32>::exact_at_dc(&Prototype::new(cutoff_hz, 1e4)).unwrap();
            assert_eq!(core.bits(), [c.b[0], c.b[1], c.b[2], c.a[0], c.a[1]], "{cutoff_hz}");
            let mut same = Direct1Feedback::new(c, core.shaping());
            let mut state = BiquadState::default();
            for n in 0..20_000 {
                let expected = core.update(&mut state, Velocity::saturating_from_bits(speeds(n)));
                assert_eq!(same.step(speeds(n)), expected.bits(), "{cutoff_hz}, {n}");
            }
        }
    }

    #[test]
    fn the_transposed_form_has_the_same_output() {
        for cutoff_hz in [0.5, 20.0, 1500.0] {
            let c = Coefficients::<i32>::exact_at_dc(&Prototype::new(cutoff_hz, 1e4)).unwrap();
            let (mut one, mut two) = (Direct1::new(c), Direct2Transposed::new(c));
            for n in 0..20_000 {
                assert_eq!(one.step(speeds(n)), two.step(speeds(n)), "{cutoff_hz}, {n}");
            }
        }
    }

    #[test]
    fn q15_at_20_hz_has_one_lsb_of_b0_and_none_below() {
        let p = Prototype::new(20.0, 1e4);
        assert!((p.b0() * 32_768.0 - 1.28).abs() < 0.01, "1.28 LSB with 15 fractional bits");
        let c = Coefficients::<i16>::exact_at_dc(&p).unwrap();
        assert_eq!((c.b, c.a), ([1, 1, 1], [-32_476, 16_095]));
        let refused = Coefficients::<i16>::exact_at_dc(&Prototype::new(5.0, 1e4)).unwrap_err();
        assert!(refused.to_string().contains("1 + a1 + a2"), "{refused}");
    }
}
