//! The bytes from and to gdb.

use std::{
    io::{self, ErrorKind, Read as _},
    net::TcpStream,
    thread,
};

use gdbstub::conn;

use super::super::{LOOK, PATIENCE, at_once};

/// A client of the port. Reading never waits.
pub(super) struct Wire {
    stream: TcpStream,
    out: Vec<u8>,
    taken: Vec<u8>,
}

impl Wire {
    pub(super) fn new(stream: TcpStream) -> Self {
        Self { stream, out: Vec::new(), taken: Vec::new() }
    }

    pub(super) fn byte(&mut self) -> io::Result<Option<u8>> {
        if self.taken.is_empty() {
            let mut bytes = [0; 4096];
            match at_once(self.stream.read(&mut bytes))? {
                Some(0) => return Err(ErrorKind::UnexpectedEof.into()),
                count => self.taken.extend(bytes[..count.unwrap_or(0)].iter().rev()),
            }
        }
        Ok(self.taken.pop())
    }
}

impl conn::Connection for Wire {
    type Error = io::Error;

    fn write(&mut self, byte: u8) -> io::Result<()> {
        self.out.push(byte);
        Ok(())
    }

    /// Sends the waiting bytes. A client that reads nothing for too long is disconnected.
    fn flush(&mut self) -> io::Result<()> {
        let mut looks = 0;
        while !self.out.is_empty() {
            match at_once(io::Write::write(&mut self.stream, &self.out))? {
                Some(count) => {
                    self.out.drain(..count);
                    looks = 0;
                }
                None if LOOK * looks > PATIENCE => return Err(ErrorKind::TimedOut.into()),
                None => {
                    looks += 1;
                    thread::sleep(LOOK);
                }
            }
        }
        Ok(())
    }
}
