//! The sampled loop: plant, encoder, controller, latency, in the order that the design fixes.

use std::collections::VecDeque;

use zwidth::units::Position;

use crate::{
    controller::{Controller, Rendered},
    plant::{PlantState, PlantStep},
    scene::Rounding,
};

/// The parts of the loop that a run does not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parts {
    /// Exact step of the device, split where a command takes effect.
    pub plant: PlantStep,
    /// m per count.
    pub resolution_m: f64,
    /// How a position becomes a count.
    pub rounding: Rounding,
    /// Force at full command, N.
    pub full_scale_n: f64,
    /// Whole samples from the encoder reading to the force; the fraction is in `plant`.
    pub latency: u64,
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
    /// The output computed with this sample, if one was due.
    pub rendered: Option<Rendered>,
    /// Force that acts on the handle at the end of this sample, N.
    pub output_n: f64,
}

/// A run in progress.
#[derive(Clone, Debug)]
pub struct Simulation<C> {
    parts: Parts,
    controller: C,
    state: PlantState,
    index: u64,
    output_n: f64,
    /// Commands on their way to the actuator: sample at which each takes effect, and force in N.
    queue: VecDeque<(u64, f64)>,
}

impl Parts {
    /// The encoder's reading at `position_m`. Saturates at the ends of `i32`.
    #[inline]
    pub fn count(&self, position_m: f64) -> i32 {
        let exact = position_m / self.resolution_m;
        let shifted = match self.rounding {
            Rounding::Floor => exact,
            Rounding::Round => exact + 0.5,
        };
        #[expect(clippy::cast_possible_truncation, reason = "saturates, as documented")]
        let towards_zero = shifted as i32;
        towards_zero.saturating_sub(i32::from(shifted < f64::from(towards_zero)))
    }
}

impl<C: Controller> Simulation<C> {
    /// A handle at rest at `start_m`, before sample 0. `controller` must be at rest at the count
    /// that the encoder reads there.
    pub fn new(parts: Parts, controller: C, start_m: f64) -> Self {
        let state = parts.plant.at_rest(start_m);
        Self {
            parts,
            controller,
            state,
            index: 0,
            output_n: 0.0,
            queue: VecDeque::new(),
        }
    }

    /// Sample `n` at `t = n T`, and the motion up to `(n + 1) T`.
    #[inline]
    pub fn step(&mut self) -> Sample {
        let Parts {
            plant,
            full_scale_n,
            latency,
            ..
        } = &self.parts;
        let index = self.index;
        let position_m = plant.position_m(&self.state);
        // 1. the encoder
        let count = self.parts.count(position_m);
        // 2. the velocity
        let due = self.controller.sample(count);
        // 3. the wall, with this very sample
        let rendered = due.then(|| self.controller.render());
        if let Some(rendered) = rendered {
            self.queue
                .push_back((index + latency, rendered.output * full_scale_n));
        }
        // 4. a command that takes effect within this sample
        let before_n = self.output_n;
        if let Some(&(effective, force_n)) = self.queue.front()
            && effective == index
        {
            self.queue.pop_front();
            self.output_n = force_n;
        }
        // 5. the plant
        self.state = plant.advance(&self.state, before_n, self.output_n);
        self.index = index + 1;
        Sample {
            index,
            position_m,
            count,
            rendered,
            output_n: self.output_n,
        }
    }

    /// The controller.
    pub fn controller(&self) -> &C {
        &self.controller
    }

    /// Position and speed of the handle now.
    pub fn state(&self) -> &PlantState {
        &self.state
    }

    /// Whether the last reading lay in the core's range.
    pub fn in_range(count: i32) -> bool {
        Position::from_counts(count).in_range()
    }
}
