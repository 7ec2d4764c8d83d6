//! What a session knows: which views the board may have had of the world, what may change from output to output, and
//! which fault has a cause.

use super::{
    answer::{Activity, Answer, Effect, View, fault_text},
    compare::same,
    frames::{Change, Frame},
    push::Push,
    run::{End, Mind, differs},
    settings::Settings,
};

/// A supply between this and what a board has is good, one below it is not, mV.
pub(super) const LOW_MV: u32 = 2_800;
/// Samples for which what the board has seen of the outside is open: two outputs and a half.
pub(super) const UNSURE: u64 = 25;
/// Nearly 1 m/s, in LSB of the velocity and in counts from output to output.
const FAST: u32 = 80 * 65_536;
const FAR: u32 = 900;
/// Travel, counts.
const TRAVEL: [i32; 2] = [-40_000, 110_000];
/// Records of the black box: half a second.
const BLACK_BOX: u64 = 500;

impl Mind {
    /// Live frames come.
    pub(super) fn sees(&self) -> bool {
        self.model.streaming && self.replayed.is_none()
    }

    /// New settings of the loop.
    pub(super) fn settle(&mut self, new: Settings, output: u64) {
        if let Some(parameters) = new.parameters(self.model.board) {
            self.twin.change(output, Change::Parameters(parameters));
        }
        self.model.settings = new;
    }

    /// The experiment is over.
    pub(super) fn calm(&mut self) {
        if self.model.activity != Activity::Idle {
            self.calm_at = self.twin.output() + 60;
        }
        self.model.activity = Activity::Idle;
    }

    /// What the console and the output task may have had before them: with the last output, or the one before.
    pub(super) fn views(&self) -> Vec<(View, View)> {
        let (before, mut view) = (self.before, self.view);
        let mut all = vec![(view, view), (before, view)];
        let of_late = |at: u64| self.now < at + UNSURE;
        if !self.sees() {
            view.stop_closed = !self.stop_open;
            view.supply_good = self.supply_mv > LOW_MV;
            // nobody has seen where the handle and the wall have gone since
            let other = View { valid: !view.valid, ..view };
            let [there, other_there] =
                [view, other].map(|view| View { contact: !view.contact, ..view });
            all = [view, other, there, other_there].map(|view| (view, view)).to_vec();
        }
        // The wall that a walk tries is in force, until the link has brought the person's back.
        if self.model.activity == Activity::Walk || self.twin.output() < self.calm_at {
            let other = |view: View| View { valid: !view.valid, ..view };
            all.extend(all.clone().into_iter().map(|(seen, newest)| (other(seen), other(newest))));
        }
        if of_late(self.supply_at) || of_late(self.stop_at) {
            for (seen, newest) in all.clone() {
                for turn in 1..16u8 {
                    let turned = |view: View, by: u8| View {
                        supply_good: view.supply_good ^ (by & 1 != 0 && of_late(self.supply_at)),
                        stop_closed: view.stop_closed ^ (by & 2 != 0 && of_late(self.stop_at)),
                        ..view
                    };
                    all.push((turned(seen, turn), turned(newest, turn >> 2)));
                }
            }
        }
        all
    }

    /// Whether this line is that answer.
    pub(super) fn is_answer(&self, line: &str, answer: &Answer) -> bool {
        if let Effect::Replay = answer.effect {
            return line.starts_with(&format!("{}, sample ", answer.text));
        }
        if self.causes_unsure && answer.effect == Effect::Clear {
            let there = "error: the cause of the fault is still there, fault 3";
            return line == "ok clear" || line.starts_with(there);
        }
        same(line, &answer.text, self.sees())
    }

    /// What `faults` says of the causes.
    pub(super) fn take_causes(&mut self, line: &str) {
        let all = line.split_once(", all ").map_or("", |(_, rest)| rest);
        let all = all.split_once(',').map_or(all, |(all, _)| all);
        let has = |code: &str| all.split(' ').any(|word| word == code);
        self.model.causes = [has("30"), has("31")];
        self.causes_unsure = false;
    }

