//! A simulated board behind a probe, at the level of its memory. The simulated board answers as the firmware does, and
//! can fail.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{channels::QUIET, *};
use crate::link::{LOG, TELEMETRY};

const RAM: u32 = 0x2000_0000;
const BLOCK: u32 = RAM + 0x100;
const BUFFERS: [[u32; 2]; 4] =
    [[RAM + 0x400, 64], [RAM + 0x500, 64], [RAM + 0x600, 256], [RAM + 0x800, 32]];
const FLASH: u32 = 0x0800_0000;
const OFF: &str = "ok status off, fault none, idle, sample 42";

/// What a failing write has done in memory.
#[derive(Clone, Copy, PartialEq)]
enum Effect {
    Nothing,
    All,
}

struct State {
    ram: Vec<u8>,
    flash: Vec<u8>,
    status: &'static str,
    has_record: bool,
    halted: bool,
    /// Whether the program reads no commands.
    busy: bool,
    begun: String,
    /// Lines that the program obeyed.
    obeyed: Vec<String>,
    looks: u32,
    /// Whether every access fails from now on.
    gone: bool,
    /// The address at which the next write fails, and what this write does before it fails.
    fails: Option<(u32, Effect)>,
    gone_after: bool,
    let_go: bool,
}

#[derive(Clone)]
struct Bench(Arc<Mutex<State>>);

impl State {
    fn word(&self, at: u32) -> u32 {
        let at = (at - RAM) as usize;
        u32::from_le_bytes(self.ram[at..at + 4].try_into().unwrap())
    }

    fn set(&mut self, at: u32, word: u32) {
        let at = (at - RAM) as usize;
        self.ram[at..at + 4].copy_from_slice(&word.to_le_bytes());
    }

    fn start(&mut self) {
        self.begun.clear();
        self.ram.fill(0);
        self.set(BLOCK + 16, 3);
        self.set(BLOCK + 20, 1);
        for (n, [buffer, size]) in (0..).zip(BUFFERS) {
            self.set(BLOCK + 24 + 24 * n + 4, buffer);
            self.set(BLOCK + 24 + 24 * n + 8, size);
        }
        let id = (BLOCK - RAM) as usize;
        self.ram[id..id + 10].copy_from_slice(b"SEGGER RTT");
    }

    fn says(&mut self, channel: u32, bytes: &[u8]) {
        let [buffer, size] = BUFFERS[channel as usize];
        let write = BLOCK + 24 + 24 * channel + 12;
        for byte in bytes {
            let at = self.word(write);
            self.ram[(buffer + at - RAM) as usize] = *byte;
            self.set(write, (at + 1) % size);
            assert_ne!(self.word(write), self.word(write + 4), "the test says too much");
        }
    }

    /// Runs the program until it has read all commands.
    fn run(&mut self) {
        let [buffer, size] = BUFFERS[3];
        let read = BLOCK + 24 + 24 * 3 + 16;
        while !self.halted && !self.busy && self.word(read) != self.word(read - 4) {
            let at = self.word(read);
            let byte = char::from(self.ram[(buffer + at - RAM) as usize]);
            self.set(read, (at + 1) % size);
            if byte != '\n' {
                self.begun.push(byte);
                continue;
            }
            let line = std::mem::take(&mut self.begun);
            let reply = match &*line {
                "" => continue,
                "status" => self.status.to_owned(),
                _ if !self.has_record => "error: no device record: there is none".to_owned(),
                line => format!("ok {line}"),
            };
            self.obeyed.push(line);
            self.says(2, format!("{reply}\n").as_bytes());
        }
    }
}

