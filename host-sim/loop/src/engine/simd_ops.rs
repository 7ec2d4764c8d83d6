//! Vector operations for lanes that `pulp` does not have: products of 32-bit halves, shifts, and `u64` views of
//! vectors. A lane has 64 bits, for floats and for integers.

use std::slice::{from_mut, from_ref};

use pulp::{
    Simd,
    bytemuck::{cast, cast_slice, cast_slice_mut},
};

use crate::simulation::quantiser::INTEGER;

/// A set of vector instructions. Every machine can run the functions of this trait, which then work lane by lane. A
/// backend whose machine has an instruction for a function overrides the function.
pub trait SimdOps: Simd {
    /// Signed 64-bit product of the lower halves, read as signed numbers. The upper halves may have any value.
    #[inline(always)]
    fn product(self, a: Self::u64s, b: Self::u64s) -> Self::u64s {
        each::<Self>(a, b, |a, b| (low(a) * low(b)).cast_unsigned())
    }

    /// Product of the lower halves, read as unsigned numbers.
    #[inline(always)]
    fn unsigned_product(self, a: Self::u64s, b: Self::u64s) -> Self::u64s {
        each::<Self>(a, b, |a, b| (a & 0xFFFF_FFFF) * (b & 0xFFFF_FFFF))
    }

    #[inline(always)]
    fn shift_left_16(self, a: Self::u64s) -> Self::u64s {
        each::<Self>(a, a, |a, _| a << 16)
    }

    /// `a >> 30`. The free bits become zeros.
    #[inline(always)]
    fn shift_right_30(self, a: Self::u64s) -> Self::u64s {
        each::<Self>(a, a, |a, _| a >> 30)
    }

    /// `a << by`, for `by` in 0 .. 63.
    #[inline(always)]
    fn shift_left(self, a: Self::u64s, by: Self::u64s) -> Self::u64s {
        each::<Self>(a, by, |a, by| a << (by & 63))
    }

    /// `a >> by`, for `by` in 0 .. 63. The free bits become zeros.
    #[inline(always)]
    fn shift_right(self, a: Self::u64s, by: Self::u64s) -> Self::u64s {
        each::<Self>(a, by, |a, by| a >> (by & 63))
    }

    /// `a >> by` of signed numbers, for `by` in 0 .. 63.
    #[inline(always)]
    fn signed_shift_right(self, a: Self::u64s, by: Self::u64s) -> Self::u64s {
        let sign = self.splat_u64s(SIGN);
        let biased = self.shift_right(self.xor_u64s(a, sign), by);
        self.sub_u64s(biased, self.shift_right(sign, by))
    }

    /// `a` where the mask is set, else `b`.
    #[inline(always)]
    fn choose(self, mask: Self::m64s, a: Self::f64s, b: Self::f64s) -> Self::f64s {
        cast(self.select_u64s(mask, cast(a), cast(b)))
    }

    /// The bits of `a` that are set in `mask`; all other bits are 0.
    #[inline(always)]
    fn masked(self, a: Self::f64s, mask: Self::u64s) -> Self::f64s {
        cast(self.and_u64s(cast(a), mask))
    }

    #[inline(always)]
    fn magnitude(self, a: Self::f64s) -> Self::f64s {
        self.masked(a, self.splat_u64s(!SIGN))
    }

    /// `a` if it is larger, else `b`. Zeros of different sign are equal, as on x86.
    #[inline(always)]
    fn max_of(self, a: Self::f64s, b: Self::f64s) -> Self::f64s {
        self.choose(self.greater_than_f64s(a, b), a, b)
    }

    /// `a` if it is smaller, else `b`.
    #[inline(always)]
    fn min_of(self, a: Self::f64s, b: Self::f64s) -> Self::f64s {
        self.choose(self.greater_than_f64s(b, a), a, b)
    }

    /// Whether `a` is larger than `b`, both signed 64-bit numbers.
    #[inline(always)]
    fn is_above(self, a: Self::u64s, b: Self::u64s) -> Self::m64s {
        self.greater_than_i64s(cast(a), cast(b))
    }

    /// The smaller of two signed 64-bit numbers.
    #[inline(always)]
    fn smaller(self, a: Self::u64s, b: Self::u64s) -> Self::u64s {
        self.select_u64s(self.is_above(a, b), b, a)
    }

