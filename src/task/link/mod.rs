//! `link`: pended by `render`, priority 1. The probe link: commands in, replies and telemetry out.
//!
//! One command at a time: what `render` has to decide is asked of it, and the reply waits for its
//! answer, which comes with the next output.

mod lines;
mod reply_channel;
mod walk;

use core::{fmt, sync::atomic::Ordering::Relaxed};

use heapless::spsc::{Consumer, Producer};
use zwidth::{
    Settings, SettingsError,
    console::{
        Activity, Command, LINE_MAX, Line, LineReader, ParseError, Reply, Situation, allowed,
        parse, signs_allowed,
    },
    experiment::{CalibrationEnd, WalkTotals},
    safety::{Refusal, Request, State},
    store::{self, SaveError, Source, Stored},
    telemetry::{Frame, Record},
    velocity::{EstimatorName, Parameter},
};

use self::{
    lines::{CalibrationHolds, CalibrationOver, HitOver},
    reply_channel::ReplyChannel,
    walk::Walking,
};
use super::{
    FLAGS, ORDERS, REPORTS, device,
    envelope::{self, ENVELOPE},
    order::{Event, Order, Report},
};
use crate::board::{self, Commands, FlashError, SettingsFlash, UpLink, Watchdog};

/// Bytes that one pass takes at most: the whole channel.
const BYTES_A_PASS: usize = 256;

/// What the answer of `render` is awaited for.
#[derive(Clone, Copy)]
enum Awaited {
    /// A command whose reply is its name.
    Done(&'static str),
    /// New settings: what to keep and how to reply.
    Settings(Stored, Change),
    /// The end of what was going on.
    Stop,
    /// Leave to write flash.
    Save,
    /// Flash is written; the reply is out.
    Resume,
    /// The wall of a walk's next cell.
    Cell,
    /// The hit at it.
    CellHit,
    /// Nothing is replied.
    Quiet,
}

/// Which setting a command changed.
#[derive(Clone, Copy)]
enum Change {
    Value(&'static str, f64, &'static str),
    Estimator(EstimatorName),
    Signs(&'static str, bool),
    Loaded(Source),
}

/// The link task. It alone talks to the host, but for the logger.
pub struct Link {
    replies: ReplyChannel,
    telemetry: UpLink,
    commands: Commands,
    flash: SettingsFlash,
    reports: Consumer<'static, Report, REPORTS>,
    orders: Producer<'static, Order, ORDERS>,
    reader: LineReader<LINE_MAX>,
    stored: Stored,
    awaited: Option<Awaited>,
    latest: Option<Report>,
    walking: Option<Walking>,
    /// What a walk had come to that ended because nobody reads; not yet said.
    unheard: Option<WalkTotals>,
    /// Another wall than the stored one is in force: a walk has just ended.
    strayed: bool,
    streaming: bool,
    sequence: u32,
    passes: u32,
}

impl Link {
    pub(super) fn new(
        link: board::Link,
        flash: SettingsFlash,
        reports: Consumer<'static, Report, REPORTS>,
        orders: Producer<'static, Order, ORDERS>,
        stored: Stored,
        source: Source,
    ) -> Self {
        let mut link = Self {
            replies: ReplyChannel::new(link.replies),
            telemetry: link.telemetry,
            commands: link.commands,
            flash,
            reports,
            orders,
            reader: LineReader::new(),
            stored,
            awaited: None,
            latest: None,
            walking: None,
            unheard: None,
            strayed: false,
            streaming: true,
            sequence: 0,
            passes: 0,
        };
        link.reply(Reply::Version(env!("CARGO_PKG_VERSION"), board::NAME));
        link.reply(Reply::Loaded(source));
        // The gains of the first settings are judged like those of any others.
        link.change(stored.settings, |_| {}, Change::Loaded(source));
        link.awaited = link.awaited.map(|_| Awaited::Quiet);
        link
    }

