//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use zwidth::{
    Control,
    safety::{GuardedSampler, Up},
    units::Position,
};

use super::{CONTROLS, FLAGS, POSITIONS, UPS};
use crate::board::{self, Encoder, Pace, Reader, Writer};

/// The sampling task. It alone reads the encoder.
pub struct Sample {
    encoder: Encoder,
    pace: Pace,
    sampler: GuardedSampler,
    control: Control,
    controls: Reader<Control, CONTROLS>,
    ups: Writer<Up, UPS>,
    positions: Writer<Position, POSITIONS>,
}

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        pace: Pace,
        sampler: GuardedSampler,
        control: Control,
        controls: Reader<Control, CONTROLS>,
        ups: Writer<Up, UPS>,
        positions: Writer<Position, POSITIONS>,
    ) -> Self {
        Self { encoder, pace, sampler, control, controls, ups, positions }
    }

    /// One sample: the count first, because a delay of it is an error of the velocity.
    ///
    /// Late by itself it cannot be: nothing masks or preempts it. If the guard finds something, a
    /// late `render` among it, the output goes off here and now, with every sample until `clear`.
    #[inline(always)]
    pub fn run(&mut self) {
        let count = self.encoder.count();
        self.pace.acknowledge();
        if let Some(control) = self.controls.read() {
            self.sampler.adopt(&self.control, &control);
            self.control = control;
        }
        let (motion, cut) = self.sampler.step(&self.control, count, &FLAGS.down());
        if cut {
            board::off();
        }
        // A queue that is full means that `render` is late, which the guard sees by itself.
        self.positions.write(motion.position);
        if motion.due {
            self.ups.write_with(|| self.sampler.up(motion, cut));
            super::pend_render();
        }
    }
}
