//! The sampled loop: plant, encoder, controller, latency, in the order that the design fixes.

pub(crate) mod accelerometer;
mod block;
pub mod controller;
pub mod edge;
pub(crate) mod hit;
pub mod passive;
pub mod port;
pub mod prepared;
pub mod senses;
pub mod trace;
pub mod twin;
pub mod window;

use std::ops::ControlFlow;

use block::Run;
pub use block::{Block, Output};

pub use crate::plant::quantiser;

use crate::{
    plant::{AnyPlant, Plant, RUN, Span},
    simulation::{
        controller::{Controller, ControllerOutput},
        quantiser::Quantiser,
        senses::{Full, Handle, Sensing},
    },
};

/// The parts of the loop that a run does not change.
#[derive(Clone, Copy, Debug)]
pub struct Parts<P> {
    /// What moves, with its step split where a command takes effect.
    pub plant: P,
    /// How a position becomes a count.
    pub encoder: Quantiser,
    /// Force at full command, N.
    pub full_scale_n: f64,
    /// Whole samples from the encoder reading to the force; the fraction is in `plant`.
    pub latency: u32,
    /// Samples per output, as the controller keeps it.
    pub period: u32,
}

/// One sample of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of the sample, from 0; its time is `index / rate`.
    pub index: u64,
    /// Position of the handle at the sample, m.
    pub position_m: f64,
    /// What the encoder read.
    pub count: i32,
    /// The controller's velocity, counts per sample.
    pub velocity: f64,
    /// The output computed with this sample, if one was due.
    pub rendered: Option<ControllerOutput>,
    /// Force that acts on the handle at the end of this sample, N.
    pub output_n: f64,
}

/// A run in progress.
#[derive(Clone, Debug)]
pub struct Simulation<C, S = Full, P: Plant = AnyPlant> {
    parts: Parts<P>,
    moving: Moving<C, S, P::State>,
    /// A ring with room for all commands that can be on their way to the actuator at once, N.
    forces_n: Box<[f64]>,
    block: Box<Block>,
}

/// What a run changes.
#[derive(Clone, Copy, Debug)]
struct Moving<C, S, X> {
    controller: C,
    sensing: S,
    state: X,
    index: u64,
    /// Samples until the next output; 0 means with the next sample. As the controller counts them.
    until_due: u32,
    output_n: f64,
    on_the_way: Latency,
}

/// Commands on their way to the actuator. One sets out every `period` samples, and each takes
/// effect `latency` samples after the sample that it answers.
#[derive(Clone, Copy, Debug)]
struct Latency {
    write: usize,
    read: usize,
    /// Sample at which the next one takes effect.
    effective: u64,
    period: u64,
}

impl Latency {
    #[inline]
    fn send(&mut self, forces_n: &mut [f64], force_n: f64) {
        if let Some(slot) = forces_n.get_mut(self.write) {
            *slot = force_n;
        }
        self.write = following(self.write, forces_n);
    }

    /// How many samples after `index` the next command takes effect, if within a run, and that command, as far as
    /// it is known before that sample is taken: one of this very sample is not.
    #[inline]
    fn next(&self, forces_n: &[f64], index: u64, acting_n: f64) -> (usize, f64) {
        let samples = usize::try_from(self.effective - index).unwrap_or(usize::MAX);
        (samples, forces_n.get(self.read).copied().unwrap_or(acting_n))
    }

    /// That command takes effect.
    #[inline]
    fn arrived(&mut self, forces_n: &[f64]) -> Option<f64> {
        self.effective += self.period;
        let arriving = forces_n.get(self.read).copied();
        self.read = following(self.read, forces_n);
        arriving
    }
}

#[inline]
fn following(slot: usize, ring: &[f64]) -> usize {
    if slot + 1 < ring.len() { slot + 1 } else { 0 }
}

impl<P> Parts<P> {
    /// The same loop around another plant.
    pub fn with<Q: Clone>(&self, plant: &Q) -> Parts<Q> {
        let Self { plant: _, encoder, full_scale_n, latency, period } = *self;
        Parts { plant: plant.clone(), encoder, full_scale_n, latency, period }
    }
}