    /// Passes on what has come since. Late: `render` drops reports, counted by gaps in telemetry.
    pub fn run(&mut self) {
        while let Some(report) = self.reports.dequeue() {
            self.stream(report.streamed);
            self.latest = Some(report);
            match report.event {
                Event::None => {}
                Event::Answer(answer) => self.answer(answer),
                Event::HitOver(verdict, scatter) if self.walking.is_some() => {
                    self.judged(verdict, &scatter);
                }
                Event::HitOver(verdict, scatter) => self.write(&HitOver(verdict, scatter)),
                Event::HitAborted(broken) if self.walking.is_some() => {
                    self.break_walk(broken.text());
                }
                Event::HitAborted(broken) => {
                    self.write(&format_args!("error: hit: {}", broken.text()));
                }
                Event::CalibrationHolds => {
                    let full_scale_n = self.stored.full_scale_n;
                    self.write(&CalibrationHolds(report.record, full_scale_n));
                }
                Event::CalibrationOver(end) => self.calibrated(end, report.record),
            }
        }
        if self.awaited.is_none() && self.latest.is_some() && !self.pursue() {
            self.listen();
        }
        self.passes = self.passes.wrapping_add(1);
        FLAGS.links.store(self.passes, Relaxed);
    }

    /// Reads up to the end of one line and obeys it. One line a pass, so that a host that floods
    /// cannot keep this task from its end, and the watchdog from being fed.
    fn listen(&mut self) {
        let mute = self.replies.is_mute();
        for _ in 0..BYTES_A_PASS {
            let mut byte = [0];
            if self.commands.read(&mut byte) == 0 {
                return;
            }
            let line = match self.reader.push(byte[0]) {
                None => continue,
                Some(Line::TooLong) => Err(ParseError::TooLong),
                Some(Line::Text(text)) => parse(text),
            };
            return match line {
                Ok(command @ (Command::Stop | Command::Disarm)) => self.obey(command),
                Ok(_) | Err(_) if mute => self.replies.ignore(),
                Ok(command) => self.obey(command),
                Err(error) => self.reply(Reply::Parse(error)),
            };
        }
    }

    /// A frame of telemetry, if it is on; a full channel drops it, and its number with it.
    fn stream(&mut self, record: Record) {
        if !self.streaming {
            return;
        }
        let frame = Frame { sequence: self.sequence, record };
        self.sequence = self.sequence.wrapping_add(1);
        self.telemetry.write(&frame.encode());
    }

    fn write(&mut self, line: &dyn fmt::Display) {
        self.replies.say(line);
    }

    fn reply(&mut self, reply: Reply<'_>) {
        self.write(&reply);
    }

    fn situation(&self) -> Option<(Situation, Record)> {
        self.latest.map(|report| {
            let walking = self.walking.is_some();
            let activity = if walking { Activity::Walk } else { report.activity };
            let situation = Situation { status: report.status, activity };
            (situation, report.record)
        })
    }

    /// Says why not, and of a wall outside the envelope what is allowed.
    fn refuse(&mut self, refusal: Refusal) {
        let stored = self.stored;
        if refusal == Refusal::Settings
            && let Err(outside) = envelope::inside(&stored)
        {
            return self.reply(Reply::Outside(outside, &ENVELOPE, envelope::key(&stored)));
        }
        self.reply(Reply::Refused(refusal));
    }

    fn order(&mut self, order: Order, awaited: Awaited) {
        // Only one order is under way, so there is room.
        if self.orders.enqueue(order).is_ok() {
            self.awaited = Some(awaited);
        }
    }

