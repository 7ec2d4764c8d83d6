//! The board's side: a [`Talk`] talks to it over a [`Link`], one command at a time, and the [`Hub`] keeps what it says.
//! With a server that has a thread of its own, in a page without threads whoever moves the board calls it.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    thread,
    time::{Duration, Instant},
};

use virtual_board::{
    link::{COMMANDS, Finger, LOG, Link, REPLIES, Seen, TELEMETRY, Wires},
    log,
};
use zwidth::telemetry::{self, Flags, Record};

use crate::history::{History, Row};

mod known;
#[cfg(test)]
mod tests;

pub use known::{From, Known, Line, Stopped};

/// Between two looks at the link.
const LOOK: Duration = Duration::from_millis(1);
/// A reply that has not come by then does not come; that to `save` waits for an erase of the flash.
const REPLY: Duration = Duration::from_millis(500);
const SAVED: Duration = Duration::from_secs(3);
/// The board's promise, and how often it is kept.
const PROMISE_MS: u32 = 200;
const WORD: Duration = Duration::from_millis(50);
/// Between two questions for the state.
const STATUS: Duration = Duration::from_millis(500);
/// Commands that may wait.
const WAITING: usize = 64;
/// Ends a line that was begun so that it is no command.
const NO_COMMAND: &[u8] = b"?\n";
/// A name that no estimator has, and what the refusal begins with: the names that the image has stand behind it.
const ESTIMATORS: [&str; 2] = ["estimator ?", "error: unknown estimator, allowed "];
/// What is asked at first, and of a board that was reset.
const GREETING: [&str; 4] = ["version", ESTIMATORS[0], "get", "status"];
/// The finger of a person: stiffness and damping of one that holds a handle lightly, and what it can do at most.
const FINGER: Finger =
    Finger { target_m: 0.0, stiffness_n_per_m: 400.0, damping_n_s_per_m: 3.0, limit_n: 12.0 };

/// What people can do to the virtual board behind the link, if it is one.
pub type Virtual = Option<Arc<Wires>>;

/// Takes the telemetry as it comes.
pub type Tape = Box<dyn FnMut(&[u8]) -> Result<(), String> + Send>;

/// Clock: returns the time since it was started.
pub type Clock = Box<dyn Fn() -> Duration + Send + Sync>;

/// The board's side of the program.
pub struct Hub {
    history: Mutex<History>,
    known: Mutex<Known>,
    asked: Mutex<Asked>,
    /// The owner's page is there, so the board may get the `alive` command.
    pub attended: AtomicBool,
    ended: AtomicBool,
    board: Virtual,
    clock: Clock,
}

#[derive(Default)]
struct Asked {
    lines: VecDeque<String>,
    stops: Vec<(u64, Duration)>,
    /// How many stops there were.
    stopped: u64,
}

