//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use zwidth::{
    Control,
    safety::{Down, GuardedSampler, Up},
};

use super::{UPS, trail};
use crate::board::{self, Encoder, Newest, Pace, Writer};

/// The sampling task. It alone reads the encoder.
pub struct Sample {
    encoder: Encoder,
    pace: Pace,
    sampler: GuardedSampler,
    control: Newest<Control>,
    down: Newest<Down>,
    ups: Writer<Up, UPS>,
}

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        pace: Pace,
        sampler: GuardedSampler,
        control: Newest<Control>,
        down: Newest<Down>,
        ups: Writer<Up, UPS>,
    ) -> Self {
        Self { encoder, pace, sampler, control, down, ups }
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
            // A queue that is full means that `render` is late, which the guard sees by itself.
            self.ups.write_with(|| self.sampler.up(motion, cut));
            super::pend_render();
        }
    }
}
