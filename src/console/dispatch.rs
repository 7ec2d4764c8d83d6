//! The actions of the commands.

use super::{
    Command, Port, Reply, Situation, allowed, is_off,
    session::{Awaited, ChangedSetting, Console, SelfTestStep},
};
use crate::{
    Settings,
    device::Unfit,
    experiment::{Order, Promise},
    period::PERIODS,
    safety::{Request, State},
    store::{Loaded, Source, Stored},
    velocity::Parameter,
};

impl<P: Port> Console<P> {
    pub(super) fn obey(&mut self, command: Command) {
        let Some((situation, record)) = self.situation() else { return };
        if let Err(refusal) = allowed(&command, &situation) {
            return self.refuse(refusal);
        }
        let mut stored = *self.stored;
        match command {
            Command::Help => self.reply(Reply::Help),
            Command::Version => self.version(),
            Command::Status => self.reply(Reply::Status(&situation, &record)),
            Command::Get => self.reply(Reply::Settings(&stored, &self.device.designs)),
            Command::Designs => self.reply(Reply::Designs(&self.device.designs)),
            Command::Faults => {
                self.reply(Reply::Faults(&situation));
                if situation.status.state == State::Fault {
                    self.order(Order::Replay, Awaited::Quiet);
                }
            }
            Command::Zero => self.request(Request::Zero, "zero"),
            Command::Arm => self.request(Request::Arm, "arm"),
            Command::Disarm => self.request(Request::Disarm, "disarm"),
            Command::Clear => self.request(Request::Clear, "clear"),
            Command::UnlockEnvelope => self.request(Request::Unlock, "unlock envelope"),
            Command::Stiffness(k) => {
                self.change(("k", k, "N/m"), |settings| settings.wall.stiffness_n_per_m = k);
            }
            Command::Damping(b) => {
                self.change(("b", b, "N s/m"), |settings| settings.wall.damping_n_s_per_m = b);
            }
            Command::Wall(place_m) => {
                self.change(("wall", place_m, "m"), |settings| settings.wall.position_m = place_m);
            }
            Command::Cutoff(cutoff_hz) => self.tune(cutoff_hz, Parameter::is_frequency),
            Command::Tuning(value) => self.tune(value, |_| true),
            Command::Further(place, value) => match stored.settings.velocity.parameter(place) {
                Some((parameter, _)) => {
                    self.change((parameter.name, value, parameter.unit), |settings| {
                        settings.velocity = settings.velocity.with_parameter(place, value);
                    });
                }
                None => self.write(&"error: this estimator has fewer parameters, see get"),
            },
            Command::Estimator(name) => {
                stored.settings.velocity = name.following(&stored.settings.velocity);
                self.propose(stored, ChangedSetting::Estimator(name));
            }
            Command::Design(name) => match self.device.designs.named(&name) {
                Some(design) => {
                    stored.settings.velocity = design.velocity;
                    self.propose(stored, ChangedSetting::Design(name));
                }
                None => self.reply(Reply::UnknownDesign(&self.device.designs)),
            },
            Command::Period(samples) => {
                match PERIODS.iter().find(|&&period| f64::from(period) == samples) {
                    Some(&period) => {
                        stored.period = period;
                        self.adapt(stored, ("period", samples, "samples"));
                    }
                    None => self.reply(Reply::Unfit(Unfit::Period(samples))),
                }
            }
            Command::Push(push_n) => {
                stored.push_n = push_n;
                self.keep(stored, ("push", push_n, "N"));
            }
            Command::Start(start_m) => {
                stored.start_m = start_m;
                self.keep(stored, ("start", start_m, "m"));
            }
            Command::Settle(settle_s) => {
                stored.settle_s = settle_s;
                self.keep(stored, ("settle", settle_s, "s"));
            }
            Command::Window(window_s) => {
                stored.window_s = window_s;
                self.keep(stored, ("window", window_s, "s"));
            }
            Command::RmsLimit(rms_limit_m) => {
                stored.rms_limit_m = rms_limit_m;
                self.keep(stored, ("rms", rms_limit_m, "m"));
            }
            Command::Criterion(criterion) => {
                stored.criterion = criterion;
                self.keep_as(stored, Reply::Word("criterion", criterion.name()));
            }
            Command::ForceRmsLimit(limit_n) => {
                stored.force_rms_limit_n = (limit_n != 0.0).then_some(limit_n);
                self.keep(stored, ("force_rms", limit_n, "N"));
            }
            Command::Grid(value, number) => {
                *value.of(&mut stored.grid) = number;
                self.keep(stored, (value.text(), number, value.unit()));
            }
            Command::FullScale(full_scale_n) => {
                stored.full_scale_n = full_scale_n;
                self.adapt(stored, ("fullscale", full_scale_n, "N"));
            }
            // The change is in force at once, and the zero is lost.
            Command::MotorReversed(reversed) => {
                stored.signs.motor_reversed = reversed;
                let changed = ChangedSetting::Signs("motor", reversed);
                self.order(Order::Signs(stored.signs), Awaited::Settings(stored, changed));
            }
            Command::EncoderReversed(reversed) => {
                stored.signs.encoder_reversed = reversed;
                let changed = ChangedSetting::Signs("encoder", reversed);
                self.order(Order::Signs(stored.signs), Awaited::Settings(stored, changed));
            }
            Command::Hit => self.begin_hit(),
            Command::Pulses(push_n) => match self.device.pulse_train(&stored, push_n) {
                Ok(plan) => self.order(Order::Pulses(plan), Awaited::Done("pulses")),
                Err(error) => self.reply(Reply::Range(&error)),
            },
            Command::Walk => self.begin_walk(),
            Command::Calibrate(percent) => match self.device.calibration(&stored, percent) {
                Ok(plan) => self.order(Order::Calibrate(plan), Awaited::Done("calibrate")),
                Err(error) => self.reply(Reply::Range(&error)),
            },
            Command::Stop => self.order(Order::Stop, Awaited::Stop),
            Command::Stream(on) => {
                self.stream.on = on;
                self.reply(Reply::Word("stream", if on { "on" } else { "off" }));
            }
            Command::Alive(ms) => match Promise::of(ms) {
                Ok(promise) => self.order(Order::Alive(promise), Awaited::Done("alive")),
                Err(error) => self.reply(Reply::Range(&error)),
            },
            Command::Save => self.order(Order::Request(Request::Stall(true)), Awaited::Save),
            // The zero is lost, because other wires move the counter.
            Command::SelfTest => {
                self.order(Order::Request(Request::Turn), Awaited::SelfTest(SelfTestStep::BEGIN));
            }
            Command::Load => self.load(&situation),
        }
    }

