//! The half of the supervisor that runs for every sample.

#![deny(clippy::float_arithmetic)]

use core::hint::cold_path;

use super::{Fault, FaultSet, SafetyPlan, plan::STUCK_RENDERS};
use crate::{Control, CounterWidth, Motion, Sampler, units::Force, velocity::Senses};

/// From `render` to `sample`: what the guard has to know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Down {
    /// Low 32 bits of the sample that the last finished output answered.
    pub rendered: u32,
    /// Counts up with every change of a field below but the force; the guard looks at them only then.
    pub changes: u32,
    /// [`Guard::events`] that `clear` has dealt with.
    pub acknowledged: u32,
    /// How often the count was to be zeroed.
    pub zeros: u32,
    /// The force last granted, none while off: it has acted since the last sample, but for the time
    /// that the output took.
    pub force: Force,
    /// Force is on: only then is high speed a fault. A hand may move a free handle as it likes.
    pub on: bool,
    /// Flash is being written, which stalls the processor: moves between two samples and missing
    /// outputs say nothing. Never set while force is on.
    pub stall: bool,
}

impl Down {
    /// As it is before the first output.
    pub const START: Self = Self {
        rendered: 0,
        changes: 0,
        acknowledged: 0,
        zeros: 0,
        force: Force::ZERO,
        on: false,
        stall: false,
    };
}

/// From `sample` to `render`: the motion and what the guard thinks of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up {
    /// The sample.
    pub motion: Motion,
    /// The guard's findings.
    pub guard: Guard,
    /// The output has to be off, now: the sampling task sees to it by itself, with every sample as
    /// long as this is set.
    pub cut: bool,
}

/// What the guard found since the last `clear`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Guard {
    /// How often something was found, ever; wraps.
    pub events: u32,
    /// How often the count was zeroed; wraps.
    pub zeros: u32,
    /// What was found first.
    pub first: Option<Fault>,
    /// The sample at which it was found.
    pub first_sample: u64,
    /// All that was found.
    pub causes: FaultSet,
    /// What is there with this very sample.
    pub present: FaultSet,
}

/// A [`Sampler`] under guard. Owned by the sampling task.
#[derive(Clone, Copy, Debug)]
pub struct GuardedSampler {
    sampler: Sampler,
    plan: SafetyPlan,
    guard: Guard,
    /// The last sample whose output is due; `None` before the first.
    awaited: Option<u32>,
    /// Outputs in a row that were not there in time.
    missed: u32,
    /// [`Down`] as of its last change.
    down: Down,
    stalled: bool,
    /// Something is there, or was and is not cleared: every sample is looked at closely.
    alert: bool,
    /// The guard's findings may have changed.
    news: bool,
}

impl GuardedSampler {
    /// A handle at rest whose encoder counter reads `counter`.
    pub fn new(plan: SafetyPlan, counter: u32, width: CounterWidth) -> Self {
        Self {
            sampler: Sampler::new(counter, width),
            plan,
            guard: Guard::default(),
            awaited: None,
            missed: 0,
            down: Down::START,
            stalled: false,
            alert: false,
            news: false,
        }
    }

    /// Takes the encoder counter's reading and says what it means. Call it once per sample, at a
    /// constant rate, with the newest [`Down`].
    ///
    /// At a sample with `motion.due`, the output of the due sample before it has to be there;
    /// if `down.rendered` says that it is not, it is late by a period.
    #[inline]
    pub fn sample(&mut self, control: &Control, counter: u32, down: &Down) -> Up {
        let (motion, cut) = self.step(control, counter, down);
        self.up(motion, cut)
    }

    /// What the last [`step`](Self::step), which gave `motion` and `cut`, means to `render`.
    #[inline]
    pub fn up(&self, motion: Motion, cut: bool) -> Up {
        Up { motion, guard: self.guard, cut }
    }

