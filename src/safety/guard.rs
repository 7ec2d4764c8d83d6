//! The half of the supervisor that runs for every sample.
//!
//! With every sample it finds out whether something is wrong, and says [`Step::cut`] then. What can
//! wait does: taking note of it, and a zero, are done one at a time, and not with a due sample, which
//! has an output to ask for. So the longest sample is hardly longer than a quiet one. Where every
//! sample is due, none of them waits.

#![deny(clippy::float_arithmetic)]

use core::hint::cold_path;

use super::{Fault, FaultSet, Guard, SafetyPlan, Token};
use crate::{
    CounterWidth, LoopParameters, Motion, Sampled, Sampler,
    encoder::Width,
    units::{Force, Offset, Position, Velocity},
    velocity::Senses,
};

/// From `render` to `sample`: what the guard has to know, with nothing left to work out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuardCommand {
    /// Low 32 bits of the sample that the last finished output answered.
    pub rendered: u32,
    /// [`Guard::events`] that `clear` has dealt with.
    pub acknowledged: u32,
    /// Another one than the last: the count is to be zeroed.
    pub zeros: Token,
    /// The force last granted, none while off: it has acted since the last sample, but for the time
    /// that the output took.
    pub force: Force,
    /// A larger move in one sample is a count jump, counts. None is while flash is written and with
    /// the first sample after it.
    pub jump: u32,
    /// A higher speed is too fast, LSB of [`Velocity`](crate::units::Velocity). None is while off: a hand may move a free
    /// handle as it likes.
    pub speed: u32,
    /// Flash is being written, which stalls the processor: missing outputs say nothing. Never set
    /// while force is on.
    pub stall: bool,
}

impl GuardCommand {
    /// As `jump` or `speed`: any will do.
    pub const ANY: u32 = i32::MAX.cast_unsigned();

    /// As it is before the first output.
    pub const fn start(plan: &SafetyPlan) -> Self {
        Self {
            rendered: plan.period.wrapping_neg(), // as if there had been one
            acknowledged: 0,
            zeros: Token::FIRST,
            force: Force::ZERO,
            jump: plan.jump,
            speed: GuardCommand::ANY,
            stall: false,
        }
    }
}

/// From `sample` to `render`, with every due sample; what the guard has noted goes apart, as [`Guard`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleReport {
    /// The sample.
    pub motion: Motion,
    /// What is there with this very sample, or was with one before it and is not in [`Guard`] yet.
    pub present: FaultSet,
}

impl SampleReport {
    /// Before the first one.
    pub const BEFORE: Self = Self {
        motion: Motion {
            sample: 0,
            position: Position::from_counts(0),
            velocity: Velocity::ZERO,
            offset: Offset::NONE,
        },
        present: FaultSet::EMPTY,
    };
}

/// One sample under guard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// What `render` is told, if an output is due.
    pub report: SampleReport,
    /// An output is due with this very sample.
    pub due: bool,
    /// The output has to be off, now: the sampling task sees to it by itself. Set again with every
    /// sample as long as that holds, but for a due one: its report is answered right after it.
    pub cut: bool,
    /// The [`Guard`] was written to.
    pub told: bool,
}

/// A [`Sampler`] under guard. Owned by the sampling task.
#[derive(Clone, Copy, Debug)]
pub struct GuardedSampler<W = CounterWidth> {
    sampler: Sampler<W>,
    /// [`GuardCommand::zeros`] that were met. Turned while something was found that is not cleared, or waits: the output
    /// has to be off. So one comparison says that nothing is asked for and nothing was found.
    met: Token,
    /// Found, and not in [`Guard`] yet.
    waiting: FaultSet,
}

impl<W: Width> GuardedSampler<W> {
    /// A handle at rest whose encoder counter reads `counter`.
    pub fn new(counter: u32, width: W) -> Self {
        Self { sampler: Sampler::new(counter, width), met: Token::FIRST, waiting: FaultSet::EMPTY }
    }

