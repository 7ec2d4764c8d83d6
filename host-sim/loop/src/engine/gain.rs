//! Gains of the core in lanes.

use zwidth::Gain;

use super::simd_ops::{SIGN, SimdOps, lanes_mut};

#[derive(Clone, Copy)]
pub struct GainLanes<S: SimdOps> {
    mantissa: S::u64s,
    half: S::u64s,
    right: S::u64s,
    /// The sign bit after the right shift. To subtract it turns a logical shift into an arithmetic shift.
    sign: S::u64s,
    left: S::u64s,
    bound: S::u64s,
}

impl<S: SimdOps> GainLanes<S> {
    pub fn zero(simd: S) -> Self {
        let zero = simd.splat_u64s(0);
        Self { mantissa: zero, half: zero, right: zero, sign: zero, left: zero, bound: zero }
    }

    pub fn set(&mut self, lane: usize, gain: Gain) {
        let shift = gain.shift();
        let right = u64::from(shift.max(0).unsigned_abs());
        let left = u64::from((-shift).max(0).unsigned_abs());
        lanes_mut(&mut self.mantissa)[lane] = u64::from(gain.mantissa().unsigned_abs());
        lanes_mut(&mut self.half)[lane] = if right > 0 { 1u64 << (right - 1) } else { 0 };
        lanes_mut(&mut self.right)[lane] = right;
        lanes_mut(&mut self.sign)[lane] = SIGN >> right;
        lanes_mut(&mut self.left)[lane] = left;
        lanes_mut(&mut self.bound)[lane] = Gain::PRODUCT_LIMIT.unsigned_abs() >> left;
    }

    #[inline(always)]
    pub fn apply(&self, simd: S, value: S::u64s) -> S::u64s {
        let product = simd.add_u64s(simd.product(self.mantissa, value), self.half);
        let biased = simd.add_u64s(product, simd.splat_u64s(SIGN));
        let shifted = simd.sub_u64s(simd.shift_right(biased, self.right), self.sign);
        let negative = simd.sub_u64s(simd.splat_u64s(0), self.bound);
        let clamped = simd.smaller(simd.larger(shifted, negative), self.bound);
        simd.shift_left(clamped, self.left)
    }
}
