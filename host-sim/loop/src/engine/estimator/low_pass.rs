//! [`Biquad::update`](zwidth::velocity::Biquad::update) in lanes.

use zwidth::velocity::{Biquad, Estimator, Shaping};

use super::Recursive;
use crate::engine::simd_ops::{SimdOps, lanes, lanes_mut};

/// Mask of the lowest 30 bits of the accumulator. The accumulator has 30 more fractional bits than the velocity,
/// because a coefficient has 30 fractional bits.
const RESIDUE: u64 = (1 << 30) - 1;
/// Half an LSB of the output.
const HALF: u64 = 1 << 29;
/// Limit of the filter's sums, which corresponds to half of the largest velocity. The core itself runs hits with larger
/// sums.
const SUM_LIMIT: u64 = 1 << 60;

#[derive(Clone, Copy)]
pub struct Coefficients<S: SimdOps> {
    b: [S::u64s; 3],
    a: [S::u64s; 2],
    second: S::u64s,
}

impl<S: SimdOps> Coefficients<S> {
    fn put(&mut self, lane: usize, bits: [i32; 5], second: bool) {
        for (place, value) in self.b.iter_mut().chain(&mut self.a).zip(bits) {
            lanes_mut(place)[lane] = i64::from(value).cast_unsigned();
        }
        lanes_mut(&mut self.second)[lane] = if second { u64::MAX } else { 0 };
    }

    fn put_filter(&mut self, lane: usize, filter: &Biquad) {
        self.put(lane, filter.bits(), filter.shaping() == Shaping::Second);
    }
}

/// State of each lane after a sample. The upper half of a lane is undefined if its number has 32 bits.
#[derive(Clone, Copy)]
pub struct LowPass<S: SimdOps> {
    /// Past inputs, in 32 bits. The unit is counts, or LSB of the velocity if the input comes from another filter.
    x: [S::u64s; 2],
    /// Past velocities, in 32 bits.
    y: [S::u64s; 2],
    /// Lower bits of the past sums (residues), plus [`HALF`].
    residue: [S::u64s; 2],
    /// Bitwise OR of all sums so far. The result is above 2 [`SUM_LIMIT`] if a sum was out of bounds.
    sums: S::u64s,
}

impl<S: SimdOps> Recursive<S> for LowPass<S> {
    type Gains = Coefficients<S>;

    fn at_rest(simd: S) -> (Self, Self::Gains) {
        let zero = simd.splat_u64s(0);
        let half = simd.splat_u64s(HALF);
        let rest = Self { x: [zero; 2], y: [zero; 2], residue: [half; 2], sums: zero };
        (rest, Coefficients { b: [zero; 3], a: [zero; 2], second: zero })
    }

    fn words(&mut self) -> impl Iterator<Item = &mut S::u64s> {
        let Self { x, y, residue, sums } = self;
        x.iter_mut().chain(y).chain(residue).chain([sums])
    }

    fn tune(gains: &mut Self::Gains, lane: usize, estimator: &Estimator) {
        match estimator {
            Estimator::LowPass(filter) => gains.put_filter(lane, filter),
            _ => gains.put(lane, [1 << 30, 0, 0, 0, 0], false),
        }
    }

    #[inline(always)]
    fn step(&mut self, simd: S, gains: &Self::Gains, moved: S::f64s) -> S::u64s {
        self.pass::<true>(simd, gains, simd.to_low(moved))
    }

    fn is_lost(&self, _: &Self::Gains, lane: usize) -> bool {
        lanes::<_, u64>(&self.sums)[lane] >= 2 * SUM_LIMIT
    }
}

impl<S: SimdOps> LowPass<S> {
    /// The output in LSB. The input is in the lower 32 bits; its unit is counts if `COUNTS` is set, else LSB.
    #[inline(always)]
    fn pass<const COUNTS: bool>(
        &mut self,
        simd: S,
        gains: &Coefficients<S>,
        x0: S::u64s,
    ) -> S::u64s {
        let Coefficients { b: [b0, b1, b2], a: [a1, a2], second } = *gains;
        let ([x1, x2], [y1, y2], [r1, r2]) = (self.x, self.y, self.residue);
        let recent = simd.add_u64s(simd.product(b0, x0), simd.product(b1, x1));
        let input = simd.add_u64s(recent, simd.product(b2, x2));
        let input = if COUNTS { simd.shift_left_16(input) } else { input };
        let output = simd.add_u64s(simd.product(a1, y1), simd.product(a2, y2));
        let carried = simd.add_u64s(r1, simd.and_u64s(second, simd.sub_u64s(r1, r2)));
        let total = simd.add_u64s(simd.sub_u64s(input, output), carried);
        let y0 = simd.shift_right_30(total);
        self.x = [x0, x1];
        self.y = [y0, y1];
        self.residue = [simd.and_u64s(total, simd.splat_u64s(RESIDUE)), r1];
        let shifted = simd.add_u64s(total, simd.splat_u64s(SUM_LIMIT));
        self.sums = simd.or_u64s(self.sums, shifted);
        y0
    }
}

#[derive(Clone, Copy)]
pub struct Cascade<S: SimdOps>([LowPass<S>; 2]);

impl<S: SimdOps> Recursive<S> for Cascade<S> {
    type Gains = [Coefficients<S>; 2];

    fn at_rest(simd: S) -> (Self, Self::Gains) {
        let (rest, gains) = LowPass::at_rest(simd);
        (Self([rest; 2]), [gains; 2])
    }

    fn words(&mut self) -> impl Iterator<Item = &mut S::u64s> {
        self.0.iter_mut().flat_map(LowPass::words)
    }

    fn tune(gains: &mut Self::Gains, lane: usize, estimator: &Estimator) {
        if let Estimator::Cascade(cascade) = estimator {
            for (gains, section) in gains.iter_mut().zip(cascade.sections()) {
                gains.put_filter(lane, section);
            }
        }
    }

    #[inline(always)]
    fn step(&mut self, simd: S, gains: &Self::Gains, moved: S::f64s) -> S::u64s {
        let [first, second] = &mut self.0;
        let between = first.step(simd, &gains[0], moved);
        second.pass::<false>(simd, &gains[1], between)
    }

    fn is_lost(&self, gains: &Self::Gains, lane: usize) -> bool {
        self.0.iter().zip(gains).any(|(section, gains)| section.is_lost(gains, lane))
    }
}
