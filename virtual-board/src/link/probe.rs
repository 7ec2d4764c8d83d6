//! A board behind a debug probe, by RTT in its memory. Probes themselves are elsewhere: here is what is done with one.
//!
//! A probe halts the core when it attaches and when it lets go. So the force is off before either: whoever attaches has
//! seen to it, and the first thing that is sent is `disarm`; the last one is `disarm`, too, and the probe is let go when
//! the board has said that it is off. A halt with the force on is fault 32.

use std::{
    thread,
    time::{Duration, Instant},
};

use host_sim::{interrupt, output::terminal::note};

use super::{COMMANDS, Link, REPLIES};
use crate::{
    elf::Elf,
    rtt::{Memory, Rtt},
};

use channels::Channels;

mod channels;
#[cfg(test)]
mod tests;

/// A board that gives no sign for so long is lost: a reset takes less.
const PATIENCE: Duration = Duration::from_secs(1);
/// An answer takes some milliseconds; behind a `save` a second.
const ANSWER: Duration = Duration::from_secs(2);
/// The same when leaving: a program that was interrupted has 0.4 s in all.
const LEAVE: Duration = Duration::from_millis(200);
/// Between two looks while nothing else is to be done.
const LOOK: Duration = Duration::from_millis(1);
/// Bytes of the program that are compared: the vectors, which nearly every change of a program moves.
const COMPARED: usize = 256;

/// A core that a probe has opened. What it says went wrong is one line.
pub trait Core: Memory<Error = String> {
    /// Whether it stands still.
    ///
    /// # Errors
    /// The probe cannot tell.
    fn is_halted(&mut self) -> Result<bool, String>;
}

/// What a debug probe has to be able to do.
pub trait Probe {
    /// Opens the core. That takes as long as several transfers, so one serves all channels.
    ///
    /// # Errors
    /// It could not be reached: one line.
    fn core(&mut self) -> Result<impl Core, String>;
}

/// How a board was met.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Met {
    /// Without force and without a fault.
    Off,
    /// With fault 32: a debugger's halt, this one or one before, has taken the force away.
    Halted,
    /// Otherwise: what it says of itself.
    Otherwise(String),
}

impl Met {
    fn read(status: &str) -> Self {
        if status.starts_with("ok status off, fault none") {
            Self::Off
        } else if status.contains(", fault 32 ") {
            Self::Halted
        } else {
            Self::Otherwise(status.to_owned())
        }
    }
}

impl std::fmt::Display for Met {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Off => f.write_str("the board is off"),
            Self::Halted => f.write_str(
                "the board has fault 32: it was halted while its force was on, by this probe or before. The force is \
                 off, as it has to be; `clear` before `arm`, and `disarm` before the next time",
            ),
            Self::Otherwise(status) => write!(f, "the board says: {status}"),
        }
    }
}

/// A board behind a probe that nobody else has.
pub struct ProbeLink<P: Probe> {
    probe: P,
    channels: Channels,
    /// `disarm` was said for the last time.
    left: bool,
}

impl<P: Probe> ProbeLink<P> {
    /// Takes over a probe that is attached to a board with that program. Sends `disarm`, and asks how the board is.
    ///
    /// # Errors
    /// It is another program, it does not run or it does not answer: one line.
    pub fn attach(mut probe: P, elf: &Elf) -> Result<(Self, Met), String> {
        let address = elf.address_of("_SEGGER_RTT").ok_or("the ELF has no symbol _SEGGER_RTT")?;
        compare(&mut probe.core()?, elf)?;
        let channels = Channels::met(&mut probe, Rtt::new(address))?;
        let mut link = Self { probe, channels, left: false };
        let unanswered = |why| format!("the board does not answer: {why}");
        if let Err(why) = link.disarm(ANSWER) {
            link.left = true; // it was tried
            return Err(unanswered(why));
        }
        let is_status = |line: &str| line.starts_with("ok status");
        let status = link.ask(b"status\n", is_status, ANSWER).map_err(unanswered)?;
        Ok((link, Met::read(&status)))
    }

    /// Switches the force off; waits for the reply.
    fn disarm(&mut self, patience: Duration) -> Result<(), String> {
        // Without a device record nothing can arm, and there is no such command.
        let is_off =
            |line: &str| line == "ok disarm" || line.starts_with("error: no device record");
        // A line that was begun ends here, as no command.
        self.ask(b"\ndisarm\n", is_off, patience).map(drop)
    }

    /// Sends a line and waits for one that answers it, even to a board that is lost.
    fn ask(
        &mut self,
        line: &[u8],
        is_answer: impl Fn(&str) -> bool,
        patience: Duration,
    ) -> Result<String, String> {
        let end = Instant::now() + patience;
        let before = self.channels.lost.take();
        let answer = self.ask_until(end, line, is_answer);
        self.channels.lost = before.or(self.channels.lost.take());
        for up in &mut self.channels.up {
            up.fresh = false;
        }
        answer
    }

