//! `link`: pended by `render`, priority 1. The probe link: commands in, replies and telemetry out.
//!
//! One command at a time: what `render` has to decide is asked of it, and the reply waits for its
//! answer, which comes with the next output.

use core::{fmt, sync::atomic::Ordering::Relaxed};

use zwidth::{
    Control, Settings, SettingsError,
    envelope::Key,
    experiment::{Scatter, Verdict},
    link::{
        Command, Decimal, LINE_MAX, Line, LineReader, ParseError, REPLY_MAX, Reply, Situation,
        Text, allowed, parse,
    },
    safety::{Refusal, Request, State},
    store::{self, SaveError, Source, Stored},
    telemetry::{Frame, Record},
    velocity::{EstimatorName, Parameter},
};

use super::{
    FLAGS, ORDERS, REPORTS,
    device::{self, DESIGN, ENVELOPE},
    order::{Event, Gains, Order, Report},
};
use crate::board::{self, FlashError, Reader, SettingsFlash, Writer};

/// Bytes that one pass takes at most: the whole channel.
const BYTES_A_PASS: usize = 256;

/// What the answer of `render` is awaited for.
#[derive(Clone, Copy)]
enum Awaited {
    /// A command whose reply is its name.
    Done(&'static str),
    /// New settings: what to keep and how to reply.
    Settings(Stored, Change),
    /// Leave to write flash.
    Save,
    /// Flash is written; the reply is out.
    Resume,
    /// Nothing is replied.
    Quiet,
}

/// Which setting a command changed.
#[derive(Clone, Copy)]
enum Change {
    Value(&'static str, f64, &'static str),
    Estimator(EstimatorName),
    Loaded(Source),
}

/// The link task. It alone talks to the host, but for the logger.
pub struct Link {
    link: board::Link,
    flash: SettingsFlash,
    reports: Reader<Report, REPORTS>,
    orders: Writer<Order, ORDERS>,
    reader: LineReader<LINE_MAX>,
    stored: Stored,
    awaited: Option<Awaited>,
    latest: Option<Report>,
    streaming: bool,
    sequence: u32,
    passes: u32,
}

impl Link {
    pub(super) fn new(
        link: board::Link,
        flash: SettingsFlash,
        reports: Reader<Report, REPORTS>,
        orders: Writer<Order, ORDERS>,
        stored: Stored,
        source: Source,
    ) -> Self {
        let mut link = Self {
            link,
            flash,
            reports,
            orders,
            reader: LineReader::new(),
            stored,
            awaited: None,
            latest: None,
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
        while let Some(report) = self.reports.read() {
            self.stream(report.record);
            self.latest = Some(report);
            match report.event {
                Event::None => {}
                Event::Answer(answer) => self.answer(answer),
                Event::HitOver(verdict, scatter) => self.write(&HitOver(verdict, scatter)),
                Event::HitBroken => self.write(&"error: the hit ended without a verdict"),
            }
        }
        if self.awaited.is_none() && self.latest.is_some() {
            self.listen();
        }
        self.passes = self.passes.wrapping_add(1);
        FLAGS.links.store(self.passes, Relaxed);
    }

    /// Reads up to the end of one line and obeys it. One line a pass, so that a host that floods
    /// cannot keep this task from its end, and the watchdog from being fed.
    fn listen(&mut self) {
        for _ in 0..BYTES_A_PASS {
            let mut byte = [0];
            if self.link.commands.read(&mut byte) == 0 {
                return;
            }
            let line = match self.reader.push(byte[0]) {
                None => continue,
                Some(Line::TooLong) => Err(ParseError::TooLong),
                Some(Line::Text(text)) => parse(text),
            };
            return match line {
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
        self.link.telemetry.write(&frame.encode());
    }

    /// One line on both channels for people.
    fn write(&mut self, line: &dyn fmt::Display) {
        let text = Text::<REPLY_MAX>::of(line);
        defmt::info!("{=str}", text.as_str());
        let text = Text::<{ REPLY_MAX + 1 }>::of(format_args!("{}\n", text.as_str()));
        self.link.replies.write(text.as_bytes());
    }

    fn reply(&mut self, reply: Reply<'_>) {
        self.write(&reply);
    }

    fn situation(&self) -> Option<(Situation, Record)> {
        self.latest.map(|report| {
            let situation = Situation { status: report.status, activity: report.activity };
            (situation, report.record)
        })
    }

    fn order(&mut self, order: Order, awaited: Awaited) {
        // Only one order is under way, so there is room.
        if self.orders.write(order) {
            self.awaited = Some(awaited);
        }
    }

    fn obey(&mut self, command: Command) {
        let Some((situation, record)) = self.situation() else { return };
        if let Err(refusal) = allowed(&command, &situation) {
            return self.reply(Reply::Refused(refusal));
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
            Command::Estimator(name) => self.change(
                self.stored.settings,
                |settings| settings.velocity = name.following(&settings.velocity),
                Change::Estimator(name),
            ),
            Command::Push(push_n) => match device::hit(push_n).build(&DESIGN) {
                Ok(_) => {
                    self.stored.push_n = push_n;
                    self.reply(Reply::Value("push", push_n, "N"));
                }
                Err(error) => self.reply(Reply::Range(&error)),
            },
            Command::Hit => match device::hit(self.stored.push_n).build(&DESIGN) {
                Ok(plan) => self.order(Order::Hit(plan), Awaited::Done("hit")),
                Err(error) => self.reply(Reply::Range(&error)),
            },
            Command::Stop => self.order(Order::Stop, Awaited::Done("stop")),
            Command::Stream(on) => {
                self.streaming = on;
                self.reply(Reply::Word("stream", if on { "on" } else { "off" }));
            }
            Command::Save => self.order(request(Request::Stall(true)), Awaited::Save),
            Command::Load => self.load(),
            Command::Walk | Command::Calibrate => {
                self.write(&"error: this firmware cannot do that yet");
            }
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
        match build(&stored) {
            Ok((control, gains)) => {
                self.order(Order::Control(control, gains), Awaited::Settings(stored, change));
            }
            Err(error) => self.reply(Reply::Range(&error)),
        }
    }

    /// Settings out of flash. Signs are taken over at the next reset only: turned while the loop
    /// runs they would look like a jump of the count.
    fn load(&mut self) {
        let loaded = store::load(&self.flash, device::defaults());
        self.propose(loaded.stored, Change::Loaded(loaded.source));
    }

    fn answer(&mut self, answer: Result<(), Refusal>) {
        let Some(awaited) = self.awaited.take() else { return };
        match (awaited, answer) {
            (Awaited::Quiet | Awaited::Resume, _) => {}
            (_, Err(refusal)) => self.reply(Reply::Refused(refusal)),
            (Awaited::Done(name), Ok(())) => self.reply(Reply::Done(name)),
            (Awaited::Settings(stored, change), Ok(())) => {
                self.stored = stored;
                match change {
                    Change::Value(name, value, unit) => self.reply(Reply::Value(name, value, unit)),
                    Change::Estimator(name) => self.reply(Reply::Word("estimator", name.text())),
                    Change::Loaded(source) => self.reply(Reply::Loaded(source)),
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

/// The integers of those settings, and where their gains lie.
fn build(stored: &Stored) -> Result<(Control, Gains), SettingsError> {
    let control = stored.settings.build(&DESIGN)?;
    let velocity = &stored.settings.velocity;
    let key = Key {
        device: stored.device.name(),
        estimator: velocity.name().text(),
        cutoff_hz: velocity.tuning().map_or(0.0, |(_, value)| value),
        latency_samples: device::LATENCY_SAMPLES,
    };
    let wall = &stored.settings.wall;
    let inside = ENVELOPE.allows(&key, wall.stiffness_n_per_m, wall.damping_n_s_per_m);
    Ok((control, if inside.is_ok() { Gains::Inside } else { Gains::Outside }))
}

/// The line that ends a hit.
struct HitOver(Verdict, Scatter);

impl fmt::Display for HitOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(verdict, scatter) = self;
        let verdict = match verdict {
            Verdict::Stable => "stable",
            Verdict::Unstable => "unstable",
            Verdict::NoContact => "no contact",
        };
        let metres = |counts: f64| Decimal(counts * DESIGN.resolution_m);
        let (rms, mean) = (metres(scatter.rms_counts()), metres(scatter.mean_counts()));
        write!(f, "ok hit {verdict}, rms {rms} m, mean {mean} m")
    }
}
