//! `cargo board serve --gdb`: connects gdb to the virtual board. gdb halts the core as a debug probe does. In a halt
//! the plant stands still. Each peripheral whose DBGMCU bit is clear runs on for the real time of the halt.

mod registers;
mod target;
mod wire;

use std::{
    io,
    net::{TcpListener, TcpStream},
    thread,
    time::{Duration, Instant},
};

use gdbstub::{
    common::Signal,
    conn::Connection as _,
    stub::{
        DisconnectReason, GdbStub, SingleThreadStopReason,
        state_machine::GdbStubStateMachine::{CtrlCInterrupt, Disconnected, Idle, Running},
    },
};
use host_sim::output::terminal::note;

use self::{target::Debugged, wire::Wire};
use super::PATIENCE;
use crate::{
    mcu::{Met, Stops},
    session::Failed,
    world::{Ended, World},
};

/// Time between two checks for bytes of the client during a halt.
const LOOK: Duration = Duration::from_micros(200);

/// What the board's thread does while gdb is connected.
pub(super) trait Board {
    /// Runs a millisecond in real time. It ends earlier if the core meets a condition of `stops`.
    fn slice(&mut self, world: &mut World<'_>, stops: &Stops) -> Result<Option<Met>, Ended>;
    /// Serves the channels in a halt. Returns false if the board is to be switched off.
    fn stands(&mut self, world: &mut World<'_>) -> bool;
    /// Called when the board runs again. The time of the halt is not simulated afterwards.
    fn goes_on(&mut self);
}

/// The port for gdb, and a client that has connected but sent nothing yet.
pub(super) struct Port {
    listener: TcpListener,
    silent: Option<(TcpStream, Instant)>,
}

impl Port {
    pub(super) fn new(listener: TcpListener) -> Self {
        Self { listener, silent: None }
    }

    /// Checks for a client and serves the client until the client disconnects. A client halts the board only when the
    /// client sends a byte.
    pub(super) fn look(
        &mut self,
        world: &mut World<'_>,
        board: &mut impl Board,
    ) -> Result<(), Failed> {
        if self.silent.is_none() {
            let Ok((client, _)) = self.listener.accept() else { return Ok(()) };
            let ready = client.set_nonblocking(true).and_then(|()| client.set_nodelay(true));
            self.silent = ready.ok().map(|()| (client, Instant::now()));
        }
        let Some((client, since)) = &self.silent else { return Ok(()) };
        match client.peek(&mut [0]) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                if since.elapsed() > PATIENCE {
                    self.silent = None;
                }
                Ok(())
            }
            Ok(1) => {
                let client = self.silent.take();
                client.map_or(Ok(()), |(client, _)| attend(client, world, board))
            }
            _ => {
                self.silent = None;
                Ok(())
            }
        }
    }
}

/// Serves a client from its first byte to its last. Afterwards the board runs in every case.
fn attend(client: TcpStream, world: &mut World<'_>, board: &mut impl Board) -> Result<(), Failed> {
    note("gdb: attached, the core is halted");
    let mut target = Debugged::new(world);
    let ended = serve(client, &mut target, board);
    target.go_on();
    board.goes_on();
    match ended {
        Ok(DisconnectReason::Kill) => {
            world.reset();
            note("gdb: killed, the board is reset");
        }
        Ok(_) => note("gdb: detached, the board goes on"),
        Err(text) => note(&format!("gdb: {text}; the board goes on")),
    }
    Ok(())
}

fn serve(
    client: TcpStream,
    target: &mut Debugged<'_, '_>,
    board: &mut impl Board,
) -> Result<DisconnectReason, String> {
    let stub = GdbStub::new(Wire::new(client));
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    let mut gdb = stub.run_state_machine(target).map_err(|error| failed(&error))?;
    loop {
        gdb = match gdb {
            Idle(mut idle) => match idle.borrow_conn().byte().map_err(|error| failed(&error))? {
                Some(byte) => idle.incoming_data(target, byte).map_err(|error| failed(&error))?,
                None => {
                    target.stay();
                    if !board.stands(target.world) {
                        return Err("the board is switched off".to_owned());
                    }
                    thread::sleep(LOOK);
                    idle.into()
                }
            },
            Running(mut running) => {
                if let Some(byte) = running.borrow_conn().byte().map_err(|error| failed(&error))? {
                    gdb = running.incoming_data(target, byte).map_err(|error| failed(&error))?;
                    continue;
                }
                match run(target, board)? {
                    None => running.into(),
                    Some(reason) => {
                        target.stop();
                        running.report_stop(target, reason).map_err(|error| failed(&error))?
                    }
                }
            }
            CtrlCInterrupt(interrupt) => {
                target.stop();
                let reason = Some(SingleThreadStopReason::Signal(Signal::SIGINT));
                interrupt.interrupt_handled(target, reason).map_err(|error| failed(&error))?
            }
            Disconnected(mut over) => {
                let reason = over.get_reason();
                if reason == DisconnectReason::Kill {
                    // gdb expects an answer to vKill, which the crate does not send.
                    let wire = over.borrow_conn();
                    let _ = wire.write_all(b"$OK#9a").and_then(|()| wire.flush());
                }
                return Ok(reason);
            }
        };
    }
}

/// Runs a slice of the board. Returns the reason of a stop for gdb, if there is one.
fn run(
    target: &mut Debugged<'_, '_>,
    board: &mut impl Board,
) -> Result<Option<SingleThreadStopReason<u32>>, String> {
    let stops = target.stops().clone();
    match board.slice(target.world, &stops) {
        Ok(None) => Ok(None),
        Ok(Some(Met::Step)) => Ok(Some(SingleThreadStopReason::DoneStep)),
        Ok(Some(met)) if target.is_hardware(met) => Ok(Some(SingleThreadStopReason::HwBreak(()))),
        Ok(Some(_)) => Ok(Some(SingleThreadStopReason::SwBreak(()))),
        // The core locked up. gdb can still examine the reason.
        Err(Ended::Stopped(_)) => Ok(Some(SingleThreadStopReason::Signal(Signal::SIGSEGV))),
        Err(ended) => Err(format!("the firmware: {ended:?}")),
    }
}
