//! The communication with a board. A [`Talk`] sends commands over a [`Link`], one at a time, and the [`Hub`] stores
//! what the board sends. A server runs the [`Talk`] in its own thread. In a page without threads, the caller runs the
//! [`Talk`] together with the board.

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
use zwidth::{
    console::is_answer,
    telemetry::{self, Flags, Record},
};

use crate::history::{History, Row};

mod known;
#[cfg(test)]
mod tests;

pub use known::{From, Known, Line, Stopped};

/// Time between two calls of [`Talk::turn`].
const LOOK: Duration = Duration::from_millis(1);
/// Longest time to wait for a reply. `SAVED` is for the reply to `save`, because that command erases flash.
const REPLY: Duration = Duration::from_millis(500);
const SAVED: Duration = Duration::from_secs(3);
/// Time in ms without `alive` after which the board switches the force off. `WORD` is the time between two `alive`
/// commands.
const PROMISE_MS: u32 = 200;
const WORD: Duration = Duration::from_millis(50);
/// Time between two `status` commands to the board.
const STATUS: Duration = Duration::from_millis(500);
/// Largest number of waiting commands.
const WAITING: usize = 64;
/// Sent to end an incomplete line. With this text, the line is not a valid command.
const NO_COMMAND: &[u8] = b"?\n";
/// A command that names an unknown estimator, and the beginning of the error reply. This reply lists the estimators of
/// the image.
const ESTIMATORS: [&str; 2] = ["estimator ?", "error: unknown estimator, allowed "];
/// The first commands that a board gets. They are sent again after the board was reset.
const GREETING: [&str; 4] = ["version", ESTIMATORS[0], "get", "status"];
/// How a person's finger holds the handle: with a light grip, and with at most this force.
const FINGER: Finger =
    Finger { target_m: 0.0, stiffness_n_per_m: 400.0, damping_n_s_per_m: 3.0, limit_n: 12.0 };

/// Access to the virtual board behind the link. `None` if the board is real.
pub type Virtual = Option<Arc<Wires>>;

/// A function that receives the telemetry's bytes.
pub type Tape = Box<dyn FnMut(&[u8]) -> Result<(), String> + Send>;

/// A clock. It returns the time since its start.
pub type Clock = Box<dyn Fn() -> Duration + Send + Sync>;

/// The state that pages and the communication with the board share.
pub struct Hub {
    history: Mutex<History>,
    known: Mutex<Known>,
    asked: Mutex<Asked>,
    /// `alive` may be sent to the board until this time.
    attended: Mutex<Duration>,
    ended: AtomicBool,
    board: Virtual,
    clock: Clock,
}

#[derive(Default)]
struct Asked {
    lines: VecDeque<String>,
    stops: Vec<(u64, Duration)>,
    /// Number of stops so far. Each [`Hub::stop`] counts.
    stopped: u64,
}

/// Locks the mutex, even if a thread has panicked with it.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    /// Starts the communication with a board in a new thread. `elf` is the program, which is needed to read the board's
    /// log. `record` also receives the telemetry.
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

    /// A hub without a thread. The caller must call [`Talk::turn`], which sends and receives.
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
            attended: Mutex::default(),
            ended: AtomicBool::new(false),
            board,
            clock,
        });
        let now = hub.now();
        let talk = Talk {
            hub: Arc::clone(&hub),
            link,
            // The memory of the table is never freed, because the decoder borrows the table. Each program has only one
            // table.
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

    /// Time since the hub started.
    pub fn now(&self) -> Duration {
        (self.clock)()
    }

    /// What is known about the board now.
    pub fn known(&self) -> MutexGuard<'_, Known> {
        lock(&self.known)
    }

    pub fn history(&self) -> MutexGuard<'_, History> {
        lock(&self.history)
    }

    /// Queues a line for the console. `stopped` is the number of [stops](Self::stopped) that the sender of the line
    /// knows.
    ///
    /// # Errors
    /// The queue is full, or there was a stop that the sender does not know.
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

    /// Sends `disarm` before everything else. Waiting lines are dropped.
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

    /// Number of stops so far.
    pub fn stopped(&self) -> u64 {
        lock(&self.asked).stopped
    }

    /// Moves the finger that holds a virtual board's handle. `target_m` is a position as the board measures it. With
    /// `None` the finger lets go.
    pub fn touch(&self, target_m: Option<f64>, resolution_m: f64) {
        let Some(board) = &self.board else { return };
        let offset_m = self.offset_m(resolution_m);
        board.touch(target_m.map(|target_m| Finger { target_m: target_m + offset_m, ..FINGER }));
    }

    /// Says that the owner's page is open until this time. If the page closes or the server hangs, no later time
    /// follows. Then the force goes off.
    pub fn attend(&self, until: Duration) {
        *lock(&self.attended) = until;
    }

    /// Opens or closes a virtual board's emergency stop.
    pub fn emergency_stop(&self, open: bool) {
        if let Some(board) = &self.board {
            board.emergency_stop(open);
        }
    }

    /// Present state of a virtual board's device, for the display.
    pub fn seen(&self) -> Option<Seen> {
        self.board.as_ref().map(|board| board.seen())
    }

    /// Offset from the board's positions to the scene's positions. The two positions are read one after the other while
    /// the handle moves, so the offset is rounded to 1 mm.
    fn offset_m(&self, resolution_m: f64) -> f64 {
        let record = self.known().record;
        let (Some(seen), Some(record)) = (self.seen(), record) else { return 0.0 };
        let offset_m = seen.position_m - f64::from(record.position.counts()) * resolution_m;
        (offset_m * 1e3).round() / 1e3
    }

    pub fn note(&self, text: &str) {
        self.known().say(From::Server, text.to_owned(), None);
    }

    /// Switches the force off and ends the thread.
    pub fn end(&self) {
        self.ended.store(true, Relaxed);
    }
}

