//! The host of the board. It reads the board's output and sends commands through the RTT channels.

use zwidth::console::Unread;

use super::{Ended, World};
use crate::board::Powered;

impl World<'_> {
    /// Reads the RTT channels.
    ///
    /// # Errors
    /// The log cannot be decoded.
    pub fn probe(&mut self) -> Result<(), Ended> {
        let Powered { mcu, rtt, .. } = &mut self.powered;
        let log = rtt.read(mcu, 0);
        self.telemetry.extend(rtt.read(mcu, 1));
        let replies = rtt.read(mcu, 2);
        self.replies.push_str(&String::from_utf8_lossy(&replies));
        self.lines.extend(self.log.feed(&log)?);
        Ok(())
    }

    /// Sends a line and returns the next line that begins with `ok` or `error`. This is its reply, or the report of an
    /// experiment that it ends. The line that counts unread replies is left out.
    ///
    /// # Errors
    /// There was no reply within 0.1 s, or an error of [`sample`](Self::sample).
    pub fn ask(&mut self, line: &str) -> Result<String, Ended> {
        self.replies.clear();
        self.send(&format!("{line}\n"))?;
        loop {
            let reply = self.reply(1_000)?;
            let is_said = reply.starts_with("ok") || reply.starts_with("error");
            if is_said && reply.parse::<Unread>().is_err() {
                return Ok(reply);
            }
        }
    }

    /// Puts bytes into the command channel.
    ///
    /// # Errors
    /// The channel had no room within 0.1 s.
    pub fn send(&mut self, bytes: &str) -> Result<(), Ended> {
        let mut rest = bytes.as_bytes();
        for _ in 0..1_000 {
            let Powered { mcu, rtt, .. } = &mut self.powered;
            let written = rtt.write(mcu, 0, rest);
            rest = &rest[written..];
            if rest.is_empty() {
                return Ok(());
            }
            self.sample()?;
        }
        Err(Ended::Timeout)
    }

    /// Waits for the next reply, for `samples` samples at most.
    ///
    /// # Errors
    /// No reply came, or an error of [`sample`](Self::sample).
    pub fn reply(&mut self, samples: u64) -> Result<String, Ended> {
        for _ in 0..samples.div_ceil(10) {
            self.run(10)?;
            if let Some((line, rest)) = self.replies.split_once('\n') {
                let line = line.to_owned();
                self.replies = rest.to_owned();
                return Ok(line);
            }
        }
        Err(Ended::Timeout)
    }
}
