//! The fixed-point core in lanes: estimators ([`super::estimator`]), [`Wall::demand`](zwidth::Wall::demand),
//! [`Demand::saturate`](zwidth::units::Demand::saturate) and [`Actuator::command`](zwidth::Actuator::command).
//!
//! In lanes only the force saturates. [`LaneController::is_lost`] detects a hit that comes near any other limit of the
//! core. The core itself then runs this hit.

use pulp::WithSimd;
use zwidth::{LoopParameters, SettingsError, units::Force};

use super::{
    estimator::{
        Beside, Each, Form, VectorForm,
        kalman::Kalman,
        levant::Levant,
        low_pass::{Cascade, LowPass},
        mean::Mean,
        observer::{Fusion, Observer},
        window::{Adaptive, Sum, Window},
    },
    gain::GainLanes,
    lanes::{Aligned, Due, LaneController, OutputStage, Row, place},
    simd_ops::{SimdOps, lanes_mut},
};
use crate::simulation::prepared::{PreparedScene, WallHit};

/// Half an LSB of a product with 30 fractional bits.
const HALF: u64 = 1 << 29;

#[repr(align(64))]
pub struct FixedLoop<S: SimdOps, F: VectorForm<S>, const R: usize> {
    simd: S,
    forms: [F; R],
    gains: [F::Gains; R],
    /// Velocities in LSB, in the lower 32 bits.
    velocity: [S::u64s; R],
    walls: [Wall<S>; R],
}

/// The core's loop with an estimator of a given form.
pub fn fixed_loop<S: SimdOps, const R: usize>(
    form: Form,
    simd: S,
) -> Box<dyn LaneController<S, R>> {
    fn of<S: SimdOps, F, const R: usize>(simd: S) -> Box<dyn LaneController<S, R>>
    where
        F: VectorForm<S> + 'static,
    {
        Box::new(FixedLoop::<S, F, R>::new(simd))
    }
    match form {
        Form::LowPass | Form::LikeLowPass => of::<S, Each<LowPass<S>>, R>(simd),
        Form::Cascade => of::<S, Each<Cascade<S>>, R>(simd),
        Form::Kalman => of::<S, Each<Kalman<S>>, R>(simd),
        Form::Mean => of::<S, Mean<S>, R>(simd),
        Form::Fir => of::<S, Window<S, Sum<S>>, R>(simd),
        Form::FoawEnd => of::<S, Window<S, Adaptive<S, false>>, R>(simd),
        Form::FoawBest => of::<S, Window<S, Adaptive<S, true>>, R>(simd),
        Form::LevantExplicit => of::<S, Each<Levant<S, false>>, R>(simd),
        Form::LevantImplicit => of::<S, Each<Levant<S, true>>, R>(simd),
        Form::Observer => of::<S, Observer<S>, R>(simd),
        Form::Fusion => of::<S, Fusion<S>, R>(simd),
    }
}

struct Begin<'a> {
    control: LoopParameters,
    beside: Beside<'a>,
}

/// Computes a hit's settings. This function is not generic over the lanes, so it is compiled once.
#[inline(never)]
fn begin<'a>(
    prepared: &'a PreparedScene,
    hit: &WallHit,
    looks: bool,
) -> Result<Begin<'a>, SettingsError> {
    let control = *prepared.core(hit)?.control();
    let scene = prepared.scene();
    let actuator = &scene.actuator;
    let late = if actuator.latency_known { actuator.latency_samples() as usize } else { 0 };
    let readings = if looks { prepared.readings() } else { None };
    Ok(Begin { control, beside: Beside { late, readings } })
}

#[derive(Clone, Copy)]
struct Wall<S: SimdOps> {
    push: S::u64s,
    stiffness: GainLanes<S>,
    damping: GainLanes<S>,
}

impl<S: SimdOps, F: VectorForm<S>, const R: usize> FixedLoop<S, F, R> {
    pub fn new(simd: S) -> Self {
        let (_, gains) = F::at_rest(simd);
        let gain = GainLanes::zero(simd);
        Self {
            simd,
            forms: std::array::from_fn(|_| F::at_rest(simd).0),
            gains: [gains; R],
            velocity: [simd.splat_u64s(0); R],
            walls: [Wall { push: simd.splat_u64s(0), stiffness: gain, damping: gain }; R],
        }
    }
}