    fn obey(&mut self, command: Command) {
        let Some((situation, record)) = self.situation() else { return };
        if let Err(refusal) = allowed(&command, &situation) {
            return self.refuse(refusal);
        }
        let request = |request| Order::Request(request);
        match command {
            Command::Help => self.reply(Reply::Help),
            Command::Version => self.reply(Reply::Version(env!("CARGO_PKG_VERSION"), board::NAME)),
            Command::Status => self.reply(Reply::Status(&situation, &record)),
            Command::Get => {
                let stored = self.stored;
                self.reply(Reply::Settings(&stored));
            }
            Command::Faults => {
                self.reply(Reply::Faults(&situation));
                if situation.status.state == State::Fault {
                    self.order(Order::Replay, Awaited::Quiet);
                }
            }
            Command::Zero => self.order(request(Request::Zero), Awaited::Done("zero")),
            Command::Arm => self.order(request(Request::Arm), Awaited::Done("arm")),
            Command::Disarm => self.order(request(Request::Disarm), Awaited::Done("disarm")),
            Command::Clear => self.order(request(Request::Clear), Awaited::Done("clear")),
            Command::UnlockEnvelope => {
                self.order(request(Request::Unlock), Awaited::Done("unlock envelope"));
            }
            Command::Stiffness(k) => self.change(
                self.stored.settings,
                |settings| settings.wall.stiffness_n_per_m = k,
                Change::Value("k", k, "N/m"),
            ),
            Command::Damping(b) => self.change(
                self.stored.settings,
                |settings| settings.wall.damping_n_s_per_m = b,
                Change::Value("b", b, "N s/m"),
            ),
            Command::Wall(position_m) => self.change(
                self.stored.settings,
                |settings| settings.wall.position_m = position_m,
                Change::Value("wall", position_m, "m"),
            ),
            Command::Cutoff(cutoff_hz) => self.tune(cutoff_hz, Parameter::is_frequency),
            Command::Tuning(value) => self.tune(value, |_| true),
            Command::Second(value) => match self.stored.settings.velocity.second() {
                Some((parameter, _)) => self.change(
                    self.stored.settings,
                    |settings| settings.velocity = settings.velocity.with_second(value),
                    Change::Value(parameter.name, value, parameter.unit),
                ),
                None => self.write(&"error: this estimator has no second parameter, see get"),
            },
            Command::Estimator(name) => self.change(
                self.stored.settings,
                |settings| settings.velocity = name.following(&settings.velocity),
                Change::Estimator(name),
            ),
            Command::Push(push_n) => {
                self.keep(Stored { push_n, ..self.stored }, Reply::Value("push", push_n, "N"));
            }
            Command::Start(start_m) => {
                self.keep(Stored { start_m, ..self.stored }, Reply::Value("start", start_m, "m"));
            }
            Command::Settle(settle_s) => {
                let stored = Stored { settle_s, ..self.stored };
                self.keep(stored, Reply::Value("settle", settle_s, "s"));
            }
            Command::Window(window_s) => {
                let stored = Stored { window_s, ..self.stored };
                self.keep(stored, Reply::Value("window", window_s, "s"));
            }
            Command::RmsLimit(rms_limit_m) => {
                let stored = Stored { rms_limit_m, ..self.stored };
                self.keep(stored, Reply::Value("rms", rms_limit_m, "m"));
            }
            Command::Grid(value, number) => {
                let mut stored = self.stored;
                *value.of(&mut stored.grid) = number;
                self.keep(stored, Reply::Value(value.text(), number, value.unit()));
            }
            Command::FullScale(full_scale_n) => {
                let stored = Stored { full_scale_n, ..self.stored };
                match device::trial(&stored, false) {
                    Ok(_) => self.propose(stored, Change::Value("fullscale", full_scale_n, "N")),
                    Err(error) => self.reply(Reply::Range(&error)),
                }
            }
            Command::MotorReversed(reversed) => {
                let mut stored = self.stored;
                stored.signs.motor_reversed = reversed;
                self.turn(stored, Change::Signs("motor", reversed));
            }
            Command::EncoderReversed(reversed) => {
                let mut stored = self.stored;
                stored.signs.encoder_reversed = reversed;
                self.turn(stored, Change::Signs("encoder", reversed));
            }
            Command::Hit => match device::trial(&self.stored, false) {
                Ok(plan) => self.order(Order::Hit(plan), Awaited::Done("hit")),
                Err(error) => self.reply(Reply::Range(&error)),
            },
            Command::Walk => self.begin_walk(),
            Command::Calibrate(percent) => match device::calibration(percent) {
                Ok(plan) => self.order(Order::Calibrate(plan), Awaited::Done("calibrate")),
                Err(error) => self.reply(Reply::Range(&error)),
            },
            Command::Stop => self.order(Order::Stop, Awaited::Stop),
            Command::Stream(on) => {
                self.streaming = on;
                self.reply(Reply::Word("stream", if on { "on" } else { "off" }));
            }
            Command::Save => self.order(request(Request::Stall(true)), Awaited::Save),
            Command::Load => self.load(&situation),
        }
    }

    /// Changes the estimator's tuning, if it has one that `fits`.
    fn tune(&mut self, value: f64, fits: fn(&Parameter) -> bool) {
        match self.stored.settings.velocity.tuning() {
            Some((parameter, _)) if fits(&parameter) => self.change(
                self.stored.settings,
                |settings| settings.velocity = settings.velocity.with_tuning(value),
                Change::Value(parameter.name, value, parameter.unit),
            ),
            Some(_) => self.write(&"error: this estimator has no cutoff: set its tuning, see get"),
            None => self.write(&"error: this estimator has nothing to tune"),
        }
    }

    /// Keeps a setting that only the next experiment looks at.
    fn keep(&mut self, stored: Stored, reply: Reply<'_>) {
        match device::trial(&stored, false).and_then(|_| stored.grid.check()) {
            Ok(()) => {
                self.stored = stored;
                self.reply(reply);
            }
            Err(error) => self.reply(Reply::Range(&error)),
        }
    }

