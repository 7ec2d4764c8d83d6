//! What the board has to answer: the console's page as a model. The state that the world decides (has the handle
//! passed the sign test, is it in the wall) is taken from the telemetry, which is checked on its own.

use zwidth::device::Device;

use crate::{board::Board, device};

use super::{
    answer::{Activity, Answer, Effect, View, fault_text},
    command::{self, Command},
    envelope::Envelope,
    settings::{GRID, OutOfRange, Settings},
};

const CONTACT: &str = "in contact: leave the wall first";
const ARMING: &str = "arming: wait for the ramp to end";
const BUSY: &str = "an experiment is running: stop first";
const ON: &str = "the force is on: disarm first";
const NOT_ARMED: &str = "not armed: arm first and wait for the ramp";

/// What the model of a board knows.
#[derive(Clone, Debug)]
pub struct Model {
    pub board: Board,
    pub envelope: Envelope,
    pub settings: Settings,
    pub saved: Option<Settings>,
    pub activity: Activity,
    pub streaming: bool,
    /// The causes of the latched fault that the world can take away: stop and supply.
    pub causes: [bool; 2],
}

impl Model {
    /// A board with nothing in its flash.
    pub fn new(board: Board) -> Self {
        Self {
            board,
            envelope: Envelope::of(board),
            settings: Settings::defaults(),
            saved: None,
            activity: Activity::Idle,
            streaming: true,
            causes: [false; 2],
        }
    }

    /// The lines that a board says by itself after a reset.
    pub fn greeting(&self) -> [String; 2] {
        [self.version(), self.loaded()]
    }

    fn version(&self) -> String {
        let Device { scene_hash, envelope, .. } = device::built_in(self.board);
        let (name, version) = (self.board.name, env!("CARGO_PKG_VERSION"));
        let hash = envelope.hash();
        format!(
            "ok version {version}, commit COMMIT, board {name}, scene {name} {scene_hash:08x}, envelope {hash:08x}, \
             layouts record 4, settings 4, telemetry 2"
        )
    }

    fn loaded(&self) -> String {
        let source = if self.saved.is_some() {
            "newest settings"
        } else {
            "defaults: nothing was saved yet"
        };
        format!("ok load: {source}")
    }

    /// The board starts anew.
    pub fn reset(&mut self) {
        self.settings = self.saved.clone().unwrap_or_else(Settings::defaults);
        self.activity = Activity::Idle;
        self.streaming = true;
    }

    /// The answer to one line, by a console that has seen `seen` and an output task that has come to `newest`.
    pub fn answer(&self, line: &[u8], seen: &View, newest: &View) -> Answer {
        match command::parse(line) {
            Err(error) => Answer::refused(&error),
            Ok(command) => match self.in_the_way(&command, seen) {
                Some(why) => self.refuse(&why),
                None => self.met(&command, seen, newest),
            },
        }
    }

    /// A refusal; of a wall outside the envelope it says what is allowed.
    fn refuse(&self, why: &str) -> Answer {
        let outside = self.settings.inside(&self.envelope).err();
        match outside.filter(|_| why.starts_with("settings are not valid")) {
            Some(text) => Answer::said(text),
            None => Answer::refused(why),
        }
    }

