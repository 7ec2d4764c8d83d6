//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use zwidth::{
    LoopParameters,
    contract::{Encoder as _, SampleTimer as _},
    safety::{Guard, GuardCommand, GuardedSampler, SampleReport},
};

use crate::board::{self, Encoder, SampleTimer};
use crate::sync::{
    DoubleBufferReader, Owner, Place, Placed, SeqlockWriter, Shown, Viewer, position_ring,
};

/// What it works with beside the sampler.
pub struct Rest {
    encoder: Encoder,
    sample_timer: SampleTimer,
    control: DoubleBufferReader<LoopParameters>,
    down: DoubleBufferReader<GuardCommand>,
    due: SeqlockWriter<SampleReport>,
    guard: SeqlockWriter<Guard>,
}

/// Where the sampler lies, for telemetry to see.
pub struct Sampling;

static PLACE: Place<GuardedSampler, Rest> = Place::new();

impl Placed for Sampling {
    type Shown = GuardedSampler;
    type Rest = Rest;

    #[inline(always)]
    fn place() -> &'static Place<GuardedSampler, Rest> {
        &PLACE
    }

    fn number(sampler: &GuardedSampler) -> u64 {
        sampler.sampler().next()
    }
}

/// The sampling task. It alone reads the encoder.
pub struct Sample(Owner<Sampling>);

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        sample_timer: SampleTimer,
        sampler: GuardedSampler,
        control: DoubleBufferReader<LoopParameters>,
        down: DoubleBufferReader<GuardCommand>,
        due: SeqlockWriter<SampleReport>,
        guard: SeqlockWriter<Guard>,
    ) -> (Self, Viewer<Sampling>) {
        let rest = Rest { encoder, sample_timer, control, down, due, guard };
        let (owner, viewer) = Owner::take(sampler, rest);
        (Self(owner), viewer)
    }

    /// One sample: the count first, because a delay of it is an error of the velocity.
    ///
    /// Late by itself it cannot be: nothing masks or preempts it. If the guard finds something, the
    /// output goes off here and now, and again with the samples until `clear`; but with a due sample
    /// `render` sees to it, and the next sample if `render` does not come.
    #[inline(always)]
    pub fn run(&mut self) {
        let Shown { shown: sampler, rest } = self.0.get();
        let (count, senses) = rest.encoder.sense();
        rest.sample_timer.acknowledge();
        let guard = rest.guard.place();
        let step = sampler.step(rest.control.get(), count, &senses, rest.down.get(), guard);
        let motion = step.report.motion;
        let number = motion.number();
        if step.told {
            rest.guard.publish(number);
        }
        if step.cut {
            board::off();
        }
        position_ring::note(motion.sample, motion.position);
        if step.due {
            rest.due.write(step.report, number);
            board::request_render();
        }
    }
}