impl Bench {
    fn new() -> Self {
        let mut state = State {
            ram: vec![0; 0x1000],
            flash: (0..=255).collect(),
            status: OFF,
            has_record: true,
            halted: false,
            busy: false,
            begun: String::new(),
            obeyed: vec![],
            looks: 0,
            gone: false,
            fails: None,
            gone_after: false,
            let_go: false,
        };
        state.start();
        Self(Arc::new(Mutex::new(state)))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn elf() -> Elf {
        Elf {
            bytes: vec![],
            flash: vec![(FLASH, (0..=255).chain(0..=9).collect())],
            symbols: vec![("_SEGGER_RTT".to_owned(), BLOCK, 120)],
            sections: vec![],
        }
    }

    fn attach(&self) -> Result<(ProbeLink<Self>, Met), String> {
        ProbeLink::attach(Self(Arc::clone(&self.0)), &Self::elf())
    }

    fn attached(&self) -> ProbeLink<Self> {
        self.attach().map(|(link, _)| link).unwrap()
    }

    fn refused(&self) -> String {
        self.attach().map(|(_, met)| met).unwrap_err()
    }
}

impl Memory for Opened<'_> {
    type Error = String;

    fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), String> {
        let mut state = self.0.state();
        if state.gone {
            return Err("the cable".to_owned());
        }
        state.looks += u32::from(address == BLOCK);
        state.run();
        let (memory, start) = if address < RAM { (&state.flash, FLASH) } else { (&state.ram, RAM) };
        let at = (address - start) as usize;
        into.copy_from_slice(&memory[at..at + into.len()]);
        Ok(())
    }

    fn write(&mut self, address: u32, from: &[u8]) -> Result<(), String> {
        let mut state = self.0.state();
        if state.gone {
            return Err("the cable".to_owned());
        }
        let effect = state.fails.filter(|(at, _)| *at == address).map(|(_, effect)| effect);
        if effect != Some(Effect::Nothing) {
            let at = (address - RAM) as usize;
            state.ram[at..at + from.len()].copy_from_slice(from);
        }
        if effect.is_some() {
            state.fails = None;
            state.gone = state.gone_after;
            return Err("a bad moment".to_owned());
        }
        Ok(())
    }
}

impl Probe for Bench {
    fn core(&mut self) -> Result<impl Core, String> {
        if self.state().gone {
            return Err("the cable".to_owned());
        }
        Ok(Opened(self))
    }
}

struct Opened<'a>(&'a Bench);

impl Core for Opened<'_> {
    fn is_halted(&mut self) -> Result<bool, String> {
        let state = self.0.state();
        if state.gone { Err("the cable".to_owned()) } else { Ok(state.halted) }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        // The test and the link share this state.
        self.state().let_go = true;
    }
}

/// Reads a channel twice. The second read always causes an access.
fn look(link: &mut ProbeLink<Bench>) {
    for _ in 0..2 {
        link.read(LOG, &mut vec![]);
    }
}

fn loses(link: &mut ProbeLink<Bench>) -> String {
    let end = Instant::now() + Duration::from_secs(5);
    loop {
        look(link);
        if let Some(why) = link.lost() {
            return why;
        }
        assert!(Instant::now() < end, "it is still there");
        thread::sleep(LOOK);
    }
}

fn heard(link: &mut ProbeLink<Bench>, channel: usize) -> String {
    let mut bytes = vec![];
    link.read(channel, &mut bytes);
    String::from_utf8(bytes).unwrap()
}

#[test]
fn the_force_is_off_before_anything_else_and_before_the_probe_is_let_go() {
    let bench = Bench::new();
    bench.state().begun.push_str("arm"); // part of a line from an earlier host
    let (link, met) = bench.attach().unwrap();
    assert_eq!(met, Met::Off);
    assert_eq!(bench.state().obeyed, ["arm", "disarm", "status"]);
    assert!(!bench.state().let_go);
    drop(link);
    assert_eq!(bench.state().obeyed[3..], ["disarm"]);
    assert!(bench.state().let_go);
    // A program that panics also sends the last `disarm`.
    let link = bench.attached();
    let panicked = thread::spawn(move || {
        let _link = link;
        std::panic::resume_unwind(Box::new(()));
    });
    assert!(panicked.join().is_err());
    assert_eq!(bench.state().obeyed[4..], ["disarm", "status", "disarm"]);
}