    /// The column "refused" of the console's page, in the order in which it is looked at.
    fn in_the_way(&self, command: &Command, view: &View) -> Option<String> {
        let arming = (view.on && !view.armed).then_some(ARMING);
        let contact = (view.on && view.contact).then_some(CONTACT);
        let on = view.on.then_some(ON);
        let busy = (self.activity != Activity::Idle).then_some(BUSY);
        let walk = matches!(self.activity, Activity::Walk | Activity::Pulses).then_some(BUSY);
        let other =
            (!matches!(self.activity, Activity::Idle | Activity::Calibration)).then_some(BUSY);
        let not_armed = (!view.armed).then_some(NOT_ARMED);
        let supply = (!view.supply_good).then_some("the supply is too low");
        let faulted = (view.fault != 0).then(|| {
            format!("a fault is latched: see faults, then clear, fault {}", fault_text(view.fault))
        });
        let fixed = match command.name {
            "arm" => return self.may_not_arm(view),
            "clear" => return self.may_not_clear(view),
            "unlock" => return faulted,
            "hit" | "pulses" => return faulted.or(not_armed.or(busy).map(Into::into)),
            "calibrate" => return faulted.or(not_armed.or(other).or(contact).map(Into::into)),
            "walk" => {
                let locked =
                    (!view.unlocked).then_some("the envelope is locked: unlock envelope first");
                return faulted.or(not_armed.or(busy).or(locked).map(Into::into));
            }
            "zero" => arming.or(busy).or(contact),
            "k" | "b" | "push" => walk,
            name if GRID.iter().any(|(known, _)| *known == name) => walk,
            "start" | "settle" | "window" | "rms" => busy,
            "motor" | "encoder" | "fullscale" | "design" | "period" => on,
            "wall" | "cutoff" | "tuning" | "tuning2" | "estimator" | "load" => {
                arming.or(walk).or(contact)
            }
            "save" => on.or(supply),
            _ => None,
        };
        fixed.map(Into::into)
    }

    fn may_not_arm(&self, view: &View) -> Option<String> {
        let why = if view.fault != 0 {
            return Some(format!(
                "a fault is latched: see faults, then clear, fault {}",
                fault_text(view.fault)
            ));
        } else if view.on {
            ON
        } else if !view.stop_closed {
            "the emergency stop is open: close it first"
        } else if !view.supply_good {
            "the supply is too low"
        } else if !view.valid {
            "settings are not valid or outside the envelope: see get"
        } else if !view.zeroed {
            "not zeroed: use zero first"
        } else if view.contact {
            CONTACT
        } else {
            return None;
        };
        Some(why.into())
    }

    fn may_not_clear(&self, view: &View) -> Option<String> {
        if view.fault == 0 {
            return Some("there is no fault".into());
        }
        let [stop, supply] = self.causes;
        let present = [(30, stop && !view.stop_closed), (31, supply && !view.supply_good)];
        let (code, _) = present.into_iter().find(|(_, there)| *there)?;
        Some(format!("the cause of the fault is still there, fault {}", fault_text(code)))
    }

