//! `cargo board fuzz`: its options and its output.

use std::path::PathBuf;

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
    bursts::{Row, bursts},
    campaign::{self, Failure, Outcome},
    counts::Counts,
    instants::{self, EVENTS, Sweep, Wrong},
};
use crate::threads::cores;

/// Options of the fuzz campaign.
#[derive(Args)]
pub struct Fuzz {
    #[arg(long, default_value = NUCLEO_F446RE.name, help = Board::names(" or "))]
    board: String,
    /// The firmware's ELF. It is built if this option is missing.
    #[arg(long)]
    elf: Option<PathBuf>,
    /// Seed of the sessions. The same number gives the same sessions.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of commands in all sessions. The last session may send a few more.
    #[arg(long, default_value_t = 2_000, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    commands: u64,
    /// Run the session in this file. A failing session is printed in the same form.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["seed", "commands"])]
    script: Option<PathBuf>,
    /// Try emergency stop, supply drop and reset in place of sessions. They come between every two instructions of an
    /// output period, and while the core sleeps.
    #[arg(long, conflicts_with_all = ["seed", "commands", "script"])]
    instants: bool,
    /// Send this number of random bursts at each output period in place of sessions. A burst has up to 2,000 lines.
    #[arg(long, value_name = "N", conflicts_with_all = ["commands", "script", "instants"])]
    bursts: Option<u64>,
    /// Print one JSON object on stdout, and nothing else there.
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Json<'a> {
    board: &'static str,
    seed: u64,
    sessions: u64,
    #[serde(flatten)]
    counts: Counts,
    virtual_s: f64,
    wall_s: f64,
    difference: Option<&'a Failure>,
}

#[derive(Serialize)]
struct BurstsJson {
    board: &'static str,
    seed: u64,
    rows: Vec<Row>,
}

#[derive(Serialize)]
struct SweepJson {
    board: &'static str,
    events: [&'static str; 3],
    #[serde(flatten)]
    sweep: Sweep,
}

/// Runs the campaign.
///
/// # Errors
/// The input is bad, the board differs from the library, or the user pressed Ctrl-C.
pub fn execute(options: &Fuzz) -> Result<(), Error> {
    // The board's own scene, for which its image is built.
    let actions = options.script.as_ref().map(|path| campaign::script(path)).transpose()?;
    let board = Board::asked(&options.board)?;
    let session = Session::open(board, options.elf.as_ref(), NamedScene::load(board.name)?)?;
    let threads = cores();
    if options.instants {
        return instants_of(&session, options.json, threads);
    }
    if let Some(count) = options.bursts {
        return bursts_of(&session, options, count);
    }
    let outcome = match &actions {
        Some(actions) => campaign::replay(&session, actions)?,
        None => campaign::sessions(&session, options.seed, options.commands, threads)?,
    };
    say(options, board, &outcome)?;
    match outcome.failure {
        _ if outcome.interrupted => Err(Error::Interrupted),
        Some(failure) => {
            Err(Error::Internal(format!("session {}: {}", failure.session, failure.what)))
        }
        None => Ok(()),
    }
}

fn bursts_of(session: &Session, options: &Fuzz, count: u64) -> Result<(), Error> {
    let board = session.board.name;
    match bursts(session, options.seed, count)? {
        Ok(rows) if options.json => print_json(&BurstsJson { board, seed: options.seed, rows }),
        Ok(rows) => {
            for row in rows {
                let Row { period, bursts, lines, obeyed, refused, ignored, lost, outputs, .. } =
                    row;
                let Row { fed_ms, fed_saving_ms, output_us, link, link_saving, .. } = row;
                note(&format!(
                    "{board}, period {period}: {bursts} bursts, {lines} lines; {obeyed} obeyed, {refused} refused, {ignored} \
                     ignored, {lost} replies lost, both counted; \
                     {outputs} outputs, none missing, the latest after {output_us:.1} us; watchdog fed within \
                     {fed_ms:.1} ms, with a save {fed_saving_ms:.0} ms; link takes {:.1} %, with a save {:.1} %",
                    100.0 * link,
                    100.0 * link_saving
                ));
            }
            Ok(())
        }
        Err(failure) => {
            for action in &failure.actions {
                print_text(&action.to_string())?;
            }
            Err(Error::Internal(format!("burst {}: {}", failure.session, failure.what)))
        }
    }
}

fn instants_of(session: &Session, json: bool, threads: usize) -> Result<(), Error> {
    let sweep = instants::sweep(session, 1, threads)?;
    let (board, count) = (session.board.name, sweep.wrong.len());
    if json {
        print_json(&SweepJson { board, events: EVENTS.map(|(_, name)| name), sweep })?;
    } else {
        let Sweep { instants, cycles, period, wrong, wall_s } = sweep;
        for Wrong { event, cycle, what } in &wrong {
            print_text(&format!("{event} at cycle {cycle}: {what}"))?;
        }
        note(&format!(
            "{board}: stop, supply, reset at {instants} instants each: all {cycles} cycles of code of the {period} of \
             an output period, and asleep; {count} wrong; {wall_s:.0} s"
        ));
    }
    if count == 0 {
        Ok(())
    } else {
        Err(Error::Internal(format!("{count} instants end in another fault")))
    }
}

fn say(
    options: &Fuzz,
    Board { name: board, chip, .. }: Board,
    outcome: &Outcome,
) -> Result<(), Error> {
    let &Outcome { counts, sessions, ref failure, wall_s, .. } = outcome;
    let seed = options.seed;
    #[expect(clippy::cast_precision_loss, reason = "for people")]
    let virtual_s = counts.cycles as f64 / chip.core_hz as f64;
    if options.json {
        let difference = failure.as_ref();
        return print_json(&Json { board, seed, sessions, counts, virtual_s, wall_s, difference });
    }
    if let Some(Failure { what, session, after_commands, after_s, actions }) = failure {
        print_text(&format!("# {board}, seed {seed}, session {session}"))?;
        print_text(&format!("# {}", what.escape_default()))?;
        for action in actions {
            print_text(&action.to_string())?;
        }
        note(&format!("found after {after_commands} commands, {after_s:.1} s"));
    }
    let Counts { commands, replies, frames, outputs, faults, resets, .. } = counts;
    note(&format!(
        "{board}: {sessions} sessions, {commands} commands; {replies} replies, {frames} frames and {outputs} outputs are \
         the library's; {faults} faults, {resets} resets; {virtual_s:.0} s on the board, {wall_s:.0} s here"
    ));
    Ok(())
}
