//! The `f64` twin in lanes: [`Twin`] with a common estimator. The order of operations is the same as in [`Twin`].

use pulp::WithSimd;
use zwidth::SettingsError;

use super::{
    lanes::{Aligned, Due, LaneController, OutputStage, Row, place},
    simd_ops::{SIGN, SimdOps, lanes_mut},
};
use crate::simulation::{
    controller::Controller,
    prepared::{PreparedScene, WallHit},
    twin::{FLUSH_BELOW, Rounding, Section},
};

#[repr(align(64))]
pub struct FloatLoop<S: SimdOps, const R: usize> {
    simd: S,
    rounding: Rounding,
    states: [TwinState<S>; R],
    gains: [TwinGains<S>; R],
}

/// Gains of each lane: two weights of the last inputs, `b0`, both `a`, stiffness, damping and push. The two weights are
/// either 2 and 1, or 1 and 0, or 0 and 0.
type TwinGains<S> = [<S as pulp::Simd>::f64s; 8];

#[derive(Clone, Copy)]
struct TwinState<S: SimdOps> {
    x: [S::f64s; 2],
    y: [S::f64s; 2],
}

impl<S: SimdOps, const R: usize> FloatLoop<S, R> {
    pub fn new(simd: S, rounding: Rounding) -> Self {
        let zero = simd.splat_f64s(0.0);
        let state = TwinState { x: [zero; 2], y: [zero; 2] };
        Self { simd, rounding, states: [state; R], gains: [[zero; 8]; R] }
    }
}

impl<S: SimdOps, const R: usize> LaneController<S, R> for FloatLoop<S, R> {
    fn start(
        &mut self,
        lane: usize,
        prepared: &PreparedScene,
        hit: &WallHit,
    ) -> Result<i32, SettingsError> {
        let twin = prepared.twin_of_core(hit, self.rounding)?;
        let (vector, place) = place::<S>(lane);
        let (state, gains) = (&mut self.states[vector], &mut self.gains[vector]);
        if let Some(Section { past, b0, a }) = twin.low_pass() {
            let [stiffness, damping] = twin.wall_gains();
            let push = Controller::push(&twin);
            let values = [past[0], past[1], b0, a[0], a[1], stiffness, damping, push];
            for (vector, value) in gains.iter_mut().zip(values) {
                lanes_mut(vector)[place] = value;
            }
        }
        for zero in state.x.iter_mut().chain(&mut state.y) {
            lanes_mut(zero)[place] = 0.0;
        }
        Ok(twin.surface())
    }

    fn take(&mut self, moved: &[Row<S, R>], due: Option<&Due<S, R>>) -> Row<S, R> {
        struct Take<'a, S: SimdOps, const R: usize>(
            &'a mut FloatLoop<S, R>,
            &'a [Row<S, R>],
            Option<&'a Due<'a, S, R>>,
        );
        impl<S: SimdOps, const R: usize> WithSimd for Take<'_, S, R> {
            type Output = Row<S, R>;

            #[inline(always)]
            fn with_simd<T: pulp::Simd>(self, _: T) -> Row<S, R> {
                let Take(FloatLoop { simd, states, gains, .. }, moved, due) = self;
                let mut now = *states;
                if !quick(*simd, &mut now, gains, moved) {
                    now = *states;
                    for row in moved {
                        for r in 0..R {
                            now[r].filter(*simd, &gains[r], row.0[r]);
                        }
                    }
                }
                *states = now;
                let mut outputs = Aligned([simd.splat_f64s(0.0); R]);
                if let Some(Due { depth, stage, .. }) = due {
                    for r in 0..R {
                        outputs.0[r] = now[r].output(*simd, &gains[r], depth[r], stage);
                    }
                }
                outputs
            }
        }
        self.simd.vectorize(Take(self, moved, due))
    }

    fn is_lost(&self, _: usize) -> bool {
        false
    }
}

/// Computes the velocities of a block without a check for subnormal numbers. The check would double the time until an
/// output. Returns `false` if the result may be wrong in a lane.
#[inline(always)]
fn quick<S: SimdOps, const R: usize>(
    simd: S,
    states: &mut [TwinState<S>; R],
    gains: &[TwinGains<S>; R],
    moved: &[Row<S, R>],
) -> bool {
    let mut smallest = [simd.splat_f64s(f64::INFINITY); R];
    for r in 0..R {
        smallest[r] = simd.magnitude(states[r].y[0]);
    }
    if !is_above(simd, &smallest, FLUSH_BELOW) {
        return false;
    }
    for row in moved {
        for r in 0..R {
            let raw = states[r].raw(simd, &gains[r], row.0[r]);
            smallest[r] = simd.min_of(smallest[r], simd.magnitude(raw));
            states[r].push(row.0[r], raw);
        }
    }
    is_above(simd, &smallest, FLUSH_BELOW)
}

#[inline(always)]
fn is_above<S: SimdOps, const R: usize>(simd: S, values: &[S::f64s; R], least: f64) -> bool {
    let mut all = simd.splat_f64s(f64::INFINITY);
    for &value in values {
        all = simd.min_of(all, value);
    }
    simd.first_true_m64s(simd.less_than_f64s(all, simd.splat_f64s(least))) >= S::F64_LANES
}

impl<S: SimdOps> TwinState<S> {
    #[inline(always)]
    fn filter(&mut self, simd: S, gains: &TwinGains<S>, difference: S::f64s) {
        let raw = self.raw(simd, gains, difference);
        let small = simd.less_than_f64s(simd.magnitude(raw), simd.splat_f64s(FLUSH_BELOW));
        self.push(difference, simd.choose(small, simd.splat_f64s(0.0), raw));
    }

    #[inline(always)]
    fn push(&mut self, difference: S::f64s, velocity: S::f64s) {
        self.x = [difference, self.x[0]];
        self.y = [velocity, self.y[0]];
    }

    #[inline(always)]
    fn output(
        &self,
        simd: S,
        gains: &TwinGains<S>,
        depth: S::f64s,
        stage: &OutputStage<S>,
    ) -> S::f64s {
        let zero = simd.splat_f64s(0.0);
        let inside = simd.greater_than_f64s(depth, zero);
        let mut velocity = self.y[0];
        if let Some(lsb) = stage.velocity_lsb {
            velocity = simd.sub_f64s(simd.add_f64s(velocity, lsb), lsb);
        }
        let [.., stiffness, damping, push] = *gains;
        let total =
            simd.add_f64s(simd.mul_f64s(stiffness, depth), simd.mul_f64s(damping, velocity));
        let one_sided = simd.max_of(total, stage.least_wall);
        let wanted = simd.sub_f64s(push, simd.choose(inside, one_sided, zero));
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

    #[inline(always)]
    fn raw(&self, simd: S, gains: &TwinGains<S>, difference: S::f64s) -> S::f64s {
        let ([x1, x2], [y1, y2]) = (self.x, self.y);
        let [p1, p2, b0, a1, a2, ..] = *gains;
        let recent = simd.add_f64s(difference, simd.mul_f64s(p1, x1));
        let input = simd.mul_f64s(b0, simd.add_f64s(recent, simd.mul_f64s(p2, x2)));
        simd.sub_f64s(simd.sub_f64s(input, simd.mul_f64s(a1, y1)), simd.mul_f64s(a2, y2))
    }
}