    /// What the guard found, if it has changed since this was last asked.
    #[inline]
    pub fn news(&mut self) -> Option<Guard> {
        if !self.news {
            return None;
        }
        cold_path();
        self.news = false;
        Some(self.guard)
    }

    /// [`sample`](Self::sample) without the copy for `render`, which only a due sample needs:
    /// the motion, and whether the output has to be off.
    ///
    /// Nearly every sample passes three comparisons and is done; all else is rare.
    #[inline]
    pub fn step(&mut self, control: &Control, counter: u32, down: &Down) -> (Motion, bool) {
        if down.changes != self.down.changes {
            cold_path();
            self.follow(down);
        }
        let before = self.sampler.position();
        let senses = Senses { force: down.force, ..Senses::NONE };
        let motion = self.sampler.sense(control, counter, &senses);
        if motion.due {
            self.expect_output(motion, down.rendered);
        }
        let moved = motion.position.wrapping_since(before).unsigned_abs();
        let speed = motion.velocity.bits().unsigned_abs();
        let quiet = moved <= self.plan.jump
            && speed <= self.plan.speed
            && motion.position.in_range()
            && !self.alert;
        if quiet {
            return (motion, false);
        }
        cold_path();
        (motion, self.look(motion, moved))
    }

    /// Takes over what `render` has changed.
    #[cold]
    fn follow(&mut self, down: &Down) {
        if down.zeros != self.guard.zeros {
            self.sampler.zero();
            self.guard.zeros = down.zeros;
        }
        self.down = *down;
        self.news = true;
        // Whether it still has a reason is found out with this sample.
        self.alert = true;
    }

    /// The output of the due sample before this one has to be there.
    #[inline]
    fn expect_output(&mut self, motion: Motion, rendered: u32) {
        #[expect(clippy::cast_possible_truncation, reason = "compared modulo 2^32")]
        let this = motion.sample as u32;
        let in_time = self.awaited.is_none_or(|awaited| awaited == rendered);
        self.awaited = Some(this);
        if !in_time || self.missed != 0 {
            cold_path();
            // The first sample after a stall still spans it.
            let stall = self.down.stall || self.stalled;
            self.missed = if in_time || stall { 0 } else { self.missed.saturating_add(1) };
            self.alert = true;
        }
    }

    /// All that there is to find in a sample, and whether the output has to be off.
    #[cold]
    fn look(&mut self, motion: Motion, moved: u32) -> bool {
        let down = self.down;
        let stall = down.stall || self.stalled;
        let speed = motion.velocity.bits().unsigned_abs();
        let present = FaultSet::EMPTY
            .with_if(Fault::CountJump, moved > self.plan.jump && !stall)
            .with_if(Fault::OverSpeed, speed > self.plan.speed && down.on)
            .with_if(Fault::OutOfRange, !motion.position.in_range())
            .with_if(Fault::LateRender, self.missed > 0)
            .with_if(Fault::StuckRender, self.missed >= STUCK_RENDERS);
        self.stalled = down.stall;
        self.news = true;
        let noted = self.guard.present.union(self.guard.causes);
        if !present.union(noted).is_empty() {
            self.note(present, motion.sample);
        }
        let cut = self.guard.events != down.acknowledged || !present.is_empty();
        let noted = self.guard.present.union(self.guard.causes);
        self.alert = cut || !noted.is_empty() || self.missed > 0 || down.stall;
        cut
    }

    fn note(&mut self, present: FaultSet, sample: u64) {
        let guard = &mut self.guard;
        if guard.events == self.down.acknowledged {
            guard.first = None;
            guard.causes = FaultSet::EMPTY;
        }
        let fresh = present.without(guard.present);
        if !fresh.is_empty() {
            if guard.first.is_none() {
                guard.first = fresh.first();
                guard.first_sample = sample;
            }
            guard.events = guard.events.wrapping_add(1);
        }
        guard.causes = guard.causes.union(fresh);
        guard.present = present;
    }
}
