//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use zwidth::{
    LoopParameters, Motion,
    contract::{Encoder as _, SampleTimer as _},
    safety::{FaultSet, Guard, GuardCommand, GuardedSampler, SampleReport},
    units::{Position, Velocity},
};

use crate::board::{self, Encoder, SampleTimer};
use crate::sync::{DoubleBufferReader, SeqlockWriter, position_ring};

/// What `render` needs of a due sample.
#[derive(Clone, Copy)]
pub struct Due {
    sample: u64,
    position: Position,
    velocity: Velocity,
    present: FaultSet,
}

impl Due {
    /// Before the first one.
    pub const BEFORE: Self = Self {
        sample: 0,
        position: Position::from_counts(0),
        velocity: Velocity::ZERO,
        present: FaultSet::EMPTY,
    };

    /// To be answered, together with what the guard found.
    pub fn up(self, guard: Guard) -> SampleReport {
        let Self { sample, position, velocity, present } = self;
        SampleReport { motion: Motion { sample, position, velocity, due: true }, present, guard }
    }
}

/// The sampling task. It alone reads the encoder.
pub struct Sample {
    encoder: Encoder,
    sample_timer: SampleTimer,
    sampler: GuardedSampler,
    control: DoubleBufferReader<LoopParameters>,
    down: DoubleBufferReader<GuardCommand>,
    due: SeqlockWriter<Due>,
    guard: SeqlockWriter<Guard>,
}

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        sample_timer: SampleTimer,
        sampler: GuardedSampler,
        control: DoubleBufferReader<LoopParameters>,
        down: DoubleBufferReader<GuardCommand>,
        due: SeqlockWriter<Due>,
        guard: SeqlockWriter<Guard>,
    ) -> Self {
        Self { encoder, sample_timer, sampler, control, down, due, guard }
    }

    /// One sample: the count first, because a delay of it is an error of the velocity.
    ///
    /// Late by itself it cannot be: nothing masks or preempts it. If the guard finds something, the
    /// output goes off here and now, and again with the samples until `clear`; but with a due sample
    /// `render` sees to it, and the next sample if `render` does not come.
    #[inline(always)]
    pub fn run(&mut self) {
        let (count, senses) = self.encoder.sense();
        self.sample_timer.acknowledge();
        let guard = self.guard.place();
        let step = self.sampler.step(self.control.get(), count, &senses, self.down.get(), guard);
        let Motion { sample, position, velocity, due } = step.motion;
        let number = step.motion.number();
        if step.told {
            self.guard.publish(number);
        }
        if step.cut {
            board::off();
        }
        position_ring::note(sample, position);
        if due {
            self.due.write(Due { sample, position, velocity, present: step.present }, number);
            board::request_render();
        }
    }
}