    /// Loads the settings from flash. Signs, full scale, design and period are changed only with the force off.
    #[inline(never)] // the two records and their readers would need stack in every command
    fn load(&mut self, situation: &Situation) {
        let Loaded { stored, source, .. } = self.port.load(self.device.defaults());
        if source == Source::Unusable {
            return self
                .write(&"error: load: a number that was saved is none, so nothing is loaded");
        }
        let old = &*self.stored;
        let design = |of: &Stored| self.device.designs.number_of(&of.settings.velocity);
        let needs_off = stored.signs != old.signs
            || stored.full_scale_n != old.full_scale_n
            || stored.period != old.period
            || design(&stored) != design(old);
        match is_off(situation) {
            Err(refusal) if needs_off => self.reply(Reply::Refused(refusal)),
            _ => self.propose(stored, ChangedSetting::Loaded(source)),
        }
    }

    /// Sends a request to the supervisor. The reply is `name`.
    fn request(&mut self, request: Request, name: &'static str) {
        self.order(Order::Request(request), Awaited::Done(name));
    }

    /// Changes the estimator's tuning, if the parameter passes `fits`.
    fn tune(&mut self, value: f64, fits: fn(&Parameter) -> bool) {
        match self.stored.settings.velocity.tuning() {
            Some((parameter, _)) if parameter.is_whole() && libm::trunc(value) != value => {
                self.write(&format_args!("error: {} is a whole number", parameter.name));
            }
            Some((parameter, _)) if fits(&parameter) => {
                self.change((parameter.name, value, parameter.unit), |settings| {
                    settings.velocity = settings.velocity.with_tuning(value);
                });
            }
            Some(_) => self.write(&"error: this estimator has no cutoff: set its tuning, see get"),
            None => self.write(&"error: this estimator has nothing to tune"),
        }
    }

