//! The same filter from other libraries. For idsp, the library's own code is called. The Q31 biquads of CMSIS-DSP are
//! written here from their published arithmetic.
//!
//! All filters have the coefficients of the core's rule ([`Coefficients::exact_at_dc`]). `a1` and `a2` have the
//! opposite sign, because these libraries add the feedback terms. CMSIS-DSP has the format 1.31 with a `postShift` of
//! 1. This format also has 30 fractional bits.

use dsp_fixedpoint::Q32;
use dsp_process::SplitProcess as _;
use idsp::iir;

use crate::{Step, fixed::Coefficients};

const FRACTION: u32 = 30;

/// The coefficients b0, b1, b2, -a1, -a2.
fn recurrence(c: &Coefficients<i32>) -> [i32; 5] {
    [c.b[0], c.b[1], c.b[2], -c.a[0], -c.a[1]]
}

/// idsp's direct form 1 with first-order error feedback.
#[derive(Clone, Copy, Debug)]
pub struct IdspDither {
    ba: [i32; 5],
    x: [i32; 2],
    y: [i32; 2],
    e: u32,
}

impl IdspDither {
    pub fn new(c: &Coefficients<i32>) -> Self {
        Self { ba: recurrence(c), x: [0; 2], y: [0; 2], e: 0 }
    }
}

impl Step for IdspDither {
    type Signal = i32;

    #[inline]
    fn step(&mut self, x: i32) -> i32 {
        let filter = iir::Biquad { ba: self.ba.map(Q32::<30>::from_bits) };
        let xy = iir::DirectForm { x: self.x, y: [self.y] };
        let mut state = iir::DirectForm1Dither { xy, e: self.e };
        let y = filter.process(&mut state, x);
        (self.x, self.y, self.e) = (state.xy.x, state.xy.y[0], state.e);
        y
    }
}

/// idsp's direct form 1. It keeps past outputs in 64 bits.
#[derive(Clone, Copy, Debug)]
pub struct IdspWide {
    ba: [i32; 5],
    x: [i32; 2],
    y: [i64; 2],
}

impl IdspWide {
    pub fn new(c: &Coefficients<i32>) -> Self {
        Self { ba: recurrence(c), x: [0; 2], y: [0; 2] }
    }
}

impl Step for IdspWide {
    type Signal = i32;

    #[inline]
    fn step(&mut self, x: i32) -> i32 {
        let filter = iir::Biquad { ba: self.ba.map(Q32::<30>::from_bits) };
        let mut state = iir::DirectForm1Wide { x: self.x, y: self.y };
        let y = filter.process(&mut state, x);
        (self.x, self.y) = (state.x, state.y);
        y
    }
}

/// `arm_biquad_cascade_df1_q31`, one stage. By its documentation, the 64-bit accumulator in 2.62 format keeps all bits
/// of the products and has one guard bit. The accumulator wraps and does not saturate. After five products the
/// accumulator is shifted by `postShift`, and truncated to 1.31: the low 32 bits are discarded. The input must be
/// scaled down by two bits to avoid overflow.
#[derive(Clone, Copy, Debug)]
pub struct CmsisQ31 {
    ba: [i32; 5],
    x: [i32; 2],
    y: [i32; 2],
}

impl CmsisQ31 {
    pub fn new(c: &Coefficients<i32>) -> Self {
        Self { ba: recurrence(c), x: [0; 2], y: [0; 2] }
    }
}

impl Step for CmsisQ31 {
    type Signal = i32;

    #[inline]
    fn step(&mut self, x: i32) -> i32 {
        let [[x1, x2], [y1, y2]] = [self.x, self.y];
        let products = self.ba.iter().zip([x, x1, x2, y1, y2]);
        let sum = products.fold(0i64, |sum, (&c, v)| sum.wrapping_add(i64::from(c) * i64::from(v)));
        #[expect(clippy::cast_possible_truncation, reason = "it wraps")]
        let y = (sum >> FRACTION) as i32;
        (self.x, self.y) = ([x, x1], [y, y1]);
        y
    }
}

/// `arm_biquad_cas_df1_32x64_q31`, one stage. By its documentation, coefficients are in 1.31 and past outputs in 1.63.
/// The 64-bit accumulator in 2.62 wraps and is shifted by `postShift`. The output is truncated to 1.31.
#[derive(Clone, Copy, Debug)]
pub struct Cmsis32x64 {
    ba: [i32; 5],
    x: [i32; 2],
    y: [i64; 2],
}

impl Cmsis32x64 {
    pub fn new(c: &Coefficients<i32>) -> Self {
        Self { ba: recurrence(c), x: [0; 2], y: [0; 2] }
    }
}

impl Step for Cmsis32x64 {
    type Signal = i32;

    #[inline]
    fn step(&mut self, x: i32) -> i32 {
        let ([b0, b1, b2, a1, a2], [x1, x2], [y1, y2]) = (self.ba, self.x, self.y);
        let exact = |c: i32, v: i32| i64::from(c) * i64::from(v);
        // A product of 1.31 and 1.63 has the format 2.62, like all other products. The lower bits are dropped.
        let product = |c: i32, v: i64| {
            let low = i64::from(c) * (v & 0xffff_ffff);
            (i64::from(c) * (v >> 32)).wrapping_add(low >> 32)
        };
        let sum = exact(b0, x)
            .wrapping_add(exact(b1, x1))
            .wrapping_add(exact(b2, x2))
            .wrapping_add(product(a1, y1))
            .wrapping_add(product(a2, y2));
        let wide = sum.wrapping_shl(64 - 32 - FRACTION);
        (self.x, self.y) = ([x, x1], [wide, y1]);
        (wide >> 32) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Prototype;

    fn inputs() -> impl Iterator<Item = i32> {
        (0..30_000i32).map(|n| match n / 1000 % 4 {
            0 => n.wrapping_mul(1_103_515_245) >> 2,
            1 => n.wrapping_mul(1_103_515_245) >> 17,
            2 => 0,
            _ => 500_000_000,
        })
    }

    /// Compares two sources of the same arithmetic. One is CMSIS-DSP's documentation, from which the code above is
    /// written. The other is idsp.
    #[test]
    fn the_form_with_wide_outputs_is_that_of_idsp_to_the_bit() {
        for cutoff_hz in [0.5, 20.0, 1500.0] {
            let c = Coefficients::exact_at_dc(&Prototype::new(cutoff_hz, 1e4)).unwrap();
            let (mut here, mut there) = (Cmsis32x64::new(&c), IdspWide::new(&c));
            for x in inputs() {
                assert_eq!(here.step(x), there.step(x), "{cutoff_hz}");
            }
        }
    }

    /// The expected outputs of this step to the middle of the range are computed by hand. They show that the sum is
    /// rounded towards minus infinity.
    #[test]
    fn the_sum_is_truncated() {
        let c = Coefficients { b: [1, 0, 0], a: [-(1 << 29), 0] };
        let mut filter = CmsisQ31::new(&c);
        assert_eq!(filter.step((1 << 30) - 1), 0);
        assert_eq!(filter.step(1 << 30), 1);
        assert_eq!(filter.step(-1), 0, "half of 1, less 2^-30");
        assert_eq!(filter.step(-1), -1);
        let mut wide = Cmsis32x64::new(&c);
        assert_eq!(wide.step(-1), -1);
    }
}
