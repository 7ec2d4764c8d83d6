//! The sampled loop: plant, encoder, controller, latency.

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

/// The parts of the loop that stay constant during a run.
#[derive(Clone, Copy, Debug)]
pub struct Parts<P> {
    /// The plant, whose step is split when a command takes effect.
    pub plant: P,
    pub encoder: Quantiser,
    /// Force at full command in N.
    pub full_scale_n: f64,
    /// Number of whole samples from the encoder reading to the force. `plant` has the rest of the latency.
    pub latency: u32,
    /// Number of samples from one output to the next. The controller must have the same number.
    pub period: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of the sample, from 0. The sample's time is `index / rate`.
    pub index: u64,
    /// Position of the handle at the sample, in m.
    pub position_m: f64,
    pub count: i32,
    /// The controller's velocity in counts per sample.
    pub velocity: f64,
    /// The output that was computed with this sample, if an output was due.
    pub rendered: Option<ControllerOutput>,
    /// Force that acts on the handle at the end of this sample, in N.
    pub output_n: f64,
}

/// A run in progress.
#[derive(Clone, Debug)]
pub struct Simulation<C, S = Full, P: Plant = AnyPlant> {
    parts: Parts<P>,
    moving: Moving<C, S, P::State>,
    /// Ring of all commands that have not taken effect yet, in N.
    forces_n: Box<[f64]>,
    block: Box<Block>,
}

#[derive(Clone, Copy, Debug)]
struct Moving<C, S, X> {
    controller: C,
    sensing: S,
    state: X,
    index: u64,
    /// Number of samples until the next output. It is 0 if the next sample has an output. The controller has the same
    /// counter.
    until_due: u32,
    output_n: f64,
    on_the_way: Latency,
}

/// Positions in the ring of the commands that have not taken effect yet. A command is sent every `period` samples.
#[derive(Clone, Copy, Debug)]
struct Latency {
    write: usize,
    read: usize,
    /// Sample at which the next command takes effect.
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

    /// Number of samples from `index` until the next command takes effect, and this command in N. The command that the
    /// sample `index` will send is not known yet.
    #[inline]
    fn next(&self, forces_n: &[f64], index: u64, acting_n: f64) -> (usize, f64) {
        let samples = usize::try_from(self.effective - index).unwrap_or(usize::MAX);
        (samples, forces_n.get(self.read).copied().unwrap_or(acting_n))
    }

    /// The command that takes effect now.
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
    /// The same loop with another plant.
    pub fn with<Q: Clone>(&self, plant: &Q) -> Parts<Q> {
        let Self { plant: _, encoder, full_scale_n, latency, period } = *self;
        Parts { plant: plant.clone(), encoder, full_scale_n, latency, period }
    }
}

impl<C: Controller, S: Sensing, X: Copy> Moving<C, S, X> {
    /// Computes the next samples: at most `most` samples, and only up to the first output. Returns how many were
    /// computed. Sample `n` is at `t = n T`, and includes the motion until `(n + 1) T`. docs/theory.md describes the
    /// five steps of a sample.
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
        // step 1: the encoder; steps 4 and 5: the plant moves until the last sample, with a command that arrives before
        // this sample
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
        // step 2: the velocity
        block.take(run, &mut self.controller, &mut self.sensing, watched);
        // step 3: the wall, at the last sample
        if due {
            let rendered = self.controller.render();
            self.sensing.granted(rendered.force);
            self.on_the_way.send(forces_n, rendered.output * parts.full_scale_n);
            block.output(rendered);
        }
        // step 4: a command that takes effect within the last sample; step 5: the plant after this command
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
    /// A handle at rest at `start_m`, before sample 0. `controller` must be at rest at the count that belongs to
    /// `start_m`.
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

    /// Computes one sample, and the motion until the next sample.
    pub fn step(&mut self) -> Sample {
        self.take(1, true);
        self.block.sample(0, self.block.outputs().first())
    }

    /// Computes up to `samples` samples. `each` gets every sample, and can end the run.
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

    /// Computes `samples` samples in blocks. `each` gets every block, and can end the run after a block. A block has
    /// [single samples](Block::each) only if the run is `watched`.
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

    /// Computes the next block, with at most `most` samples. Returns the number of samples.
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

    pub(crate) fn controller_mut(&mut self) -> &mut C {
        &mut self.moving.controller
    }

    /// Replaces the plant with the same plant, but with another force of the hand.
    pub(crate) fn set_plant(&mut self, plant: P) {
        self.parts.plant = plant;
    }

    pub fn plant(&self) -> &P {
        &self.parts.plant
    }

    pub fn state(&self) -> &P::State {
        &self.moving.state
    }
}