/// What it guards, whatever has panicked with it.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    /// Talks to a board from now on, in a thread of its own. `elf`: the program, to read its log by. `record`: where the
    /// telemetry goes as well.
    pub fn start(
        link: Box<dyn Link>,
        board: Virtual,
        elf: Option<&[u8]>,
        record: Option<Tape>,
    ) -> (Arc<Self>, thread::JoinHandle<()>) {
        let begun = Instant::now();
        let (hub, mut talk) = Self::new(link, board, elf, Box::new(move || begun.elapsed()));
        talk.record = record;
        let thread = thread::spawn(move || talk.run());
        (hub, thread)
    }

    /// A hub without a thread of its own: each [`Talk::turn`] sends and receives.
    pub fn new(
        link: Box<dyn Link>,
        board: Virtual,
        elf: Option<&[u8]>,
        clock: Clock,
    ) -> (Arc<Self>, Talk) {
        let hub = Arc::new(Self {
            history: Mutex::default(),
            known: Mutex::default(),
            asked: Mutex::default(),
            attended: AtomicBool::new(false),
            ended: AtomicBool::new(false),
            board,
            clock,
        });
        let now = hub.now();
        let talk = Talk {
            hub: Arc::clone(&hub),
            link,
            // Its table is kept for good: the decoder borrows it, and there is one of each program.
            log: elf
                .and_then(|elf| log::table(elf).ok())
                .map(|table| log::Decoder::new(Box::leak(Box::new(table)))),
            logged: vec![],
            record: None,
            decoder: telemetry::Decoder::new(),
            pending: None,
            unsent: vec![],
            begun: true,
            replies: vec![],
            words: 0,
            promised: false,
            word_at: now,
            status_at: now,
            quiet: GREETING.into(),
            stops: vec![],
            twice: VecDeque::new(),
            settings: None,
            last: None,
        };
        (hub, talk)
    }

    /// The time since it began.
    pub fn now(&self) -> Duration {
        (self.clock)()
    }

    /// What is known now.
    pub fn known(&self) -> MutexGuard<'_, Known> {
        lock(&self.known)
    }

    /// Every row that has come.
    pub fn history(&self) -> MutexGuard<'_, History> {
        lock(&self.history)
    }

    /// A line for the console. `stopped`: how many [stops](Self::stopped) its author knows of.
    ///
    /// # Errors
    /// There is no room, or a stop that its author does not know of came first.
    pub fn command(&self, line: &str, stopped: Option<u64>) -> Result<(), &'static str> {
        let mut asked = lock(&self.asked);
        if stopped.is_some_and(|known| known != asked.stopped) {
            return Err("a stop came first");
        }
        if asked.lines.len() >= WAITING {
            return Err("too many commands wait");
        }
        asked.lines.push_back(line.to_owned());
        Ok(())
    }

    /// Force off before everything else; what waits is not sent.
    pub fn stop(&self, id: u64) {
        let forgotten = {
            let mut asked = lock(&self.asked);
            asked.stops.push((id, self.now()));
            asked.stopped += 1;
            std::mem::take(&mut asked.lines)
        };
        let mut known = self.known();
        for line in forgotten {
            known.say(From::Server, format!("not sent: {line}"), Some(line));
        }
    }

    /// How many stops there were.
    pub fn stopped(&self) -> u64 {
        lock(&self.asked).stopped
    }

    /// The finger on a virtual board's handle; `target_m` in the board's positions.
    pub fn touch(&self, target_m: Option<f64>, resolution_m: f64) {
        let Some(board) = &self.board else { return };
        let offset_m = self.offset_m(resolution_m);
        board.touch(target_m.map(|target_m| Finger { target_m: target_m + offset_m, ..FINGER }));
    }

    /// The switch of a virtual board's emergency stop.
    pub fn emergency_stop(&self, open: bool) {
        if let Some(board) = &self.board {
            board.emergency_stop(open);
        }
    }

    /// What a person would see of a virtual board.
    pub fn seen(&self) -> Option<Seen> {
        self.board.as_ref().map(|board| board.seen())
    }

    /// From the board's positions to the scene's, to the millimetre: the handle moves between the two readings.
    fn offset_m(&self, resolution_m: f64) -> f64 {
        let record = self.known().record;
        let (Some(seen), Some(record)) = (self.seen(), record) else { return 0.0 };
        let offset_m = seen.position_m - f64::from(record.position.counts()) * resolution_m;
        (offset_m * 1e3).round() / 1e3
    }

    /// Says something to all pages.
    pub fn note(&self, text: &str) {
        self.known().say(From::Server, text.to_owned(), None);
    }

    /// Force off and the end of the thread.
    pub fn end(&self) {
        self.ended.store(true, Relaxed);
    }
}

/// What was sent last and is to be answered.
struct Pending {
    line: String,
    /// What the reply begins with; none: whatever is a reply. Of a question that the board always answers: replies to
    /// what was sent before it are not taken for its own.
    begins: Option<String>,
    /// A person is told the reply.
    loud: bool,
    since: Duration,
}