    /// A command that nothing is in the way of.
    fn met(&self, command: &Command, seen: &View, newest: &View) -> Answer {
        let mut new = self.settings.clone();
        let number = command.number;
        let outcome = match command.name {
            "help" => return Answer::said(command::help()),
            "version" => return Answer::said(self.version()),
            "status" => return Answer::said(self.status(seen)),
            "get" => return Answer::said(self.settings.text(self.board.name)),
            // The boards' own scenes have none.
            "designs" => return Answer::said("ok designs none"),
            "design" => return Answer::refused("unknown design, allowed none"),
            "faults" if seen.fault == 0 => return Answer::said("ok faults none"),
            "faults" => {
                let text = format!("ok faults {}", fault_text(seen.fault));
                return Answer { effect: Effect::Replay, ..Answer::said(text) };
            }
            "stream" => {
                let answer = Answer::ok(
                    format!("stream {}", command.word),
                    Effect::Stream(command.word == "on"),
                );
                return answer.now();
            }
            "zero" => return self.zero(newest),
            "arm" => match self.may_not_arm(newest) {
                Some(why) => return self.refuse(&why),
                None => ("arm".into(), Effect::Arm),
            },
            "disarm" => ("disarm".into(), Effect::Disarm),
            "clear" => match self.may_not_clear(newest) {
                Some(why) => return self.refuse(&why),
                None => ("clear".into(), Effect::Clear),
            },
            "unlock" => ("unlock envelope".into(), Effect::Unlock),
            "stop" => ("stop".into(), Effect::Stop),
            "save" => ("save".into(), Effect::Save),
            "hit" => match self.settings.hit_range() {
                Err(error) => return Answer::of_range(&error),
                Ok(()) => ("hit".into(), Effect::Begin(Activity::Hit)),
            },
            "pulses" => match self.settings.pulses_range(number) {
                Err(error) => return Answer::of_range(&error),
                Ok(()) => ("pulses".into(), Effect::Begin(Activity::Pulses)),
            },
            "walk" => match self.settings.grid_range().and_then(|()| self.settings.hit_range()) {
                Err(error) => return Answer::of_range(&error),
                Ok(()) => return Answer::ok("walk", Effect::Begin(Activity::Walk)).now(),
            },
            "calibrate" if number.abs() <= 30.0 => {
                ("calibrate".into(), Effect::Begin(Activity::Calibration))
            }
            "calibrate" => {
                let allowed = [-30.0, 30.0];
                return Answer::of_range(&OutOfRange { name: "calibrate", value: number, allowed });
            }
            "alive" if number == 0.0 => ("alive".into(), Effect::None),
            "alive" => {
                let allowed = [20.0, 10_000.0];
                return Answer::of_range(&OutOfRange { name: "alive", value: number, allowed });
            }
            "motor" | "encoder" => {
                let reversed = command.word == "-";
                let place = if command.name == "motor" {
                    &mut new.motor_reversed
                } else {
                    &mut new.encoder_reversed
                };
                *place = reversed;
                (format!("{} {}", command.name, command.word), Effect::Signs(new))
            }
            "load" => return self.load(seen, newest),
            "fullscale" => {
                new.full_scale_n = number;
                if let Err(error) = new.experiment_range() {
                    return Answer::of_range(&error);
                }
                return self.change(new, format!("fullscale {number} N"), seen, newest);
            }
            // Another one than that is not asked for: the calculation beside the board has outputs at 1 kHz.
            "period" if number == 10.0 => {
                if let Err(error) = new.experiment_range() {
                    return Answer::of_range(&error);
                }
                return self.change(new, "period 10 samples".into(), seen, newest);
            }
            "period" => {
                return Answer::refused(&format!("period is {number}, allowed 1 2 5 10"));
            }
            "k" => {
                new.k = number;
                return self.change(new, format!("k {number} N/m"), seen, newest);
            }
            "b" => {
                new.b = number;
                return self.change(new, format!("b {number} N s/m"), seen, newest);
            }
            "wall" => {
                new.wall_m = number;
                return self.change(new, format!("wall {number} m"), seen, newest);
            }
            "tuning2" => return Answer::refused("this estimator has no second parameter, see get"),
            "cutoff" | "tuning" if !new.is_tuned() => {
                return Answer::refused("this estimator has nothing to tune");
            }
            "cutoff" | "tuning" => {
                new.cutoff_hz = number;
                return self.change(new, format!("cutoff {number} Hz"), seen, newest);
            }
            "estimator" => {
                new.take_estimator(Settings::estimator_named(&command.word).unwrap_or_default());
                let text = format!("estimator {}", new.estimator());
                return self.change(new, text, seen, newest);
            }
            name => return self.keep(new, name, number),
        };
        Answer::ok(outcome.0, outcome.1)
    }

    fn zero(&self, newest: &View) -> Answer {
        if newest.on && !newest.armed {
            return Answer::refused(ARMING);
        }
        if newest.on && newest.contact {
            return Answer::refused(CONTACT);
        }
        if newest.on && (self.settings.wall_m / 1e-6).round() < 0.0 {
            return Answer::refused("the wall reaches over 0: move it or disarm first");
        }
        Answer::ok("zero", Effect::Zero)
    }