    /// Changes a setting that both the loop and the experiments use.
    fn adapt(&mut self, stored: Stored, (name, value, unit): (&'static str, f64, &'static str)) {
        match self.device.experiment(&stored) {
            Ok(_) => self.propose(stored, ChangedSetting::Value(name, value, unit)),
            Err(error) => self.reply(Reply::Range(&error)),
        }
    }

    /// Changes a setting that only the next experiment uses.
    fn keep(&mut self, stored: Stored, (name, value, unit): (&'static str, f64, &'static str)) {
        self.keep_as(stored, Reply::Value(name, value, unit));
    }

    fn keep_as(&mut self, stored: Stored, reply: Reply<'_>) {
        // The settings are stored twice. Without this check, an edit would copy a flipped bit into both copies.
        if !self.is_whole() {
            return self.lose();
        }
        let checked = self.device.experiment(&stored);
        match checked.and_then(|_| stored.grid.check()) {
            Ok(()) => {
                self.stored.set(stored);
                self.reply(reply);
            }
            Err(error) => self.reply(Reply::Range(&error)),
        }
    }

    /// Changes a setting of the loop.
    fn change(
        &mut self,
        (name, value, unit): (&'static str, f64, &'static str),
        edit: impl FnOnce(&mut Settings),
    ) {
        let mut stored = *self.stored;
        edit(&mut stored.settings);
        self.propose(stored, ChangedSetting::Value(name, value, unit));
    }

    /// Builds the settings, and orders them from the task `render`. The console stores them when `render` has accepted
    /// them.
    pub(super) fn propose(&mut self, stored: Stored, changed: ChangedSetting) {
        let device = self.device;
        if let Some(unfit) = device.unfit(&stored) {
            return self.reply(Reply::Unfit(unfit));
        }
        match (device.order(&stored), device.inside(&stored)) {
            (Ok(_), Err(outside)) if self.is_locked() => {
                self.reply(Reply::Outside(outside, device, device.key(&stored)));
            }
            (Ok(_), _) if stored.period != self.stored.period => match device.period(&stored) {
                Ok(plan) => self.order(Order::Period(plan), Awaited::Period(stored, changed)),
                Err(error) => self.reply(Reply::Range(&error)),
            },
            (Ok(order), _) => {
                self.order_settings(&stored, order, Awaited::Settings(stored, changed))
            }
            (Err(error), _) => self.reply(Reply::Range(&error)),
        }
    }

    /// The second step of a change of the output period. In the first step `render` has accepted the settings that are
    /// counted in outputs. So now the parameters of the loop are ordered.
    #[inline(never)] // it is not needed below `answer`
    pub(super) fn propose_next(&mut self, stored: Stored, changed: ChangedSetting) {
        if let Ok(order) = self.device.order(&stored) {
            self.order_settings(&stored, order, Awaited::Settings(stored, changed));
        }
    }

    /// Whether a wall outside the envelope is refused. This is so while the force is on and the envelope is locked.
    /// With the force off such a wall is accepted, but then `arm` is refused.
    fn is_locked(&self) -> bool {
        self.latest.is_some_and(|(now, _)| now.status.state.is_on() && !now.status.unlocked)
    }
}
