//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use zwidth::{
    Control, Motion,
    safety::{Down, Guard, GuardedSampler},
};

use super::trail;
use crate::board::{self, Encoder, Newest, Pace, Writing};

/// The sampling task. It alone reads the encoder.
pub struct Sample {
    encoder: Encoder,
    pace: Pace,
    sampler: GuardedSampler,
    control: Newest<Control>,
    down: Newest<Down>,
    due: Writing<(Motion, bool)>,
    guard: Writing<Guard>,
}

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        pace: Pace,
        sampler: GuardedSampler,
        control: Newest<Control>,
        down: Newest<Down>,
        due: Writing<(Motion, bool)>,
        guard: Writing<Guard>,
    ) -> Self {
        Self { encoder, pace, sampler, control, down, due, guard }
    }

    /// One sample: the count first, because a delay of it is an error of the velocity.
    ///
    /// Late by itself it cannot be: nothing masks or preempts it. If the guard finds something, a
    /// late `render` among it, the output goes off here and now, with every sample until `clear`.
    #[inline(always)]
    pub fn run(&mut self) {
        let count = self.encoder.count();
        self.pace.acknowledge();
        let (motion, cut) = self.sampler.step(self.control.get(), count, self.down.get());
        if cut {
            board::off();
        }
        trail::note(motion.sample, motion.position);
        if motion.due {
            if let Some(guard) = self.sampler.news() {
                self.guard.write(guard);
            }
            self.due.write((motion, cut));
            super::pend_render();
        }
    }
}
