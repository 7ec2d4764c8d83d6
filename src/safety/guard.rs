//! The part of the supervisor that runs for every sample.
//!
//! The guard looks for faults in every sample. After a fault it sets [`Step::cut`]. Two actions can wait: to note a
//! fault, and to zero the count. The guard does only one of them in a sample. With a due sample it does neither,
//! because such a sample also requests an output. So the longest sample is hardly longer than a quiet sample. If every
//! sample is due, the two actions do not wait.
//!
//! The order of the checks suits the Cortex-M4's number of registers. `tests/elf/control/budget.rs` checks the cycles.

#![deny(clippy::float_arithmetic)]

use core::{
    hint::cold_path,
    sync::atomic::{Ordering::SeqCst, compiler_fence},
};

use super::{Fault, FaultSet, Guard, SafetyPlan, Token, token::Turn};
use crate::{
    CounterWidth, LoopParameters, Motion, Sampled, Sampler,
    encoder::Width,
    units::{Force, Position, Velocity},
    velocity::Senses,
};

/// Message from the task `render` to the task `sample`. It has all numbers that the guard needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuardCommand {
    /// Low 32 bits of the number of the sample whose output was finished last.
    pub rendered: u32,
    /// The value of [`Guard::events`] at the last `clear`. Faults up to this event no longer switch off.
    pub acknowledged: u32,
    /// Requests a zeroing of the count: each new value is one request.
    pub zeros: Token,
    /// The force that was granted last, or 0 while off. It has acted since the last sample, apart from the time in
    /// which the output was computed.
    pub force: Force,
    /// Largest motion from one sample to the next, in counts. A larger one is a count jump. There is no limit while
    /// flash is written and at the first sample after that.
    pub jump: u32,
    /// Largest allowed speed, in LSB of [`Velocity`](crate::units::Velocity). There is no limit while the force is off,
    /// because a hand may move a free handle at any speed.
    pub speed: u32,
    /// Whether flash is being written. This stalls the processor, so missing outputs are no fault then. It is never
    /// true while force is on.
    pub stall: bool,
}

impl GuardCommand {
    /// Value of `jump` or `speed` that sets no limit.
    pub const ANY: u32 = i32::MAX.cast_unsigned();

    /// The command before the first output.
    pub const fn start(plan: &SafetyPlan) -> Self {
        Self {
            rendered: plan.period.wrapping_neg(), // as if there had been an output
            acknowledged: 0,
            zeros: Token::FIRST,
            force: Force::ZERO,
            jump: plan.jump,
            speed: GuardCommand::ANY,
            stall: false,
        }
    }
}

/// Report from the task `sample` to the task `render`, with every due sample. The faults that are already noted are
/// passed separately, in [`Guard`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleReport {
    /// Number, position and velocity of the sample.
    pub motion: Motion,
    /// Faults of this sample, and faults of an earlier sample that are not noted in [`Guard`] yet.
    pub present: FaultSet,
}

impl SampleReport {
    /// The report before the first sample.
    pub const BEFORE: Self = Self {
        motion: Motion { sample: 0, position: Position::from_counts(0), velocity: Velocity::ZERO },
        present: FaultSet::EMPTY,
    };
}

/// Result of one guarded sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The report for `render`, if an output is due.
    pub report: SampleReport,
    /// Whether an output is due with this sample.
    pub due: bool,
    /// Whether the task `sample` must switch the output off now. Until `clear` this is true at every sample except a
    /// due one. After a due sample `render` runs at once, and switches off because of the report.
    pub cut: bool,
    /// Whether this step has changed the [`Guard`].
    pub told: bool,
}

/// A sample, and the counts by which the handle has moved since the last sample.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    sampled: Sampled,
    moved: i32,
}

