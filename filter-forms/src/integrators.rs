//! State-variable and delta form in fixed point: their states are integrators, held in wide words, so
//! a low cutoff costs no accuracy of the coefficients that matter.
//!
//! Equations as in [`crate::float`]. What the delta form rounds is its output, which goes back through both
//! integrators: that is the error feedback of the second order, by structure. The state-variable form
//! goes on with what it has not rounded, so the rounding of its output is neither fed back nor shaped.

use crate::{
    Prototype, Refused, Signal, Step,
    fixed::{fraction, round},
    word::{Wide as _, Word},
};

#[expect(clippy::cast_precision_loss, reason = "a power of two")]
fn power(bits: u32) -> f64 {
    (1u64 << bits) as f64
}

/// State-variable form with trapezoidal integrators.
#[derive(Clone, Copy, Debug)]
pub struct StateVariable<W: Word> {
    g: W,
    d: W,
    s: [W::Wide; 2],
}

impl<W: Word> StateVariable<W> {
    /// Bits of a state below the signal's LSB; three are left above for its overshoot.
    const BELOW: u32 = W::BITS - 4;

    /// At rest.
    ///
    /// # Errors
    /// `g` rounds to 0.
    pub fn new(p: &Prototype) -> Result<Self, Refused> {
        let one = power(fraction(W::BITS));
        let [g, d] = [p.g(), p.d()].map(|value| W::of_f64(round(value * one)));
        if g == W::ZERO {
            return Err(Refused::Zero { coefficient: "g", fraction: fraction(W::BITS) });
        }
        Ok(Self { g, d, s: [W::Wide::ZERO; 2] })
    }
}

impl<W: Word + Signal> Step for StateVariable<W> {
    type Signal = W;

    #[inline]
    fn step(&mut self, x: W) -> W {
        let bits = fraction(W::BITS);
        let [s1, s2] = self.s;
        let v =
            self.d.times_wide(self.g.times_wide(x.wide().up(Self::BELOW) - s2, bits) + s1, bits);
        let rise = self.g.times_wide(v, bits);
        let y = rise + s2;
        self.s = [v + v - s1, y + rise];
        W::clipped((y + W::Wide::one_at(Self::BELOW - 1)).down(Self::BELOW))
    }
}

/// Delta form.
#[derive(Clone, Copy, Debug)]
pub struct Delta<W: Word> {
    b0: W,
    /// `alpha1 2^alpha1_bits`.
    alpha1: W,
    alpha1_bits: u32,
    /// `alpha2 2^alpha2_bits`; also the numerator's middle coefficient.
    alpha2: W,
    alpha2_bits: u32,
    /// Bits of the first state below the signal's LSB, at most `alpha2_bits`.
    below: u32,
    /// In units of `2^-below` and `2^-alpha2_bits` LSB.
    s: [W::Wide; 2],
}

impl<W: Word> Delta<W> {
    /// At rest.
    ///
    /// # Errors
    /// `alpha2` rounds to 0.
    pub fn new(p: &Prototype) -> Result<Self, Refused> {
        // As many bits as alpha1 fills a word with.
        let mut alpha1_bits = W::BITS - 3;
        while p.alpha1() * power(alpha1_bits + 1) < power(W::BITS - 2) && alpha1_bits < 62 {
            alpha1_bits += 1;
        }
        // The second state stays below 4 alpha1 times the largest signal.
        let alpha2_bits = alpha1_bits - 2;
        let alpha2 = W::of_f64(round(p.alpha2() * power(alpha2_bits)));
        if alpha2 == W::ZERO {
            return Err(Refused::Zero { coefficient: "1 + a1 + a2", fraction: alpha2_bits });
        }
        let below = alpha2_bits.min(W::BITS - 3);
        Ok(Self {
            b0: W::of_f64(round(p.b0() * power(below))),
            alpha1: W::of_f64(round(p.alpha1() * power(alpha1_bits))),
            alpha1_bits,
            alpha2,
            alpha2_bits,
            below,
            s: [W::Wide::ZERO; 2],
        })
    }
}

impl<W: Word + Signal> Step for Delta<W> {
    type Signal = W;

    /// The states stay at their ends, so that an overload ends with its input.
    #[inline]
    fn step(&mut self, x: W) -> W {
        let half = W::Wide::one_at(self.below - 1);
        let sum = self.s[0].clipped_add(self.b0.times(x)).clipped_add(half);
        let y = W::clipped(sum.down(self.below));
        let (forward, back) = (self.alpha2.times(x), self.alpha1.times(y));
        let rise = self.s[1].clipped_add(forward).down(self.alpha2_bits - self.below);
        let fall = back.down(self.alpha1_bits - self.below);
        self.s[0] = self.s[0].clipped_add(rise.clipped_add(-fall));
        self.s[1] = self.s[1].clipped_add(forward - self.alpha2.times(y));
        y
    }
}