    /// The same with the counter's width as a value, for whoever looks at it.
    pub fn of_any_width(self) -> GuardedSampler {
        let Self { sampler, met, waiting } = self;
        GuardedSampler { sampler: sampler.of_any_width(), met, waiting }
    }

    /// What it guards.
    pub const fn sampler(&self) -> &Sampler<W> {
        &self.sampler
    }

    /// How often the count was zeroed; wraps.
    #[expect(clippy::cast_possible_truncation, reason = "16 bits")]
    pub const fn zeros(&self) -> u16 {
        self.zeros_met().number() as u16
    }

    const fn is_alert(&self) -> bool {
        self.met.is_turned()
    }

    const fn zeros_met(&self) -> Token {
        if self.is_alert() { self.met.turned() } else { self.met }
    }

    #[inline(always)]
    fn meet(&mut self, zeros: Token, alert: bool) {
        self.met = if alert { zeros.turned() } else { zeros };
    }

    /// Notes that it has to be off.
    #[inline(always)]
    fn wait(&mut self, found: FaultSet) {
        self.waiting = self.waiting.union(found);
        self.meet(self.zeros_met(), true);
    }

    /// Takes the encoder counter's reading and says what it means. Call it once per sample, at a
    /// constant rate, with the newest [`GuardCommand`]. `senses` is what the board has beside the count; the
    /// force is that of `down`. `guard` is what was found so far; it is written in its place, and
    /// [`Step::told`] set then.
    ///
    /// At a due sample, the output of the due sample before it has to be there;
    /// if `down.rendered` says that it is not, it is late by a period.
    #[inline]
    pub fn step(
        &mut self,
        control: &LoopParameters,
        counter: u32,
        senses: &Senses,
        down: &GuardCommand,
        guard: &mut Guard,
    ) -> Step {
        let senses = Senses { force: down.force, ..*senses };
        self.step_then(control, counter, &senses, || down, guard)
    }

    /// [`step`](Self::step) with the force in `senses`, and `down` not looked up before the velocity is there: until
    /// then the Cortex-M4 has no register to spare for it.
    #[inline(always)]
    pub fn step_then<'a>(
        &mut self,
        control: &LoopParameters,
        counter: u32,
        senses: &Senses,
        down: impl FnOnce() -> &'a GuardCommand,
        guard: &mut Guard,
    ) -> Step {
        let before = self.sampler.position();
        let Sampled { mut motion, due } = self.sampler.sense(control, counter, senses);
        let down = down();
        if due {
            self.expect_output(motion.number(), down, control.period.get());
            // Often enough, and a due sample is not the longest.
            self.expect_origin();
        }
        let jumped = beyond(motion.position.wrapping_since(before), down.jump);
        let fast = beyond(motion.velocity.bits(), down.speed);
        let quiet = !jumped && !fast && down.zeros == self.met;
        if quiet {
            let report = SampleReport { motion, present: FaultSet::EMPTY };
            return Step { report, due, cut: false, told: false };
        }
        cold_path();
        let present =
            FaultSet::EMPTY.with_if(Fault::CountJump, jumped).with_if(Fault::OverSpeed, fast);
        if !present.is_empty() {
            self.wait(present);
        }
        if due && control.period.get() > 1 {
            // The output that this sample asks for says no by itself. Should it not come, the next
            // sample cuts.
            let report = SampleReport { motion, present: self.waiting };
            return Step { report, due, cut: false, told: false };
        }
        // A bit that has flipped asks for no zero: what is zero would be somewhere else from then on, unnoticed.
        let zeroes = down.zeros.asks_after(self.zeros_met());
        let alert = self.is_alert();
        self.meet(down.zeros, alert);
        if !zeroes {
            let told = self.note(motion.number(), down, guard);
            let cut = told || self.is_alert();
            Step { report: SampleReport { motion, present }, due, cut, told }
        } else {
            guard.zeros = down.zeros.number();
            self.sampler.zero();
            motion.position = self.sampler.position();
            let report = SampleReport { motion, present: self.waiting };
            Step { report, due, cut: alert, told: true }
        }
    }

    /// Notes what has waited. If nothing has, and what was noted is dealt with, the output may be on
    /// again. Says whether something was noted.
    #[inline(always)]
    fn note(&mut self, sample: u32, down: &GuardCommand, guard: &mut Guard) -> bool {
        let answered = guard.events == down.acknowledged;
        if self.waiting.is_empty() {
            self.meet(down.zeros, !answered);
            return false;
        }
        if answered {
            guard.causes = self.waiting;
            guard.first = self.waiting;
            guard.first_sample = sample;
        } else {
            guard.causes = guard.causes.union(self.waiting);
        }
        guard.events = guard.events.wrapping_add(1);
        self.waiting = FaultSet::EMPTY;
        true
    }

    /// Position 0 has to be where it was put.
    #[inline(always)]
    fn expect_origin(&mut self) {
        if !self.sampler.is_whole() {
            cold_path();
            self.wait(FaultSet::EMPTY.with(Fault::Memory));
        }
    }

    /// The output of the due sample before this one has to be there, unless flash was written.
    #[inline(always)]
    fn expect_output(&mut self, sample: u32, down: &GuardCommand, period: u32) {
        let behind = sample.wrapping_sub(down.rendered);
        if behind != period && !down.stall {
            cold_path();
            self.wait(FaultSet::EMPTY.with(Fault::LateRender));
        }
    }
}