#[test]
fn a_halt_is_told_from_a_board_that_was_off_and_no_record_is_off() {
    let bench = Bench::new();
    let halted = "ok status fault, fault 32 (debugger halt), idle";
    bench.state().status = halted;
    let met = bench.attach().unwrap().1;
    assert_eq!(met, Met::Halted);
    assert!(met.to_string().contains("`clear` before `arm`"));
    let other = "ok status fault, fault 30 (emergency stop), idle";
    bench.state().status = other;
    assert_eq!(bench.attach().unwrap().1, Met::Otherwise(other.to_owned()));
    bench.state().status = "ok status off, no device record: there is none";
    bench.state().has_record = false;
    assert!(matches!(bench.attach().unwrap().1, Met::Otherwise(_)));
}

#[test]
fn one_look_serves_three_channels_and_bytes_keep_their_order() {
    let bench = Bench::new();
    let mut link = bench.attached();
    let mut all = [const { String::new() }; 3];
    for n in 0..40 {
        for channel in 0..3 {
            bench.state().says(channel, format!("{channel}:{n} ").as_bytes());
        }
        let before = bench.state().looks;
        for channel in [REPLIES, LOG, TELEMETRY] {
            let said = heard(&mut link, channel);
            all[channel].push_str(&said);
        }
        assert_eq!(bench.state().looks - before, 1);
    }
    for (channel, text) in all.iter().enumerate() {
        let expected: String = (0..40).map(|n| format!("{channel}:{n} ")).collect();
        assert_eq!(*text, expected);
    }
    link.read(7, &mut vec![]);
    assert_eq!(link.write(1, b"get\n"), 0, "there is one down channel");
}

#[test]
fn what_does_not_fit_is_sent_later() {
    let bench = Bench::new();
    let mut link = bench.attached();
    bench.state().busy = true;
    let line = b"a line of more than thirty-one bytes\n";
    let first = link.write(COMMANDS, line);
    assert_eq!(first, 31, "one of 32 stays free");
    assert_eq!(link.write(COMMANDS, &line[first..]), 0);
    bench.state().busy = false;
    look(&mut link);
    assert_eq!(link.write(COMMANDS, &line[first..]), line.len() - first);
    look(&mut link);
    let text = std::str::from_utf8(line).unwrap().trim();
    assert_eq!(bench.state().obeyed.last().unwrap(), text);
}

#[test]
fn an_error_that_passes_takes_no_byte_and_doubles_none() {
    let bench = Bench::new();
    let mut link = bench.attached();
    let mut all = heard(&mut link, TELEMETRY);
    for (n, effect) in [(0, Effect::Nothing), (1, Effect::All), (2, Effect::Nothing)] {
        bench.state().says(1, format!("{n} before ").as_bytes());
        bench.state().fails = Some((BLOCK + 24 + 24 + 16, effect));
        all.push_str(&heard(&mut link, TELEMETRY));
        bench.state().gone = true;
        all.push_str(&heard(&mut link, TELEMETRY));
        thread::sleep(PATIENCE / 2); // twice this time is longer than the limit
        all.push_str(&heard(&mut link, TELEMETRY));
        bench.state().gone = false;
        bench.state().says(1, format!("{n} after ").as_bytes());
        all.push_str(&heard(&mut link, TELEMETRY));
    }
    assert_eq!(link.lost(), None);
    assert_eq!(all, "0 before 0 after 1 before 1 after 2 before 2 after ");
}

#[test]
fn no_command_is_sent_twice() {
    let bench = Bench::new();
    let mut link = bench.attached();
    let down = BLOCK + 24 + 24 * 3 + 12;
    for effect in [Effect::Nothing, Effect::All] {
        bench.state().obeyed.clear();
        bench.state().fails = Some((down, effect));
        let mut unsent = &b"hit\n"[..];
        while !unsent.is_empty() {
            unsent = &unsent[link.write(COMMANDS, unsent)..];
        }
        look(&mut link);
        assert_eq!(bench.state().obeyed, ["hit"]);
    }
    assert_eq!(link.lost(), None);
    bench.state().fails = Some((down, Effect::All));
    bench.state().gone_after = true;
    assert_eq!(link.write(COMMANDS, b"hit\n"), 0);
    assert!(link.lost().unwrap().contains("nobody knows whether a command"));
    assert_eq!(link.write(COMMANDS, b"hit\n"), 0);
    // A lost board stays lost. But the link still sends `disarm` to a lost board if an access succeeds.
    bench.state().gone = false;
    drop(link);
    assert_eq!(bench.state().obeyed, ["hit", "hit", "disarm"]);
}

