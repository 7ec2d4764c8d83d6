//! Vectors of loops. They compute the step of [`Simulation`](crate::simulation::Simulation), with one lane for each
//! hit.
//!
//! All lanes of a batch share the scene and the time. So outputs are due in the same samples in all lanes, and commands
//! take effect in the same samples. For this reason a hit begins only when an output is due. Before its first output, a
//! hit's command is 0 and changes nothing.

#![expect(
    clippy::needless_range_loop,
    reason = "each chain of iterators would be compiled for each kind of lanes"
)]

use pulp::WithSimd;
use zwidth::SettingsError;

use super::simd_ops::SimdOps;
use crate::simulation::prepared::{PreparedScene, WallHit};

mod actuation;
mod watch;

pub use actuation::Actuation;
pub use watch::{Motion, Watched};

/// Largest number of samples in a block. A block is computed stage by stage: first the plant moves over all samples,
/// then the filter runs. If the samples were computed one by one, each step would wait for the step before it, and take
/// twice the time.
const BLOCK: usize = 16;
const BLOCK_SAMPLES: u32 = 16;
/// Largest number of samples that a controller takes in one call.
pub const ROWS: usize = BLOCK + 1;

/// A controller in lanes. The functions of a controller are called once per block. These functions are compiled once
/// per backend, not once per plant.
pub trait LaneController<S: SimdOps, const R: usize> {
    /// Puts the controller of a hit into a lane, at rest, with the settings of the scalar loop. Returns the position of
    /// the wall's surface in counts.
    ///
    /// # Errors
    /// A setting is out of range.
    fn start(
        &mut self,
        lane: usize,
        prepared: &PreparedScene,
        hit: &WallHit,
    ) -> Result<i32, SettingsError>;
    /// Whether the controller uses the handle's speed.
    fn looks(&self) -> bool {
        false
    }
    /// Takes the handle's speeds at the next samples, in m/s.
    fn look(&mut self, _speeds: &[Row<S, R>]) {}
    /// Takes samples. `moved` is the change of the count since the sample before. If an output is `due` with the last
    /// sample, returns the output as a fraction of full scale. If no output is due, the result is undefined.
    fn take(&mut self, moved: &[Row<S, R>], due: Option<&Due<S, R>>) -> Row<S, R>;
    /// Whether the hit has left the range in which lane and controller compute the same values.
    fn is_lost(&self, lane: usize) -> bool;
}

/// Inputs from which an output is computed: depth and true speed.
pub struct Due<'a, S: SimdOps, const R: usize> {
    /// Depth of the handle behind the wall's surface, in counts.
    pub depth: [S::f64s; R],
    /// The true speed in m/s.
    pub speed: [S::f64s; R],
    pub stage: &'a OutputStage<S>,
}

/// Index of the vector that contains a lane, and index of the lane in this vector.
pub fn place<S: SimdOps>(lane: usize) -> (usize, usize) {
    (lane / S::F64_LANES, lane % S::F64_LANES)
}

/// Values of an output that all lanes share.
#[derive(Clone, Copy)]
pub struct OutputStage<S: SimdOps> {
    /// Smallest force: 0 with `push_only`, else the smallest number of the force's type.
    pub least: S::u64s,
    pub least_wall: S::f64s,
    /// Number of codes from 0 to full scale. `None` without quantisation.
    pub codes: Option<S::u64s>,
    pub codes_f64: Option<S::f64s>,
    pub per_code: S::f64s,
    /// LSB for the rounding of the twin's velocity. `None` if the velocity is not rounded.
    pub velocity_lsb: Option<S::f64s>,
    /// Factor from m/s to LSB of the core's velocity. `None` if the wall does not use the true velocity.
    pub told: Option<S::f64s>,
    pub full_scale_n: S::f64s,
}

