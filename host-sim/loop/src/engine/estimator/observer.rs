//! [`Observer`](velocity::Observer) in lanes: the core's own code, over vectors. The observer gets the force, or the
//! acceleration from an accelerometer.

use zwidth::{
    units::Force,
    velocity::{self, Estimator, Factor, ObserverState},
};

use super::{
    Beside, VectorForm,
    accelerometer::Accelerometer,
    word::{LaneFactor, Vector},
};
use crate::{
    engine::{
        gain::GainLanes,
        lanes::{ROWS, Row},
        simd_ops::{SimdOps, lanes, lanes_mut},
    },
    scene::LATENCY_KNOWN_MAX,
};

#[derive(Clone, Copy)]
pub struct Gains<S: SimdOps> {
    observer: velocity::Observer<LaneFactor<S>>,
    per_force: GainLanes<S>,
    /// All bits are set for lanes whose gains are too large for the lane arithmetic.
    without: S::u64s,
}

#[derive(Clone, Copy)]
struct Observed<S: SimdOps> {
    state: ObserverState<Vector<S>>,
    /// Bitwise OR of all states so far. The result is above twice the limit if a state was out of bounds.
    seen: S::u64s,
}

/// Observer with force input. The granted force determines the known part of the acceleration.
pub struct Observer<S: SimdOps> {
    observed: Observed<S>,
    granted: S::u64s,
    /// Granted forces that the observer has not received yet, one per sample. The ring is only used if the actuator's
    /// latency is known.
    ring: [S::u64s; LATENCY_KNOWN_MAX as usize],
    /// Number of used entries of the ring. With 0, the observer gets a force at once.
    late: usize,
    next: usize,
}

/// Observer that gets the acceleration.
pub struct Fusion<S: SimdOps> {
    observed: Observed<S>,
    accelerometer: Accelerometer<S>,
    /// Known acceleration at the next samples.
    known: [S::u64s; ROWS],
}

/// Limit of the known acceleration, and of `x - x^` (measured minus estimated position): 2^12 counts. After a jump of
/// 2^14 counts, `x - x^` is still below 2^15 counts. As a number with 32 fractional bits, 2^15 counts is 2^47.
const LIMIT: u64 = 1 << 44;
/// Number of fractional bits of velocity and disturbance beyond those of the position. Velocity and disturbance are
/// below 2^12 counts per sample.
const MORE: [u32; 2] = [12, 16];

impl<S: SimdOps> Observed<S> {
    fn at_rest(simd: S) -> (Self, Gains<S>) {
        let zero = simd.splat_u64s(0);
        let word = Vector { simd, bits: zero };
        let state = ObserverState { error: word, velocity: word, disturbance: word };
        let factor = LaneFactor::zero(simd);
        let observer = velocity::Observer {
            position: factor,
            velocity: factor,
            disturbance: factor,
            per_force: zwidth::Gain::default(),
        };
        let gains = Gains { observer, per_force: GainLanes::zero(simd), without: zero };
        (Self { state, seen: zero }, gains)
    }

    fn start(&mut self, gains: &mut Gains<S>, lane: usize, observer: &velocity::Observer) {
        type Core = velocity::Observer<Factor>;
        let own = &mut gains.observer;
        let mut has = observer.per_force.apply(Force::FULL_SCALE.bits()).unsigned_abs() < LIMIT;
        for (place, factor, bits) in [
            (&mut own.position, observer.position, 0),
            (&mut own.velocity, observer.velocity, Core::VELOCITY_MORE),
            (&mut own.disturbance, observer.disturbance, Core::DISTURBANCE_MORE),
        ] {
            has &= place.set(lane, factor, bits);
        }
        gains.per_force.set(lane, observer.per_force);
        lanes_mut(&mut gains.without)[lane] = if has { 0 } else { u64::MAX };
        let ObserverState { error, velocity, disturbance } = &mut self.state;
        for word in [&mut error.bits, &mut velocity.bits, &mut disturbance.bits, &mut self.seen] {
            lanes_mut::<_, u64>(word)[lane] = 0;
        }
    }

    /// The velocity in LSB, after the count has changed by `moved`.
    #[inline(always)]
    fn step(&mut self, simd: S, gains: &Gains<S>, moved: S::f64s, known: S::u64s) -> S::u64s {
        let moved = Vector { simd, bits: simd.to_low(moved) };
        let known = Vector { simd, bits: known };
        let velocity = gains.observer.update(&mut self.state, moved, known).bits;
        self.seen = simd.or_u64s(self.seen, near(simd, &self.state));
        velocity
    }

    fn is_lost(&self, gains: &Gains<S>, lane: usize) -> bool {
        let get = |word: &S::u64s| lanes::<_, u64>(word)[lane];
        get(&self.seen) >= 2 * LIMIT || get(&gains.without) != 0
    }
}

impl<S: SimdOps> VectorForm<S> for Observer<S> {
    type Gains = Gains<S>;

    fn at_rest(simd: S) -> (Self, Gains<S>) {
        let (observed, gains) = Observed::at_rest(simd);
        let zero = simd.splat_u64s(0);
        let ring = [zero; LATENCY_KNOWN_MAX as usize];
        (Self { observed, granted: zero, ring, late: 0, next: 0 }, gains)
    }