    fn ask_until(
        &mut self,
        end: Instant,
        line: &[u8],
        is_answer: impl Fn(&str) -> bool,
    ) -> Result<String, String> {
        let _ = self.turn(b""); // the loop meets what is wrong again
        self.channels.up[REPLIES].bytes.clear(); // what is old
        let mut unsent = line;
        loop {
            let trouble = match self.turn(unsent) {
                Ok(sent) => {
                    unsent = &unsent[sent..];
                    None
                }
                Err(error) => Some(error),
            };
            let replies = &mut self.channels.up[REPLIES].bytes;
            while let Some(end) = replies.iter().position(|byte| *byte == b'\n') {
                let reply: Vec<u8> = replies.drain(..=end).collect();
                let reply = String::from_utf8_lossy(&reply).trim_end().to_owned();
                if is_answer(&reply) {
                    return Ok(reply);
                }
            }
            if Instant::now() > end {
                let line = String::from_utf8_lossy(line).trim().to_owned();
                return Err(trouble.unwrap_or_else(|| format!("no reply to `{line}`")));
            }
            if let Some(why) = &self.channels.lost {
                return Err(why.clone());
            }
            rest(self.left)?;
        }
    }

    /// Sends what has room, and takes what has come; how much was sent.
    fn turn(&mut self, bytes: &[u8]) -> Result<usize, String> {
        let mut core = self.probe.core()?;
        let sent = if bytes.is_empty() { 0 } else { self.channels.send(&mut core, bytes)? };
        // What was sent is sent, whatever comes of the rest: that is tried again with the next turn.
        match self.channels.exchange(&mut core) {
            Err(error) if sent == 0 => Err(error),
            _ => Ok(sent),
        }
    }

    /// Whatever goes wrong may pass, but not for ever.
    fn weigh<T>(&mut self, result: Result<T, String>) -> Option<T> {
        let error = match result {
            Ok(value) => {
                self.channels.failing = None;
                return Some(value);
            }
            Err(error) => error,
        };
        let since = *self.channels.failing.get_or_insert_with(Instant::now);
        if since.elapsed() > PATIENCE {
            self.channels.lost.get_or_insert(error);
        }
        None
    }

    /// Force off, acknowledged, for the last time.
    fn leave(&mut self) -> Result<(), String> {
        if std::mem::replace(&mut self.left, true) {
            return Ok(());
        }
        self.disarm(LEAVE)
    }
}

impl<P: Probe + Send> Link for ProbeLink<P> {
    /// One look serves all channels, each once.
    fn read(&mut self, channel: usize, into: &mut Vec<u8>) {
        if self.channels.up.get(channel).is_some_and(|up| !up.fresh) && self.lost().is_none() {
            let looked = self.probe.core().and_then(|mut core| self.channels.exchange(&mut core));
            self.weigh(looked);
        }
        if let Some(up) = self.channels.up.get_mut(channel) {
            up.fresh = false;
            into.append(&mut up.bytes);
        }
    }

    fn write(&mut self, channel: usize, bytes: &[u8]) -> usize {
        if channel != COMMANDS || bytes.is_empty() || self.lost().is_some() {
            return 0;
        }
        let sent = self.probe.core().and_then(|mut core| self.channels.send(&mut core, bytes));
        self.weigh(sent).unwrap_or(0)
    }

    fn lost(&self) -> Option<String> {
        self.channels.lost.clone()
    }
}

impl<P: Probe> Drop for ProbeLink<P> {
    fn drop(&mut self) {
        if let Err(why) = self.leave() {
            note(&format!(
                "the board has not acknowledged disarm: {why}. Letting go of it halts it, which takes the force away; \
                 see that it is off, and use the wired stop"
            ));
        }
    }
}

/// Whether that program is in the board's flash: another one has its channels and its log elsewhere.
fn compare(core: &mut impl Core, elf: &Elf) -> Result<(), String> {
    let Some((address, program)) = elf.flash.iter().min_by_key(|(address, _)| *address) else {
        return Err("the ELF has nothing for the flash".to_owned());
    };
    let program = &program[..program.len().min(COMPARED)];
    let mut flash = vec![0; program.len()];
    core.read(*address, &mut flash)?;
    match (0..).zip(program.iter().zip(&flash)).find(|(_, (wanted, found))| wanted != found) {
        None => Ok(()),
        Some((offset, (wanted, found))) => Err(format!(
            "the board runs another program than this ELF: flash has 0x{found:02x} at 0x{:08x}, the ELF \
             0x{wanted:02x}. Flash this one, or give the other one's file with --elf",
            address + offset
        )),
    }
}

/// Between two looks; a program that shall end goes on only to leave.
fn rest(leaving: bool) -> Result<(), String> {
    thread::sleep(LOOK);
    let is_over = interrupt::is_requested() && !leaving;
    if is_over { Err("interrupted".to_owned()) } else { Ok(()) }
}
