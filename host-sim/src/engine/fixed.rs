//! The fixed-point core in lanes: [`Biquad::update`](zwidth::velocity::Biquad::update),
//! [`Wall::demand`](zwidth::Wall::demand), [`Demand::saturate`](zwidth::units::Demand::saturate) and
//! [`Actuator::command`](zwidth::Actuator::command), for hits that stay far inside every range that they
//! saturate at but the force's. A hit that does not is noticed ([`Lanes::is_lost`]) and run by the core itself.

use zwidth::{
    Gain, LoopParameters,
    units::Force,
    velocity::{Estimator, Shaping},
};

use super::{
    lanes::{Lanes, OutputStage},
    simd_ops::{SIGN, SimdOps, lanes, lanes_mut},
};

/// Fractional bits of a coefficient, and of the accumulator beyond the velocity's.
const RESIDUE: u64 = (1 << 30) - 1;
/// Half an LSB of the output.
const HALF: u64 = 1 << 29;
/// Sums of the filter beyond it are left to the core: half of the largest velocity.
const SUM_LIMIT: u64 = 1 << 60;

/// Coefficients and gains, a lane each.
#[derive(Clone, Copy)]
pub struct FixedGains<S: SimdOps> {
    b: [S::u64s; 3],
    a: [S::u64s; 2],
    second: S::u64s,
    stiffness: GainLanes<S>,
    damping: GainLanes<S>,
}

/// What the samples left behind, a lane each. Numbers of 32 bits have rubbish above them.
#[derive(Clone, Copy)]
pub struct FixedState<S: SimdOps> {
    /// Past differences, counts, 32 bits.
    x: [S::u64s; 2],
    /// Past velocities, 32 bits; the newest is what the wall sees.
    y: [S::u64s; 2],
    /// Past residues, plus [`HALF`]: the lower bits of the sums as they are.
    residue: [S::u64s; 2],
    /// All sums so far, one over the other: beyond 2 [`SUM_LIMIT`] if one was out of bounds.
    sums: S::u64s,
}

/// [`Gain`] in lanes.
#[derive(Clone, Copy)]
struct GainLanes<S: SimdOps> {
    mantissa: S::u64s,
    half: S::u64s,
    right: S::u64s,
    /// What the sign bit becomes when it is shifted right: an arithmetic shift made of a logical one.
    sign: S::u64s,
    left: S::u64s,
    bound: S::u64s,
}

impl<S: SimdOps> GainLanes<S> {
    fn zero(simd: S) -> Self {
        let zero = simd.splat_u64s(0);
        Self { mantissa: zero, half: zero, right: zero, sign: zero, left: zero, bound: zero }
    }

    fn set(&mut self, lane: usize, gain: Gain) {
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

    /// [`Gain::apply`] of 32-bit numbers.
    #[inline(always)]
    fn apply(&self, simd: S, value: S::u64s) -> S::u64s {
        let product = simd.add_u64s(simd.product(self.mantissa, value), self.half);
        let biased = simd.add_u64s(product, simd.splat_u64s(SIGN));
        let shifted = simd.sub_u64s(simd.shift_right(biased, self.right), self.sign);
        let negative = simd.sub_u64s(simd.splat_u64s(0), self.bound);
        let clamped = simd.smaller(simd.larger(shifted, negative), self.bound);
        simd.shift_left(clamped, self.left)
    }
}

impl<S: SimdOps> Lanes<S> for FixedState<S> {
    type Gains = FixedGains<S>;
    type Controller = LoopParameters;

    const QUICK_ABOVE: Option<f64> = None;

    fn at_rest(simd: S) -> Self {
        let zero = simd.splat_u64s(0);
        let half = simd.splat_u64s(HALF);
        Self { x: [zero; 2], y: [zero; 2], residue: [half; 2], sums: zero }
    }

    fn no_gains(simd: S) -> Self::Gains {
        let zero = simd.splat_u64s(0);
        let gain = GainLanes::zero(simd);
        FixedGains { b: [zero; 3], a: [zero; 2], second: zero, stiffness: gain, damping: gain }
    }

