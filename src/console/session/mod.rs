//! One session of the console. It takes bytes from the host and reports from `render`. It gives lines, telemetry frames
//! and orders.
//!
//! The console obeys one command at a time. If the task `render` has to decide, the console sends it an order. The
//! reply waits for the answer, which comes with the next output.

mod self_test;
mod series;
mod stream;

use core::fmt;

use super::{
    Command, LINE_MAX, Line, LineReader, ParseError, Port, Reply, Situation,
    lines::{CalibrationHolds, CalibrationOver, JudgedHit},
    parse_in,
    reply::ReplyIn,
    reply_channel::ReplyChannel,
    spoken::Spoken,
};
use crate::{
    device::Device,
    experiment::{Event, Order, Report},
    safety::{Doubled, Fault, Refusal, Request},
    store::{Name, Source, Stored},
    telemetry::{InForce, Record},
    velocity::EstimatorName,
};
pub(super) use self_test::SelfTestStep;
use series::HitSeries;
use stream::Stream;

/// The largest number of bytes that one pass takes. The channel holds as many.
const BYTES_A_PASS: usize = 256;

/// Number of passes after which an order without an answer, or a pass without a report, is a fault. Both come with the
/// next output. In the meantime the console reads no command, not even `disarm`.
const UNHEARD_PASSES: u8 = 50;

/// Purpose of the order whose answer is awaited.
#[allow(
    clippy::large_enum_variant,
    reason = "there is one, and no heap; large on a 64-bit host only"
)]
#[derive(Clone, Copy)]
pub(super) enum Awaited {
    /// A command whose reply is its name.
    Done(&'static str),
    /// An order for the settings that are counted in outputs, with a new output period. It is the first of two orders.
    /// The second one is for the settings in this variant.
    Period(Stored, ChangedSetting),
    /// An order for new settings. The fields are the settings that will be stored, and the change that the reply names.
    Settings(Stored, ChangedSetting),
    /// Permission to test this part.
    SelfTest(SelfTestStep),
    /// The end of the running experiment.
    Stop,
    /// Permission to write flash.
    Save,
    /// The next wall of a series, or the next hit.
    Series,
    /// An order without a reply.
    Quiet,
}

#[derive(Clone, Copy)]
pub(super) enum ChangedSetting {
    Value(&'static str, f64, &'static str),
    Estimator(EstimatorName),
    Design(Name),
    Signs(&'static str, bool),
    Loaded(Source),
}

/// A console on a board.
#[derive(Clone)]
pub struct Console<P> {
    pub(super) port: P,
    pub(super) device: &'static Device<'static>,
    /// Copy of the device, made at the start. Every order is made from the device. So before each order the two are
    /// compared, to find a changed bit.
    device_then: Device<'static>,
    pub(super) replies: ReplyChannel,
    reader: LineReader<LINE_MAX>,
    pub(super) stored: Doubled<Stored>,
    /// Number of the design that equals the stored settings, or 0 if there is none.
    pub(super) design: u8,
    awaited: Option<Awaited>,
    /// Number of passes since the last report at which no order was under way.
    unheard: u8,
    /// Newest output, and the state at this output. The state does not include a running series, which only the console
    /// knows.
    pub(super) latest: Option<(Situation, Record)>,
    series: Option<HitSeries>,
    /// A hit that is over, but not yet judged by the criterion `quiet`. It waits for the variance of its output codes.
    over: Option<JudgedHit>,
    /// A series of hits that ended because nobody reads the lines. Its end is not reported yet.
    unread: Option<HitSeries>,
    /// Whether a walk has just ended, so that its last wall is still in force instead of the stored wall.
    restore_wall: bool,
    /// Whether a series of hits is running, up to the order that restores the stored wall. Only during a series does
    /// the console give orders by itself. The flag is stored twice, so that one flipped bit cannot begin a series.
    in_series: Doubled<bool>,
    pub(super) stream: Stream,
}

impl<P: Port> Console<P> {
    /// Makes the console of `device`. It starts with the settings `stored`, which come from `source`.
    pub fn new(port: P, device: &'static Device<'static>, stored: Stored, source: Source) -> Self {
        let first = device.design(&stored).ok().zip(device.control(&stored).ok());
        let mut console = Self {
            port,
            device,
            device_then: *device,
            replies: ReplyChannel::new(),
            reader: LineReader::new(),
            stored: Doubled::new(stored),
            design: device.designs.number_of(&stored.settings.velocity),
            awaited: None,
            unheard: 0,
            latest: None,
            series: None,
            over: None,
            unread: None,
            restore_wall: false,
            in_series: Doubled::new(false),
            stream: Stream::new(
                first.as_ref().map(|(design, loop_parameters)| (*design, &stored, loop_parameters)),
            ),
        };
        console.version();
        console.reply(Reply::Loaded(source));
        // The envelope judges the first settings like all other settings.
        console.propose(stored, ChangedSetting::Loaded(source));
        console.awaited = console.awaited.map(|_| Awaited::Quiet);
        console
    }