/// The last command that was sent. Its reply has not come yet.
struct Pending {
    line: String,
    /// How the expected reply begins. `None` if any reply is accepted. Only questions of this program have a known
    /// beginning. With it, the reply to an earlier command is not taken for the reply to a question.
    begins: Option<String>,
    /// Whether the reply is shown to a person.
    loud: bool,
    since: Duration,
}

impl Pending {
    fn is_answered_by(&self, line: &str) -> bool {
        // A board that refuses its device record answers only the first question.
        let may_refuse = !self.loud && self.line != GREETING[0];
        let begins = |begins: &String| line.starts_with(begins);
        self.begins.as_ref().is_none_or(begins) || may_refuse && line.starts_with("error")
    }

    fn waits(&self) -> Duration {
        if self.line.trim() == "save" { SAVED } else { REPLY }
    }
}

pub struct Talk {
    hub: Arc<Hub>,
    link: Box<dyn Link>,
    log: Option<log::Decoder<'static>>,
    /// Bytes of the log that were received in the last turn.
    logged: Vec<u8>,
    record: Option<Tape>,
    decoder: telemetry::Decoder,
    pending: Option<Pending>,
    /// Bytes that are not sent yet, because the board had no room for them.
    unsent: Vec<u8>,
    /// Whether the board may have received an incomplete line. This is true at the start, because an earlier host may
    /// have sent one.
    begun: bool,
    /// Bytes of an incomplete reply.
    replies: Vec<u8>,
    /// Number of `alive` commands that the board has not answered yet.
    words: u32,
    /// Whether the board expects `alive` commands.
    promised: bool,
    word_at: Duration,
    status_at: Duration,
    quiet: VecDeque<&'static str>,
    stops: Vec<(u64, Duration)>,
    /// Console lines that the log will repeat. A line is removed when the log has repeated it.
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
        // All bytes must be sent, but the board may have little room for them. A board that reads nothing gets no
        // `alive`, so it switches off by itself.
        let end = Instant::now() + REPLY;
        while !self.unsent.is_empty() && Instant::now() < end {
            thread::sleep(LOOK);
            self.flush();
        }
        thread::sleep(10 * LOOK);
    }

    /// Reads the board's bytes and sends the next command. Returns false if the board is lost.
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

    /// Drops all bytes that wait to be sent, and sends `disarm` instead.
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
                // `alive` comes before `arm`, so that the force is never on without a time limit.
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

    /// Ends the wait for a reply. `why` says why no reply comes.
    fn give_up(&mut self, why: &str) {
        if let Some(Pending { line, .. }) = self.pending.take().filter(|pending| pending.loud) {
            self.hub.known().say(From::Server, format!("no reply to {line}: {why}"), Some(line));
        }
    }

    /// Handles a reset of the board. The board has lost the last command. What was known of the board's state is no
    /// longer valid.
    fn meet_again(&mut self) {
        self.give_up("the board was reset");
        self.hub.note("the board was reset");
        self.quiet = GREETING.into();
        (self.settings, self.promised, self.words) = (None, false, 0);
    }

    /// Sends `alive` while the force is on and the owner is present. Without the owner, switches the force off. If this
    /// program ends, the board gets no `alive` and switches off.
    fn keep_the_promise(&mut self, now: Duration) {
        if now.saturating_sub(self.word_at) < WORD {
            return;
        }
        let on = self.hub.known().is_on();
        let attended = now < *lock(&self.hub.attended);
        if on && attended {
            self.promise(PROMISE_MS, now);
        } else if on && self.promised {
            self.hub.note("nobody is there who may command: force off");
            self.hub.stop(0);
            self.word_at = now + 20 * WORD; // the next try if the force is still on; else the end of the time limit
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
        let is_answer = is_answer(&line);
        let answered = self.pending.take_if(|asked| is_answer && asked.is_answered_by(&line));
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
            // If the list is cut off, its last name may be incomplete.
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
            // The line is a reply to an earlier host's command.
            None if is_answer
                && self.pending.as_ref().is_some_and(|asked| asked.line == GREETING[0]) => {}
            None => known.say(From::Board, line, None),
        }
    }

    fn read_log(&mut self) {
        // Only the bytes of the previous turn are decoded now. The replies that came together with these bytes have
        // been read in the meantime.
        let bytes = std::mem::take(&mut self.logged);
        self.link.read(LOG, &mut self.logged);
        let Some(log) = &mut self.log else { return };
        // Log bytes that cannot be decoded are ignored. They may be from another program, or may begin in the middle of
        // a frame.
        for line in log.feed(&bytes).unwrap_or_default() {
            // The log repeats the console's lines. A long line is repeated in pieces.
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
