//! The running experiment, and the push that it proposes for the next output. A push is the force of an experiment,
//! without the wall's force. [`safety`](crate::safety) decides how much of the push acts.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use super::{
    AbortReason, Activity, Calibration, CalibrationEnd, CalibrationPlan, Duty, DutyPlan, Event,
    HitSequence, HitSequencePlan, PulseTrain, PulseTrainPlan, RunningVariance,
};
use crate::{
    safety::{Doubled, OutputCommand, Proposal, Refusal},
    units::{Force, Position},
    wall::Wall,
};

#[derive(Clone)]
pub(crate) enum Experiment {
    None,
    Hit(HitSequence),
    Calibration(Calibration),
    Pulses(PulseTrain),
}

/// The running experiment, if there is one, and its push.
#[derive(Clone)]
pub struct Experiments {
    experiment: Experiment,
    /// Kind of the running experiment. It repeats what `experiment` says, so that a flipped bit cannot begin an
    /// experiment.
    activity: Activity,
    /// Push of the next output.
    push: Force,
    /// Push of the last output.
    pushed: Force,
    duty: Duty,
    duty_plan: Doubled<DutyPlan>,
    /// The event of an experiment that has reached a stage or has ended by itself. It waits here until the caller takes
    /// it.
    news: Event,
    /// Mean and variance of the output codes in the window of the last hit.
    codes: RunningVariance,
    /// Whether a hit is over whose codes must still be sent. They follow in a separate event, so that a report stays
    /// short.
    tells_codes: bool,
    /// Event with the codes, sent after the end of the hit was reported.
    codes_news: Event,
}

impl Experiments {
    /// No experiment is running, and the motor is cold.
    pub fn new(duty_plan: DutyPlan) -> Self {
        Self {
            experiment: Experiment::None,
            activity: Activity::None,
            push: Force::ZERO,
            pushed: Force::ZERO,
            duty: Duty::default(),
            duty_plan: Doubled::new(duty_plan),
            news: Event::None,
            codes: RunningVariance::EMPTY,
            tells_codes: false,
            codes_news: Event::None,
        }
    }

    /// What runs at the moment, apart from the wall.
    #[inline(always)]
    pub fn activity(&self) -> Activity {
        self.activity
    }

    /// The push for the next output.
    #[inline(always)]
    pub fn proposal(&self) -> Proposal {
        Proposal { push: self.push, still: matches!(self.activity, Activity::Calibration) }
    }

    /// The push of the last output that was given to [`follow`](Self::follow).
    #[inline(always)]
    pub fn pushed(&self) -> Force {
        self.pushed
    }

    /// Whether a hit begins with the output that was just written.
    #[inline(always)]
    pub fn begins_hit(&self) -> bool {
        matches!(&self.experiment, Experiment::Hit(hit) if hit.is_fresh())
    }

    /// The event that the caller must take. It is `Event::None` if there is none.
    #[inline(always)]
    pub fn news(&mut self) -> &mut Event {
        if matches!(self.news, Event::None) { &mut self.codes_news } else { &mut self.news }
    }