/// Whether `value` is beyond +-`limit`, which is at most [`GuardCommand::ANY`].
#[inline(always)]
fn beyond(value: i32, limit: u32) -> bool {
    value.cast_unsigned().wrapping_add(limit) > limit.wrapping_mul(2)
}

#[cfg(test)]
mod tests {
    use core::num::NonZeroU32;

    use super::*;
    use crate::{Design, Output, Settings, VelocitySettings, WallSettings};

    #[test]
    fn limits_hold_on_both_sides_and_to_the_count() {
        for limit in [0, 1, 501, 100 << 16, GuardCommand::ANY - 1] {
            let end = limit.cast_signed();
            assert!(!beyond(end, limit) && !beyond(-end, limit) && !beyond(0, limit));
            assert!(beyond(end + 1, limit) && beyond(-end - 1, limit), "{limit}");
        }
        for value in [i32::MAX, -i32::MAX, 0, 1, -1] {
            assert!(!beyond(value, GuardCommand::ANY));
        }
    }

    /// A wall that is far, and the speed of the last sample.
    fn free() -> LoopParameters {
        let design = Design {
            rate_hz: 10_000.0,
            resolution_m: 1e-6,
            full_scale_n: 5.906,
            period: 10,
            output: Output::Continuous,
        };
        let wall = WallSettings {
            position_m: 0.1,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        };
        Settings { velocity: VelocitySettings::Difference {}, wall }.build(&design).unwrap()
    }

    const ANYTHING: GuardCommand = GuardCommand {
        rendered: 0,
        acknowledged: 0,
        zeros: Token::FIRST,
        force: Force::ZERO,
        jump: GuardCommand::ANY,
        speed: GuardCommand::ANY,
        stall: true,
    };

    /// What is found at the second sample, after the first at 0 counts.
    fn second(counts: i32, down: GuardCommand) -> FaultSet {
        let (control, mut guard) = (free(), Guard::NOTHING);
        let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
        for (n, counts) in [0, counts].into_iter().enumerate() {
            let step =
                sampler.step(&control, counts.cast_unsigned(), &Senses::NONE, &down, &mut guard);
            assert_eq!(step.cut, !guard.causes.is_empty(), "{n}");
            assert_eq!(step.told, !guard.causes.is_empty(), "{n}");
        }
        guard.causes
    }