    /// The console's access to the board.
    pub fn port(&mut self) -> &mut P {
        &mut self.port
    }

    /// The settings that the console accepted last.
    pub fn stored(&self) -> &Stored {
        &self.stored
    }

    /// Whether an order is under way. Until its answer no command is read.
    pub fn is_waiting(&self) -> bool {
        self.awaited.is_some()
    }

    /// Takes the report of an output. Call it for every report, in order.
    pub fn report(&mut self, report: &Report) {
        self.stream(report);
        let Report { status, activity, record, .. } = *report;
        self.latest = Some((Situation { status, activity }, record));
        match report.event {
            Event::None => {}
            Event::Answer(answer) => match self.stream.answered(answer.is_ok()) {
                Some(asked) if !self.is_in_force(&asked) => {
                    self.answer(Err(Refusal::Faulted(Fault::Memory)));
                    self.trip();
                }
                _ => self.answer(answer),
            },
            Event::HitOver(verdict, counts) => self.hit_over(verdict, counts, report.port),
            Event::HitCodes(codes) => self.hit_codes(codes),
            Event::HitAborted(reason) if self.series.is_some() => self.end_series(reason.text()),
            Event::HitAborted(reason) => {
                self.write(&format_args!("error: hit: {}", reason.text()));
            }
            Event::PulsesOver(Ok(())) => self.write(&"ok pulses over"),
            Event::PulsesOver(Err(reason)) => {
                self.write(&format_args!("error: pulses: {}", reason.text()));
            }
            Event::CalibrationHolds => {
                self.write(&CalibrationHolds(
                    report.record,
                    self.stored.full_scale_n,
                    self.spoken(),
                ));
            }
            Event::CalibrationOver(end) => {
                self.write(&CalibrationOver(
                    end,
                    report.record,
                    self.stored.full_scale_n,
                    self.spoken(),
                ));
            }
        }
        if self.awaited.is_none() {
            self.unheard = 0;
        }
    }

    /// Continues a series, or obeys a command if `listens` allows it. Returns whether there was anything to do. Call it
    /// after the reports, which come with every output.
    pub fn pass(&mut self, listens: bool) -> bool {
        self.unheard = self.unheard.saturating_add(1);
        let free = self.awaited.is_none() && self.latest.is_some();
        free && (self.pursue() || listens && self.listen())
    }

    /// Whether no command can be heard any more, because a flipped bit has stopped reports, orders or answers.
    pub fn is_deaf(&self) -> bool {
        self.unheard > UNHEARD_PASSES
    }

    /// Reads up to the end of one line and obeys it. Returns whether there were bytes. A pass takes one line. The
    /// caller decides how often this function runs, see [`Pace`](crate::console::Pace).
    fn listen(&mut self) -> bool {
        let mute = self.is_mute();
        for taken in 0..BYTES_A_PASS {
            let Some(byte) = self.port.read() else { return taken > 0 };
            let line = match self.reader.push(byte) {
                None => continue,
                Some(Line::TooLong) => Err(ParseError::TooLong),
                Some(Line::Text(text)) => parse_in(text, Spoken::of(self.device)),
            };
            match line {
                Ok(command @ (Command::Stop | Command::Disarm)) => self.obey(command),
                Ok(_) | Err(_) if mute => self.replies.ignore(),
                Ok(command) => self.obey(command),
                Err(error) => self.reply(Reply::Parse(error)),
            }
            break;
        }
        true
    }

    /// Whether a line still waits because nobody reads.
    pub(super) fn is_mute(&mut self) -> bool {
        self.replies.is_mute(&mut self.port)
    }

    pub(super) fn write(&mut self, line: &dyn fmt::Display) {
        self.replies.say(&mut self.port, line);
    }

    pub(super) fn reply(&mut self, reply: Reply<'_>) {
        self.write(&ReplyIn(reply, self.spoken()));
    }

    pub(super) fn spoken(&self) -> Spoken {
        Spoken::of(self.device)
    }

    pub(super) fn version(&mut self) {
        self.reply(Reply::Version(P::COMMIT, self.device));
    }

    pub(super) fn situation(&self) -> Option<(Situation, Record)> {
        self.latest.map(|(now, record)| {
            let activity = self.series.as_ref().map_or(now.activity, HitSeries::activity);
            (Situation { activity, ..now }, record)
        })
    }

    /// Replies with the reason. For a wall outside the envelope the reply also has the allowed range.
    #[inline(never)] // its texts and keys do not belong on the stack of a command that is obeyed
    pub(super) fn refuse(&mut self, refusal: Refusal) {
        let stored = *self.stored;
        match self.device.inside(&stored) {
            Err(outside) if refusal == Refusal::Settings => {
                self.reply(Reply::Outside(outside, self.device, self.device.key(&stored)));
            }
            _ => self.reply(Reply::Refused(refusal)),
        }
    }