impl Pending {
    fn is_answered_by(&self, line: &str) -> bool {
        match &self.begins {
            // A board whose device record is refused answers the first question, and no other.
            Some(begins) => {
                let may_refuse = !self.loud && self.line != GREETING[0];
                line.starts_with(begins) || may_refuse && line.starts_with("error")
            }
            None => line.starts_with("ok") || line.starts_with("error"),
        }
    }

    fn waits(&self) -> Duration {
        if self.line.trim() == "save" { SAVED } else { REPLY }
    }
}

/// The conversation with a board.
pub struct Talk {
    hub: Arc<Hub>,
    link: Box<dyn Link>,
    log: Option<log::Decoder<'static>>,
    /// What has come of the log since it was last read.
    logged: Vec<u8>,
    record: Option<Tape>,
    decoder: telemetry::Decoder,
    pending: Option<Pending>,
    /// Bytes that the board had no room for.
    unsent: Vec<u8>,
    /// The board has a part of a line; at first perhaps that of a host before this one.
    begun: bool,
    /// Pieces of a line.
    replies: Vec<u8>,
    /// Words whose replies are to come.
    words: u32,
    /// The board has a promise.
    promised: bool,
    word_at: Duration,
    status_at: Duration,
    quiet: VecDeque<&'static str>,
    stops: Vec<(u64, Duration)>,
    /// Lines of the console whose copy in the log is still to come.
    twice: VecDeque<String>,
    settings: Option<u16>,
    last: Option<Record>,
}

impl Talk {
    fn run(mut self) {
        while !self.hub.ended.load(Relaxed) {
            if !self.turn() {
                return;
            }
            thread::sleep(LOOK);
        }
        self.disarm();
        // Until it is out, for a board that has little room; one that takes nothing has its promise.
        let end = Instant::now() + REPLY;
        while !self.unsent.is_empty() && Instant::now() < end {
            thread::sleep(LOOK);
            self.flush();
        }
        thread::sleep(10 * LOOK);
    }

    /// Hears what the board has said, and says what is next; whether there still is a board.
    pub fn turn(&mut self) -> bool {
        let lost = self.link.lost();
        if lost.is_some() {
            self.hub.known().lost = lost;
            return false;
        }
        self.read_replies();
        self.read_log();
        self.read_telemetry();
        self.ask();
        true
    }

    /// Force off before everything that waits.
    fn disarm(&mut self) {
        self.unsent.clear();
        self.send("disarm");
    }

    fn send(&mut self, line: &str) {
        if self.begun && self.unsent.is_empty() {
            self.unsent.extend_from_slice(NO_COMMAND);
        }
        self.unsent.extend_from_slice(line.as_bytes());
        self.unsent.push(b'\n');
        self.flush();
    }

    fn flush(&mut self) {
        if !self.unsent.is_empty() {
            let sent = self.link.write(COMMANDS, &self.unsent);
            if let Some(last) = self.unsent.drain(..sent).next_back() {
                self.begun = last != b'\n';
            }
        }
    }