    #[test]
    fn a_jump_and_a_speed_are_found_beyond_their_limit_and_not_at_it() {
        for sign in [1, -1] {
            let jump = |counts: i32| second(sign * counts, GuardCommand { jump: 7, ..ANYTHING });
            assert_eq!(jump(7), FaultSet::EMPTY);
            assert_eq!(jump(8), FaultSet::EMPTY.with(Fault::CountJump));
            let down = GuardCommand { speed: 7 << Velocity::FRACTION_BITS, ..ANYTHING };
            assert_eq!(second(sign * 7, down), FaultSet::EMPTY);
            assert_eq!(second(sign * 8, down), FaultSet::EMPTY.with(Fault::OverSpeed));
        }
    }

    /// A flipped bit of the count at position 0 would move every wall. `zero` puts it right.
    #[test]
    fn a_moved_origin_is_told_once_per_output_until_the_next_zero() {
        for period in [10, 1] {
            let control = LoopParameters { period: NonZeroU32::new(period).unwrap(), ..free() };
            let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
            let (mut down, mut guard) = (ANYTHING, Guard::NOTHING);
            let mut told = |sampler: &mut GuardedSampler, zeros: Token, outputs: u32| {
                down.zeros = zeros;
                for _ in 0..outputs * period {
                    let events = guard.events;
                    let step = sampler.step(&control, 700, &Senses::NONE, &down, &mut guard);
                    assert!(step.cut || guard.events == events);
                    down.acknowledged = guard.events; // as `clear` would at once
                }
                guard.events
            };
            let zeros = Token::FIRST;
            assert_eq!(told(&mut sampler, zeros, 3), 0);
            sampler.sampler.spoil_origin();
            assert_eq!(told(&mut sampler, zeros, 3), 3, "period {period}");
            told(&mut sampler, zeros.next(), 2);
            assert_eq!(sampler.sampler.position().counts(), 0);
            let so_far = told(&mut sampler, zeros.next(), 1);
            assert_eq!(told(&mut sampler, zeros.next(), 5), so_far, "period {period}");
            assert_eq!(guard.causes, FaultSet::EMPTY.with(Fault::Memory));
        }
    }

    /// An output is late when the one before the due sample is not there; not while flash is written.
    #[test]
    fn a_late_output_is_found_with_the_sample_after_the_due_one() {
        for (rendered, stall, late) in
            [(0, false, false), (u32::MAX - 9, false, true), (u32::MAX - 9, true, false)]
        {
            let (control, mut guard) = (free(), Guard::NOTHING);
            let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
            let mut due = 0;
            for n in 0..12 {
                let rendered = if n <= 9 { n / 10 * 10 } else { rendered };
                let first = n == 0; // nothing can be there yet
                let down = GuardCommand { rendered, stall: stall || first, ..ANYTHING };
                let step = sampler.step(&control, 0, &Senses::NONE, &down, &mut guard);
                due += u32::from(step.due);
                assert_eq!(step.cut, late && n == 11, "sample {n}");
            }
            assert_eq!(due, 2);
            let expected = FaultSet::EMPTY.with_if(Fault::LateRender, late);
            assert_eq!(guard.causes, expected, "rendered {rendered}");
        }
    }

    /// Any bit of the number that asks for a zero, and of the one that was met last: the count stays where it is. An
    /// order that is whole is met after it.
    #[test]
    fn a_bit_that_flips_asks_for_no_zero() {
        let control = free();
        let asked = Token::FIRST.next();
        let down = GuardCommand { zeros: asked, ..ANYTHING };
        let step = |sampler: &mut GuardedSampler, down: &GuardCommand| {
            let step =
                sampler.step(&control, 700, &Senses::NONE, down, &mut Guard::NOTHING.clone());
            assert!(!step.cut);
            step.report.motion.position.counts()
        };
        for bit in 0..32 {
            let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
            sampler.met = asked;
            let flipped = GuardCommand { zeros: asked.flipped(bit), ..down };
            assert_eq!(step(&mut sampler, &flipped), 700, "bit {bit}");
            sampler.met = asked.flipped(bit);
            for _ in 0..3 {
                assert_eq!(step(&mut sampler, &down), 700, "bit {bit}");
            }
            let next = GuardCommand { zeros: asked.next(), ..down };
            assert_eq!(step(&mut sampler, &next), 0, "bit {bit}");
        }
    }
}
