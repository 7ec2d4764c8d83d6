//! Keeps all lanes busy: checks their results, ends hits and begins new hits.

use zwidth::{
    Output,
    actuator::Actuator,
    experiment::{Hit, HitPlan, RunningVariance, Verdict},
    units::{Force, Position},
};

use super::{
    estimator::Form,
    lanes::{
        Actuation, Aligned, Chunk, Kept, LaneController, Motion, Moving, OutputStage, ROWS, Row,
        Shared, mask, place,
    },
    simd_ops::{SimdOps, lanes, lanes_mut},
    work::{Depth, Outcome, Pushes, Tally, Task, scalar},
};
use crate::{
    plant::{ExactStep, Plant as _},
    scene::Rounding,
    simulation::{
        controller::lsb_per_m_per_s,
        prepared::{HitError, Numeric, PreparedScene, WallHit},
        twin,
        window::{Stiff, Watch},
    },
};

/// Largest number of samples between two checks of the lanes.
const CHUNK_SAMPLES: u32 = 512;
/// Largest change of the count between two samples in a lane.
const JUMP_MAX: f64 = (1 << 14) as f64;
/// Largest distance of the count from zero when a lane is checked. Until the next check the count then stays within the
/// core's range, because 2^29 + 512 * 2^14 < 2^30.
const COUNT_MAX: f64 = (1 << 29) as f64;
/// Limit below which sums of squares are exact.
const SQUARES_MAX: f64 = (1u64 << 53) as f64;

#[derive(Clone, Debug)]
struct Running<'a> {
    hit: WallHit,
    /// The scene, with the push of this hit.
    prepared: &'a PreparedScene,
    /// Number of samples that the hit has taken so far.
    samples: u32,
    surface: i32,
    /// First count of the window.
    origin: i32,
    variance: RunningVariance,
    contact: bool,
}

struct Scheduler<'a, 'c, S: SimdOps, const P: usize, const R: usize> {
    simd: S,
    task: Task<'a>,
    step: ExactStep<P>,
    /// Whether a hit is over, so that the next hit waits for the next due output.
    waiting: bool,
    tally: Tally,
    shared: Shared<S, P>,
    kept: [Kept<S>; R],
    moving: [Moving<S, P>; R],
    controller: &'c mut dyn LaneController<S, R>,
    actuation: Actuation<S, R>,
    motion: Option<Motion<S, R>>,
    speeds: Option<Box<[Row<S, R>; ROWS]>>,
    running: Vec<Option<Running<'a>>>,
}

/// Runs the hits of `work` in lanes. All lanes run in the calling thread.
pub fn run<'a, S: SimdOps, const P: usize, const R: usize>(
    simd: S,
    task: Task<'a>,
    step: &ExactStep<P>,
    controller: &mut dyn LaneController<S, R>,
    work: &mut Pushes<'a>,
) -> Tally {
    let mut scheduler = Scheduler::<S, P, R>::new(simd, task, step, controller);
    for lane in 0..scheduler.running.len() {
        scheduler.begin(lane, work);
    }
    while let Some(samples) = scheduler.until_next_event() {
        let Scheduler { shared, kept, moving, controller, actuation, motion, speeds, .. } =
            &mut scheduler;
        let (controller, motion) = (&mut **controller, motion.as_mut());
        let speeds = speeds.as_deref_mut();
        Chunk { shared, kept, moving, controller, actuation, motion, speeds, samples }.go(simd);
        for lane in 0..scheduler.running.len() {
            if let Some(outcome) = scheduler.look(lane, samples) {
                scheduler.waiting = true;
                let running = scheduler.running[lane].take();
                let outcome = match (outcome, running) {
                    (Some(outcome), _) => {
                        scheduler.tally.in_lanes += 1;
                        Ok(outcome)
                    }
                    (None, Some(running)) => scheduler.scalar(running.prepared, &running.hit),
                    (None, None) => continue,
                };
                work.done(lane, outcome);
            }
        }
        if scheduler.waiting && scheduler.actuation.is_due() {
            scheduler.waiting = false;
            for lane in 0..scheduler.running.len() {
                if scheduler.running[lane].is_none() {
                    scheduler.begin(lane, work);
                }
            }
        }
    }
    scheduler.tally
}

