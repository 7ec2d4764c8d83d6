//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use zwidth::{
    LoopParameters,
    contract::{Encoder as _, SampleTimer as _},
    safety::{Guard, GuardCommand, GuardedSampler, SampleReport},
};

use crate::board::{self, Encoder, SampleTimer};
use crate::sync::{DoubleBufferReader, SeqlockWriter, position_ring};

/// The sampling task. It alone reads the encoder.
pub struct Sample {
    encoder: Encoder,
    sample_timer: SampleTimer,
    sampler: GuardedSampler,
    control: DoubleBufferReader<LoopParameters>,
    down: DoubleBufferReader<GuardCommand>,
    due: SeqlockWriter<SampleReport>,
    guard: SeqlockWriter<Guard>,
}

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        sample_timer: SampleTimer,
        sampler: GuardedSampler,
        control: DoubleBufferReader<LoopParameters>,
        down: DoubleBufferReader<GuardCommand>,
        due: SeqlockWriter<SampleReport>,
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
        let motion = step.report.motion;
        let number = motion.number();
        if step.told {
            self.guard.publish(number);
        }
        if step.cut {
            board::off();
        }
        position_ring::note(motion.sample, motion.position);
        if step.due {
            self.due.write(step.report, number);
            board::request_render();
        }
    }
}