impl<C: Controller, S: Sensing, X: Copy> Moving<C, S, X> {
    /// The next samples, at most so many and none behind an output: sample `n` at `t = n T` with the motion up to
    /// `(n + 1) T`, the steps in the order that a sample needs them. Returns how many.
    #[inline(always)]
    fn run<P: Plant<State = X>>(
        &mut self,
        parts: &Parts<P>,
        forces_n: &mut [f64],
        (most, watched): (u32, bool),
        (run, block): (&mut Run, &mut Block),
    ) -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "16")]
        let most = most.min(RUN as u32);
        let due = self.until_due < most;
        let samples = if due { self.until_due + 1 } else { most };
        self.until_due = if due { parts.period - 1 } else { self.until_due - samples };
        let (index, looks) = (self.index, self.sensing.looks());
        // 4. and 5. the plant up to the last sample, with a command that takes effect before it, and 1. the encoder
        run.samples = samples as usize;
        let (arrival, arriving_n) = self.on_the_way.next(forces_n, index, self.output_n);
        let span = Span {
            index,
            samples: run.samples,
            watched: watched || looks || C::IS_TOLD,
            acting_n: self.output_n,
            arrival,
            arriving_n,
            encoder: parts.encoder,
        };
        if let Some(mut places) = block.places() {
            self.state = parts.plant.run(self.state, &span, &mut places, &mut run.course);
        }
        self.index += u64::from(samples);
        if arrival + 1 < run.samples {
            self.output_n = arriving_n;
            self.on_the_way.arrived(forces_n);
        }
        // 2. the velocity
        block.take(run, &mut self.controller, &mut self.sensing, watched);
        // 3. the wall, with the last sample
        if due {
            let rendered = self.controller.render();
            self.sensing.granted(rendered.force);
            self.on_the_way.send(forces_n, rendered.output * parts.full_scale_n);
            block.output(rendered);
        }
        // 4. a command that takes effect within that sample, and 5. the plant
        let state = self.state;
        if self.on_the_way.effective + 1 == self.index {
            let force_n = self.on_the_way.arrived(forces_n).unwrap_or(self.output_n);
            self.state = parts.plant.advance_split(&state, self.output_n, force_n);
            self.output_n = force_n;
        } else {
            self.state = parts.plant.advance(&state, self.output_n);
        }
        if looks {
            let handle = |state: &X| Handle {
                position_m: parts.plant.position_m(state),
                speed_m_per_s: parts.plant.speed_m_per_s(state),
            };
            self.sensing.moved(handle(&state), handle(&self.state));
        }
        if watched {
            block.end(parts.plant.force_n(&self.state, self.output_n));
        }
        samples
    }
}

impl<C: Controller, S: Sensing, P: Plant> Simulation<C, S, P> {
    /// A handle at rest at `start_m`, before sample 0. `controller` must be at rest at the count
    /// that the encoder reads there.
    pub fn new(parts: Parts<P>, controller: C, sensing: S, start_m: f64) -> Self {
        let on_the_way = Latency {
            write: 0,
            read: 0,
            effective: parts.latency.into(),
            period: parts.period.into(),
        };
        let state = parts.plant.at_rest(start_m);
        let (index, until_due, output_n) = (0, 0, 0.0);
        let moving = Moving { controller, sensing, state, index, until_due, output_n, on_the_way };
        let room = (parts.latency / parts.period + 1) as usize;
        Self { parts, moving, forces_n: vec![0.0; room].into(), block: Block::new().into() }
    }

    /// One sample, and the motion up to the next one.
    pub fn step(&mut self) -> Sample {
        self.take(1, true);
        self.block.sample(0, self.block.outputs().first())
    }

    /// Up to `samples` steps; `each` sees every sample and may end the run.
    pub fn run<B>(
        &mut self,
        samples: u32,
        mut each: impl FnMut(&Sample) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        for _ in 0..samples {
            each(&self.step())?;
        }
        ControlFlow::Continue(())
    }

    /// So many samples, block by block; `each` may end the run behind its block. Only the blocks of a run that is
    /// `watched` can be told [sample by sample](Block::each).
    #[inline]
    pub fn blocks<B>(
        &mut self,
        samples: u32,
        watched: bool,
        mut each: impl FnMut(&Block) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        let mut left = samples;
        while left > 0 {
            left -= self.take(left, watched);
            each(&self.block)?;
        }
        ControlFlow::Continue(())
    }

    /// The next block, of so many samples at most; returns how many.
    #[inline(never)]
    fn take(&mut self, most: u32, watched: bool) -> u32 {
        let Self { parts, moving, forces_n, block } = self;
        let (mut run, mut left) = (Run::NONE, most);
        block.begin(moving.index);
        while left > 0 && block.has_room() {
            left -= moving.run(parts, forces_n, (left, watched), (&mut run, block));
        }
        most - left
    }

    pub fn controller(&self) -> &C {
        &self.moving.controller
    }

    /// The controller, to be pushed with something else.
    pub(crate) fn controller_mut(&mut self) -> &mut C {
        &mut self.moving.controller
    }

    /// The same plant under another force of the hand.
    pub(crate) fn set_plant(&mut self, plant: P) {
        self.parts.plant = plant;
    }

    pub fn plant(&self) -> &P {
        &self.parts.plant
    }

    /// The plant's state now.
    pub fn state(&self) -> &P::State {
        &self.moving.state
    }
}