    /// Whether experiment and limits are unchanged. Call it after each output.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        let (activity, whole) = match &self.experiment {
            Experiment::None => (Activity::None, true),
            Experiment::Hit(hit) => (Activity::Hit, hit.is_whole()),
            Experiment::Calibration(calibration) => (Activity::Calibration, calibration.is_whole()),
            Experiment::Pulses(train) => (Activity::Pulses, train.is_whole()),
        };
        let limits = self.duty_plan.is_whole() && self.duty.is_whole();
        activity == self.activity && whole && limits
    }

    /// Sets the motor's thermal limits for another output period. Call it with the force off.
    pub fn set_duty(&mut self, duty: DutyPlan) {
        self.duty_plan.set(duty);
    }

    /// Runs a wall hit.
    ///
    /// # Errors
    /// An experiment is running.
    #[inline(always)] // a call would copy the plan once more; so would the calls below
    pub fn hit(&mut self, plan: HitSequencePlan) -> Result<(), Refusal> {
        self.free()?;
        self.set(Activity::Hit, Experiment::Hit(HitSequence::new(plan)));
        Ok(())
    }

    /// Runs a pulse train.
    ///
    /// # Errors
    /// An experiment is running, or `wall` has a force. The console has checked that it has none.
    #[inline(always)]
    pub fn pulses(&mut self, plan: PulseTrainPlan, wall: &Wall) -> Result<(), Refusal> {
        self.free()?;
        if wall.acts() {
            return Err(Refusal::Settings);
        }
        self.set(Activity::Pulses, Experiment::Pulses(PulseTrain::new(plan)));
        Ok(())
    }

    /// Holds a constant force, or continues with another one.
    ///
    /// # Errors
    /// Another experiment is running.
    #[inline(always)]
    pub fn calibrate(&mut self, plan: CalibrationPlan) -> Result<(), Refusal> {
        if let Experiment::Calibration(calibration) = &mut self.experiment {
            calibration.retarget(plan);
            return Ok(());
        }
        self.free()?;
        self.set(Activity::Calibration, Experiment::Calibration(Calibration::new(plan)));
        Ok(())
    }

    fn free(&self) -> Result<(), Refusal> {
        if matches!(self.experiment, Experiment::None) { Ok(()) } else { Err(Refusal::Busy) }
    }

    /// Ends the experiment without an event. The push of the experiment fades.
    #[inline(always)]
    pub fn stop(&mut self) {
        // `set` is not used, because it would copy as much as the largest experiment.
        self.activity = Activity::None;
        self.experiment = Experiment::None;
        self.push = Force::ZERO;
    }

    #[inline(always)]
    fn set(&mut self, activity: Activity, experiment: Experiment) {
        (self.activity, self.experiment) = (activity, experiment);
    }

    fn end(&mut self, news: Event) {
        self.stop();
        self.news = news;
    }

    /// Computes the next push. Call it after each output, with the force that was granted, the position at this output,
    /// and the `positions` of the samples since the last output. The push acts one output later. That is not too late:
    /// a return move tolerates a millisecond, and a hit begins only with the output of its push.
    #[inline(always)]
    pub fn follow(
        &mut self,
        wall: &Wall,
        grant: OutputCommand,
        position: Position,
        positions: impl Iterator<Item = Position>,
    ) {
        self.pushed = self.push;
        self.duty.add(&self.duty_plan, grant.force().unwrap_or_default());
        if core::mem::take(&mut self.tells_codes) {
            cold_path(); // not with the output that ends the hit: it has enough other work
            self.codes_news = Event::HitCodes(self.codes);
        }
        self.observe(wall, grant, positions);
        self.prepare(position, wall.penetration(position) > 0);
    }

    /// Feeds the samples since the last output to the experiment.
    fn observe(
        &mut self,
        wall: &Wall,
        grant: OutputCommand,
        mut positions: impl Iterator<Item = Position>,
    ) {
        let on = matches!(grant, OutputCommand::On(_));
        match self.experiment {
            Experiment::Hit(_) if !on => self.end(Event::HitAborted(AbortReason::Off)),
            Experiment::Calibration(_) if !on => {
                self.end(Event::CalibrationOver(CalibrationEnd::Off));
            }
            Experiment::Pulses(_) if !on => self.end(Event::PulsesOver(Err(AbortReason::Off))),
            _ => {}
        }
        let Experiment::Hit(hit) = &mut self.experiment else {
            positions.for_each(drop);
            return;
        };
        let mut verdict = None;
        if hit.is_fresh() {
            // Only the last sample, which has the output that began the hit, belongs to the hit.
            if let Some(position) = positions.last() {
                verdict = hit.sample(position, wall.penetration(position) > 0);
            }
        } else {
            for position in positions.by_ref() {
                verdict = verdict.or(hit.sample(position, wall.penetration(position) > 0));
            }
        }
        if hit.scatter().samples() == 0 {
            self.codes = RunningVariance::EMPTY;
        } else if verdict.is_none()
            && let OutputCommand::On(granted) = grant
        {
            self.codes.push_number(granted.command().code());
        }
        if let Some(verdict) = verdict.or_else(|| hit.early_verdict()) {
            let counts = *hit.scatter();
            self.tells_codes = true;
            self.end(Event::HitOver(verdict, counts));
        }
    }

    /// Computes the push of the next output.
    fn prepare(&mut self, position: Position, contact: bool) {
        let (push, over) = match &mut self.experiment {
            Experiment::None => (Force::ZERO, None), // also after a flipped bit
            Experiment::Hit(hit) => match hit.output(position, contact, &self.duty) {
                Ok(push) => (push, None),
                Err(reason) => (Force::ZERO, Some(Event::HitAborted(reason))),
            },
            Experiment::Calibration(calibration) => match calibration.output(position, contact) {
                Ok(push) => {
                    if calibration.is_complete_now() {
                        self.news = Event::CalibrationHolds;
                    }
                    (push, None)
                }
                Err(end) => (Force::ZERO, Some(Event::CalibrationOver(end))),
            },
            Experiment::Pulses(train) => match train.output(position, contact, &self.duty) {
                Ok(Some(push)) => (push, None),
                Ok(None) => (Force::ZERO, Some(Event::PulsesOver(Ok(())))),
                Err(reason) => (Force::ZERO, Some(Event::PulsesOver(Err(reason)))),
            },
        };
        self.push = push;
        if let Some(event) = over {
            self.end(event);
        }
    }
}