    fn start(
        &mut self,
        _: S,
        gains: &mut Gains<S>,
        lane: usize,
        estimator: &Estimator,
        beside: Beside<'_>,
    ) {
        let Estimator::Observer(observer) = estimator else { return };
        self.observed.start(gains, lane, observer);
        self.late = beside.late;
        for word in std::iter::once(&mut self.granted).chain(&mut self.ring) {
            lanes_mut::<_, u64>(word)[lane] = 0;
        }
    }

    #[inline(always)]
    fn take<const R: usize>(
        forms: &mut [Self; R],
        simd: S,
        gains: &[Gains<S>; R],
        moved: &[Row<S, R>],
        _: bool,
        velocity: &mut [S::u64s; R],
    ) {
        let mut now = [forms[0].observed; R];
        let (mut known, mut last) = ([forms[0].granted; R], *velocity);
        for r in 0..R {
            (now[r], known[r]) = (forms[r].observed, forms[r].granted);
        }
        for row in moved {
            for r in 0..R {
                if forms[r].late > 0 {
                    known[r] = forms[r].tell();
                }
                last[r] = now[r].step(simd, &gains[r], row.0[r], known[r]);
            }
        }
        for r in 0..R {
            forms[r].observed = now[r];
        }
        *velocity = last;
    }

    #[inline(always)]
    fn granted(&mut self, simd: S, gains: &Gains<S>, force: S::u64s) {
        self.granted = gains.per_force.apply(simd, force);
    }

    fn is_lost(&self, gains: &Gains<S>, lane: usize) -> bool {
        self.observed.is_lost(gains, lane)
    }
}

impl<S: SimdOps> Observer<S> {
    /// Returns the force that the observer gets at this sample, and moves the ring on by one sample. Before the first
    /// sample of a hit the force is zero.
    #[inline(always)]
    fn tell(&mut self) -> S::u64s {
        let Some(place) = self.ring.get_mut(self.next) else { return self.granted };
        let told = std::mem::replace(place, self.granted);
        self.next = if self.next + 1 < self.late { self.next + 1 } else { 0 };
        told
    }
}

impl<S: SimdOps> VectorForm<S> for Fusion<S> {
    type Gains = Gains<S>;

    fn at_rest(simd: S) -> (Self, Gains<S>) {
        let (observed, gains) = Observed::at_rest(simd);
        let known = [simd.splat_u64s(0); ROWS];
        (Self { observed, accelerometer: Accelerometer::none(simd), known }, gains)
    }

    fn start(
        &mut self,
        simd: S,
        gains: &mut Gains<S>,
        lane: usize,
        estimator: &Estimator,
        beside: Beside<'_>,
    ) {
        let Estimator::Fusion(fusion) = estimator else { return };
        self.observed.start(gains, lane, &fusion.0);
        if let Some(readings) = beside.readings {
            self.accelerometer.start(simd, lane, readings);
        }
    }

    const LOOKS: bool = true;

    #[inline(always)]
    fn look<const R: usize>(forms: &mut [Self; R], simd: S, speeds: &[Row<S, R>]) {
        for form in forms.iter_mut() {
            form.accelerometer.draw(speeds.len());
        }
        let mut now = [forms[0].accelerometer.sensed; R];
        for r in 0..R {
            now[r] = forms[r].accelerometer.sensed;
        }
        for (n, row) in speeds.iter().take(ROWS).enumerate() {
            for r in 0..R {
                let Self { accelerometer: Accelerometer { scale, drawn, .. }, known, .. } =
                    &mut forms[r];
                known[n] = now[r].read(simd, scale, row.0[r], drawn[n]);
            }
        }
        for r in 0..R {
            forms[r].accelerometer.sensed = now[r];
        }
    }

    #[inline(always)]
    fn take<const R: usize>(
        forms: &mut [Self; R],
        simd: S,
        gains: &[Gains<S>; R],
        moved: &[Row<S, R>],
        _: bool,
        velocity: &mut [S::u64s; R],
    ) {
        let mut now = [forms[0].observed; R];
        for r in 0..R {
            now[r] = forms[r].observed;
        }
        let mut last = *velocity;
        for (n, row) in moved.iter().take(ROWS).enumerate() {
            for r in 0..R {
                last[r] = now[r].step(simd, &gains[r], row.0[r], forms[r].known[n]);
            }
        }
        for r in 0..R {
            forms[r].observed = now[r];
        }
        *velocity = last;
    }

    fn is_lost(&self, gains: &Gains<S>, lane: usize) -> bool {
        self.observed.is_lost(gains, lane)
    }
}

/// A number above twice [`LIMIT`] if one of the states is out of bounds.
#[inline(always)]
fn near<S: SimdOps>(simd: S, state: &ObserverState<Vector<S>>) -> S::u64s {
    let above = |word: S::u64s, more: u32| simd.add_u64s(word, simd.splat_u64s(LIMIT << more));
    let [velocity, disturbance] = MORE;
    let fast = above(state.velocity.bits, velocity);
    let fast = simd.shift_right(fast, simd.splat_u64s(velocity.into()));
    let strong = above(state.disturbance.bits, disturbance);
    let strong = simd.shift_right(strong, simd.splat_u64s(disturbance.into()));
    simd.or_u64s(above(state.error.bits, 0), simd.or_u64s(fast, strong))
}
