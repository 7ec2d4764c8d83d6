//! The `f64` twin in lanes: [`Twin`] with one of the usual estimators, operation for operation.

use crate::simulation::twin::{FLUSH_BELOW, LowPass, Twin};

use super::{
    lanes::{Lanes, OutputStage},
    simd_ops::{SIGN, SimdOps, lanes_mut},
};

/// Coefficients and gains, a lane each.
#[derive(Clone, Copy)]
pub struct TwinGains<S: SimdOps> {
    /// Weights of the last inputs in the numerator: 2 and 1, 1 and 0, or none.
    past: [S::f64s; 2],
    b0: S::f64s,
    a: [S::f64s; 2],
    stiffness: S::f64s,
    damping: S::f64s,
}

/// What the samples left behind, a lane each.
#[derive(Clone, Copy)]
pub struct TwinState<S: SimdOps> {
    x: [S::f64s; 2],
    y: [S::f64s; 2],
}

impl<S: SimdOps> Lanes<S> for TwinState<S> {
    type Gains = TwinGains<S>;
    type Controller = Twin;

    fn at_rest(simd: S) -> Self {
        let zero = simd.splat_f64s(0.0);
        Self { x: [zero; 2], y: [zero; 2] }
    }

    fn no_gains(simd: S) -> Self::Gains {
        let zero = simd.splat_f64s(0.0);
        TwinGains { past: [zero; 2], b0: zero, a: [zero; 2], stiffness: zero, damping: zero }
    }

    fn start(&mut self, gains: &mut Self::Gains, lane: usize, twin: &Twin) {
        let Some(LowPass { past, b0, a }) = twin.low_pass() else { return };
        let [stiffness, damping] = twin.wall_gains();
        let [p1, p2] = &mut gains.past;
        let [a1, a2] = &mut gains.a;
        let places = [p1, p2, &mut gains.b0, a1, a2, &mut gains.stiffness, &mut gains.damping];
        let values = [past[0], past[1], b0, a[0], a[1], stiffness, damping];
        for (place, value) in places.into_iter().zip(values) {
            lanes_mut(place)[lane] = value;
        }
        for zero in self.x.iter_mut().chain(&mut self.y) {
            lanes_mut(zero)[lane] = 0.0;
        }
    }

    #[inline(always)]
    fn filter(&mut self, simd: S, gains: &Self::Gains, difference: S::f64s) {
        let raw = self.raw(simd, gains, difference);
        let small = simd.less_than_f64s(simd.magnitude(raw), simd.splat_f64s(FLUSH_BELOW));
        self.x = [difference, self.x[0]];
        self.y = [simd.choose(small, simd.splat_f64s(0.0), raw), self.y[0]];
    }

    /// Without a look at subnormal numbers, which an output waits for as long as for all the rest.
    const QUICK_ABOVE: Option<f64> = Some(FLUSH_BELOW);

    #[inline(always)]
    fn quick(&mut self, simd: S, gains: &Self::Gains, difference: S::f64s, smallest: &mut S::f64s) {
        let raw = self.raw(simd, gains, difference);
        *smallest = simd.min_of(*smallest, simd.magnitude(raw));
        self.x = [difference, self.x[0]];
        self.y = [raw, self.y[0]];
    }

    #[inline(always)]
    fn output(&self, simd: S) -> S::f64s {
        simd.magnitude(self.y[0])
    }

    #[inline(always)]
    fn render(
        &self,
        simd: S,
        gains: &Self::Gains,
        depth: S::f64s,
        _: S::f64s,
        stage: &OutputStage<S>,
    ) -> S::f64s {
        let zero = simd.splat_f64s(0.0);
        let inside = simd.greater_than_f64s(depth, zero);
        let mut velocity = self.y[0];
        if let Some(lsb) = stage.velocity_lsb {
            velocity = simd.sub_f64s(simd.add_f64s(velocity, lsb), lsb);
        }
        let total = simd.add_f64s(
            simd.mul_f64s(gains.stiffness, depth),
            simd.mul_f64s(gains.damping, velocity),
        );
        let one_sided = simd.max_of(total, stage.least_wall);
        let wanted = simd.sub_f64s(stage.push, simd.choose(inside, one_sided, zero));
        let one = simd.splat_f64s(1.0);
        let force = simd.min_of(simd.max_of(wanted, simd.splat_f64s(-1.0)), one);
        match stage.codes_f64 {
            None => force,
            Some(codes) => {
                let scaled = simd.mul_f64s(simd.magnitude(force), codes);
                let whole = simd.floor(simd.add_f64s(scaled, simd.splat_f64s(0.5)));
                let sign = simd.masked(force, simd.splat_u64s(SIGN));
                let signed = simd.or_u64s(pulp::bytemuck::cast(whole), pulp::bytemuck::cast(sign));
                simd.div_f64s(pulp::bytemuck::cast(signed), codes)
            }
        }
    }

    fn is_lost(&self, _: usize) -> bool {
        false
    }
}

impl<S: SimdOps> TwinState<S> {
    #[inline(always)]
    fn raw(&self, simd: S, gains: &TwinGains<S>, difference: S::f64s) -> S::f64s {
        let ([x1, x2], [y1, y2]) = (self.x, self.y);
        let TwinGains { past: [p1, p2], b0, a: [a1, a2], .. } = *gains;
        // whole numbers: exact, fused or not
        let recent = simd.mul_add_e_f64s(p1, x1, difference);
        let input = simd.mul_f64s(b0, simd.mul_add_e_f64s(p2, x2, recent));
        simd.sub_f64s(simd.sub_f64s(input, simd.mul_f64s(a1, y1)), simd.mul_f64s(a2, y2))
    }
}