    /// What an experiment says by itself; whether it is that.
    pub(super) fn reports(&mut self, line: &str) -> bool {
        let starts = |all: &[&str]| all.iter().any(|start| line.starts_with(start));
        let (over, goes_on): (&[&str], &[&str]) = match self.model.activity {
            Activity::Idle => return false,
            Activity::Hit => {
                (&["ok hit stable,", "ok hit unstable,", "ok hit no contact,", "error: hit: "], &[])
            }
            Activity::Walk => {
                (&["ok walk over, ", "error: walk: "], &["walk hit ", "walk boundary "])
            }
            Activity::Calibration => (&["ok calibrate over: "], &["calibrate holds "]),
            Activity::Pulses => (&["ok pulses over", "error: pulses: "], &[]),
        };
        if starts(over) {
            self.calm();
        }
        starts(over) || starts(goes_on)
    }

    /// A fault has to come, if force is on.
    pub(super) fn must(&mut self, code: u8) {
        let sure = self.asked.is_empty() && self.sees() && self.due.is_none();
        let on = self.view.on || code == 10;
        if sure && on && self.view.fault == 0 && self.answered_at + UNSURE < self.now {
            self.due = Some((code, self.now + UNSURE));
        }
    }

    pub(super) fn restart(&mut self) {
        self.view = View::default();
        self.before = View::default();
        self.asked.clear();
        (self.waited, self.saving) = (0, false);
        self.begun.clear();
        self.told = None;
        self.sequence = None;
        self.replayed = None;
        self.jumped_at = None;
        self.due = None;
        self.calm_at = 0;
        self.zero_lost_until = 0;
        self.loses_zero = false;
        self.allowed = Default::default();
        self.push = Push::default();
        self.arming = 0;
    }

    /// A record out of the black box.
    pub(super) fn replay(&mut self, frame: &Frame) -> Result<(), End> {
        match &mut self.replayed {
            Some(count) => *count += 1,
            None => return differs(format!("the black box of sample {} unasked", frame.sample)),
        }
        Ok(())
    }

    pub(super) fn replay_ended(&mut self) -> Result<(), End> {
        match self.replayed {
            // The frame of the very report that answered it.
            Some(0) | None => Ok(()),
            Some(count) => {
                self.replayed = None;
                self.blind = true;
                if count > BLACK_BOX + 20 {
                    differs(format!("the black box has {count} records"))
                } else {
                    Ok(())
                }
            }
        }
    }