    /// The larger of two signed 64-bit numbers.
    #[inline(always)]
    fn larger(self, a: Self::u64s, b: Self::u64s) -> Self::u64s {
        self.select_u64s(self.is_above(a, b), a, b)
    }

    /// Converts whole numbers to integers in the lower 32 bits. The result is correct below 2^51 in magnitude. The
    /// upper bits are undefined.
    #[inline(always)]
    fn to_low(self, whole: Self::f64s) -> Self::u64s {
        cast(self.add_f64s(whole, self.splat_f64s(INTEGER)))
    }

    /// Converts signed 64-bit numbers to floats. The result is exact below 2^51 in magnitude.
    #[inline(always)]
    fn to_float(self, number: Self::u64s) -> Self::f64s {
        let bits = self.add_u64s(number, self.splat_u64s(INTEGER.to_bits()));
        self.sub_f64s(cast(bits), self.splat_f64s(INTEGER))
    }

    /// Converts whole numbers to signed 64-bit numbers. The result is correct below 2^51 in magnitude.
    #[inline(always)]
    fn to_integer(self, whole: Self::f64s) -> Self::u64s {
        self.sub_u64s(self.to_low(whole), self.splat_u64s(INTEGER.to_bits()))
    }

    /// The value rounded towards zero: [`f64::trunc`].
    #[inline(always)]
    fn truncate(self, value: Self::f64s) -> Self::f64s {
        let (size, whole) = (self.magnitude(value), self.splat_f64s(WHOLE));
        let nearest = self.sub_f64s(self.add_f64s(size, whole), whole);
        let less = self.sub_f64s(nearest, self.splat_f64s(1.0));
        let below = self.choose(self.greater_than_f64s(nearest, size), less, nearest);
        let size = self.choose(self.less_than_f64s(size, whole), below, size);
        self.signed(size, value)
    }

    /// The nearest whole number, as [`f64::round`] gives it. Halves are rounded away from zero.
    #[inline(always)]
    fn round(self, value: Self::f64s) -> Self::f64s {
        let half = self.splat_f64s(0.5f64.next_down()); // with 0.5, the number just below 0.5 would be rounded to 1
        self.truncate(self.add_f64s(value, self.signed(half, value)))
    }

    /// `size`, which must not be negative, with the sign of `sign`.
    #[inline(always)]
    fn signed(self, size: Self::f64s, sign: Self::f64s) -> Self::f64s {
        let sign = self.masked(sign, self.splat_u64s(SIGN));
        cast(self.or_u64s(cast(size), cast(sign)))
    }

    /// The largest whole number not above `value`. The result is correct below 2^51 in magnitude.
    #[inline(always)]
    fn floor(self, value: Self::f64s) -> Self::f64s {
        let integer = self.splat_f64s(INTEGER);
        let nearest = self.sub_f64s(self.add_f64s(value, integer), integer);
        let up = self.greater_than_f64s(nearest, value);
        let less = self.sub_f64s(nearest, self.splat_f64s(1.0));
        self.choose(up, less, nearest)
    }
}

/// Smallest float from which on all floats are whole numbers.
const WHOLE: f64 = (1u64 << 52) as f64;

pub const SIGN: u64 = 1 << 63;

#[inline(always)]
fn low(bits: u64) -> i64 {
    #[expect(clippy::cast_possible_truncation, reason = "the lower half is what is asked for")]
    let low = bits as u32;
    i64::from(low.cast_signed())
}

#[inline(always)]
fn each<S: Simd>(mut a: S::u64s, b: S::u64s, f: impl Fn(u64, u64) -> u64) -> S::u64s {
    for (a, b) in lanes_mut(&mut a).iter_mut().zip(lanes(&b)) {
        *a = f(*a, *b);
    }
    a
}

pub fn lanes<V: pulp::bytemuck::Pod, T: pulp::bytemuck::Pod>(vector: &V) -> &[T] {
    cast_slice(from_ref(vector))
}

pub fn lanes_mut<V: pulp::bytemuck::Pod, T: pulp::bytemuck::Pod>(vector: &mut V) -> &mut [T] {
    cast_slice_mut(from_mut(vector))
}

impl SimdOps for pulp::Scalar {}

#[cfg(target_arch = "aarch64")]
impl SimdOps for pulp::aarch64::Neon {}

