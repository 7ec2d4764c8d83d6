//! A board behind a debug probe. The link uses RTT in the board's memory. This module uses a probe through a trait. The
//! drivers of probes are elsewhere.
//!
//! A probe halts the core when it attaches and when it detaches. A halt with the force on is fault 32. So the force
//! must be off before both halts. Before attaching, the caller must switch the force off. This link sends `disarm` as
//! its first line and as its last line. The probe detaches when the board has replied that the force is off.

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

/// Time after which the board is treated as lost if every access fails. A reset takes less time.
const PATIENCE: Duration = Duration::from_secs(1);
/// Longest wait for an answer. An answer usually takes some milliseconds. After a `save` it takes a second.
const ANSWER: Duration = Duration::from_secs(2);
/// Longest wait for the answer to the last `disarm`. After Ctrl-C a program has 0.4 s in all.
const LEAVE: Duration = Duration::from_millis(200);
/// Time between two checks of an idle board.
const LOOK: Duration = Duration::from_millis(1);
/// Number of compared bytes of the program. These bytes are the vectors, which differ after nearly every change of a
/// program.
const COMPARED: usize = 256;

/// A core that a probe has opened. Each error is one line of text.
pub trait Core: Memory<Error = String> {
    fn is_halted(&mut self) -> Result<bool, String>;
}

/// Operations that a debug probe must have.
pub trait Probe {
    /// Opens the core. Opening takes as long as several transfers, so one opening serves all channels.
    ///
    /// # Errors
    /// The core could not be reached. The error is one line of text.
    fn core(&mut self) -> Result<impl Core, String>;
}

/// State of a board when the probe attached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Met {
    /// The force is off and there is no fault.
    Off,
    /// The board reports fault 32. The halt by this probe, or an earlier halt by a debugger, has switched the force
    /// off.
    Halted,
    /// Another state, as the board's reply names it.
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

/// A board behind a probe that no other program uses.
pub struct ProbeLink<P: Probe> {
    probe: P,
    channels: Channels,
    /// Whether the last `disarm` was sent.
    left: bool,
}

impl<P: Probe> ProbeLink<P> {
    /// Takes over a probe that is attached to a board with the program `elf`. Sends `disarm` and asks for the state.
    ///
    /// # Errors
    /// The board has another program, does not run or does not answer. The error is one line of text.
    pub fn attach(mut probe: P, elf: &Elf) -> Result<(Self, Met), String> {
        let address = elf.address_of("_SEGGER_RTT").ok_or("the ELF has no symbol _SEGGER_RTT")?;
        compare(&mut probe.core()?, elf)?;
        let channels = Channels::met(&mut probe, Rtt::new(address))?;
        let mut link = Self { probe, channels, left: false };
        let unanswered = |why| format!("the board does not answer: {why}");
        if let Err(why) = link.disarm(ANSWER) {
            link.left = true; // do not send `disarm` again
            return Err(unanswered(why));
        }
        let is_status = |line: &str| line.starts_with("ok status");
        let status = link.ask(b"status\n", is_status, ANSWER).map_err(unanswered)?;
        Ok((link, Met::read(&status)))
    }

    /// Switches the force off and waits for the reply.
    fn disarm(&mut self, patience: Duration) -> Result<(), String> {
        // A board without a device record has no command `disarm`, and cannot arm.
        let is_off =
            |line: &str| line == "ok disarm" || line.starts_with("error: no device record");
        // The first newline ends a line that may have been begun. Otherwise `disarm` would become a part of that line.
        self.ask(b"\ndisarm\n", is_off, patience).map(drop)
    }

    /// Sends a line and waits for its answer. The line is also sent to a lost board.
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
        let _ = self.turn(b""); // the loop meets an error again
        self.channels.up[REPLIES].bytes.clear(); // old replies
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

    /// Sends as many bytes as have room and takes the received bytes. Returns how many bytes were sent.
    fn turn(&mut self, bytes: &[u8]) -> Result<usize, String> {
        let mut core = self.probe.core()?;
        let sent = if bytes.is_empty() { 0 } else { self.channels.send(&mut core, bytes)? };
        // The sent bytes are counted even if the reading fails. The next turn reads again.
        match self.channels.exchange(&mut core) {
            Err(error) if sent == 0 => Err(error),
            _ => Ok(sent),
        }
    }

    /// Handles an error. An error may be temporary, but after [`PATIENCE`] with errors only, the board is lost.
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

    /// Switches the force off for the last time and waits for the reply.
    fn leave(&mut self) -> Result<(), String> {
        if std::mem::replace(&mut self.left, true) {
            return Ok(());
        }
        self.disarm(LEAVE)
    }
}

impl<P: Probe + Send> Link for ProbeLink<P> {
    /// One access serves all channels. The next access is made when a channel is read for the second time.
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

/// Checks that the board's flash contains the program `elf`. In another program the channels and the log's messages
/// differ.
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

/// Waits between two checks. After Ctrl-C, returns an error, except while the program leaves the board.
fn rest(leaving: bool) -> Result<(), String> {
    thread::sleep(LOOK);
    let is_over = interrupt::is_requested() && !leaving;
    if is_over { Err("interrupted".to_owned()) } else { Ok(()) }
}