    /// What may change from output to output.
    pub(super) fn transition(&mut self, old: &View, new: &View) -> Result<(), End> {
        let at = new.sample;
        if let Some(boots) = self.boots.take() {
            if !boots.contains(&new.fault) {
                return differs(format!(
                    "after the reset fault {}, should be one of {boots:?}",
                    new.fault
                ));
            }
            if new.fault != 0 && self.causes_unsure {
                self.model.causes = [new.fault == 30, new.fault == 31];
            }
            let forced = new.force != 0 || new.armed;
            if new.on || forced || new.zeroed || new.unlocked || new.fault == 0 && at > 100 {
                return differs(format!("it starts with {new:?}"));
            }
            return Ok(());
        }
        let gap = at != old.sample + 10;
        if at <= old.sample {
            return differs(format!("sample {at} after {}", old.sample));
        }
        if gap && self.sees() && !self.blind && !self.saving {
            return differs(format!(
                "an output is missing between samples {} and {at}",
                old.sample
            ));
        }
        self.blind = false;
        // between two outputs it may have been faster than either frame says
        let step = self.twin.take_longest_step().saturating_mul(1 << 16);
        self.fastest = new.velocity.unsigned_abs().max(step).max(self.fastest / 2);
        let moved = new.position.abs_diff(old.position);
        if !gap && moved > FAR && !self.allowed.zero {
            self.fastest = u32::MAX;
        }
        if new.on && !self.allowed.arm && !old.on {
            return differs(format!("on at sample {at} without arm"));
        }
        if new.on && !new.stop_closed {
            return differs(format!("on at sample {at} with the stop open"));
        }
        if new.on && new.fault != 0 || new.armed && !new.on {
            return differs(format!(
                "on, armed, fault: {}, {}, {} at sample {at}",
                new.on, new.armed, new.fault
            ));
        }
        if new.unlocked && !old.unlocked && !self.allowed.unlock {
            return differs(format!("the envelope is unlocked at sample {at} without unlock"));
        }
        if new.unlocked && new.fault != 0 {
            return differs(format!("the envelope is unlocked at sample {at} with a fault"));
        }
        if new.zeroed && !old.zeroed && !self.allowed.zero {
            return differs(format!("zeroed at sample {at} without zero"));
        }
        let jumped = self.jumped_at.is_some_and(|at| self.now < at + UNSURE);
        if old.zeroed
            && !new.zeroed
            && !self.allowed.turn
            && !jumped
            && (old.fault == new.fault || !matches!(new.fault, 10..=14))
        {
            return differs(format!("the zero is lost at sample {at}"));
        }
        if std::mem::take(&mut self.loses_zero) && new.zeroed && !self.allowed.zero {
            return differs(format!("the zero outlives a jump at sample {at}"));
        }
        if old.on && !new.on && new.fault == 0 && !self.allowed.disarm {
            return differs(format!("off at sample {at} without a fault"));
        }
        self.arming = if new.on && !new.armed { self.arming + 1 } else { 0 };
        if new.armed && !old.armed && old.on && !gap && self.armed_after < 290 {
            return differs(format!(
                "armed at sample {at}, {} outputs after arm",
                self.armed_after
            ));
        }
        self.armed_after = self.arming;
        if old.fault != new.fault && new.fault != 0 {
            self.counts.faults += 1;
            self.latched(old, new)?;
        } else if old.fault != 0 && new.fault == 0 && !gap {
            return differs(format!("the fault is gone at sample {at} without clear"));
        }
        if let Some((code, until)) = self.due
            && self.now > until
        {
            return differs(format!("fault {} should have come by sample {at}", fault_text(code)));
        }
        let Settings { k, b, .. } = self.model.settings;
        let acts = k != 0.0 || b != 0.0 || self.model.activity == Activity::Walk;
        self.push.step(new, gap, acts);
        self.allowed = Default::default();
        Ok(())
    }

    /// A fault has come: is it one that could?
    fn latched(&mut self, old: &View, new: &View) -> Result<(), End> {
        let of_late = |at: u64, bad: bool| bad || self.now < at + 2 * UNSURE;
        let stop = of_late(self.stop_at, self.stop_open) && self.stop_at > 0;
        let supply = of_late(self.supply_at, self.supply_mv <= LOW_MV) && self.supply_at > 0;
        let [low, high] = TRAVEL;
        let jumped = self.jumped_at.is_some_and(|at| self.now < at + UNSURE);
        let possible = match new.fault {
            10 => jumped,
            11 => self.fastest > FAST,
            13 => self.push.moves_too_little(),
            14 => (90..=115).contains(&self.armed_after) || self.armed_after == 0 && old.on,
            15 => new.position < low + 1000 || new.position > high - 1000,
            30 => stop,
            31 => supply,
            _ => false,
        };
        if !possible {
            let fault = fault_text(new.fault);
            return differs(format!(
                "fault {fault} at sample {} without a cause, {old:?}, {new:?}",
                new.sample
            ));
        }
        if matches!(new.fault, 10 | 12..=14) && new.zeroed {
            return differs(format!(
                "the zero outlives fault {} at sample {}",
                new.fault, new.sample
            ));
        }
        if let Some((code, _)) = self.due.take() {
            // The first edges of a jump may be too fast in a sample of their own; the jump is then among the causes.
            self.loses_zero = (code, new.fault) == (10, 11);
            if new.fault > code && !self.loses_zero {
                let [said, right] = [new.fault, code].map(fault_text);
                return differs(format!(
                    "fault {said} at sample {}, should be {right}",
                    new.sample
                ));
            }
        }
        self.model.causes = [new.fault == 30, new.fault == 31];
        self.causes_unsure = (stop && new.fault != 30) || (supply && new.fault != 31);
        Ok(())
    }
}