    /// New settings of the loop: refused out of range, outside the envelope while that holds, and where they would
    /// move the wall or the velocity in contact.
    fn change(&self, new: Settings, text: String, seen: &View, newest: &View) -> Answer {
        let answer = Answer::ok(text, Effect::Loop(new.clone()));
        self.proposed(&new, seen, newest).unwrap_or(answer)
    }

    /// Why settings of the loop are not taken.
    fn proposed(&self, new: &Settings, seen: &View, newest: &View) -> Option<Answer> {
        if let Err(error) = new.loop_range() {
            return Some(Answer::of_range(&error));
        }
        if let Err(text) = new.inside(&self.envelope)
            && seen.on
            && !seen.unlocked
        {
            return Some(Answer::said(text));
        }
        let old = &self.settings;
        let surface = |settings: &Settings| (settings.wall_m / 1e-6).round();
        let moved = surface(old) != surface(new);
        let [old, made] =
            [old, new].map(|settings| settings.parameters(self.board).map(|made| made.estimator));
        let inside = moved && f64::from(newest.position) > surface(new);
        let careful = moved || old != made;
        (careful && newest.on && (newest.contact || inside)).then(|| Answer::refused(CONTACT))
    }

    fn load(&self, seen: &View, newest: &View) -> Answer {
        let new = self.saved.clone().unwrap_or_else(Settings::defaults);
        let old = &self.settings;
        let turned = (new.motor_reversed, new.encoder_reversed)
            != (old.motor_reversed, old.encoder_reversed);
        if (turned || new.full_scale_n != old.full_scale_n) && seen.on {
            return Answer::refused(ON);
        }
        let text = self.loaded();
        let answer = Answer { text, effect: Effect::Load(new.clone()), ordered: true };
        self.proposed(&new, seen, newest).unwrap_or(answer)
    }

    /// A setting that only the next experiment looks at.
    fn keep(&self, mut new: Settings, name: &str, number: f64) -> Answer {
        let (place, unit) = match name {
            "push" => (&mut new.push_n, "N"),
            "start" => (&mut new.start_m, "m"),
            "settle" => (&mut new.settle_s, "s"),
            "window" => (&mut new.window_s, "s"),
            "rms" => (&mut new.rms_m, "m"),
            _ => {
                let place = GRID.iter().position(|(known, _)| *known == name).unwrap_or_default();
                (&mut new.grid[place], GRID[place].1)
            }
        };
        *place = number;
        match new.experiment_range().and_then(|()| new.grid_range()) {
            Err(error) => Answer::of_range(&error),
            Ok(()) => Answer::ok(format!("{name} {number} {unit}"), Effect::Keep(new)).now(),
        }
    }

    fn status(&self, view: &View) -> String {
        let state = match (view.fault, view.on, view.armed) {
            (0, false, _) => "off",
            (0, true, true) => "armed",
            (0, true, false) => "arming",
            _ => "fault",
        };
        let activity = match self.activity {
            Activity::Idle => "idle",
            Activity::Hit => "hit",
            Activity::Walk => "walk",
            Activity::Calibration => "calibration",
            Activity::Pulses => "pulses",
        };
        let mut text = format!(
            "ok status {state}, fault {}, {activity}, sample {}, position {} counts, velocity {} counts/sample, \
             force {} %, code {}",
            fault_text(view.fault),
            view.sample,
            view.position,
            f64::from(view.velocity) / 65_536.0,
            f64::from(view.force) / 2f64.powi(30) * 100.0,
            view.code,
        );
        for (fact, yes, no) in [
            (view.zeroed, "zeroed", "not zeroed"),
            (view.contact, "in contact", "free"),
            (view.stop_closed, "stop closed", "stop open"),
            (view.supply_good, "supply good", "supply low"),
            (view.valid, "settings valid", "settings refused"),
            (view.unlocked, "envelope unlocked", "envelope locked"),
        ] {
            text += ", ";
            text += if fact { yes } else { no };
        }
        text
    }
}