    /// Turns motor and encoder as `stored` says; in force at once, and the zero is lost.
    fn turn(&mut self, stored: Stored, change: Change) {
        self.order(Order::Signs(stored.signs), Awaited::Settings(stored, change));
    }

    /// Builds changed settings and proposes them; they are kept once `render` has taken them.
    fn change(&mut self, settings: Settings, edit: impl FnOnce(&mut Settings), change: Change) {
        let mut stored = Stored { settings, ..self.stored };
        edit(&mut stored.settings);
        self.propose(stored, change);
    }

    fn propose(&mut self, stored: Stored, change: Change) {
        let estimator = stored.settings.velocity.name();
        if let Some(sense) = estimator.missing(board::SENSES) {
            return self.reply(Reply::NoSense(estimator, sense));
        }
        match (envelope::order(&stored), envelope::inside(&stored)) {
            (Ok(_), Err(outside)) if self.is_locked() => {
                self.reply(Reply::Outside(outside, &ENVELOPE, envelope::key(&stored)));
            }
            (Ok(order), _) => self.order(order, Awaited::Settings(stored, change)),
            (Err(error), _) => self.reply(Reply::Range(&error)),
        }
    }

    /// Force acts, and the envelope was not unlocked for it. With the force off a wall outside is
    /// taken, and `arm` refused.
    fn is_locked(&self) -> bool {
        self.latest.is_some_and(|report| report.status.state.is_on() && !report.status.unlocked)
    }

    /// Settings out of flash. Signs and full scale are taken over only with the force off.
    fn load(&mut self, now: &Situation) {
        let loaded = store::load(&mut self.flash, device::defaults());
        let (old, new) = (self.stored, loaded.stored);
        let turned = new.signs != old.signs;
        if (turned || new.full_scale_n != old.full_scale_n)
            && let Err(refusal) = signs_allowed(now)
        {
            return self.reply(Reply::Refused(refusal));
        }
        self.propose(new, Change::Loaded(loaded.source));
    }

    fn calibrated(&mut self, end: CalibrationEnd, record: Record) {
        self.write(&CalibrationOver(end, record, self.stored.full_scale_n));
    }

    fn answer(&mut self, answer: Result<(), Refusal>) {
        let Some(awaited) = self.awaited.take() else { return };
        match (awaited, answer) {
            (Awaited::Quiet | Awaited::Resume, _) => {}
            (Awaited::Cell | Awaited::CellHit, Err(refusal)) => self.break_walk(refusal.text()),
            (Awaited::Cell | Awaited::CellHit, Ok(())) => self.advance(),
            (Awaited::Stop, _) => {
                self.break_walk("stopped");
                self.reply(Reply::Done("stop"));
            }
            (_, Err(refusal)) => self.refuse(refusal),
            (Awaited::Done(name), Ok(())) => self.reply(Reply::Done(name)),
            (Awaited::Settings(stored, change), Ok(())) => {
                let signs = self.stored.signs;
                self.stored = stored;
                match change {
                    Change::Value(name, value, unit) => self.reply(Reply::Value(name, value, unit)),
                    Change::Estimator(name) => self.reply(Reply::Word("estimator", name.text())),
                    Change::Signs(name, reversed) => {
                        self.reply(Reply::Word(name, if reversed { "-" } else { "+" }));
                    }
                    Change::Loaded(source) => {
                        self.reply(Reply::Loaded(source));
                        if stored.signs != signs {
                            self.order(Order::Signs(stored.signs), Awaited::Quiet);
                        }
                    }
                }
            }
            (Awaited::Save, Ok(())) => {
                let saved = store::save(&mut self.flash, &self.stored);
                self.order(Order::Request(Request::Stall(false)), Awaited::Resume);
                match saved {
                    Ok(_) => self.reply(Reply::Done("save")),
                    Err(error) => {
                        if let SaveError::Flash(FlashError(status)) = error {
                            defmt::error!("flash status {=u32:#x}", status);
                        }
                        self.reply(Reply::Failed("save"));
                    }
                }
            }
        }
    }
}

/// Says what is wrong with a constant of `device.rs`, and stays there with everything off.
pub(super) fn refuse(link: board::Link, mut watchdog: Watchdog, error: &SettingsError) -> ! {
    let mut replies = ReplyChannel::new(link.replies);
    replies.say(&"error: a constant of src/task/device.rs is not allowed, nothing runs");
    replies.say(&Reply::Range(error));
    loop {
        watchdog.feed();
    }
}
