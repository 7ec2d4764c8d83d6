//! One hit on the device, with everything before it. First a warm motor cools down, then the return move brings the
//! handle to the start.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{
    Duty, Hit, HitPlan, RunningVariance, Verdict,
    approach::{AbortReason, Approach, ApproachPlan},
};
use crate::{
    safety::{Doubled, sum},
    units::{Force, Position},
};

/// The parts of a hit sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitSequencePlan {
    /// The hit in integer form.
    pub hit: HitPlan,
    /// The way to the start of the hit.
    pub approach: ApproachPlan,
    /// [Sum](sum()) of `approach`.
    pub approach_sum: u32,
    /// Number of outputs from one check to the next. A check finds out whether the verdict is already certain, and
    /// gives a certain verdict at once. With [`NEVER`](Self::NEVER) there are no such checks.
    pub look: u32,
}

impl HitSequencePlan {
    /// Value of `look` without checks. The verdict then comes at the end of the window.
    pub const NEVER: u32 = u32::MAX;
    /// Milliseconds from one check for a certain verdict to the next.
    pub(crate) const LOOK_MS: u32 = 32;
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Approach(Approach),
    Hit(Hit),
}

/// A hit sequence in progress.
#[derive(Clone, Copy, Debug)]
pub struct HitSequence {
    hit: Doubled<HitPlan>,
    approach: ApproachPlan,
    approach_sum: u32,
    look: u32,
    phase: Phase,
    /// Whether the phase is the hit. It repeats what `phase` says, so that a flipped bit cannot begin a hit.
    hits: bool,
    /// Outputs since the last check for an early verdict.
    looked: u32,
    /// Whether the hit began with the last output.
    fresh: bool,
}

impl HitSequence {
    /// Makes a hit sequence whose first output is still to come.
    #[inline(always)]
    pub fn new(plan: HitSequencePlan) -> Self {
        let HitSequencePlan { hit, approach, approach_sum, look } = plan;
        let (hit, phase) = (Doubled::new(hit), Phase::Approach(Approach::default()));
        Self { hit, approach, approach_sum, look, phase, hits: false, looked: 0, fresh: false }
    }

    /// A sequence that begins with the hit itself.
    #[cfg(test)]
    pub fn at_its_push(plan: HitSequencePlan) -> Self {
        Self { phase: Phase::Hit(Hit::new(plan.hit)), hits: true, ..Self::new(plan) }
    }

    /// Flips a bit of the second copy of the push.
    #[cfg(test)]
    pub fn spoil(&mut self) {
        let push = Force::saturating_from_bits(self.hit.push.bits() ^ 1);
        self.hit.spoil(HitPlan { push, ..*self.hit });
    }