/// Values of a sample that all lanes share.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Shared<S: SimdOps, const P: usize> {
    pub phi: [[S::f64s; P]; P],
    pub gamma: [S::f64s; P],
    pub before: [S::f64s; P],
    pub after: [S::f64s; P],
    pub rest_m: S::f64s,
    pub resolution_m: S::f64s,
    /// Number that is added to a position in counts before it is rounded down. It is 1/2 if the encoder rounds to
    /// nearest, else 0.
    pub bias: S::f64s,
    /// Whether anything is measured in addition to the counts.
    pub watches: bool,
    pub stage: OutputStage<S>,
}

/// State of a vector of hits; each sample changes the state.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Moving<S: SimdOps, const P: usize> {
    pub state: [S::f64s; P],
    /// Change of the state in one sample, caused by the acting force and the hand together.
    pub pushed: [S::f64s; P],
    pub hand: [S::f64s; P],
    /// Force that acts on the plant, in N.
    pub acting_n: S::f64s,
    pub counted: Counted<S>,
    pub watched: Watched<S>,
}

/// The encoder's last count, and sums over the window since the last check. The sums use counts relative to the first
/// count of the window. All values are whole numbers below 2^53, so they are exact.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Counted<S: SimdOps> {
    pub count: S::f64s,
    /// Largest change of the count between two samples so far.
    pub jump: S::f64s,
    pub sum: S::f64s,
    pub squares: S::f64s,
    pub deepest: S::f64s,
}

/// Values of a vector of hits that stay constant over many samples.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Kept<S: SimdOps> {
    pub surface: S::f64s,
    /// First count of the window.
    pub origin: S::f64s,
    /// All bits are set while the lane is in its window.
    pub within: S::u64s,
    /// First position of the window in m. All bits of `watching` are set from the sample of this position on.
    pub origin_m: S::f64s,
    pub watching: S::u64s,
}

/// A vector aligned in memory so that it does not cross a cache line.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Aligned<V>(pub V);

/// The state after a step without a force. The operations have the same order as in the scalar plants.
#[inline(always)]
fn free<S: SimdOps, const P: usize>(
    simd: S,
    shared: &Shared<S, P>,
    state: &[S::f64s; P],
) -> [S::f64s; P] {
    let mut next = [simd.splat_f64s(0.0); P];
    for (next, row) in next.iter_mut().zip(&shared.phi) {
        for (term, (entry, value)) in row.iter().zip(state).enumerate() {
            let product = simd.mul_f64s(*entry, *value);
            let first = P == 2 && term == 0; // same order as `ExactStep`
            *next = if first { product } else { simd.add_f64s(*next, product) };
        }
    }
    next
}

#[inline(always)]
fn plus<S: SimdOps, const P: usize>(
    simd: S,
    mut state: [S::f64s; P],
    pushed: [S::f64s; P],
) -> [S::f64s; P] {
    for (state, pushed) in state.iter_mut().zip(pushed) {
        *state = simd.add_f64s(*state, pushed);
    }
    state
}

/// Change of the state in one sample, caused by a force of the actuator and by the hand's force.
#[inline(always)]
fn pushed<S: SimdOps, const P: usize>(
    simd: S,
    effect: &[S::f64s; P],
    force_n: S::f64s,
    hand: &[S::f64s; P],
) -> [S::f64s; P] {
    let mut pushed = *hand;
    for (pushed, effect) in pushed.iter_mut().zip(effect) {
        *pushed = simd.add_f64s(simd.mul_f64s(*effect, force_n), *pushed);
    }
    pushed
}

/// One field of each of the R vectors. A generic function would be compiled for each kind of lanes, a macro is not.
macro_rules! each_field {
    ($vectors:expr, $field:ident) => {{
        let mut values = [$vectors[0].$field; R];
        for r in 1..R {
            values[r] = $vectors[r].$field;
        }
        values
    }};
}
use each_field;

/// Several samples of all lanes, to be computed in one call.
pub struct Chunk<'a, S: SimdOps, const P: usize, const R: usize> {
    pub shared: &'a Shared<S, P>,
    pub kept: &'a [Kept<S>; R],
    pub moving: &'a mut [Moving<S, P>; R],
    pub controller: &'a mut dyn LaneController<S, R>,
    pub actuation: &'a mut Actuation<S, R>,
    /// Receives all positions, if they are measured.
    pub motion: Option<&'a mut Motion<S, R>>,
    /// Receives the speeds of a block in m/s, if the controller uses them.
    pub speeds: Option<&'a mut [Row<S, R>; ROWS]>,
    pub samples: u32,
}

