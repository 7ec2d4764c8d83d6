//! `cargo board fuzz`: its options and what it prints.

use std::{num::NonZero, path::PathBuf, thread};

use clap::Args;
use host_sim::{
    error::Error,
    output::terminal::{note, print_json, print_text},
    scene::NamedScene,
};
use serde::Serialize;
use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    session::Session,
};

use super::{
    campaign::{self, Outcome},
    instants::{self, EVENTS, Sweep, Wrong},
};

/// Options of the fuzz campaign.
#[derive(Args)]
pub struct Fuzz {
    #[arg(long, default_value = NUCLEO_F446RE.name, help = Board::names(" or "))]
    board: String,
    /// The firmware; built if not given.
    #[arg(long)]
    elf: Option<PathBuf>,
    /// Which sessions; the same number gives the same ones.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Commands in all, or a few more.
    #[arg(long, default_value_t = 2_000, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    commands: u64,
    /// Run this session, as a failing one was printed.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["seed", "commands"])]
    script: Option<PathBuf>,
    /// In place of sessions: stop, supply and reset between every two instructions of an output period, and asleep.
    #[arg(long, conflicts_with_all = ["seed", "commands", "script"])]
    instants: bool,
    /// One JSON object on stdout, and nothing else there.
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Json<'a> {
    board: &'static str,
    seed: u64,
    sessions: u64,
    commands: u64,
    replies: u64,
    frames: u64,
    outputs: u64,
    faults: u64,
    resets: u64,
    virtual_s: f64,
    wall_s: f64,
    difference: Option<Difference<'a>>,
}

#[derive(Serialize)]
struct Difference<'a> {
    what: &'a str,
    session: u64,
    after_commands: u64,
    after_s: f64,
    script: Vec<String>,
}

/// Runs it.
///
/// # Errors
/// Bad input, a difference, or Ctrl-C.
pub fn execute(options: &Fuzz) -> Result<(), Error> {
    // The board's own scene: what it is built for.
    let actions = options.script.as_ref().map(|path| campaign::script(path)).transpose()?;
    let board = Board::asked(&options.board)?;
    let session = Session::open(board, options.elf.as_ref(), NamedScene::load(board.name)?)?;
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    if options.instants {
        return instants_of(&session, options.json, threads);
    }
    let outcome = match &actions {
        Some(actions) => campaign::replay(&session, actions)?,
        None => campaign::sessions(&session, options.seed, options.commands, threads)?,
    };
    #[expect(clippy::cast_precision_loss, reason = "for people")]
    let virtual_s = outcome.counts.cycles as f64 / board.chip.core_hz as f64;
    if options.json {
        print(options.seed, board, &outcome, virtual_s)?;
    } else {
        say(options.seed, board, &outcome, virtual_s)?;
    }
    match outcome.failure {
        _ if outcome.interrupted => Err(Error::Interrupted),
        Some(failure) => {
            Err(Error::Internal(format!("session {}: {}", failure.session, failure.what)))
        }
        None => Ok(()),
    }
}

#[derive(Serialize)]
struct SweepJson {
    board: &'static str,
    events: [&'static str; 3],
    instants: u64,
    cycles_of_code: u64,
    cycles: u64,
    wall_s: f64,
    wrong: Vec<WrongJson>,
}

#[derive(Serialize)]
struct WrongJson {
    event: &'static str,
    cycle: u64,
    what: String,
}

fn instants_of(session: &Session, json: bool, threads: usize) -> Result<(), Error> {
    let Sweep { instants, cycles, period, wrong, wall_s } = instants::sweep(session, 1, threads)?;
    let (name, count) = (session.board.name, wrong.len());
    if json {
        let wrong =
            wrong.into_iter().map(|Wrong { event, cycle, what }| WrongJson { event, cycle, what });
        print_json(&SweepJson {
            board: name,
            events: EVENTS.map(|(_, name)| name),
            instants,
            cycles_of_code: cycles,
            cycles: period,
            wall_s,
            wrong: wrong.collect(),
        })?;
    } else {
        for Wrong { event, cycle, what } in &wrong {
            print_text(&format!("{event} at cycle {cycle}: {what}"))?;
        }
        note(&format!(
            "{name}: stop, supply, reset at {instants} instants each: all {cycles} cycles of code of the {period} of \
             an output period, and asleep; {count} wrong; {wall_s:.0} s"
        ));
    }
    if count == 0 {
        Ok(())
    } else {
        Err(Error::Internal(format!("{count} instants end in another fault")))
    }
}

fn say(seed: u64, board: Board, outcome: &Outcome, virtual_s: f64) -> Result<(), Error> {
    if let Some(failure) = &outcome.failure {
        print_text(&format!("# {}, seed {seed}, session {}", board.name, failure.session))?;
        print_text(&format!("# {}", failure.what.escape_default()))?;
        for action in &failure.actions {
            print_text(&action.to_string())?;
        }
        let (commands, seconds) = failure.found;
        note(&format!("found after {commands} commands, {seconds:.1} s"));
    }
    let c = outcome.counts;
    note(&format!(
        "{}: {} sessions, {} commands; {} replies, {} frames and {} outputs are the library's; {} faults, {} resets; \
         {virtual_s:.0} s on the board, {:.0} s here",
        board.name,
        outcome.sessions,
        c.commands,
        c.replies,
        c.frames,
        c.outputs,
        c.seen.faults,
        c.resets,
        outcome.wall_s,
    ));
    Ok(())
}

fn print(seed: u64, board: Board, outcome: &Outcome, virtual_s: f64) -> Result<(), Error> {
    let c = outcome.counts;
    let difference = outcome.failure.as_ref().map(|failure| Difference {
        what: &failure.what,
        session: failure.session,
        after_commands: failure.found.0,
        after_s: failure.found.1,
        script: failure.actions.iter().map(ToString::to_string).collect(),
    });
    print_json(&Json {
        board: board.name,
        seed,
        sessions: outcome.sessions,
        commands: c.commands,
        replies: c.replies,
        frames: c.frames,
        outputs: c.outputs,
        faults: c.seen.faults,
        resets: c.resets,
        virtual_s,
        wall_s: outcome.wall_s,
        difference,
    })
}
