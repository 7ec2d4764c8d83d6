//! State-variable and delta form in fixed point. The states of both forms are integrators in wide words. So the
//! important coefficients are accurate even at a low cutoff.
//!
//! The equations are in [`crate::float`]. The delta form feeds its rounded output back through both integrators. This
//! acts as second-order error feedback. The state-variable form continues with the value before rounding. So the
//! rounding error is not fed back and not shaped.

use crate::{
    Prototype, Refused, Signal, Step,
    fixed::{fraction, round},
    word::{Wide as _, Word},
};

#[expect(clippy::cast_precision_loss, reason = "a power of two")]
fn power(bits: u32) -> f64 {
    (1u64 << bits) as f64
}

#[derive(Clone, Copy, Debug)]
pub struct StateVariable<W: Word> {
    g: W,
    d: W,
    s: [W::Wide; 2],
}

impl<W: Word> StateVariable<W> {
    /// Number of bits that a state has below the signal's LSB. Three bits are left above the signal for overshoot.
    const BELOW: u32 = W::BITS - 4;

    /// A filter at rest.
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
            self.d.times_wide(self.g.times_wide((x.wide() << Self::BELOW) - s2, bits) + s1, bits);
        let rise = self.g.times_wide(v, bits);
        let y = rise + s2;
        self.s = [v + v - s1, y + rise];
        W::clipped((y + (W::Wide::ONE << (Self::BELOW - 1))) >> Self::BELOW)
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Delta<W: Word> {
    b0: W,
    /// The coefficient is stored as the integer `alpha1 2^alpha1_bits`.
    alpha1: W,
    alpha1_bits: u32,
    /// The coefficient is stored as the integer `alpha2 2^alpha2_bits`. `alpha2` is also the numerator's middle
    /// coefficient.
    alpha2: W,
    alpha2_bits: u32,
    /// Number of bits that the first state has below the signal's LSB. It is at most `alpha2_bits`.
    below: u32,
    /// The two states. The first is in units of `2^-below` LSB, the second in units of `2^-alpha2_bits` LSB.
    s: [W::Wide; 2],
}

impl<W: Word> Delta<W> {
    /// A filter at rest.
    ///
    /// # Errors
    /// `alpha2` rounds to 0.
    pub fn new(p: &Prototype) -> Result<Self, Refused> {
        // Fractional bits at which alpha1 fills a word.
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

    /// The states saturate. So an overload ends when its input ends.
    #[inline]
    fn step(&mut self, x: W) -> W {
        let half = W::Wide::ONE << (self.below - 1);
        let sum = self.s[0].clipped_add(self.b0.times(x)).clipped_add(half);
        let y = W::clipped(sum >> self.below);
        let (forward, back) = (self.alpha2.times(x), self.alpha1.times(y));
        let rise = self.s[1].clipped_add(forward) >> (self.alpha2_bits - self.below);
        let fall = back >> (self.alpha1_bits - self.below);
        self.s[0] = self.s[0].clipped_add(rise.clipped_add(-fall));
        self.s[1] = self.s[1].clipped_add(forward - self.alpha2.times(y));
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float;

    /// Number of fractional bits of a signal. It is 15 for Q15 and 16 for the other formats.
    fn lsb_bits<W: Word>() -> u32 {
        if W::BITS == 16 { 15 } else { 16 }
    }

    const CUTOFFS_HZ: [f64; 6] = [0.1, 1.0, 20.0, 500.0, 2000.0, 4500.0];

    /// Speed of a hand at sample `n`, up to `full` LSB. The motion is fast, slow, backwards and zero in turn.
    fn speed(n: i32, full: f64) -> f64 {
        let seed = n.wrapping_mul(1_103_515_245).wrapping_add(12_345);
        let random = f64::from(seed >> 8) / f64::from(1 << 23);
        round(match n / 5000 % 4 {
            0 => full * random,
            1 => 1e-3 * full * random,
            2 => -0.7 * full,
            _ => 0.0,
        })
    }

    /// Largest difference between the outputs of two forms for the motion of [`speed`], in LSB.
    fn distance<W: Word + Signal>(
        form: &mut impl Step<Signal = W>,
        exact: &mut impl Step<Signal = f64>,
        full: f64,
    ) -> f64 {
        let mut worst = 0f64;
        for n in 0..60_000 {
            let x = speed(n, full);
            let y = form.step(W::of_f64(x)).to_counts(15) * f64::from(1u32 << lsb_bits::<W>());
            worst = worst.max((y - exact.step(x)).abs());
        }
        worst
    }

    /// The allowed difference has two parts: the rounding of the output, and the effect of rounded coefficients.
    #[test]
    fn in_fixed_point_they_are_what_they_are_in_f64() {
        for cutoff_hz in CUTOFFS_HZ {
            let p = Prototype::new(cutoff_hz, 1e4);
            let full = 8e6;
            let mut form = StateVariable::<i32>::new(&p).unwrap();
            let off = distance(&mut form, &mut float::StateVariable::<f64>::new(&p), full);
            assert!(off < 0.51 + 5e-5 * full, "state-variable, {cutoff_hz}: {off}");
            let mut form = Delta::<i32>::new(&p).unwrap();
            let off = distance(&mut form, &mut float::Delta::<f64>::new(&p), full);
            assert!(off < 5.0 + 5e-6 * full, "delta, {cutoff_hz}: {off}");
            if cutoff_hz < 400.0 {
                continue;
            }
            let full = 16_000.0;
            let mut form = StateVariable::<i16>::new(&p).unwrap();
            let off = distance(&mut form, &mut float::StateVariable::<f64>::new(&p), full);
            assert!(off < 0.51 + 2e-3 * full, "state-variable in Q15, {cutoff_hz}: {off}");
            let mut form = Delta::<i16>::new(&p).unwrap();
            let off = distance(&mut form, &mut float::Delta::<f64>::new(&p), full);
            assert!(off < 5.0 + 2e-3 * full, "delta in Q15, {cutoff_hz}: {off}");
        }
    }

    #[test]
    fn an_overload_saturates_and_ends_with_its_input() {
        for cutoff_hz in [20.0, 500.0, 4500.0] {
            let p = Prototype::new(cutoff_hz, 1e4);
            let mut forms =
                (StateVariable::<i32>::new(&p).unwrap(), Delta::<i32>::new(&p).unwrap());
            let mut both = |x: i32| [forms.0.step(x), forms.1.step(x)];
            for _ in 0..20_000 {
                assert!(both(i32::MAX).iter().all(|&y| y >= 0), "{cutoff_hz}: it wraps");
            }
            assert!(both(i32::MAX).iter().all(|&y| y >= i32::MAX - 1), "{cutoff_hz}");
            (0..20_000).for_each(|_| _ = both(0));
            assert!(both(0).iter().all(|&y| y.abs() <= 2), "{cutoff_hz}: {:?}", both(0));
        }
    }
}