/// A value of all lanes.
pub type Row<S, const R: usize> = Aligned<[<S as pulp::Simd>::f64s; R]>;

impl<S: SimdOps, const P: usize> Moving<S, P> {
    /// State of a handle at rest, before sample 0.
    pub fn new(simd: S) -> Self {
        let zero = simd.splat_f64s(0.0);
        let counted = Counted { count: zero, jump: zero, sum: zero, squares: zero, deepest: zero };
        let nothing = [zero; P];
        let watched = Watched::new(simd);
        let (state, pushed, hand) = (nothing, nothing, nothing);
        Self { state, pushed, hand, acting_n: zero, counted, watched }
    }

    #[inline(always)]
    pub fn position_m(&self, simd: S, shared: &Shared<S, P>) -> S::f64s {
        simd.add_f64s(self.state[0], shared.rest_m)
    }

    #[inline(always)]
    fn advance(&mut self, simd: S, shared: &Shared<S, P>) {
        let free = free(simd, shared, &self.state);
        self.state = plus(simd, free, self.pushed);
    }

    #[inline(always)]
    fn advance_split(&mut self, simd: S, shared: &Shared<S, P>, force_n: S::f64s) {
        self.state = free(simd, shared, &self.state);
        for (state, effect) in self.state.iter_mut().zip(&shared.before) {
            *state = simd.add_f64s(*state, simd.mul_f64s(*effect, self.acting_n));
        }
        let after = pushed(simd, &shared.after, force_n, &self.hand);
        self.state = plus(simd, self.state, after);
        self.acting_n = force_n;
        self.pushed = pushed(simd, &shared.gamma, force_n, &self.hand);
    }
}

