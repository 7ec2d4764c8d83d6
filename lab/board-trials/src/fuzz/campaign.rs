//! Runs many sessions, one after another on each core, and collects their results.

use std::{
    path::Path,
    sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
    time::Instant,
};

use host_sim::{error::Error, input, interrupt};
use serde::Serialize;
use virtual_board::{device, session::Session};
use zwidth::period::PERIODS;

use super::{
    action::{Action, FORMS},
    counts::Counts,
    generate::{Situation, next},
    run::{End, Run},
    shrink::shrink,
};
use crate::{random::Random, threads::on_threads};

/// Approximate number of commands in a session.
const SESSION: u64 = 150;

/// A session in which the board and the library differed.
#[derive(Clone, Debug, Serialize)]
pub struct Failure {
    pub what: String,
    pub session: u64,
    /// Number of commands that all sessions had sent before the failure was found.
    pub after_commands: u64,
    pub after_s: f64,
    /// The shortest session that was found with the same failure.
    #[serde(rename = "script")]
    pub actions: Vec<Action>,
}

#[derive(Clone, Debug, Default)]
pub struct Outcome {
    pub counts: Counts,
    pub sessions: u64,
    pub failure: Option<Failure>,
    /// Whether Ctrl-C has ended the campaign.
    pub interrupted: bool,
    /// Duration, in s.
    pub wall_s: f64,
}

/// Runs random sessions with about `commands` commands in all. The sessions follow from `seed`. The run ends when a
/// session fails.
///
/// # Errors
/// The board does not start.
pub fn sessions(
    session: &Session,
    seed: u64,
    commands: u64,
    threads: usize,
) -> Result<Outcome, Error> {
    let begun = Instant::now();
    let (number, done, ended) = (AtomicU64::new(0), AtomicU64::new(0), AtomicBool::new(false));
    let work = |run: &mut Run<'_>, _| {
        let mut outcome = Outcome::default();
        let start = run.snapshot();
        while done.load(Relaxed) < commands && !ended.load(Relaxed) {
            let session_number = number.fetch_add(1, Relaxed);
            run.restore(&start);
            let random = Random::of_case(seed, session_number);
            let (actions, end) = one(run, session, random, commands.min(SESSION));
            done.fetch_add(run.checks.counts.commands, Relaxed);
            outcome.counts += run.checks.counts;
            outcome.sessions += 1;
            let Err(end) = end else { continue };
            ended.store(true, Relaxed);
            if let End::Difference(what) = end {
                let after_commands = done.load(Relaxed);
                let after_s = begun.elapsed().as_secs_f64();
                let (actions, what) = shrink(run, &start, actions, what);
                let session = session_number;
                outcome.failure = Some(Failure { what, session, after_commands, after_s, actions });
            }
        }
        Ok(outcome)
    };
    let mut all = Outcome::default();
    for outcome in on_threads(threads, threads, || boot(session), work)? {
        all.counts += outcome.counts;
        all.sessions += outcome.sessions;
        let failures = all.failure.into_iter().chain(outcome.failure);
        all.failure = failures.min_by_key(|failure| failure.session);
    }
    all.interrupted = interrupt::is_requested();
    all.wall_s = begun.elapsed().as_secs_f64();
    Ok(all)
}

/// Runs one session with about `SESSION` commands. Returns the session's actions and its end.
fn one(
    run: &mut Run<'_>,
    session: &Session,
    mut random: Random,
    commands: u64,
) -> (Vec<Action>, Result<(), End>) {
    let (device, good_mv) = (device::built_in(session.board), session.board.supply_mv);
    // Each session begins with a random output period.
    let mut actions = vec![Action::Say(format!("period {}", random.of(&PERIODS)))];
    if let Err(end) = run.act(&actions[0]) {
        return (actions, Err(end));
    }
    while run.checks.counts.commands < commands
        && let Some(situation) = Situation::of(&run.checks, device, good_mv)
    {
        for action in next(&mut random, &situation) {
            actions.push(action);
            if let Err(end) = run.act(&actions[actions.len() - 1]) {
                return (actions, Err(end));
            }
        }
    }
    let end = run.finish();
    (actions, end)
}

fn boot(session: &Session) -> Result<Run<'_>, Error> {
    Run::boot(session).map_err(|end| match end {
        End::Interrupted => Error::Interrupted,
        End::Difference(what) => Error::Internal(format!("the board does not start: {what}")),
    })
}

/// Runs a session from a script.
///
/// # Errors
/// The board does not start, or the user pressed Ctrl-C.
pub fn replay(session: &Session, actions: &[Action]) -> Result<Outcome, Error> {
    let begun = Instant::now();
    let mut run = boot(session)?;
    run.checks.counts = Counts::default();
    let ended = actions.iter().try_for_each(|action| run.act(action)).and_then(|()| run.finish());
    let failure = match ended {
        Ok(()) => None,
        Err(End::Interrupted) => return Err(Error::Interrupted),
        Err(End::Difference(what)) => {
            let after_commands = run.checks.counts.commands;
            let after_s = begun.elapsed().as_secs_f64();
            let actions = actions.to_vec();
            Some(Failure { what, session: 0, after_commands, after_s, actions })
        }
    };
    let wall_s = begun.elapsed().as_secs_f64();
    Ok(Outcome { counts: run.checks.counts, sessions: 1, failure, interrupted: false, wall_s })
}

/// Reads a script: one action per line. Lines that begin with `#` are comments.
///
/// # Errors
/// The file cannot be read, or a line is not an action.
pub fn script(path: &Path) -> Result<Vec<Action>, Error> {
    let text = input::read(path, input::SCENE)?;
    let text = String::from_utf8(text)
        .map_err(|_| Error::Input(format!("{}: not UTF-8 text", path.display())))?;
    let lines =
        text.lines().enumerate().filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    lines
        .map(|(n, line)| {
            line.parse().map_err(|()| {
                Error::Input(format!(
                    "{}:{}: {line:?} is no action, allowed {FORMS}",
                    path.display(),
                    n + 1
                ))
            })
        })
        .collect()
}