#[test]
fn a_probe_that_disappears_is_lost_and_nobody_waits_for_it() {
    let bench = Bench::new();
    let mut link = bench.attached();
    bench.state().gone = true;
    let begun = Instant::now();
    assert_eq!(loses(&mut link), "the cable");
    assert!(begun.elapsed() >= PATIENCE);
    let begun = Instant::now();
    drop(link);
    assert!(begun.elapsed() < LEAVE * 3);
    assert_eq!(bench.refused(), "the cable");
}

#[test]
fn a_board_that_was_reset_goes_on_and_one_that_stays_in_reset_is_lost() {
    let bench = Bench::new();
    let mut link = bench.attached();
    bench.state().says(1, b"before ");
    assert_eq!(heard(&mut link, TELEMETRY), "before ");
    bench.state().ram.fill(0);
    look(&mut link);
    assert_eq!(link.write(COMMANDS, b"get\n"), 0);
    thread::sleep(PATIENCE / 5);
    bench.state().start();
    bench.state().says(1, b"after");
    assert_eq!(heard(&mut link, TELEMETRY), "after");
    assert_eq!(link.write(COMMANDS, b"get\n"), 4);
    look(&mut link);
    assert_eq!(bench.state().obeyed.last().unwrap(), "get");
    assert_eq!(link.lost(), None);
    bench.state().ram.fill(0);
    assert!(loses(&mut link).contains("no RTT control block at 0x20000100 any more"));
}

#[test]
fn another_program_after_a_reset_is_not_taken_for_the_board() {
    let bench = Bench::new();
    let mut link = bench.attached();
    bench.state().set(BLOCK + 24 + 4, RAM + 0x900);
    assert!(loses(&mut link).contains("other buffers"));
}

#[test]
fn a_halted_core_is_lost_and_none_is_met() {
    let bench = Bench::new();
    let mut link = bench.attached();
    thread::sleep(QUIET * 2);
    look(&mut link);
    assert_eq!(link.lost(), None, "silence alone is no halt");
    bench.state().halted = true;
    assert!(loses(&mut link).contains("has to be reset"));
    drop(link);
    assert!(bench.refused().contains("the board does not answer: the core is halted"));
    bench.state().ram.fill(0);
    assert!(bench.refused().starts_with("the core is halted"));
}

#[test]
fn a_second_reader_is_found() {
    let bench = Bench::new();
    let mut link = bench.attached();
    bench.state().says(1, b"for two");
    bench.state().set(BLOCK + 24 + 24 + 16, 3);
    assert!(loses(&mut link).contains("another program reads up channel 1"));
}

#[test]
fn another_program_or_none_is_said_with_where_it_was_looked_for() {
    let bench = Bench::new();
    bench.state().flash[7] = 0;
    let why = bench.refused();
    assert!(why.contains("0x00 at 0x08000007, the ELF 0x07"), "{why}");
    bench.state().flash[7] = 7;
    bench.state().set(BLOCK + 16, 1);
    let why = bench.refused();
    assert!(why.contains("at 0x20000100 names 1 channels up and 1 down"), "{why}");
    bench.state().ram.fill(0);
    let why = bench.refused();
    assert!(why.contains("no RTT control block at 0x20000100, where the program"), "{why}");
    bench.state().start();
    bench.state().busy = true;
    assert_eq!(bench.refused(), "the board does not answer: no reply to `disarm`");
    let elf = Elf { symbols: vec![], ..Bench::elf() };
    let refused = ProbeLink::attach(Bench::new(), &elf).map(|(_, met)| met);
    assert_eq!(refused, Err("the ELF has no symbol _SEGGER_RTT".to_owned()));
    assert!(bench.state().obeyed.is_empty());
}
