//! A pulse train: four pushes of a handle outside any wall. `identify` finds the device from their motion.
//!
//! | pulse | push | for |
//! |---|---|---|
//! | 1, 2 | the force, and its negative | [`SHORT_S`] |
//! | 3, 4 | a [`WEAKER`]th of it, and its negative | [`LONG_S`] |
//!
//! Each pulse begins at rest at the start, after a return move. After each pulse there is no force for [`REST_S`], and
//! the handle swings freely. Short strong pulses show the mass and the amplifier's lag, because the force changes
//! often. Long weak pulses show damping, spring and friction, because the handle reaches the same speed over a longer
//! distance.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{
    Duty,
    approach::{AbortReason, Approach, ApproachPlan},
};
use crate::{
    safety::{Doubled, sum},
    units::{Force, Position},
};

/// Length of the first two pulses, in s.
pub const SHORT_S: f64 = 0.05;
/// Length of the last two pulses, in s.
pub const LONG_S: f64 = 0.2;
/// Factor by which the last two pulses are weaker.
pub const WEAKER: f64 = 4.0;
/// Time without a force after each pulse, in s.
pub const REST_S: f64 = 3.0;
/// Number of pulses in a train.
pub const PULSES: usize = 4;
/// Push of each pulse, as a part of the force of the train.
pub const PARTS: [f64; PULSES] = [1.0, -1.0, 1.0 / WEAKER, -1.0 / WEAKER];
/// Length of each pulse, in s.
pub const LENGTHS_S: [f64; PULSES] = [SHORT_S, SHORT_S, LONG_S, LONG_S];

/// A pulse train in integer form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PulseTrainPlan {
    /// Push of each pulse, and its length in outputs.
    pub pulses: [(Force, u32); PULSES],
    /// Outputs of rest after each pulse.
    pub rest: u32,
    /// The way to the start of each pulse.
    pub approach: ApproachPlan,
    /// [Sum](sum()) of `approach`.
    pub approach_sum: u32,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Approach(Approach),
    /// Outputs since the pulse began.
    Push(u32),
    /// Outputs since the pulse ended.
    Rest(u32),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Approach,
    Push,
    Rest,
}

impl Phase {
    #[inline(always)]
    fn part(&self) -> Part {
        match self {
            Self::Approach(_) => Part::Approach,
            Self::Push(_) => Part::Push,
            Self::Rest(_) => Part::Rest,
        }
    }
}

/// A pulse train in progress.
#[derive(Clone, Copy, Debug)]
pub struct PulseTrain {
    pulses: Doubled<[(Force, u32); PULSES]>,
    rest: Doubled<u32>,
    approach: ApproachPlan,
    approach_sum: u32,
    /// Number of pulses that are over.
    over: usize,
    phase: Phase,
    /// Kind of the phase. It repeats what `phase` says, so that a flipped bit cannot begin a pulse.
    part: Part,
}

impl PulseTrain {
    /// Makes a pulse train whose first output is still to come.
    pub fn new(plan: PulseTrainPlan) -> Self {
        let PulseTrainPlan { pulses, rest, approach, approach_sum } = plan;
        let (pulses, rest) = (Doubled::new(pulses), Doubled::new(rest));
        let phase = Phase::Approach(Approach::default());
        Self { pulses, rest, approach, approach_sum, over: 0, phase, part: Part::Approach }
    }

    /// Flips a bit of the second copy of the pulses.
    #[cfg(test)]
    pub fn spoil(&mut self) {
        let mut pulses = *self.pulses;
        pulses[2].1 ^= 1;
        self.pulses.spoil(pulses);
    }

