//! The task `sample`, with priority 15. The interrupt of the sampling timer requests it at 10 kHz.

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

/// The guarded sampler for a counter of 32 bits, which every board has.
type GuardedSampler = zwidth::safety::GuardedSampler<Bits32>;

/// The task's data beside the sampler.
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

/// All data of a sample in one block. So the code loads a single address, and all data are at constant distances from
/// it.
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

/// Names the block and its parts. Telemetry reads the sampler in the block.
pub struct Sampling;

/// Names the part of the block with the type `$of`.
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
    /// Adds the force that acts to `senses`, for estimators that use it.
    #[inline(always)]
    fn with_force(&mut self, senses: Senses) -> Senses {
        if cfg!(feature = "estimators") {
            return Senses { force: self.down.get().force, ..senses };
        }
        senses
    }

    /// Handles each result of [`judge`](GuardedSampler::judge) in its own branch, which makes a quiet sample short.
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

    /// Carries out the guard's decision for a sample that is not quiet.
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

    /// Reports a due sample to `render`, and requests its output.
    #[inline(always)]
    fn report(&mut self, report: SampleReport) {
        position_ring::note(report.motion.sample, report.motion.position);
        self.due.write(report, report.motion.number());
        board::request_render();
    }
}

/// The task `sample`. Only this task reads the encoder.
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

    /// Runs one sample: reads the count, computes position and velocity, checks them, and hands them on.
    ///
    /// The count is read first, because a late count makes the velocity wrong. The sample itself cannot be late:
    /// nothing masks it and no task preempts it. If the guard finds a fault, the output goes off at once, and again
    /// with each sample until `clear`. With a due sample, `render` switches off. If `render` does not run, the next
    /// sample switches off.
    #[inline(always)]
    pub fn run(&mut self) {
        let Shown { shown: sampler, rest } = self.0.get();
        let (count, senses) = rest.encoder.sense();
        rest.sample_timer.acknowledge();

        let senses = rest.with_force(senses);
        let control = rest.control.get();
        let measured = sampler.measure(control, count, &senses);
        // The guard's numbers are read only now, when registers are free for them.
        let judged = sampler.judge(measured, control, rest.down.get());
        rest.hand_on(sampler, judged);
    }
}
