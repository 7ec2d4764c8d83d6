//! `sample`: 10 kHz, priority 15, interrupt of the sampling timer.

use zwidth::{
    LoopParameters,
    contract::{Encoder as _, SampleTimer as _},
    encoder::Bits32,
    safety::{FaultSet, Guard, GuardCommand, Judged, SampleReport},
    velocity::Senses,
};

use crate::board::{self, Encoder, SampleTimer};
use crate::sync::{
    DoubleBuffer, DoubleBufferReader, Owner, Place, Placed, Seqlock, SeqlockWriter, Shown, Static,
    Viewer, position_ring,
};

/// Of a counter of 32 bits, as every board has.
type GuardedSampler = zwidth::safety::GuardedSampler<Bits32>;

/// What it works with beside the sampler.
pub struct Rest {
    encoder: Encoder,
    sample_timer: SampleTimer,
    control: ControlReader,
    down: CommandReader,
    due: ReportWriter,
    guard: GuardWriter,
}

pub type ControlReader = DoubleBufferReader<LoopParameters, Sampling>;
pub type CommandReader = DoubleBufferReader<GuardCommand, Sampling>;
pub type ReportWriter = SeqlockWriter<SampleReport, Sampling>;
pub type GuardWriter = SeqlockWriter<Guard, Sampling>;

/// All that a sample reads and writes, in one block: its code has one address, and everything is at a constant distance
/// from there.
#[repr(C)]
struct Block {
    own: Place<GuardedSampler, Rest>,
    control: DoubleBuffer<LoopParameters>,
    down: DoubleBuffer<GuardCommand>,
    due: Seqlock<SampleReport>,
    guard: Seqlock<Guard>,
}

static PLACE: Block = Block {
    own: Place::new(),
    control: DoubleBuffer::new(),
    down: DoubleBuffer::new(),
    due: Seqlock::new(SampleReport::BEFORE),
    guard: Seqlock::new(Guard::NOTHING),
};

/// Names the block and its parts. Telemetry sees the sampler there.
pub struct Sampling;

/// The part of the block that is a `T`.
macro_rules! part {
    ($($part:ident: $of:ty),*) => {$(
        impl Static<$of> for Sampling {
            #[inline(always)]
            fn place() -> &'static $of {
                &PLACE.$part
            }
        }
    )*};
}

part!(
    own: Place<GuardedSampler, Rest>,
    control: DoubleBuffer<LoopParameters>,
    down: DoubleBuffer<GuardCommand>,
    due: Seqlock<SampleReport>,
    guard: Seqlock<Guard>
);

impl Placed for Sampling {
    type Shown = GuardedSampler;
    type Rest = Rest;

    fn number(sampler: &GuardedSampler) -> u64 {
        sampler.sampler().next()
    }
}

impl Rest {
    /// With the force, for estimators that look at it.
    #[inline(always)]
    fn with_force(&mut self, senses: Senses) -> Senses {
        if cfg!(feature = "estimators") {
            return Senses { force: self.down.get().force, ..senses };
        }
        senses
    }

    /// Each case to its end, see [`judge`](GuardedSampler::judge).
    #[inline(always)]
    fn hand_on(&mut self, sampler: &mut GuardedSampler, judged: Judged) {
        let Judged { motion, due, found, quiet } = judged;
        if !due && quiet {
            position_ring::note(motion.sample, motion.position);
        } else if !due {
            let motion = self.settle(sampler, &judged).motion;
            position_ring::note(motion.sample, motion.position);
        } else if quiet {
            self.report(SampleReport { motion, present: FaultSet::EMPTY });
        } else if self.control.get().period.get() > 1 {
            let present = sampler.defer(found, self.down.get());
            self.report(SampleReport { motion, present });
        } else {
            let report = self.settle(sampler, &judged);
            self.report(report);
        }
    }

    /// Does what the guard says to a sample that is not quiet.
    #[inline(always)]
    fn settle(&mut self, sampler: &mut GuardedSampler, judged: &Judged) -> SampleReport {
        let step = sampler.settle(judged, self.down.get(), self.guard.place());
        if step.cut {
            board::off();
        }
        if step.told {
            self.guard.publish(step.report.motion.number());
        }
        step.report
    }

    /// Of a due sample: asks for its output.
    #[inline(always)]
    fn report(&mut self, report: SampleReport) {
        position_ring::note(report.motion.sample, report.motion.position);
        self.due.write(report, report.motion.number());
        board::request_render();
    }
}

/// The sampling task. It alone reads the encoder.
pub struct Sample(Owner<Sampling>);

impl Sample {
    pub(super) fn new(
        encoder: Encoder,
        sample_timer: SampleTimer,
        sampler: GuardedSampler,
        control: ControlReader,
        down: CommandReader,
        due: ReportWriter,
        guard: GuardWriter,
    ) -> (Self, Viewer<Sampling>) {
        let rest = Rest { encoder, sample_timer, control, down, due, guard };
        let (owner, viewer) = Owner::take(sampler, rest);
        (Self(owner), viewer)
    }

    /// One sample: the count, position and velocity, whether something is wrong, and who has to know.
    ///
    /// The count comes first, because a delay of it is an error of the velocity. Late by itself it cannot be: nothing masks
    /// or preempts it. If the guard finds something, the output goes off here and now, and again with the samples until
    /// `clear`; but with a due sample `render` sees to it, and the next sample if `render` does not come.
    #[inline(always)]
    pub fn run(&mut self) {
        let Shown { shown: sampler, rest } = self.0.get();
        let (count, senses) = rest.encoder.sense();
        rest.sample_timer.acknowledge();

        let senses = rest.with_force(senses);
        let control = rest.control.get();
        let measured = sampler.measure(control, count, &senses);
        // Only now is there a register for what the guard has to know.
        let judged = sampler.judge(measured, control, rest.down.get());
        rest.hand_on(sampler, judged);
    }
}