    /// Whether pulses, rest and approach are still those that were ordered, and no flipped bit has changed the phase.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.pulses.is_whole()
            && self.rest.is_whole()
            && self.phase.part() == self.part
            && match &self.phase {
                Phase::Approach(approach) => {
                    approach.is_whole() && sum(&self.approach) == self.approach_sum
                }
                Phase::Push(_) | Phase::Rest(_) => true,
            }
    }

    #[inline(always)]
    fn begin(&mut self, phase: Phase) {
        self.part = phase.part();
        self.phase = phase;
    }

    /// Returns the push for this output. Returns `None` when all pulses are over. `contact` says whether the handle is
    /// inside the wall, which has no force.
    ///
    /// # Errors
    /// The train cannot continue. There is no push any more.
    pub fn output(
        &mut self,
        position: Position,
        contact: bool,
        duty: &Duty,
    ) -> Result<Option<Force>, AbortReason> {
        if let Phase::Approach(approach) = &mut self.phase {
            let way =
                approach.output((&self.approach, self.approach_sum), (position, contact), duty)?;
            if way.is_some() {
                return Ok(way);
            }
            self.begin(Phase::Push(0));
        }
        let Some(&(push, length)) = self.pulses.get(self.over) else { return Ok(None) };
        if let Phase::Push(outputs) = &mut self.phase {
            if *outputs < length {
                *outputs += 1;
                return Ok(Some(push));
            }
            self.begin(Phase::Rest(0));
        }
        if let Phase::Rest(outputs) = &mut self.phase {
            if *outputs < *self.rest {
                *outputs += 1;
                return Ok(Some(Force::ZERO));
            }
            self.over += 1;
            self.begin(Phase::Approach(Approach::default()));
        }
        Ok(self.pulses.get(self.over).map(|_| Force::ZERO))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::{
        DutySettings,
        return_move::tests::{DESIGN, Handle, SETTINGS as BACK},
    };
    use std::vec::Vec;

    fn plan() -> PulseTrainPlan {
        let duty = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };
        let force = |push_n| DESIGN.force("push_n", push_n).unwrap();
        let duty = duty.build(&DESIGN, 2_000).unwrap();
        let approach = ApproachPlan { back: BACK.build(&DESIGN).unwrap(), duty };
        PulseTrainPlan {
            pulses: [(force(1.2), 50), (force(-1.2), 50), (force(0.3), 200), (force(-0.3), 200)],
            rest: 300,
            approach,
            approach_sum: sum(&approach),
        }
    }

    #[test]
    fn a_flipped_bit_of_its_phase_is_told() {
        let phases = [Phase::Approach(Approach::default()), Phase::Push(0), Phase::Rest(0)];
        for (n, begun) in phases.into_iter().enumerate() {
            let mut train = PulseTrain::new(plan());
            train.begin(begun);
            for (other, phase) in phases.into_iter().enumerate() {
                train.phase = phase;
                assert_eq!(train.is_whole(), other == n);
            }
        }
    }

    #[test]
    fn a_flipped_bit_of_its_plans_is_told() {
        let plan = plan();
        let whole = PulseTrain::new(plan);
        assert!(whole.is_whole());
        for spoil in ApproachPlan::SPOILS {
            let mut train = whole;
            train.approach = spoil(plan.approach);
            assert!(!train.is_whole());
        }
        let mut train = whole;
        train.rest.spoil(plan.rest ^ 1);
        assert!(!train.is_whole());
    }

    /// The train has four pulses with both signs and both lengths. Each begins at rest at the start. Apart from the
    /// return move no force acts between them.
    #[test]
    #[cfg_attr(miri, ignore = "four returns in closed loop")]
    fn four_pulses_each_from_rest_at_the_start() {
        let (plan, mut duty) = (plan(), Duty::default());
        let mut train = PulseTrain::new(plan);
        let mut handle = Handle::at(0.01);
        let mut pulses: Vec<(Force, u32)> = Vec::new();
        let mut rests = 0;
        loop {
            let before = train.phase;
            let Some(push) = train.output(handle.position(), false, &duty).unwrap() else { break };
            match train.phase {
                Phase::Push(1) => {
                    assert!(matches!(before, Phase::Approach(_)));
                    assert!(handle.x.abs() < 6e-5 && handle.v.abs() < 5e-3, "{}", handle.x);
                    pulses.push((push, 1));
                }
                Phase::Push(outputs) => {
                    assert_eq!(push, pulses.last().unwrap().0);
                    pulses.last_mut().unwrap().1 = outputs;
                }
                Phase::Rest(_) => {
                    assert_eq!(push, Force::ZERO);
                    rests += 1;
                }
                Phase::Approach(_) => {}
            }
            duty.add(&plan.approach.duty, push);
            handle.go(push);
        }
        assert_eq!(pulses, plan.pulses);
        assert_eq!(rests, 4 * plan.rest);
    }

    #[test]
    #[cfg_attr(miri, ignore = "a return that takes its time")]
    fn it_ends_where_the_handle_does_not_come_back_or_the_motor_stays_warm() {
        let at = Position::from_counts(80_000);
        let end = |duty: &Duty| {
            let mut train = PulseTrain::new(plan());
            (0..1_000_000).find_map(|_| train.output(at, false, duty).err())
        };
        assert_eq!(end(&Duty::default()), Some(AbortReason::NotBack));
        let mut warm = Duty::default();
        while !warm.is_too_warm(&plan().approach.duty) {
            warm.add(&plan().approach.duty, Force::FULL_SCALE);
        }
        assert_eq!(end(&warm), Some(AbortReason::TooWarm));
    }
}
