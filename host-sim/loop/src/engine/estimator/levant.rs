//! [`Levant`](zwidth::velocity::Levant) in lanes. The lanes are exact only if the states are far inside their ranges.

use pulp::bytemuck::cast;
use zwidth::velocity::{Estimator, Word as _};

use super::{
    Recursive,
    word::{FACTOR_BITS, LaneGain, Vector},
};
use crate::engine::simd_ops::{SimdOps, lanes, lanes_mut};

#[derive(Clone, Copy)]
pub struct Sizes<S: SimdOps> {
    alpha: S::u64s,
    lambda: LaneGain<S>,
    half: S::u64s,
    square: S::u64s,
    /// All bits are set for lanes whose lambda is too large for the lane arithmetic.
    without: S::u64s,
}

#[derive(Clone, Copy)]
pub struct Levant<S: SimdOps, const IMPLICIT: bool> {
    ahead: S::u64s,
    velocity: S::u64s,
    /// Bitwise OR of all states so far. The result is above 2 [`LIMIT`] if a state was out of bounds.
    seen: S::u64s,
}

/// Limit of the position, 2^14 counts, and of the velocity, 2^14 counts per sample.
const LIMIT: u64 = 1 << (FACTOR_BITS - 2);
/// Number of fractional bits of the velocity state beyond those of the output.
const DROPPED: u32 = 16;

impl<S: SimdOps, const IMPLICIT: bool> Recursive<S> for Levant<S, IMPLICIT> {
    type Gains = Sizes<S>;

    fn at_rest(simd: S) -> (Self, Sizes<S>) {
        let zero = simd.splat_u64s(0);
        let lambda = LaneGain::zero(simd);
        let sizes = Sizes { alpha: zero, lambda, half: zero, square: zero, without: zero };
        (Self { ahead: zero, velocity: zero, seen: zero }, sizes)
    }

    fn words(&mut self) -> impl Iterator<Item = &mut S::u64s> {
        let Self { ahead, velocity, seen } = self;
        [ahead, velocity, seen].into_iter()
    }

    fn tune(sizes: &mut Sizes<S>, lane: usize, estimator: &Estimator) {
        let Estimator::Levant(levant) = estimator else { return };
        sizes.lambda.set(lane, levant.lambda());
        let has = LaneGain::<S>::has(levant.lambda());
        let [alpha, half, square] = levant.sizes().map(i64::cast_unsigned);
        let Sizes { alpha: a, half: h, square: s, without, .. } = sizes;
        for (place, value) in
            [(a, alpha), (h, half), (s, square), (without, if has { 0 } else { u64::MAX })]
        {
            lanes_mut(place)[lane] = value;
        }
    }

    #[inline(always)]
    fn step(&mut self, simd: S, sizes: &Sizes<S>, moved: S::f64s) -> S::u64s {
        let zero = simd.splat_u64s(0);
        let moved = simd.shift_left(simd.to_low(moved), simd.splat_u64s(32));
        let e = simd.sub_u64s(self.ahead, moved);
        let negative = simd.select_u64s(simd.is_above(zero, e), simd.splat_u64s(u64::MAX), zero);
        let size = with_sign(simd, e, negative);
        let output = if IMPLICIT {
            let beyond = simd.sub_u64s(size, sizes.alpha);
            let outside = simd.is_above(beyond, zero);
            let back = simd.select_u64s(outside, with_sign(simd, sizes.alpha, negative), e);
            self.velocity = simd.sub_u64s(self.velocity, back);
            let square = simd.add_u64s(sizes.square, simd.larger(beyond, zero));
            let root = simd.sub_u64s(root(simd, square), sizes.half);
            let pull = Vector { simd, bits: root }.times(sizes.lambda).bits;
            let left = simd.larger(simd.sub_u64s(beyond, pull), zero);
            let left = simd.select_u64s(outside, with_sign(simd, left, negative), zero);
            self.ahead = simd.add_u64s(left, self.velocity);
            self.velocity
        } else {
            let pull = Vector { simd, bits: root(simd, size) }.times(sizes.lambda).bits;
            let still = simd.equal_u64s(e, zero);
            let alpha = simd.select_u64s(still, zero, with_sign(simd, sizes.alpha, negative));
            let u = simd.sub_u64s(self.velocity, with_sign(simd, pull, negative));
            self.velocity = simd.sub_u64s(self.velocity, alpha);
            self.ahead = simd.add_u64s(e, u);
            u
        };
        let limit = simd.splat_u64s(LIMIT);
        let seen = [self.ahead, self.velocity, output].map(|word| simd.add_u64s(word, limit));
        let [a, b, c] = seen;
        self.seen = simd.or_u64s(self.seen, simd.or_u64s(a, simd.or_u64s(b, c)));
        Vector { simd, bits: output }.rounded(DROPPED).bits
    }

    fn is_lost(&self, sizes: &Sizes<S>, lane: usize) -> bool {
        let get = |word: &S::u64s| lanes::<_, u64>(word)[lane];
        get(&self.seen) >= 2 * LIMIT || get(&sizes.without) != 0
    }
}

/// `size`, with its sign changed in the lanes where `negative` has all bits set.
#[inline(always)]
fn with_sign<S: SimdOps>(simd: S, size: S::u64s, negative: S::u64s) -> S::u64s {
    simd.sub_u64s(simd.xor_u64s(size, negative), negative)
}

/// The core's square root for numbers below 2^50, with 32 fractional bits. The root has at most 31 significant bits.
#[inline(always)]
fn root<S: SimdOps>(simd: S, square: S::u64s) -> S::u64s {
    let of = |bits: u64| simd.splat_u64s(bits);
    let float = simd.to_float(square);
    // n is half the number of leading zeros, at most 16. The number of leading zeros is 63 + 1023 - exponent.
    let exponent = simd.shift_right(cast(float), of(52));
    let n = simd.shift_right(simd.sub_u64s(of(63 + 1023), exponent), of(1));
    let n = simd.smaller(n, of(16));
    let twice = simd.shift_left(n, of(1));
    let scale = simd.shift_left(simd.add_u64s(twice, of(1023)), of(52));
    let nearest = simd.floor(simd.sqrt_f64s(simd.mul_f64s(float, cast(scale))));
    let bits = simd.to_low(simd.min_of(nearest, simd.splat_f64s(f64::from(u32::MAX))));
    let bits = simd.and_u64s(bits, of(u32::MAX.into()));
    // if the conversion rounded up, the root is too large by one
    let rest = simd.sub_u64s(simd.shift_left(square, twice), simd.unsigned_product(bits, bits));
    let one_less = simd.shift_right(rest, of(63));
    let bits = simd.sub_u64s(bits, one_less);
    simd.shift_left(bits, simd.sub_u64s(of(16), n))
}

#[cfg(test)]
mod tests {
    use super::root;

    fn cores(square: u64) -> u64 {
        let n = square.leading_zeros().min(62) / 2;
        let bits = (square << (2 * n)).isqrt();
        if n > 16 { bits >> (n - 16) } else { bits << (16 - n) }
    }

    #[test]
    fn the_root_is_the_cores_where_a_float_rounds_it_up() {
        for m in 1u64 << 14..1 << 15 {
            let r = (m << 17) + 1;
            for square in [(r * r - 1) >> 18, m * m - 1, m * m, m * m + 1, (m * m) << 20, m & 7] {
                assert_eq!(root(pulp::Scalar, square), cores(square), "{square}");
            }
        }
    }
}
