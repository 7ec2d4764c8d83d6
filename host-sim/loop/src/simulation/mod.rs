//! The sampled loop: plant, encoder, controller, latency, in the order that the design fixes.

pub mod controller;
pub mod edge;
mod hit;
pub mod passive;
pub mod port;
pub mod prepared;
pub mod quantiser;
pub mod senses;
pub mod trace;
pub mod twin;
pub mod window;

use std::ops::ControlFlow;

use crate::{
    plant::{AnyPlant, Moment, Plant},
    simulation::{
        controller::{Controller, ControllerOutput},
        quantiser::Quantiser,
        senses::{AnySensing, Handle, Sensing},
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
pub struct Simulation<C, S = AnySensing, P: Plant = AnyPlant> {
    parts: Parts<P>,
    moving: Moving<C, S, P::State>,
    /// A ring with room for all commands that can be on their way to the actuator at once, N.
    forces_n: Box<[f64]>,
}

/// What a step changes. Small and `Copy`: [`Simulation::run`] works on a copy, which the compiler
/// can keep in registers from step to step; in memory the loop takes twice the time.
#[derive(Clone, Copy, Debug)]
struct Moving<C, S, X> {
    controller: C,
    sensing: S,
    state: X,
    index: u64,
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

    /// The command that acts at the end of the sample `index`, as far as it is known before that sample is
    /// taken: one of this very sample is not.
    #[inline]
    fn next(&self, forces_n: &[f64], index: u64, acting_n: f64) -> f64 {
        if index != self.effective {
            return acting_n;
        }
        forces_n.get(self.read).copied().unwrap_or(acting_n)
    }

    /// The command that takes effect within the sample `index`, if one does.
    #[inline]
    fn arriving(&mut self, forces_n: &[f64], index: u64) -> Option<f64> {
        if index != self.effective {
            return None;
        }
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

impl<C: Controller + Copy, S: Sensing, X: Copy> Moving<C, S, X> {
    /// Sample `n` at `t = n T`, and the motion up to `(n + 1) T`.
    #[inline(always)] // called, it would keep the state in memory
    fn step<P: Plant<State = X>>(&mut self, parts: &Parts<P>, forces_n: &mut [f64]) -> Sample {
        let index = self.index;
        let position_m = parts.plant.position_m(&self.state);
        // 1. the encoder
        let (before_n, after_n) =
            (self.output_n, self.on_the_way.next(forces_n, index, self.output_n));
        let moment = Moment { index, before_n, after_n };
        let count = parts.encoder.count(parts.plant.reading_m(&self.state, &moment));
        // 2. the velocity
        let due = self.controller.sample(count, self.sensing.senses());
        if C::IS_TOLD {
            self.controller.told(parts.plant.speed_m_per_s(&self.state));
        }
        // 3. the wall, with this very sample
        let rendered = due.then(|| self.controller.render());
        if let Some(rendered) = rendered {
            self.sensing.granted(rendered.force);
            self.on_the_way.send(forces_n, rendered.output * parts.full_scale_n);
        }
        // 4. a command that takes effect within this sample, and 5. the plant
        let state = self.state;
        match self.on_the_way.arriving(forces_n, index) {
            None => self.state = parts.plant.advance(&self.state, self.output_n),
            Some(force_n) => {
                self.state = parts.plant.advance_split(&self.state, self.output_n, force_n);
                self.output_n = force_n;
            }
        }
        let handle = |state: &X| Handle {
            position_m: parts.plant.position_m(state),
            speed_m_per_s: parts.plant.speed_m_per_s(state),
        };
        self.sensing.moved(handle(&state), handle(&self.state));
        self.index = index + 1;
        let velocity = self.controller.velocity();
        let output_n = parts.plant.force_n(&self.state, self.output_n);
        Sample { index, position_m, count, velocity, rendered, output_n }
    }
}

impl<C: Controller + Copy, S: Sensing, P: Plant> Simulation<C, S, P> {
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
        let moving = Moving { controller, sensing, state, index: 0, output_n: 0.0, on_the_way };
        let room = (parts.latency / parts.period + 1) as usize;
        Self { parts, moving, forces_n: vec![0.0; room].into() }
    }

    /// One sample, and the motion up to the next one.
    pub fn step(&mut self) -> Sample {
        self.moving.step(&self.parts, &mut self.forces_n)
    }

    /// Up to `samples` steps; `each` sees every sample and may end the run.
    #[inline]
    pub fn run<B>(
        &mut self,
        samples: u32,
        mut each: impl FnMut(&Sample) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        let parts = self.parts.clone();
        let mut moving = self.moving;
        let mut outcome = ControlFlow::Continue(());
        for _ in 0..samples {
            let sample = moving.step(&parts, &mut self.forces_n);
            outcome = each(&sample);
            if outcome.is_break() {
                break;
            }
        }
        self.moving = moving;
        outcome
    }

    /// The controller.
    pub fn controller(&self) -> &C {
        &self.moving.controller
    }

    /// The plant.
    pub fn plant(&self) -> &P {
        &self.parts.plant
    }

    /// The plant's state now.
    pub fn state(&self) -> &P::State {
        &self.moving.state
    }
}