impl<S: SimdOps, F: VectorForm<S>, const R: usize> LaneController<S, R> for FixedLoop<S, F, R> {
    fn start(
        &mut self,
        lane: usize,
        prepared: &PreparedScene,
        hit: &WallHit,
    ) -> Result<i32, SettingsError> {
        let Begin { control, beside } = begin(prepared, hit, F::LOOKS)?;
        let (vector, place) = place::<S>(lane);
        let gains = &mut self.gains[vector];
        self.forms[vector].start(self.simd, gains, place, &control.estimator, beside);
        lanes_mut::<_, u64>(&mut self.velocity[vector])[place] = 0;
        let push = i64::from(prepared.plan().push.bits()).cast_unsigned();
        lanes_mut::<_, u64>(&mut self.walls[vector].push)[place] = push;
        self.walls[vector].stiffness.set(place, control.wall.stiffness());
        self.walls[vector].damping.set(place, control.wall.damping());
        Ok(control.wall.surface().counts())
    }

    fn looks(&self) -> bool {
        F::LOOKS
    }

    fn look(&mut self, speeds: &[Row<S, R>]) {
        struct Look<'a, S: SimdOps, F: VectorForm<S>, const R: usize>(
            &'a mut FixedLoop<S, F, R>,
            &'a [Row<S, R>],
        );
        impl<S: SimdOps, F: VectorForm<S>, const R: usize> WithSimd for Look<'_, S, F, R> {
            type Output = ();

            #[inline(always)]
            fn with_simd<T: pulp::Simd>(self, _: T) {
                let Look(FixedLoop { simd, forms, .. }, speeds) = self;
                F::look(forms, *simd, speeds);
            }
        }
        self.simd.vectorize(Look(self, speeds));
    }

    fn take(&mut self, moved: &[Row<S, R>], due: Option<&Due<S, R>>) -> Row<S, R> {
        struct Take<'a, S: SimdOps, F: VectorForm<S>, const R: usize>(
            &'a mut FixedLoop<S, F, R>,
            &'a [Row<S, R>],
            Option<&'a Due<'a, S, R>>,
        );
        impl<S: SimdOps, F: VectorForm<S>, const R: usize> WithSimd for Take<'_, S, F, R> {
            type Output = Row<S, R>;

            #[inline(always)]
            fn with_simd<T: pulp::Simd>(self, _: T) -> Row<S, R> {
                let Take(FixedLoop { simd, forms, gains, velocity, walls }, moved, due) = self;
                F::take(forms, *simd, gains, moved, due.is_some(), velocity);
                let mut outputs = Aligned([simd.splat_f64s(0.0); R]);
                if let Some(Due { depth, speed, stage }) = due {
                    for r in 0..R {
                        let force = walls[r].force(*simd, depth[r], velocity[r], speed[r], stage);
                        forms[r].granted(*simd, &gains[r], force);
                        outputs.0[r] = output(*simd, force, stage);
                    }
                }
                outputs
            }
        }
        self.simd.vectorize(Take(self, moved, due))
    }

    fn is_lost(&self, lane: usize) -> bool {
        let (vector, place) = place::<S>(lane);
        self.forms[vector].is_lost(&self.gains[vector], place)
    }
}

impl<S: SimdOps> Wall<S> {
    /// The granted force in LSB.
    #[inline(always)]
    fn force(
        &self,
        simd: S,
        depth: S::f64s,
        velocity: S::u64s,
        speed: S::f64s,
        stage: &OutputStage<S>,
    ) -> S::u64s {
        let zero = simd.splat_u64s(0);
        let inside = simd.greater_than_f64s(depth, simd.splat_f64s(0.0));
        let spring = self.stiffness.apply(simd, simd.to_low(depth));
        let velocity = match stage.told {
            None => velocity,
            Some(scale) => {
                let exact = simd.add_f64s(simd.mul_f64s(speed, scale), simd.splat_f64s(0.5));
                simd.to_low(simd.floor(exact))
            }
        };
        let damper = self.damping.apply(simd, velocity);
        let total = simd.larger(simd.add_u64s(spring, damper), stage.least);
        let wall = simd.select_u64s(inside, total, zero);
        let full = simd.splat_u64s(Force::FULL_SCALE.bits().unsigned_abs().into());
        let wanted = simd.sub_u64s(self.push, wall);
        simd.smaller(simd.larger(wanted, simd.sub_u64s(zero, full)), full)
    }
}

/// The output for a force, as a fraction of full scale.
#[inline(always)]
fn output<S: SimdOps>(simd: S, force: S::u64s, stage: &OutputStage<S>) -> S::f64s {
    let zero = simd.splat_u64s(0);
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

/// `value`, with its sign changed in the lanes where `negative` has all bits set.
#[inline(always)]
fn signed<S: SimdOps>(simd: S, value: S::u64s, negative: S::u64s) -> S::u64s {
    simd.sub_u64s(simd.xor_u64s(value, negative), negative)
}