impl<S: SimdOps, const P: usize, const R: usize> Chunk<'_, S, P, R> {
    /// Runs the samples with the instructions of this backend.
    pub fn go(self, simd: S) {
        struct Go<'a, S: SimdOps, const P: usize, const R: usize>(Chunk<'a, S, P, R>, S);
        impl<S: SimdOps, const P: usize, const R: usize> WithSimd for Go<'_, S, P, R> {
            type Output = ();

            #[inline(always)]
            fn with_simd<T: pulp::Simd>(mut self, _: T) {
                self.0.run(self.1);
            }
        }
        simd.vectorize(Go(self, simd));
    }

    #[inline(always)]
    fn run(&mut self, simd: S) {
        let mut buffer = [Aligned([simd.splat_f64s(0.0); R]); ROWS];
        let mut speeds = self.speeds.take();
        let mut left = self.samples;
        while left > 0 {
            let plain = left.min(self.actuation.samples_to_event());
            let samples = plain.min(BLOCK_SAMPLES);
            left -= samples;
            self.actuation.phase += samples;
            // If a block reaches an event (an output, an arriving command) within the chunk, the sample with the event
            // is the last sample of the block.
            let event = samples == plain && left > 0;
            let Some(block) = buffer.get_mut(..=samples as usize) else { return };
            let end = samples as usize + usize::from(event);
            match &mut speeds {
                None => self.move_on::<false>(simd, block, &mut []),
                Some(speeds) => {
                    self.move_on::<true>(simd, block, &mut speeds[..]);
                    self.controller.look(speeds.get(..end).unwrap_or_default());
                }
            }
            let Some(block) = buffer.get_mut(..end) else { return };
            if self.shared.watches {
                self.watch(simd, block);
            }
            self.count(simd, block);
            if event && self.actuation.is_due() {
                self.output(simd, block);
            } else {
                self.controller.take(block, None);
            }
            if event {
                self.event(simd);
                left -= 1;
            }
        }
    }

    /// Computes the handle's positions in m, at the beginning of a block and after each sample. No command may arrive
    /// in the block. With `LOOKS`, the handle's speeds in m/s are computed too.
    #[inline(always)]
    fn move_on<const LOOKS: bool>(
        &mut self,
        simd: S,
        block: &mut [Row<S, R>],
        speeds: &mut [Row<S, R>],
    ) {
        let mut speeds = speeds.iter_mut();
        let Some((last, block)) = block.split_last_mut() else { return };
        let mut state = each_field!(self.moving, state);
        let pushed = each_field!(self.moving, pushed);
        let shared = *self.shared;
        for row in block {
            if LOOKS && let Some(speeds) = speeds.next() {
                for r in 0..R {
                    speeds.0[r] = state[r][1];
                }
            }
            for r in 0..R {
                row.0[r] = simd.add_f64s(state[r][0], shared.rest_m);
                state[r] = plus(simd, free(simd, &shared, &state[r]), pushed[r]);
            }
        }
        for r in 0..R {
            self.moving[r].state = state[r];
            last.0[r] = self.moving[r].position_m(simd, &shared);
        }
        if LOOKS && let Some(speeds) = speeds.next() {
            for r in 0..R {
                speeds.0[r] = state[r][1];
            }
        }
    }

    /// Converts the positions of a block to changes of the count, and updates the sums of the window.
    #[inline(always)]
    fn count(&mut self, simd: S, block: &mut [Row<S, R>]) {
        let Shared { resolution_m, bias, .. } = *self.shared;
        let mut counted = each_field!(self.moving, counted);
        let (origin, within) = (each_field!(self.kept, origin), each_field!(self.kept, within));
        for row in block {
            for r in 0..R {
                let Counted { count: last, jump, sum, squares, deepest } = counted[r];
                let exact = simd.div_f64s(row.0[r], resolution_m);
                let count = simd.floor(simd.add_f64s(exact, bias));
                let difference = simd.sub_f64s(count, last);
                let away = simd.masked(simd.sub_f64s(count, origin[r]), within[r]);
                counted[r] = Counted {
                    count,
                    jump: simd.max_of(jump, simd.magnitude(difference)),
                    sum: simd.add_f64s(sum, away),
                    // the result is exact, with or without a fused operation
                    squares: simd.mul_add_e_f64s(away, away, squares),
                    deepest: simd.max_of(deepest, away),
                };
                row.0[r] = difference;
            }
        }
        for r in 0..R {
            self.moving[r].counted = counted[r];
        }
    }

    /// Runs the controller over a block, and sends its output to the actuator.
    #[inline(always)]
    fn output(&mut self, simd: S, block: &[Row<S, R>]) {
        let stage = &self.shared.stage;
        let mut depth = each_field!(self.kept, surface);
        let mut speed = depth;
        // a closure that is not inlined would not use the instructions of this backend
        for r in 0..R {
            depth[r] = simd.sub_f64s(self.moving[r].counted.count, depth[r]);
            speed[r] = self.moving[r].state[1];
        }
        let mut forces_n = self.controller.take(block, Some(&Due { depth, speed, stage })).0;
        for r in 0..R {
            if self.shared.watches {
                self.moving[r].watched.output(simd, forces_n[r], self.kept[r].watching);
            }
            forces_n[r] = simd.mul_f64s(forces_n[r], stage.full_scale_n);
        }
        self.actuation.phase = 0;
        self.actuation.send(forces_n);
    }

    /// Applies an arriving command, and moves the plant to the next sample.
    #[inline(always)]
    fn event(&mut self, simd: S) {
        let arriving =
            (self.actuation.phase == self.actuation.arrival).then(|| self.actuation.oldest());
        for r in 0..R {
            match arriving {
                Some(forces_n) => self.moving[r].advance_split(simd, self.shared, forces_n[r]),
                None => self.moving[r].advance(simd, self.shared),
            }
        }
        self.actuation.phase += 1;
    }
}

/// Returns all ones if `set`, else all zeros.
pub fn mask(set: bool) -> u64 {
    if set { u64::MAX } else { 0 }
}