    pub(super) fn order_settings(&mut self, stored: &Stored, order: Order, awaited: Awaited) {
        if let (Order::LoopParameters(parameters, _), Ok(design)) =
            (&order, self.device.design(stored))
        {
            self.stream.propose(design, stored, parameters);
        }
        self.order(order, awaited);
    }

    /// Gives an order, whose answer is then awaited.
    pub(super) fn order(&mut self, order: Order, awaited: Awaited) {
        if !self.is_whole() {
            return self.lose();
        }
        self.give(order, awaited);
    }

    fn give(&mut self, order: Order, awaited: Awaited) {
        self.awaited = Some(awaited);
        if !self.port.order(order) {
            self.unheard = u8::MAX; // there is always room, if no bit has flipped
        }
    }

    /// Whether settings and device are unchanged. Orders are made from both.
    pub(super) fn is_whole(&self) -> bool {
        self.stored.is_whole() && self.device_then == *self.device
    }

    /// Whether the settings in force equal the ordered settings. For this the parameters are computed once more.
    /// Without this check, a bit that flips in an order on its way could put another wall in force.
    #[inline(never)] // its parameters are not needed below `report`
    fn is_in_force(&mut self, asked: &InForce) -> bool {
        let parameters = asked.settings.build(&asked.design);
        parameters.is_ok_and(|parameters| self.port.is_in_force(&parameters))
    }

    /// Orders the fault for a flipped bit, which switches the force off. Drops all proposed settings.
    fn trip(&mut self) {
        self.stream.answered(false);
        self.give(Order::Request(Request::Trip(Fault::Memory)), Awaited::Quiet);
    }

    #[cfg(test)]
    pub(super) fn flip(&mut self, of_device: bool) {
        if of_device {
            self.device_then.design.period ^= 1;
        } else {
            let mut stored = *self.stored;
            stored.settings.wall.damping_n_s_per_m += 2.0;
            self.stored.spoil(stored);
        }
    }

    /// Makes the console wait for an answer that never comes.
    #[cfg(test)]
    pub(super) fn flip_awaited(&mut self) {
        self.awaited = Some(Awaited::Quiet);
    }

    /// Handles a flipped bit in settings or device. From now on the console gives no order except the order for this
    /// fault.
    #[cold]
    pub(super) fn lose(&mut self) {
        self.trip();
        let refusal = Refusal::Faulted(Fault::Memory);
        if self.series.is_some() {
            self.end_series(refusal.text());
        } else {
            self.reply(Reply::Refused(refusal));
        }
    }

    #[inline(never)] // what it has on the stack, for a `save` above all, is not needed below `obey`
    fn answer(&mut self, answer: Result<(), Refusal>) {
        let Some(awaited) = self.awaited.take() else { return };
        match (awaited, answer) {
            (Awaited::Quiet, _) => {}
            (Awaited::Series, Err(refusal)) => self.end_series(refusal.text()),
            (Awaited::Series, Ok(())) => self.advance(),
            (Awaited::Stop, _) => {
                self.end_series("stopped");
                self.reply(Reply::Done("stop"));
            }
            (Awaited::SelfTest(_), Err(refusal)) => {
                self.refuse(refusal);
                self.order(Order::Request(Request::Stall(false)), Awaited::Quiet);
            }
            (_, Err(refusal)) => self.refuse(refusal),
            (Awaited::Done(name), Ok(())) => self.reply(Reply::Done(name)),
            (Awaited::Period(stored, changed), Ok(())) => self.propose_next(stored, changed),
            (Awaited::SelfTest(step), Ok(())) => self.test(step),
            (Awaited::Settings(stored, changed), Ok(())) => self.keep_changed(stored, changed),
            (Awaited::Save, Ok(())) => {
                let saved = self.is_whole() && self.port.save(&self.stored);
                // The write to flash has ended.
                self.order(Order::Request(Request::Stall(false)), Awaited::Quiet);
                self.reply(if saved { Reply::Done("save") } else { Reply::Failed("save") });
            }
        }
    }

    /// Keeps settings that the task `render` has accepted.
    fn keep_changed(&mut self, stored: Stored, changed: ChangedSetting) {
        let signs = self.stored.signs;
        if stored.period != self.stored.period {
            self.flush();
        }
        self.stored.set(stored);
        self.design = self.device.designs.number_of(&stored.settings.velocity);
        match changed {
            ChangedSetting::Value(name, value, unit) => self.reply(Reply::Value(name, value, unit)),
            ChangedSetting::Estimator(name) => self.reply(Reply::Word("estimator", name.text())),
            ChangedSetting::Design(name) => self.reply(Reply::Word("design", name.text())),
            ChangedSetting::Signs(name, reversed) => {
                self.reply(Reply::Word(name, if reversed { "-" } else { "+" }));
            }
            ChangedSetting::Loaded(source) => {
                self.reply(Reply::Loaded(source));
                if stored.signs != signs {
                    self.order(Order::Signs(stored.signs), Awaited::Quiet);
                }
            }
        }
    }
}