impl<'a, 'c, S: SimdOps, const P: usize, const R: usize> Scheduler<'a, 'c, S, P, R> {
    fn new(
        simd: S,
        task: Task<'a>,
        step: &ExactStep<P>,
        controller: &'c mut dyn LaneController<S, R>,
    ) -> Self {
        let parts = task.prepared.parts();
        let zero = simd.splat_f64s(0.0);
        let splat = |value: f64| simd.splat_f64s(value);
        let mut phi = [[zero; P]; P];
        for (phi, row) in phi.iter_mut().zip(&step.phi) {
            *phi = each(simd, row);
        }
        let shared = Shared {
            phi,
            gamma: each(simd, &step.gamma),
            before: each(simd, &step.before),
            after: each(simd, &step.after),
            rest_m: splat(step.rest_m[0]),
            resolution_m: splat(parts.encoder.resolution_m),
            bias: splat(if parts.encoder.rounding == Rounding::Round { 0.5 } else { 0.0 }),
            watches: !task.prepared.judge().is_plain(),
            stage: stage(simd, task),
        };
        let kept = Kept {
            surface: zero,
            origin: zero,
            within: simd.splat_u64s(0),
            origin_m: zero,
            watching: simd.splat_u64s(0),
        };
        let listens = task.prepared.judge().listens();
        let motion = listens.then(|| Motion::new(simd, task.prepared.plan().window));
        let actuation = Actuation::new(simd, parts.period, parts.latency);
        let speeds = controller.looks().then(|| Box::new([Aligned([zero; R]); ROWS]));
        Self {
            simd,
            task,
            step: *step,
            waiting: false,
            tally: Tally::default(),
            shared,
            kept: [kept; R],
            moving: [Moving::new(simd); R],
            controller,
            actuation,
            motion,
            speeds,
            running: vec![None; R * S::F64_LANES],
        }
    }

    fn scalar(&mut self, prepared: &PreparedScene, hit: &WallHit) -> Result<Outcome, HitError> {
        self.tally.scalar += 1;
        scalar(Task { prepared, ..self.task }, hit)
    }

    /// Puts the next hit into a free lane. Hits that cannot run in lanes are run here, in the scalar loop.
    fn begin(&mut self, lane: usize, work: &mut Pushes<'a>) {
        let own = Form::of(self.task.prepared.scene().velocity.estimator());
        while let Some((hit, prepared)) = work.next(lane) {
            if Form::of(hit.velocity.name()) != own {
                work.done(lane, self.scalar(prepared, &hit));
                continue;
            }
            match self.controller.start(lane, prepared, &hit) {
                Err(error) => {
                    self.tally.scalar += 1;
                    work.done(lane, Err(error.into()));
                }
                Ok(_) if f64::from(prepared.first_count(&hit)).abs() > COUNT_MAX => {
                    work.done(lane, self.scalar(prepared, &hit));
                }
                Ok(surface) => return self.start(lane, prepared, hit, surface),
            }
        }
        self.idle(lane);
    }

    fn start(&mut self, lane: usize, prepared: &'a PreparedScene, hit: WallHit, surface: i32) {
        let (vector, place) = place::<S>(lane);
        let (kept, moving) = (&mut self.kept[vector], &mut self.moving[vector]);
        let state = self.step.at_rest(prepared.start_m(&hit));
        let set = |vector: &mut S::f64s, value: f64| lanes_mut(vector)[place] = value;
        for (vector, value) in moving.state.iter_mut().zip(state) {
            set(vector, value);
        }
        let hand = prepared.parts().plant.hand();
        for ((pushed, of_hand), hand) in moving.pushed.iter_mut().zip(&mut moving.hand).zip(hand) {
            set(pushed, 0.0 + hand);
            set(of_hand, hand);
        }
        for vector in [&mut moving.acting_n, &mut moving.counted.jump] {
            set(vector, 0.0);
        }
        set(&mut moving.counted.count, prepared.first_count(&hit).into());
        set(&mut kept.surface, surface.into());
        lanes_mut(&mut kept.within)[place] = mask(false);
        lanes_mut(&mut kept.watching)[place] = mask(false);
        for commands_n in &mut self.actuation.commands_n {
            set(&mut commands_n.0[vector], 0.0);
        }
        self.running[lane] = Some(Running {
            hit,
            prepared,
            samples: 0,
            surface,
            origin: 0,
            variance: RunningVariance::default(),
            contact: false,
        });
    }