    fn start(&mut self, gains: &mut Self::Gains, lane: usize, control: &LoopParameters) {
        // A difference alone is a low-pass that lets everything through.
        const PASS: ([i32; 5], bool) = ([1 << 30, 0, 0, 0, 0], false);
        let (coefficients, second) = match &*control.estimator {
            Estimator::LowPass(filter) => (filter.bits(), filter.shaping() == Shaping::Second),
            _ => PASS,
        };
        let wide = |value: i32| i64::from(value).cast_unsigned();
        for (place, value) in gains.b.iter_mut().chain(&mut gains.a).zip(coefficients) {
            lanes_mut(place)[lane] = wide(value);
        }
        lanes_mut(&mut gains.second)[lane] = if second { u64::MAX } else { 0 };
        gains.stiffness.set(lane, control.wall.stiffness());
        gains.damping.set(lane, control.wall.damping());
        for zero in self.x.iter_mut().chain(&mut self.y).chain([&mut self.sums]) {
            lanes_mut::<_, u64>(zero)[lane] = 0;
        }
        for residue in &mut self.residue {
            lanes_mut(residue)[lane] = HALF;
        }
    }

    #[inline(always)]
    fn filter(&mut self, simd: S, gains: &Self::Gains, difference: S::f64s) {
        let x0 = simd.to_low(difference);
        let FixedGains { b: [b0, b1, b2], a: [a1, a2], second, .. } = *gains;
        let ([x1, x2], [y1, y2], [r1, r2]) = (self.x, self.y, self.residue);
        let recent = simd.add_u64s(simd.product(b0, x0), simd.product(b1, x1));
        let input = simd.shift_left_16(simd.add_u64s(recent, simd.product(b2, x2)));
        let output = simd.add_u64s(simd.product(a1, y1), simd.product(a2, y2));
        let carried = simd.add_u64s(r1, simd.and_u64s(second, simd.sub_u64s(r1, r2)));
        let total = simd.add_u64s(simd.sub_u64s(input, output), carried);
        self.x = [x0, x1];
        self.y = [simd.shift_right_30(total), y1];
        self.residue = [simd.and_u64s(total, simd.splat_u64s(RESIDUE)), r1];
        let shifted = simd.add_u64s(total, simd.splat_u64s(SUM_LIMIT));
        self.sums = simd.or_u64s(self.sums, shifted);
    }

    #[inline(always)]
    fn render(
        &self,
        simd: S,
        gains: &Self::Gains,
        depth: S::f64s,
        speed: S::f64s,
        stage: &OutputStage<S>,
    ) -> S::f64s {
        let zero = simd.splat_u64s(0);
        let inside = simd.greater_than_f64s(depth, simd.splat_f64s(0.0));
        let spring = gains.stiffness.apply(simd, simd.to_low(depth));
        let velocity = match stage.told {
            None => self.y[0],
            Some(scale) => {
                let exact = simd.add_f64s(simd.mul_f64s(speed, scale), simd.splat_f64s(0.5));
                simd.to_low(simd.floor(exact))
            }
        };
        let damper = gains.damping.apply(simd, velocity);
        let total = simd.larger(simd.add_u64s(spring, damper), stage.least);
        let wall = simd.select_u64s(inside, total, zero);
        let full = simd.splat_u64s(Force::FULL_SCALE.bits().unsigned_abs().into());
        let wanted = simd.sub_u64s(stage.push_bits, wall);
        let force = simd.smaller(simd.larger(wanted, simd.sub_u64s(zero, full)), full);
        let given = match stage.codes {
            None => force,
            Some(codes) => {
                let negative =
                    simd.select_u64s(simd.is_above(zero, force), simd.splat_u64s(u64::MAX), zero);
                let scaled = simd.product(signed(simd, force, negative), codes);
                let rounded = simd.shift_right_30(simd.add_u64s(scaled, simd.splat_u64s(HALF)));
                signed(simd, rounded, negative)
            }
        };
        simd.mul_f64s(simd.to_float(given), stage.per_code)
    }

    fn is_lost(&self, lane: usize) -> bool {
        lanes::<_, u64>(&self.sums)[lane] >= 2 * SUM_LIMIT
    }
}

/// `value`, negated where all bits of `negative` are set.
#[inline(always)]
fn signed<S: SimdOps>(simd: S, value: S::u64s, negative: S::u64s) -> S::u64s {
    simd.sub_u64s(simd.xor_u64s(value, negative), negative)
}