    fn ask(&mut self) {
        self.flush();
        let now = self.hub.now();
        let stops = std::mem::take(&mut lock(&self.hub.asked).stops);
        if !stops.is_empty() {
            self.disarm();
            self.give_up("a stop came first");
            self.quiet = ["get", "status"].into();
            self.stops.extend(stops);
            self.hub.known().say(From::Person, "disarm".to_owned(), None);
            self.pending = Some(Pending {
                line: "disarm".to_owned(),
                begins: Some("ok disarm".to_owned()),
                loud: true,
                since: now,
            });
        }
        self.keep_the_promise(now);
        if let Some(pending) = &self.pending {
            let waits = pending.waits();
            if now.saturating_sub(pending.since) < waits {
                return;
            }
            self.give_up(&format!("waited {} s", waits.as_secs_f64()));
        }
        let next = lock(&self.hub.asked).lines.pop_front();
        let (line, loud) = match next {
            Some(line) => (line, true),
            None => match self.quiet.pop_front() {
                Some(line) => (line.to_owned(), false),
                None if now.saturating_sub(self.status_at) > STATUS => ("status".to_owned(), false),
                None => return,
            },
        };
        if loud {
            self.hub.known().say(From::Person, line.clone(), None);
            if line.trim() == "arm" {
                // Before it, so that no moment of force is without it.
                self.promise(PROMISE_MS, now);
            }
        } else if line == "status" {
            self.status_at = now;
        }
        self.send(&line);
        let begins = match line.as_str() {
            _ if loud => None,
            question if question == ESTIMATORS[0] => Some(ESTIMATORS[1].to_owned()),
            question => Some(format!("ok {question}")),
        };
        self.pending = Some(Pending { line, begins, loud, since: now });
    }

    /// The reply that is waited for does not come.
    fn give_up(&mut self, why: &str) {
        if let Some(Pending { line, .. }) = self.pending.take().filter(|pending| pending.loud) {
            self.hub.known().say(From::Server, format!("no reply to {line}: {why}"), Some(line));
        }
    }

    /// The board has begun anew: what it was asked is forgotten there, and nothing that is known of it need hold.
    fn meet_again(&mut self) {
        self.give_up("the board was reset");
        self.hub.note("the board was reset");
        self.quiet = GREETING.into();
        (self.settings, self.promised, self.words) = (None, false, 0);
    }

    /// While the force is on and the owner is there, the board hears so; without the owner it is switched off, and if
    /// this program ends it is silence that switches off.
    fn keep_the_promise(&mut self, now: Duration) {
        if now.saturating_sub(self.word_at) < WORD {
            return;
        }
        let on = self.hub.known().is_on();
        let attended = self.hub.attended.load(Relaxed);
        if on && attended {
            self.promise(PROMISE_MS, now);
        } else if on && self.promised {
            self.hub.note("nobody is there who may command: force off");
            self.hub.stop(0);
            self.word_at = now + 20 * WORD; // again if it is still on, or the end of the promise
        } else if self.promised && !on && now.saturating_sub(self.word_at) > 10 * WORD {
            self.promise(0, now);
        }
    }

    fn promise(&mut self, ms: u32, now: Duration) {
        self.send(&format!("alive {ms}"));
        self.words += 1;
        self.promised = ms > 0;
        self.word_at = now;
    }

