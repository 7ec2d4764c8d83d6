//! The approach to the start of a hit or a pulse. First a warm motor cools down. Then the return move follows.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Duty, DutyPlan, Return, ReturnPlan, ReturnStep};
use crate::{
    safety::sum,
    units::{Force, Position},
};

/// Why a hit sequence ended without a verdict, or why a pulse train ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AbortReason {
    /// The force went off.
    Off,
    /// The handle did not come back to the start in time.
    NotBack,
    /// The motor does not cool down: another force warms it.
    TooWarm,
}

impl AbortReason {
    /// What is wrong and what helps.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Off => "the force went off: see status and faults",
            Self::NotBack => "the handle did not come back to the start in time: is it held?",
            Self::TooWarm => "the motor does not cool down: does the handle rest in a wall?",
        }
    }
}

/// An approach in integer form.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub struct ApproachPlan {
    /// The return move.
    pub back: ReturnPlan,
    /// Thermal limits of the motor.
    pub duty: DutyPlan,
}

#[cfg(test)]
impl ApproachPlan {
    /// Each flips a bit of one of the two plans.
    pub const SPOILS: [fn(Self) -> Self; 2] = [
        |mut plan| {
            plan.back.spoil();
            plan
        },
        |mut plan| {
            plan.duty.spoil();
            plan
        },
    ];
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Approach {
    back: Return,
    /// Whether the return move is under way. If not, the motor is cooling down.
    moves: bool,
    /// Number of outputs since the motor began to cool down.
    cooled: u32,
    /// [Sum](Return::sum) of `back` after the last output.
    back_sum: u32,
}

impl Default for Approach {
    #[inline(always)]
    fn default() -> Self {
        let back = Return::default();
        Self { back, moves: false, cooled: 0, back_sum: back.sum() }
    }
}

impl Approach {
    /// Whether the return move is as the last output left it.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.back.sum() == self.back_sum
    }

    /// Returns the push for this output. Returns `None` when the handle rests at the start and the motor is cool
    /// enough. `contact` says whether the handle is inside the wall. The sum is that of the plan.
    ///
    /// # Errors
    /// The handle does not get to the start.
    #[inline(always)]
    pub fn output(
        &mut self,
        (plan, plan_sum): (&ApproachPlan, u32),
        place: (Position, bool),
        duty: &Duty,
    ) -> Result<Option<Force>, AbortReason> {
        // The next check of the experiment finds the change.
        if !self.is_whole() {
            return Ok(Some(Force::ZERO));
        }
        let step = self.step(plan, place, duty);
        self.back_sum = self.back.sum();
        // With a changed plan the approach does not end, either.
        let ends = !matches!(step, Ok(Some(_)));
        if ends && sum(plan) != plan_sum {
            return Ok(Some(Force::ZERO));
        }
        step
    }

    #[inline(always)]
    fn step(
        &mut self,
        ApproachPlan { back, duty: limits }: &ApproachPlan,
        (position, contact): (Position, bool),
        duty: &Duty,
    ) -> Result<Option<Force>, AbortReason> {
        if duty.is_too_warm(limits) {
            self.moves = false; // something holds the handle on its way
        }
        if !self.moves && !duty.is_ready(limits) {
            self.cooled = self.cooled.saturating_add(1);
            let patient = self.cooled <= limits.patience();
            return if patient { Ok(Some(Force::ZERO)) } else { Err(AbortReason::TooWarm) };
        }
        if !self.moves {
            self.back.restart();
            self.moves = true;
        }
        let moved = self.back.output(back, position, contact);
        match moved {
            ReturnStep::Push(force) => Ok(Some(force)),
            ReturnStep::TooLong => Err(AbortReason::NotBack),
            // The approach has warmed the motor. The hit or pulse needs a cool motor.
            ReturnStep::Arrived if !duty.is_ready(limits) => {
                self.moves = false;
                Ok(Some(Force::ZERO))
            }
            ReturnStep::Arrived => Ok(None),
        }
    }

    #[cfg(test)]
    pub fn cools(&self) -> bool {
        !self.moves
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::{
        DutySettings,
        return_move::tests::{DESIGN, SETTINGS as BACK},
    };

    #[test]
    fn a_motor_that_the_way_back_has_warmed_cools_down_at_the_start_and_stands_there_again() {
        let back = BACK.build(&DESIGN).unwrap();
        let duty = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };
        let plan = ApproachPlan { back, duty: duty.build(&DESIGN, 60_000).unwrap() };
        let (cold, mut warm) = (Duty::default(), Duty::default());
        while warm.is_ready(&plan.duty) {
            warm.add(&plan.duty, Force::FULL_SCALE);
        }
        let mut approach = Approach::default();
        let mut output = |duty: &Duty| {
            let push = approach.step(&plan, (Position::from_counts(0), false), duty);
            (push.unwrap(), approach.cools())
        };
        // The handle must rest for 20 ms before it counts as arrived.
        for _ in 0..19 {
            assert_eq!(output(&cold), (Some(Force::ZERO), false));
        }
        for _ in 0..10 {
            assert_eq!(output(&warm), (Some(Force::ZERO), true));
        }
        for _ in 0..19 {
            assert_eq!(output(&cold), (Some(Force::ZERO), false));
        }
        assert_eq!(output(&cold), (None, false));
    }

    #[test]
    fn a_changed_plan_does_not_end_it() {
        let duty = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };
        let duty = duty.build(&DESIGN, 60_000).unwrap();
        let plan = ApproachPlan { back: BACK.build(&DESIGN).unwrap(), duty };
        let ends = |plan_sum| {
            let mut approach = Approach::default();
            let mut output = || {
                let place = (Position::from_counts(0), false);
                approach.output((&plan, plan_sum), place, &Duty::default()).unwrap()
            };
            (0..100).any(|_| output().is_none())
        };
        assert!(ends(sum(&plan)) && !ends(sum(&plan) ^ 1));
    }

    #[test]
    fn a_flipped_bit_of_the_return_move_stops_its_push_and_is_told() {
        let duty = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };
        let duty = duty.build(&DESIGN, 60_000).unwrap();
        let plan = ApproachPlan { back: BACK.build(&DESIGN).unwrap(), duty };
        let mut approach = Approach::default();
        let output = |approach: &mut Approach| {
            let place = (Position::from_counts(-40_000), false);
            approach.output((&plan, sum(&plan)), place, &Duty::default()).unwrap()
        };
        let pushes = (0..200).map(|_| output(&mut approach)).last().unwrap();
        assert!(pushes > Some(Force::ZERO) && approach.is_whole());
        approach.back.spoil();
        for _ in 0..2 {
            assert_eq!((output(&mut approach), approach.is_whole()), (Some(Force::ZERO), false));
        }
    }

    #[test]
    fn a_way_back_that_warms_the_motor_beyond_its_limit_is_broken_off() {
        let back = BACK.build(&DESIGN).unwrap();
        let duty = DutySettings { continuous_force_n: 0.75, time_constant_s: 10.0 };
        let plan = ApproachPlan { back, duty: duty.build(&DESIGN, 1_000).unwrap() };
        let mut heat = Duty::default();
        let mut approach = Approach::default();
        let mut pushed = false;
        for _ in 0..9_000 {
            // Somebody holds the handle.
            let push = approach.step(&plan, (Position::from_counts(-40_000), false), &heat);
            let push = push.unwrap().unwrap();
            pushed |= push != Force::ZERO;
            assert!(push == Force::ZERO || !heat.is_too_warm(&plan.duty));
            heat.add(&plan.duty, push);
            if pushed && approach.cools() {
                return;
            }
        }
        panic!("it goes on");
    }
}