    /// Puts a handle at the device's rest position into a lane that has no hit.
    fn idle(&mut self, lane: usize) {
        let still = Moving::<S, P>::new(self.simd);
        let (vector, place) = place::<S>(lane);
        let moving = &mut self.moving[vector];
        for (vector, value) in moving.state.iter_mut().zip(still.state) {
            lanes_mut::<_, f64>(vector)[place] = lanes::<_, f64>(&value)[place];
        }
        for vector in moving.pushed.iter_mut().chain(&mut moving.hand) {
            lanes_mut(vector)[place] = 0.0;
        }
        lanes_mut(&mut moving.acting_n)[place] = 0.0;
        lanes_mut(&mut self.kept[vector].within)[place] = mask(false);
    }

    /// Number of samples until a lane must be checked. `None` if no lane has a hit.
    fn until_next_event(&self) -> Option<u32> {
        let to_output = self.waiting.then(|| self.actuation.samples_to_output());
        let soonest = soonest(&self.running, self.task.prepared.plan(), self.shared.watches);
        let samples = [soonest, to_output].into_iter().flatten().min()?;
        Some(samples.min(CHUNK_SAMPLES))
    }

    /// Checks a lane after `samples` more samples. Returns `None` if the lane's hit is not over. If the hit is over,
    /// returns its outcome, or `Some(None)` if the outcome is not valid.
    fn look(&mut self, lane: usize, samples: u32) -> Option<Option<Outcome>> {
        let running = self.running[lane].as_mut()?;
        running.samples += samples;
        let (vector, place) = place::<S>(lane);
        let (kept, moving) = (&mut self.kept[vector], &mut self.moving[vector]);
        let get = |vector: &S::f64s| lanes::<_, f64>(vector)[place];
        let count = get(&moving.counted.count);
        let mut finite = true;
        for value in &moving.state {
            finite &= get(value).is_finite();
        }
        let near = get(&moving.counted.jump) <= JUMP_MAX && count.abs() <= COUNT_MAX;
        if !finite || !near || self.controller.is_lost(lane) {
            return Some(None);
        }
        let settle = self.task.prepared.plan().settle;
        if running.samples == settle && self.shared.watches {
            let at_m = get(&moving.position_m(self.simd, &self.shared));
            lanes_mut(&mut kept.origin_m)[place] = at_m;
            lanes_mut(&mut kept.watching)[place] = mask(true);
            moving.watched.clear(place);
        }
        if running.samples <= settle {
            return None;
        }
        if running.samples == settle + 1 {
            running.open_window(count);
            lanes_mut(&mut kept.origin)[place] = count;
            lanes_mut(&mut kept.within)[place] = mask(true);
            lanes_mut(&mut moving.counted.deepest)[place] = f64::NEG_INFINITY;
        } else {
            let sums = [get(&moving.counted.sum), get(&moving.counted.squares)];
            if !running.add(samples, sums, get(&moving.counted.deepest)) {
                return Some(None);
            }
        }
        lanes_mut(&mut moving.counted.sum)[place] = 0.0;
        lanes_mut(&mut moving.counted.squares)[place] = 0.0;
        let watch = moving.watched.lane(place, get(&kept.origin_m));
        let motion = self.motion.as_ref();
        let motion = || motion.map_or(vec![], |motion| motion.lane(vector, place));
        running.judge(self.task.depth, &watch, motion).map(Some)
    }
}

