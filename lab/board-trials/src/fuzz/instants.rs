//! Tries emergency stop, supply drop and reset at each instant of an output period. These instants are between every
//! two instructions, and some while the core sleeps. The board is armed and its handle is in the wall. Each event must
//! cause its own fault, and enable must be inactive in time.

use std::time::Instant;

use host_sim::{error::Error, interrupt};
use serde::Serialize;
use virtual_board::{
    session::{Session, ask, ask_each},
    world::{Ended, World},
};
use zwidth::telemetry::Decoder;

use super::rule;
use crate::threads::on_threads;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The emergency stop opens.
    Stop,
    /// The supply falls too low.
    Supply,
    /// The reset pin is pulled.
    Reset,
}

pub const EVENTS: [(Event, &str); 3] =
    [(Event::Stop, "stop"), (Event::Supply, "supply"), (Event::Reset, "reset")];

/// Number of cycles between two tried instants while the core sleeps.
const SLEEP: u64 = 500;
/// Time limit of the supply detector, in s (docs/faults.md).
const SUPPLY_S: f64 = 60e-6;
/// Number of samples within which the fault must be reported. `STARTED` is the number if the board has to start again.
const TOLD: u64 = 25;
const STARTED: u64 = 600;
/// A supply that is too low, in mV.
const LOW_MV: u32 = 2_000;
/// Number of pieces into which the period is divided. The threads share the pieces.
const PIECES: usize = 64;

/// An instant with a wrong result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Wrong {
    pub event: &'static str,
    /// Number of cycles from the start of the period to the instant.
    pub cycle: u64,
    pub what: String,
}

/// The result after all instants of an output period were tried on one board.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Sweep {
    /// Number of tried instants. Every event is tried at each instant.
    pub instants: u64,
    /// Number of cycles of the period in which instructions run. The sweep covers all these cycles.
    #[serde(rename = "cycles_of_code")]
    pub cycles: u64,
    /// Number of cycles in the whole period.
    #[serde(rename = "cycles")]
    pub period: u64,
    /// Duration, in s.
    pub wall_s: f64,
    /// Wrong results, in the order of their cycles.
    pub wrong: Vec<Wrong>,
}

/// Tries the events on one board. Only every `part`-th instant is tried.
///
/// # Errors
/// The board does not reach the state in which the events are tried, or the user pressed Ctrl-C.
pub fn sweep(session: &Session, part: u64, threads: usize) -> Result<Sweep, Error> {
    let begun = Instant::now();
    let start = pressed(session)?.snapshot();
    let period = 10 * session.board.cycles_per_sample();
    let pieces = on_threads(
        PIECES,
        threads,
        || Ok(session.boot()?),
        |world, piece| {
            world.restore(&start);
            let begin = world.powered.mcu.now();
            let ends = [piece, piece + 1].map(|n| begin + n as u64 * period / PIECES as u64);
            stretch(world, begin, ends, part)
        },
    )?;
    let mut sweep = Sweep { period, ..Sweep::default() };
    for piece in pieces {
        sweep.instants += piece.instants;
        sweep.cycles += piece.cycles;
        sweep.wrong.extend(piece.wrong);
    }
    sweep.wall_s = begun.elapsed().as_secs_f64();
    Ok(sweep)
}

/// An armed board whose handle is held 0.3 mm inside a wall.
fn pressed(session: &Session) -> Result<World<'_>, Error> {
    let mut world = session.boot()?;
    ask_each(&mut world, &["zero", "unlock envelope", "wall 0.005", "k 4000", "b 20", "arm"])?;
    world.run(4_000)?;
    world.lead(0.1);
    world.run(530)?;
    world.lead(0.0);
    world.run(100)?;
    let status = ask(&mut world, "status")?;
    let ready = status.starts_with("ok status armed, fault none") && status.contains("in contact");
    if ready {
        Ok(world)
    } else {
        Err(Error::Internal(format!("not pressed into its wall: {status}")))
    }
}

/// Tries the instants between the two cycles in `ends`. The period began at cycle `begin`.
fn stretch(world: &mut World<'_>, begin: u64, ends: [u64; 2], part: u64) -> Result<Sweep, Error> {
    let [from, to] = ends;
    let mut sweep = Sweep::default();
    let (mut last, mut number) = (from, 0);
    world.run_to(from)?;
    loop {
        let now = world.powered.mcu.now();
        if now >= to {
            return Ok(sweep);
        }
        interrupt::check()?;
        let asleep = world.powered.mcu.is_asleep();
        number += 1;
        if if asleep { now >= last + SLEEP } else { number % part == 0 } {
            last = now;
            sweep.instants += 1;
            let here = world.snapshot();
            for (event, name) in EVENTS {
                if let Err(what) = try_event(world, event) {
                    sweep.wrong.push(Wrong { event: name, cycle: now - begin, what });
                }
                world.restore(&here);
            }
        }
        world.run_to(now + 1)?;
        if !asleep {
            sweep.cycles += world.powered.mcu.now() - now;
        }
    }
}

/// Applies the event and checks its fault.
fn try_event(world: &mut World<'_>, event: Event) -> Result<(), String> {
    let ended = |ended: Ended| format!("the program ended: {ended:?}");
    world.probe().map_err(ended)?;
    world.telemetry.clear();
    let mcu = &mut world.powered.mcu;
    let (code, samples, within) = match event {
        Event::Stop => {
            world.emergency_stop(true);
            (30, TOLD, 0)
        }
        Event::Supply => {
            mcu.set_supply_mv(LOW_MV);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                clippy::cast_precision_loss,
                reason = "some ten thousand"
            )]
            let within = (SUPPLY_S * mcu.core_hz() as f64) as u64;
            (31, TOLD, within)
        }
        Event::Reset => {
            world.reset();
            (23, STARTED, 0)
        }
    };
    let off_by = world.powered.mcu.now() + within;
    world.run_to(off_by).map_err(ended)?;
    rule(!world.powered.amplifier.is_enabled(), || "enable is still active".into())?;
    let mut decoder = Decoder::new();
    for _ in 0..samples {
        world.sample().map_err(ended)?;
        world.probe().map_err(ended)?;
        rule(!world.powered.amplifier.is_enabled(), || "enable is active again".into())?;
        let bytes = std::mem::take(&mut world.telemetry);
        let faults: Vec<u8> = bytes
            .into_iter()
            .filter_map(|byte| decoder.push(byte))
            .map(|frame| frame.record.fault)
            .collect();
        if let Some(&fault) = faults.iter().find(|fault| **fault != 0) {
            return rule(fault == code, || format!("fault {fault}, should be {code}"));
        }
        let is_silent = event != Event::Reset || faults.is_empty();
        rule(is_silent, || "no fault after the reset".into())?;
    }
    Err(format!("fault {code} does not come"))
}