/// Access for tests to the private fields.
#[cfg(test)]
pub(crate) struct Parts<'a> {
    pub(crate) experiment: &'a mut Experiment,
    pub(crate) activity: &'a mut Activity,
    pub(crate) push: &'a mut Force,
    pub(crate) duty: &'a mut Duty,
    pub(crate) duty_plan: &'a mut Doubled<DutyPlan>,
}

#[cfg(test)]
impl Experiments {
    pub(crate) fn parts(&mut self) -> Parts<'_> {
        let Self { experiment, activity, push, duty, duty_plan, .. } = self;
        Parts { experiment, activity, push, duty, duty_plan }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        device::tests::DEVICE,
        experiment::{HitPlan, Verdict},
        safety::GrantedForce,
    };

    const ON: OutputCommand = OutputCommand::On(GrantedForce::ZERO);

    /// A handle on the surface is not in contact. This is tested for the first sample of a hit, for a later sample of a
    /// hit, and for a calibration.
    #[test]
    fn contact_begins_one_count_behind_the_surface() {
        let stored = DEVICE.defaults();
        let plan = DEVICE.hit_sequence(&stored, false).unwrap();
        let plan = HitSequencePlan { hit: HitPlan { settle: 0, window: 1, ..plan.hit }, ..plan };
        let push = DEVICE.calibration(&stored, 2.0).unwrap();
        let wall = DEVICE.control(&stored).unwrap().wall;
        for (behind, contact) in [(-1, false), (0, false), (1, true)] {
            let position = wall.surface().wrapping_add(behind);
            for outputs_more in [0, 1] {
                let mut experiments = Experiments::new(plan.approach.duty);
                let (mut hit, start) = (HitSequence::new(plan), plan.approach.back.start());
                while !hit.is_fresh() {
                    hit.output(start, false, &Duty::default()).unwrap();
                }
                for _ in 0..outputs_more {
                    hit.output(start, false, &Duty::default()).unwrap();
                }
                experiments.set(Activity::Hit, Experiment::Hit(hit));
                experiments.observe(&wall, ON, core::iter::once(position));
                let verdict = if contact { Verdict::Stable } else { Verdict::NoContact };
                let Event::HitOver(judged, _) = experiments.news else { panic!("none") };
                assert_eq!(judged, verdict, "{behind} {outputs_more}");
            }
            let mut experiments = Experiments::new(plan.approach.duty);
            experiments.calibrate(push).unwrap();
            experiments.prepare(position, contact);
            let ended = matches!(experiments.news, Event::CalibrationOver(CalibrationEnd::Contact));
            assert_eq!(ended, contact, "{behind}");
        }
    }
}