/// A sample and the faults that were found in it. If it is not [`quiet`](Self::quiet), call [`GuardedSampler::defer`]
/// or [`GuardedSampler::settle`] next.
#[derive(Clone, Copy, Debug, PartialEq)]
#[must_use = "what was found is noted by `settle` or `defer`"]
pub struct Judged {
    /// Position and velocity of the handle.
    pub motion: Motion,
    /// Whether an output is due with this sample.
    pub due: bool,
    /// Faults of this sample.
    pub found: FaultSet,
    /// Whether there is nothing to do: no fault was found, none waits to be noted, and no zeroing of the count is
    /// requested.
    pub quiet: bool,
}

/// A [`Sampler`] with the guard around it. The task `sample` owns it.
#[derive(Clone, Copy, Debug)]
pub struct GuardedSampler<W = CounterWidth> {
    sampler: Sampler<W>,
    /// The last value of [`GuardCommand::zeros`] that was carried out. While a fault is not cleared or waits to be
    /// noted, the output must be off. The value is then turned (`Token::turned`), so that it equals no request. So a
    /// single comparison shows that no zeroing is requested and that there is no fault.
    met: Token,
    /// Faults that were found and are not in [`Guard`] yet.
    waiting: FaultSet,
}

impl<W: Width> GuardedSampler<W> {
    /// Begins with a handle at rest, whose encoder counter reads `counter`.
    pub fn new(counter: u32, width: W) -> Self {
        Self { sampler: Sampler::new(counter, width), met: Token::FIRST, waiting: FaultSet::EMPTY }
    }

    /// This guarded sampler with the counter's width as a value, for readers in another task.
    pub fn of_any_width(self) -> GuardedSampler {
        let Self { sampler, met, waiting } = self;
        GuardedSampler { sampler: sampler.of_any_width(), met, waiting }
    }

    /// The sampler without the guard.
    pub const fn sampler(&self) -> &Sampler<W> {
        &self.sampler
    }

    /// Number of times that the count was zeroed. The number wraps.
    #[expect(clippy::cast_possible_truncation, reason = "16 bits")]
    pub const fn zeros(&self) -> u16 {
        self.zeros_met().number() as u16
    }

    const fn zeros_met(&self) -> Token {
        self.met.by(self.met.turn())
    }