/// Vector operations of x86. An instruction has the same name for vectors of different lengths.
#[cfg(target_arch = "x86_64")]
macro_rules! x86 {
    (
        $machine:ty, $set:ident, [$($signed:ident)?],
        $truncate:ident, $product:ident, $unsigned:ident, $left_by:ident, $right_by:ident, $left:ident, $right:ident
    ) => {
        impl SimdOps for $machine {
            #[inline(always)]
            fn max_of(self, a: Self::f64s, b: Self::f64s) -> Self::f64s {
                self.max_f64s(a, b)
            }

            #[inline(always)]
            fn min_of(self, a: Self::f64s, b: Self::f64s) -> Self::f64s {
                self.min_f64s(a, b)
            }

            #[inline(always)]
            fn truncate(self, value: Self::f64s) -> Self::f64s {
                self.$truncate(value)
            }

            #[inline(always)]
            fn product(self, a: Self::u64s, b: Self::u64s) -> Self::u64s {
                cast(self.$set.$product(cast(a), cast(b)))
            }

            #[inline(always)]
            fn unsigned_product(self, a: Self::u64s, b: Self::u64s) -> Self::u64s {
                cast(self.$set.$unsigned(cast(a), cast(b)))
            }

            $(
                #[inline(always)]
                fn signed_shift_right(self, a: Self::u64s, by: Self::u64s) -> Self::u64s {
                    cast(self.$set.$signed(cast(a), cast(by)))
                }
            )?

            #[inline(always)]
            fn shift_left_16(self, a: Self::u64s) -> Self::u64s {
                cast(self.$set.$left_by::<16>(cast(a)))
            }

            #[inline(always)]
            fn shift_right_30(self, a: Self::u64s) -> Self::u64s {
                cast(self.$set.$right_by::<30>(cast(a)))
            }

            #[inline(always)]
            fn shift_left(self, a: Self::u64s, by: Self::u64s) -> Self::u64s {
                cast(self.$set.$left(cast(a), cast(by)))
            }

            #[inline(always)]
            fn shift_right(self, a: Self::u64s, by: Self::u64s) -> Self::u64s {
                cast(self.$set.$right(cast(a), cast(by)))
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
x86!(
    pulp::x86::V3,
    avx2,
    [],
    truncate_f64x4,
    _mm256_mul_epi32,
    _mm256_mul_epu32,
    _mm256_slli_epi64,
    _mm256_srli_epi64,
    _mm256_sllv_epi64,
    _mm256_srlv_epi64
);

#[cfg(target_arch = "x86_64")]
x86!(
    pulp::x86::V4,
    avx512f,
    [_mm512_srav_epi64],
    truncate_f64x8,
    _mm512_mul_epi32,
    _mm512_mul_epu32,
    _mm512_slli_epi64,
    _mm512_srli_epi64,
    _mm512_sllv_epi64,
    _mm512_srlv_epi64
);

#[cfg(test)]
mod tests {
    use super::*;

    fn rounded<S: SimdOps>(simd: Option<S>, value: f64) -> Vec<f64> {
        simd.map_or(vec![], |simd| lanes(&simd.round(simd.splat_f64s(value))).to_vec())
    }

    #[test]
    fn every_machine_rounds_as_f64_does() {
        let halves = (0..54).flat_map(|bits| [0.5, 1.5].map(|half| half * (1u64 << bits) as f64));
        let edges = halves.flat_map(|half| [half.next_down(), half, half.next_up()]);
        let odd = (0..1000).map(|n| f64::from(n) + 0.5);
        let others = [0.0, 2.3, 1e300, f64::INFINITY, f64::MIN_POSITIVE];
        for value in edges.chain(odd).chain(others).flat_map(|value| [value, -value]) {
            let mut found = rounded(Some(pulp::Scalar), value);
            #[cfg(target_arch = "x86_64")]
            {
                found.extend(rounded(pulp::x86::V3::try_new(), value));
                found.extend(rounded(pulp::x86::V4::try_new(), value));
            }
            #[cfg(target_arch = "aarch64")]
            found.extend(rounded(pulp::aarch64::Neon::try_new(), value));
            for found in found {
                assert_eq!(found.to_bits(), value.round().to_bits(), "{value:e}");
            }
        }
    }
}
