//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use core::sync::atomic::Ordering::Relaxed;

use heapless::spsc::{Consumer, Producer};
use zwidth::{Control, Motion, Sampler};

use super::FLAGS;
use crate::board::{self, Encoder, Pace};

/// The sampling task. It alone reads the encoder.
pub struct Sample {
    encoder: Encoder,
    pace: Pace,
    sampler: Sampler,
    control: Control,
    controls: Consumer<'static, Control>,
    motions: Producer<'static, Motion>,
    /// Low half of the number of the last sample that was due; `None` before the first.
    awaited: Option<u32>,
}

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        pace: Pace,
        sampler: Sampler,
        control: Control,
        controls: Consumer<'static, Control>,
        motions: Producer<'static, Motion>,
    ) -> Self {
        Self {
            encoder,
            pace,
            sampler,
            control,
            controls,
            motions,
            awaited: None,
        }
    }

    /// One sample: the count first, because a delay of it is an error of the velocity.
    ///
    /// If the output of the last due sample is not there when the next one is due, the output goes
    /// off, here and now; `render` may be stuck.
    #[inline(always)]
    pub fn run(&mut self) {
        let count = self.encoder.count();
        self.pace.acknowledge();
        if let Some(control) = self.controls.dequeue() {
            self.control = control;
        }
        let motion = self.sampler.sample(&self.control, count);
        let queued = self.motions.enqueue(motion).is_ok();
        if motion.due {
            let answered = FLAGS.answered.load(Relaxed);
            if !queued || self.awaited.is_some_and(|awaited| awaited != answered) {
                board::off();
                FLAGS.late.store(true, Relaxed);
            }
            self.awaited = Some(super::low_half(motion.sample));
            super::pend_render();
        }
    }
}