    /// Whether hit and approach are still those that were ordered, and no flipped bit has changed the phase. The plan
    /// of the approach is checked during the approach only.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        let begun = match &self.phase {
            Phase::Hit(hit) => self.hits && *hit.plan() == *self.hit,
            Phase::Approach(approach) => {
                !self.hits && approach.is_whole() && sum(&self.approach) == self.approach_sum
            }
        };
        begun && self.hit.is_whole()
    }

    /// Returns the push for this output. `contact` says whether the handle is inside the wall.
    ///
    /// # Errors
    /// The sequence cannot continue. There is no push any more.
    pub fn output(
        &mut self,
        position: Position,
        contact: bool,
        duty: &Duty,
    ) -> Result<Force, AbortReason> {
        self.fresh = false;
        if let Phase::Approach(approach) = &mut self.phase {
            if let Some(push) =
                approach.output((&self.approach, self.approach_sum), (position, contact), duty)?
            {
                return Ok(push);
            }
            (self.phase, self.hits) = (Phase::Hit(Hit::new(*self.hit)), true);
            self.fresh = true;
        }
        self.looked = self.looked.saturating_add(1);
        Ok(self.hit.push)
    }

    /// Whether the hit began with the last output. Of the samples up to that output, only the last sample belongs to
    /// the hit.
    pub fn is_fresh(&self) -> bool {
        self.fresh
    }

    /// Takes one sample. `contact` says whether its position is inside the wall.
    #[inline]
    pub fn sample(&mut self, position: Position, contact: bool) -> Option<Verdict> {
        match &mut self.phase {
            Phase::Hit(hit) => hit.sample(position, contact),
            Phase::Approach(_) => None,
        }
    }

    /// Returns a verdict before the end of the window, if the plan allows it and the verdict is certain.
    pub fn early_verdict(&mut self) -> Option<Verdict> {
        let Phase::Hit(hit) = &self.phase else { return None };
        if self.looked < self.look {
            return None;
        }
        self.looked = 0;
        hit.certain_verdict()
    }

    /// Sums of the window's samples so far. They are empty before the hit.
    pub fn scatter(&self) -> &RunningVariance {
        match &self.phase {
            Phase::Hit(hit) => hit.scatter(),
            Phase::Approach(_) => &RunningVariance::EMPTY,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        HitSettings,
        experiment::{
            DutySettings,
            return_move::tests::{DESIGN, Handle, SETTINGS as BACK},
        },
    };

    const HIT: HitSettings =
        HitSettings { push_n: 2.835, settle_s: 1.0, window_s: 0.5, rms_limit_m: 1.5e-5 };

    fn plan(early: bool) -> HitSequencePlan {
        let hit = HIT.build(&DESIGN).unwrap();
        let duty = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };
        let duty = duty.build(&DESIGN, hit.settle + hit.window).unwrap();
        let look = if early { 32 } else { HitSequencePlan::NEVER };
        let approach = ApproachPlan { back: BACK.build(&DESIGN).unwrap(), duty };
        HitSequencePlan { hit, approach, approach_sum: sum(&approach), look }
    }

    /// Runs a sequence against a soft stop at 0.07 m that vibrates by `chatter_m`. Returns the verdict, and the outputs
    /// of each phase.
    fn run(
        mut duty: Duty,
        early: bool,
        chatter_m: f64,
    ) -> (Result<Verdict, AbortReason>, [u32; 3]) {
        let plan = plan(early);
        let mut sequence = HitSequence::new(plan);
        let mut handle = Handle::at(0.0517);
        let mut spent = [0; 3];
        for n in 0..200_000 {
            let push = match sequence.output(handle.position(), handle.x > 0.07, &duty) {
                Ok(push) => push,
                Err(broken) => return (Err(broken), spent),
            };
            let phase = match sequence.phase {
                Phase::Approach(approach) => usize::from(!approach.cools()),
                Phase::Hit(_) => 2,
            };
            spent[phase] += 1;
            if sequence.is_fresh() {
                assert!(handle.x.abs() < 6e-5, "{}", handle.x);
            }
            duty.add(&plan.approach.duty, push);
            handle.go(push);
            if handle.x > 0.07 {
                let sign = if n % 2 == 0 { 1.0 } else { -1.0 };
                (handle.x, handle.v) = (0.0702 + sign * chatter_m, 0.0);
            }
            for _ in 0..10 {
                if let Some(verdict) = sequence.sample(handle.position(), handle.x > 0.07) {
                    return (Ok(verdict), spent);
                }
            }
            if let Some(verdict) = sequence.early_verdict() {
                return (Ok(verdict), spent);
            }
        }
        panic!("it never ends");
    }

    #[test]
    fn a_cold_motor_goes_back_and_hits_at_once() {
        let (verdict, [cool, back, hit]) = run(Duty::default(), false, 0.0);
        assert_eq!((verdict, cool, hit), (Ok(Verdict::Stable), 0, 1_500));
        assert!((300..2_000).contains(&back), "{back}");
    }

    #[test]
    #[cfg_attr(miri, ignore = "three hits in closed loop")]
    fn an_unstable_verdict_may_come_early_and_a_stable_one_never() {
        let (verdict, [_, _, hit]) = run(Duty::default(), true, 0.0);
        assert_eq!((verdict, hit), (Ok(Verdict::Stable), 1_500));
        assert_eq!(run(Duty::default(), false, 5e-5).1[2], 1_500);
        let (verdict, [_, _, hit]) = run(Duty::default(), true, 5e-5);
        assert_eq!(verdict, Ok(Verdict::Unstable));
        assert!((1_000..1_200).contains(&hit), "{hit}");
    }

    #[test]
    fn a_flipped_bit_of_plan_or_phase_is_told() {
        let plan = plan(false);
        let [settle, window, push] = [
            HitPlan { settle: plan.hit.settle ^ 1, ..plan.hit },
            HitPlan { window: plan.hit.window ^ 1 << 20, ..plan.hit },
            HitPlan { push: Force::FULL_SCALE, ..plan.hit },
        ];
        let (way, hitting) = (HitSequence::new(plan), HitSequence::at_its_push(plan));
        assert!(way.is_whole() && hitting.is_whole());
        let approach = Phase::Approach(Approach::default());
        assert!(!HitSequence { phase: approach, ..hitting }.is_whole());
        assert!(!HitSequence { phase: Phase::Hit(Hit::new(plan.hit)), ..way }.is_whole());
        for spoil in ApproachPlan::SPOILS {
            let mut sequence = way;
            sequence.approach = spoil(plan.approach);
            assert!(!sequence.is_whole());
        }
        for hit in [settle, window, push] {
            assert!(!HitSequence { phase: Phase::Hit(Hit::new(hit)), ..hitting }.is_whole());
            for mut sequence in [way, hitting] {
                sequence.hit.spoil(hit);
                assert!(!sequence.is_whole());
            }
        }
    }

    #[test]
    fn a_look_for_an_early_verdict_comes_once_in_so_many_outputs() {
        let plan = plan(true);
        let mut wild = RunningVariance::default();
        for n in 0..1_000 {
            wild.push(Position::from_counts(n % 2 * 1_000));
        }
        let phase = Phase::Hit(Hit::in_window(plan.hit, 1, wild));
        let mut sequence = HitSequence { phase, hits: true, ..HitSequence::new(plan) };
        for n in 1..=96 {
            sequence.output(Position::from_counts(0), false, &Duty::default()).unwrap();
            let expected = (n % 32 == 0).then_some(Verdict::Unstable);
            assert_eq!(sequence.early_verdict(), expected, "{n}");
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "a motor takes half a minute to warm")]
    fn a_warm_motor_waits_first() {
        let plan = plan(false);
        let mut warm = Duty::default();
        while !warm.is_too_warm(&plan.approach.duty) {
            warm.add(&plan.approach.duty, Force::FULL_SCALE);
        }
        let (verdict, [cool, _, hit]) = run(warm, false, 0.0);
        assert_eq!((verdict, hit), (Ok(Verdict::Stable), 1_500));
        assert!(cool > 100, "{cool}");
        // a motor that stays warm, because the wall still demands force
        let mut sequence = HitSequence::new(plan);
        let at = Position::from_counts(80_000);
        let ended =
            (0..1_000_000).find_map(|n| sequence.output(at, true, &warm).err().map(|b| (n, b)));
        assert_eq!(ended, Some((plan.approach.duty.patience(), AbortReason::TooWarm)));
    }
}