    fn read_replies(&mut self) {
        self.link.read(REPLIES, &mut self.replies);
        while let Some(end) = self.replies.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.replies.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line[..end]).trim_end().to_owned();
            if !line.is_empty() {
                self.hear(line);
            }
        }
        self.replies.truncate(1 << 16);
    }

    fn hear(&mut self, line: String) {
        self.twice.push_back(line.clone());
        if self.twice.len() > 64 {
            self.twice.pop_front();
        }
        if line == "ok alive" && self.words > 0 {
            self.words -= 1;
            return;
        }
        let now = self.hub.now();
        let mut known = lock(&self.hub.known);
        if line == "ok disarm" && !self.stops.is_empty() {
            for (id, since) in self.stops.drain(..) {
                known.stops += 1;
                known
                    .stopped
                    .push_back(Stopped { id, ms: (now.saturating_sub(since)).as_secs_f64() * 1e3 });
                if known.stopped.len() > 16 {
                    known.stopped.pop_front();
                }
            }
        }
        let is_report = is_report(&line);
        let answered = self.pending.take_if(|asked| !is_report && asked.is_answered_by(&line));
        match line.strip_prefix("ok ").and_then(|said| said.split_whitespace().next()) {
            Some("get") => {
                known.settings_after = known.numbered;
                known.settings.clone_from(&line);
            }
            Some("status") => known.status.clone_from(&line),
            Some("version") => known.version.clone_from(&line),
            _ => {}
        }
        if let Some(names) = line.strip_prefix(ESTIMATORS[1]) {
            // Of a list that is cut off the last name is in doubt.
            let whole = names
                .strip_suffix('~')
                .map_or(names, |cut| cut.rsplit_once(' ').unwrap_or_default().0);
            known.estimators = whole.split(' ').map(str::to_owned).collect();
        }
        match answered {
            Some(asked) if asked.loud => {
                known.say(From::Board, line, Some(asked.line));
                if !self.quiet.contains(&"get") {
                    self.quiet.extend(["get", "status"]);
                }
            }
            Some(_) => {}
            // What was asked by a host before this one.
            None if !is_report
                && self.pending.as_ref().is_some_and(|asked| asked.line == GREETING[0]) => {}
            None => known.say(From::Board, line, None),
        }
    }

    fn read_log(&mut self) {
        // Those lines that were complete when it was last looked at: the replies that have come with them have been read by now.
        let bytes = std::mem::take(&mut self.logged);
        self.link.read(LOG, &mut self.logged);
        let Some(log) = &mut self.log else { return };
        // A log that makes no sense, of another program or begun in the middle, is passed over.
        for line in log.feed(&bytes).unwrap_or_default() {
            // What the console says stands in the log too; a long line comes there in pieces.
            let piece = line.strip_suffix('~').unwrap_or(&line);
            if let Some(place) = self.twice.iter().position(|known| known.contains(piece)) {
                let rest = self.twice[place].replacen(piece, "", 1);
                self.twice[place] = rest;
                self.twice.retain(|rest| !rest.is_empty());
            } else {
                self.hub.known().say(From::Log, line, None);
            }
        }
    }

    fn read_telemetry(&mut self) {
        let mut bytes = vec![];
        self.link.read(TELEMETRY, &mut bytes);
        if bytes.is_empty() {
            return;
        }
        if let Some(Err(error)) = self.record.as_mut().map(|record| record(&bytes)) {
            self.hub.note(&format!("the record ends here: {error}"));
            self.record = None;
        }
        let mut history = lock(&self.hub.history);
        let (mut newest, mut was_reset) = (None, false);
        for byte in bytes {
            let Some(frame) = self.decoder.push(byte) else { continue };
            for output in self.decoder.outputs(frame) {
                let record = output.record;
                if record.flags.contains(Flags::REPLAY) {
                    continue;
                }
                let step = self.last.map_or(0, |last| record.sample.wrapping_sub(last.sample));
                was_reset |= self.last.is_some_and(|last| record.sample < last.sample);
                self.last = Some(record);
                if [1, 2, 5, 10].contains(&step) && step != history.step() {
                    history.restart(step);
                }
                newest = Some(record);
                let values =
                    [record.position.counts(), record.velocity.bits(), record.force.bits()];
                history.push(record.sample, &Row { values, flags: record.flags.bits() });
            }
        }
        drop(history);
        if was_reset {
            self.meet_again();
        }
        let mut known = self.hub.known();
        known.counts = [self.decoder.frames, self.decoder.dropped, self.decoder.garbage];
        if let Some(record) = newest {
            known.record = Some(record);
            if self.settings.replace(record.settings) != Some(record.settings)
                && !self.quiet.contains(&"get")
            {
                self.quiet.push_back("get");
            }
        }
    }
}

/// What an experiment says by itself, as no answer to a command.
fn is_report(line: &str) -> bool {
    const REPORTS: [&str; 10] = [
        "ok walk over",
        "ok pulses over",
        "ok calibrate over",
        "ok hit stable",
        "ok hit unstable",
        "ok hit no contact",
        "error: hit",
        "error: walk",
        "error: pulses",
        "error: nobody was reading",
    ];
    REPORTS.iter().any(|start| line.starts_with(start))
}