    /// Takes a reading of the encoder counter. Call it once per sample, at a constant rate, with the newest
    /// [`GuardCommand`] as `down`. `senses` are the board's other senses. The force of `down` replaces the force in
    /// `senses`. `guard` has the findings so far. If this call changes `guard`, [`Step::told`] is set.
    ///
    /// At a due sample, the output of the due sample before it must be finished. If `down.rendered` shows that this
    /// output is not finished, the output is late by a period.
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
        let measured = self.measure(control, counter, &senses);
        let judged = self.judge(measured, control, down);
        let Judged { motion, due, found, quiet } = judged;
        let present = if quiet {
            FaultSet::EMPTY
        } else if due && control.period.get() > 1 {
            self.defer(found, down)
        } else {
            return self.settle(&judged, down, guard);
        };
        Step { report: SampleReport { motion, present }, due, cut: false, told: false }
    }

    /// The first stage of [`step`](Self::step): position and velocity, with the force in `senses`.
    #[inline(always)]
    pub fn measure(&mut self, control: &LoopParameters, counter: u32, senses: &Senses) -> Measured {
        let before = self.sampler.position();
        let sampled = self.sampler.sense(control, counter, senses);
        Measured { sampled, moved: sampled.motion.position.wrapping_since(before) }
    }

    /// The second stage of [`step`](Self::step): finds faults.
    ///
    /// The caller must handle each result in its own branch. If the branches joined again, each branch would load the
    /// values of all branches, and a quiet sample would take longer.
    #[inline(always)]
    pub fn judge(
        &mut self,
        measured: Measured,
        control: &LoopParameters,
        down: &GuardCommand,
    ) -> Judged {
        let Measured { sampled: Sampled { mut motion, due }, moved } = measured;
        read_anew();
        motion.position = self.sampler.position();
        let judged = Judged { motion, due, found: FaultSet::EMPTY, quiet: true };
        if !due {
            return self.with_motion(judged, moved, down);
        }
        // The output of the previous due sample must be finished, unless flash was written.
        let behind = motion.number().wrapping_sub(down.rendered);
        let found = if behind != control.period.get() && !down.stall {
            cold_path();
            read_anew();
            FaultSet::EMPTY.with(Fault::LateRender).with_if(Fault::Memory, !self.sampler.is_whole())
        } else if !self.sampler.is_whole() {
            // A flipped bit has moved position 0. A check at due samples is enough. Due samples have time for it,
            // because they are not the longest samples.
            cold_path();
            read_anew();
            FaultSet::EMPTY.with(Fault::Memory)
        } else {
            return self.with_motion(judged, moved, down);
        };
        self.with_motion(Judged { found, ..judged }, moved, down)
    }

    /// Adds the faults of this motion, which are count jump and over-speed. Sets whether the sample is quiet.
    #[inline(always)]
    fn with_motion(&self, judged: Judged, moved: i32, down: &GuardCommand) -> Judged {
        let jumped = beyond(moved, down.jump);
        let fast = beyond(judged.motion.velocity.bits(), down.speed);
        if judged.found.is_empty() && !jumped && !fast {
            return Judged { quiet: down.zeros == self.met, ..judged };
        }
        cold_path();
        let found = judged.found.with_if(Fault::CountJump, jumped).with_if(Fault::OverSpeed, fast);
        Judged { found, quiet: false, ..judged }
    }

    /// Handles a due sample that is not quiet, unless every sample is due. Returns the faults for the report of this
    /// sample. These faults keep the requested output off. If this output does not come, the next sample switches off.
    #[inline(always)]
    pub fn defer(&mut self, found: FaultSet, down: &GuardCommand) -> FaultSet {
        let waiting = self.waiting.union(found);
        if !found.is_empty() {
            // From a fault until `clear` the stored token is turned. If one of its bits has flipped, it is no longer
            // recognised as turned. A second turn could then give the token of `down`, and the next sample would be
            // quiet.
            let met = self.zeros_met().turned();
            if met != down.zeros {
                self.met = met;
            }
            self.waiting = waiting;
        }
        waiting
    }

    /// Handles any other sample that is not quiet. It notes the faults of the sample, or zeroes the count.
    #[inline(always)]
    pub fn settle(&mut self, judged: &Judged, down: &GuardCommand, guard: &mut Guard) -> Step {
        read_anew();
        let Judged { due, found, .. } = *judged;
        let mut motion = Motion { position: self.sampler.position(), ..judged.motion };
        let waiting = self.waiting.union(found);
        if down.zeros.number() != self.met.number() {
            cold_path();
            let turn = self.met.turn();
            // A flipped bit must not zero the count: position 0 would then be somewhere else, and nobody would notice.
            if down.zeros.asks_after(self.met.by(turn)) {
                let turn = if found.is_empty() { turn } else { Turn::HALF };
                (self.met, self.waiting) = (down.zeros.by(turn), waiting);
                guard.zeros = down.zeros.number();
                self.sampler.zero();
                motion.position = self.sampler.position();
                let report = SampleReport { motion, present: waiting };
                return Step { report, due, cut: self.met.is_turned(), told: true };
            }
        }
        let report = SampleReport { motion, present: found.within(OF_MOTION) };
        let dealt_with = guard.events == down.acknowledged;
        if waiting.is_empty() {
            // If `clear` has covered all noted faults, the output may be on again.
            let turn = if dealt_with { Turn::NONE } else { Turn::HALF };
            self.met = down.zeros.by(turn);
            return Step { report, due, cut: !dealt_with, told: false };
        }
        (self.met, self.waiting) = (down.zeros.turned(), FaultSet::EMPTY);
        guard.note(waiting, motion.number(), dealt_with);
        Step { report, due, cut: true, told: true }
    }
}

/// The faults that the motion of a single sample can show.
const OF_MOTION: FaultSet = FaultSet::EMPTY.with(Fault::CountJump).with(Fault::OverSpeed);

