//! Frames and lines of a session against the model, as they come.

use super::{
    answer::{Activity, Answer, Effect, View},
    compare::same,
    frames::{Change, Frame, Twin, flag},
    mind::{LOW_MV, UNSURE},
    model::Model,
    run::{End, Run, differs},
    settings::Settings,
};
use crate::board::Force;

/// The core beside a board that starts with the model's settings.
pub(super) fn twin(model: &Model) -> Result<Twin, End> {
    let codes = match model.board.wiring.force {
        Force::Dac { .. } => (2047, 2048),
        Force::Pwm { .. } => (4200, 0),
    };
    match model.settings.parameters(model.board) {
        Some(parameters) => Ok(Twin::new(parameters, codes)),
        None => differs("the core does not take the settings that the board starts with"),
    }
}

impl Run<'_> {
    /// A frame of telemetry has come.
    pub(super) fn frame(&mut self, mut frame: Frame) -> Result<(), End> {
        let mind = &mut self.mind;
        if mind.sequence.is_some_and(|next| next != frame.sequence) {
            return differs(format!("a frame is missing before sample {}", frame.sample));
        }
        mind.sequence = Some(frame.sequence.wrapping_add(1));
        if frame.is(flag::REPLAY) {
            return mind.replay(&frame);
        }
        mind.replay_ended()?;
        frame.busy = mind.model.activity != Activity::Idle || frame.sample < mind.calm_at;
        mind.twin.expect(frame);
        let supply_good = mind.supply_mv > LOW_MV;
        let old = mind.view;
        let mut new = View {
            sample: frame.sample,
            position: frame.position,
            velocity: frame.velocity,
            force: frame.force,
            code: frame.code,
            on: frame.is(flag::ON),
            armed: frame.is(flag::ARMED),
            contact: frame.is(flag::CONTACT),
            zeroed: frame.is(flag::ZEROED),
            stop_closed: frame.is(flag::STOP_CLOSED),
            supply_good,
            // the first output after a reset is made before the link has judged the settings
            valid: mind.boots.is_none()
                && (old.unlocked || mind.model.settings.inside(&mind.model.envelope).is_ok()),
            unlocked: frame.is(flag::UNLOCKED),
            fault: frame.fault,
        };
        if !frame.is(flag::RENDERED)
            || frame.is(flag::FAULT) != (frame.fault != 0)
            || frame.flags >> 11 != 0
        {
            return differs(format!(
                "flags {:#x} with fault {} at sample {}",
                frame.flags, frame.fault, frame.sample
            ));
        }
        if frame.sample <= mind.zero_lost_until {
            new.zeroed = false;
        }
        mind.transition(&old, &new)?;
        mind.before = old;
        mind.view = new;
        mind.counts.armed += u64::from(new.armed);
        Ok(())
    }

    /// What the hardware gives is what the newest frame says, with the motor's sign; or it is off since.
    pub(super) fn outputs(&self) -> Result<(), End> {
        let View { sample, on, code, .. } = self.mind.view;
        let enabled = self.world.powered.amplifier.is_enabled();
        if !on && enabled {
            return differs(format!(
                "enable is active while the frame of sample {sample} says off"
            ));
        }
        let [magnitude, sign, dac] = self.world.powered.mcu.force_registers().map(i64::from);
        let (zero, given) = match self.world.powered.board.wiring.force {
            Force::Dac { .. } => (2048, dac - 2048),
            Force::Pwm { .. } => (0, if sign == 0 { magnitude } else { -magnitude }),
        };
        let told = i64::from(code) - zero;
        let told = if self.mind.model.settings.motor_reversed && on { -told } else { told };
        let off_since = given == 0 && !enabled;
        if given != told && !off_since && self.mind.asked.is_empty() {
            return differs(format!(
                "the output's code is {given} from zero, and {told} in the frame of sample {sample}"
            ));
        }
        Ok(())
    }

    /// The emergency stop opens or closes.
    pub(super) fn stop(&mut self, open: bool) -> Result<(), End> {
        self.probe()?;
        self.world.emergency_stop(open);
        let mind = &mut self.mind;
        if open != mind.stop_open {
            mind.stop_at = mind.now;
        }
        mind.stop_open = open;
        if open {
            mind.must(30);
            if self.world.powered.amplifier.is_enabled() {
                return differs("enable is active with the stop open");
            }
        }
        Ok(())
    }

    /// The supply changes.
    pub(super) fn supply(&mut self, mv: u32) -> Result<(), End> {
        self.probe()?;
        self.world.powered.mcu.set_supply_mv(mv);
        let mind = &mut self.mind;
        if (mv > LOW_MV) != (mind.supply_mv > LOW_MV) {
            mind.supply_at = mind.now;
        }
        mind.supply_mv = mv;
        if mv <= LOW_MV {
            mind.must(31);
        }
        Ok(())
    }

    /// The board starts anew, by its pin or by its supply.
    pub(super) fn reset(&mut self, power: bool) -> Result<(), End> {
        self.probe()?;
        self.restart(power)
    }

    /// The same where nobody has looked at what the board said.
    pub(super) fn restart(&mut self, power: bool) -> Result<(), End> {
        if power {
            self.world.power_cycle();
        } else {
            self.world.reset();
        }
        let mind = &mut self.mind;
        let View { on, fault, .. } = mind.view;
        // What an answer has just promised, or a line that was under way asks for, may be in backup RAM or not yet.
        let settled = mind.asked.is_empty()
            && mind.due.is_none()
            && mind.view.sample == mind.before.sample + 10;
        let changing =
            mind.allowed.arm || mind.allowed.disarm || mind.answered_at + UNSURE > mind.now;
        let sure = settled && !changing && mind.sees();
        mind.boots = Some(match (power, sure) {
            (true, _) => vec![0],
            (false, true) if fault != 0 => vec![fault],
            (false, true) => vec![if on { 23 } else { 0 }],
            (false, false) => vec![0, 23, fault, 10, 11, 13, 14, 15, 30, 31],
        });
        mind.causes_unsure |= !sure;
        mind.counts.resets += 1;
        mind.model.reset();
        mind.greeting = mind.model.greeting().into();
        mind.restart();
        let compared = mind.twin.compared;
        mind.twin = twin(&mind.model)?;
        mind.twin.compared = compared;
        self.world.replies.clear();
        self.world.telemetry.clear();
        self.greeted()
    }

    /// A line has come.
    pub(super) fn line(&mut self, line: &str) -> Result<(), End> {
        let mind = &mut self.mind;
        mind.waited = 0;
        if let Some(expected) = mind.greeting.pop_front() {
            let good = same(line, &expected, true);
            return if good {
                Ok(())
            } else {
                differs(format!("it greets with {line:?}, should be {expected:?}"))
            };
        }
        if mind.reports(line) {
            return Ok(());
        }
        let Some(asked) = mind.asked.pop_front() else {
            return differs(format!("nobody asked for {line:?}"));
        };
        if asked.trim_ascii().eq_ignore_ascii_case("save") {
            mind.saving = false;
        }
        let mut expected = None;
        for (seen, newest) in mind.views() {
            let answer = mind.model.answer(asked.as_bytes(), &seen, &newest);
            if mind.is_answer(line, &answer) {
                if let Effect::Replay = answer.effect {
                    mind.take_causes(line);
                }
                return self.take(&answer);
            }
            expected.get_or_insert(answer.text);
        }
        let expected = expected.unwrap_or_default();
        differs(format!("{asked:?} is answered by {line:?}, should be {expected:?}"))
    }

    /// A right answer: what it says holds.
    fn take(&mut self, answer: &Answer) -> Result<(), End> {
        let enabled = self.world.powered.amplifier.is_enabled();
        let mind = &mut self.mind;
        if !answer.text.starts_with("ok") {
            mind.counts.refused += 1;
            return Ok(());
        }
        mind.counts.obeyed += 1;
        if answer.ordered {
            mind.answered_at = mind.now;
        }
        let output = if mind.sees() { mind.view.sample } else { mind.twin.output() };
        match answer.effect.clone() {
            Effect::None => {}
            Effect::Loop(new) => mind.settle(new, output),
            Effect::Load(new) => {
                let signs = |s: &Settings| (s.motor_reversed, s.encoder_reversed);
                if signs(&new) != signs(&mind.model.settings) {
                    mind.view.zeroed = false;
                    mind.allowed.turn = true;
                    mind.zero_lost_until = output + 10;
                }
                mind.settle(new, output);
            }
            Effect::Keep(new) => mind.model.settings = new,
            Effect::Signs(new) => {
                mind.model.settings = new;
                mind.view.zeroed = false;
                mind.allowed.turn = true;
            }
            Effect::Zero => {
                mind.twin.change(output, Change::Zero);
                mind.view.zeroed = true;
                mind.allowed.zero = true;
            }
            Effect::Arm => {
                (mind.view.on, mind.view.armed) = (true, false);
                mind.allowed.arm = true;
            }
            Effect::Disarm => {
                (mind.view.on, mind.view.armed, mind.view.unlocked) = (false, false, false);
                mind.allowed.disarm = true;
                if enabled {
                    return differs("disarm is answered before the force is off");
                }
            }
            Effect::Clear => mind.view.fault = 0,
            Effect::Unlock => {
                mind.view.unlocked = true;
                mind.allowed.unlock = true;
            }
            Effect::Begin(activity) => mind.model.activity = activity,
            Effect::Stop => mind.calm(),
            Effect::Stream(on) => {
                mind.blind |= on;
                mind.model.streaming = on;
            }
            Effect::Save => mind.model.saved = Some(mind.model.settings.clone()),
            Effect::Replay => mind.replayed = Some(0),
        }
        Ok(())
    }
}