/// Number of samples until one of these hits must be checked. A hit is checked after the first sample of its window,
/// because this sample gives the origin, and at its end. With `watches`, the hit is also checked just before its
/// window.
fn soonest(running: &[Option<Running<'_>>], plan: &HitPlan, watches: bool) -> Option<u32> {
    let next = |running: &Running| match running.samples {
        n if watches && n < plan.settle => plan.settle - n,
        n if n <= plan.settle => plan.settle + 1 - n,
        n => plan.settle + plan.window - n,
    };
    running.iter().flatten().map(next).min()
}

impl Running<'_> {
    /// Begins the window. `count` is the first count of the window.
    fn open_window(&mut self, count: f64) {
        #[expect(clippy::cast_possible_truncation, reason = "whole and below 2^30")]
        let count = count as i32;
        self.variance.push(Position::from_counts(count));
        self.contact = count > self.surface;
        self.origin = count;
    }

    /// Adds the sums and the deepest position of `samples` more samples. They are in counts relative to the first count
    /// of the window. Returns `false` if the sums may not be exact.
    fn add(&mut self, samples: u32, [sum, squares]: [f64; 2], deepest: f64) -> bool {
        #[expect(clippy::cast_possible_truncation, reason = "whole and below 2^53")]
        let integer = |value: f64| value as i64;
        if squares >= SQUARES_MAX {
            return false;
        }
        self.variance.add(samples, integer(sum), integer(squares).unsigned_abs().into());
        self.contact |= deepest > f64::from(self.surface) - f64::from(self.origin);
        true
    }

    /// Returns the outcome if the hit is over or its verdict is certain.
    fn judge(
        &self,
        depth: Depth,
        watch: &Watch,
        motion: impl FnOnce() -> Vec<f64>,
    ) -> Option<Outcome> {
        let prepared = self.prepared;
        let hit = Hit::in_window(*prepared.plan(), u32::from(self.contact), self.variance);
        if !hit.is_over() {
            let early = depth != Depth::Whole;
            let certain = || prepared.judge().certain_verdict(&hit, watch, prepared.plan().window);
            return early.then(certain).flatten().map(Outcome::of);
        }
        let plain = prepared.judge().is_plain();
        if plain && depth != Depth::Whole {
            return Some(Outcome::of(hit.verdict()));
        }
        let stiffness_n_per_m = self.hit.stiffness_n_per_m;
        let wall = Stiff { stiffness_n_per_m, surface: self.surface };
        let measures = prepared.judge().measures(&hit, wall, watch, motion);
        let verdict = prepared.judge().verdict(&hit, wall, &measures);
        let shown = match depth {
            Depth::Verdict => false,
            Depth::Bounded => verdict != Verdict::Unstable,
            Depth::Whole => true,
        };
        Some(Outcome {
            verdict,
            rms_m: (depth == Depth::Whole).then_some(measures.rms_m),
            measures: (shown && !plain).then_some(measures),
        })
    }
}

/// One vector for each number. All lanes of the vector have this number.
fn each<S: SimdOps, const P: usize>(simd: S, numbers: &[f64; P]) -> [S::f64s; P] {
    let mut vectors = [simd.splat_f64s(0.0); P];
    for (vector, number) in vectors.iter_mut().zip(numbers) {
        *vector = simd.splat_f64s(*number);
    }
    vectors
}

/// Computes the values of an output that are the same for all hits.
fn stage<S: SimdOps>(simd: S, task: Task<'_>) -> OutputStage<S> {
    let Task { prepared, numeric, .. } = task;
    let splat = |value: f64| simd.splat_f64s(value);
    let push_only = prepared.scene().wall.push_only;
    let codes = match prepared.design().output {
        Output::Continuous => None,
        Output::Dac { .. } | Output::Pwm { .. } => Actuator::new(prepared.design().output).ok(),
    };
    let codes = codes.map(|actuator| actuator.codes_per_full_scale());
    let per_full_scale = codes.unwrap_or(Force::FULL_SCALE.bits().unsigned_abs());
    OutputStage {
        least: simd.splat_u64s(if push_only { 0 } else { i64::MIN.cast_unsigned() }),
        least_wall: splat(if push_only { 0.0 } else { f64::NEG_INFINITY }),
        codes: codes.map(|codes| simd.splat_u64s(codes.into())),
        codes_f64: codes.map(|codes| splat(codes.into())),
        per_code: splat(1.0 / f64::from(per_full_scale)),
        told: prepared.is_told().then(|| splat(lsb_per_m_per_s(prepared.design()))),
        velocity_lsb: (numeric == Numeric::F64Rounded).then(|| splat(twin::ROUND_TO_LSB)),
        full_scale_n: splat(task.prepared.parts().full_scale_n),
    }
}