/// Makes the code after this call read values from memory again. So these values occupy no register before the call.
#[inline(always)]
fn read_anew() {
    compiler_fence(SeqCst);
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

    /// Parameters with a wall that is far away. The estimated velocity is the motion of the last sample.
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

    /// Returns the faults of a second sample at `counts`, after a first sample at 0.
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

    /// A flipped bit in the count at position 0 would move every wall. The command `zero` repairs it.
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

    /// An output is late if it is still missing at the next due sample. While flash is written, no output counts as
    /// late.
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

    /// The token of the last zeroing is kept. The count stays as it is after a flipped bit in this token, or in the
    /// token that requests a zeroing. A valid request is still carried out.
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

    /// From a fault until `clear`, every sample except a due one switches off. A flipped bit of the request does not
    /// end this.
    #[test]
    fn a_bit_that_flips_in_an_alert_ends_no_cut() {
        let control = free();
        for bit in 0..32 {
            let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
            let (mut down, mut guard) = (GuardCommand { jump: 7, ..ANYTHING }, Guard::NOTHING);
            let mut step = |sampler: &mut GuardedSampler, counter, down: &GuardCommand| {
                let step = sampler.step(&control, counter, &Senses::NONE, down, &mut guard);
                step.cut || step.due
            };
            step(&mut sampler, 0, &down);
            assert!(step(&mut sampler, 100, &down));
            down.zeros = down.zeros.flipped(bit);
            for n in 0..25 {
                assert!(step(&mut sampler, 100, &down), "bit {bit}, sample {n}");
            }
            down.acknowledged = 1;
            step(&mut sampler, 100, &down);
            assert!(!step(&mut sampler, 100, &down), "bit {bit}");
        }
    }

    /// A due sample finds another fault, although the first one was not cleared yet. Each sample up to the next due
    /// sample still switches off. Every bit of the request and of the token of the last zeroing flips, at every time.
    #[test]
    fn a_bit_that_flips_before_another_fault_ends_no_cut() {
        let control = free();
        for (bit, at, of_request) in (0..32)
            .flat_map(|bit| [1, 2, 10].map(|at| [(bit, at, true), (bit, at, false)]))
            .flatten()
        {
            let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
            let (mut down, mut guard) = (GuardCommand { jump: 7, ..ANYTHING }, Guard::NOTHING);
            for n in 0..20u32 {
                match of_request {
                    true if n == at => down.zeros = down.zeros.flipped(bit),
                    false if n == at => sampler.met = sampler.met.flipped(bit),
                    _ => {}
                }
                let counter = match n {
                    0 => 0,
                    1..10 => 100,
                    _ => 200, // jumps with a due sample
                };
                let step = sampler.step(&control, counter, &Senses::NONE, &down, &mut guard);
                assert_eq!(step.due, n % 10 == 0);
                assert_eq!(
                    step.cut, !step.due,
                    "bit {bit} of the request: {of_request}, at {at}, sample {n}"
                );
                assert_eq!(
                    sampler.sampler.position().counts().cast_unsigned(),
                    counter,
                    "not zeroed"
                );
            }
        }
    }

    /// A due sample has found a fault. The next sample notes it and switches off, even if a bit of the token of the
    /// last zeroing has flipped before.
    #[test]
    fn a_bit_that_flips_lets_nothing_on() {
        let control = free();
        for bit in 0..32 {
            let mut guard = Guard::NOTHING;
            let mut sampler = GuardedSampler::new(0, CounterWidth::Bits32);
            let mut cut = |sampler: &mut GuardedSampler, jump| {
                let down = GuardCommand { jump, ..ANYTHING };
                let step = sampler.step(&control, 8, &Senses::NONE, &down, &mut guard);
                assert_eq!(step.report.motion.position.counts(), 8);
                step.cut
            };
            assert!(!cut(&mut sampler, 7), "a due sample, which is told");
            sampler.met = sampler.met.flipped(bit);
            for _ in 0..3 {
                assert!(cut(&mut sampler, GuardCommand::ANY), "bit {bit}");
            }
        }
    }
}
