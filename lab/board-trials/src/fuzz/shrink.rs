//! Finds the shortest session with the same failure. The search leaves out a piece of the session if the session still
//! fails without the piece. Large pieces are tried first.

use std::time::{Duration, Instant};

use host_sim::interrupt;
use virtual_board::world::Snapshot;

use super::{
    action::Action,
    run::{Checks, End, Run},
};

type Before = (Snapshot, Checks);

/// Time limit of the search.
const PATIENCE: Duration = Duration::from_secs(60);

/// The kind of a difference. It is the beginning of the text, without words that have digits.
fn kind(what: &str) -> String {
    let word = |word: &&str| !word.contains(|c: char| c.is_ascii_digit());
    what.split_whitespace().filter(word).take(8).collect::<Vec<_>>().join(" ")
}

/// A failing session, with the state of the board before each action.
struct Failing {
    actions: Vec<Action>,
    before: Vec<Before>,
    what: String,
}

/// Runs `actions` from the last state of `before`. Returns whether they fail in the same way as the original session.
fn fails(
    run: &mut Run<'_>,
    mut before: Vec<Before>,
    actions: &[Action],
    like: &str,
) -> Option<Failing> {
    let begun = before.len() - 1;
    run.restore(before.last()?);
    for (n, action) in actions.iter().enumerate().skip(begun) {
        if n > begun {
            before.push(run.snapshot());
        }
        match run.act(action) {
            Ok(()) => {}
            Err(End::Difference(what)) if kind(&what) == like => {
                return Some(Failing { actions: actions[..=n].to_vec(), before, what });
            }
            Err(_) => return None,
        }
    }
    match run.finish() {
        Err(End::Difference(what)) if kind(&what) == like => {
            Some(Failing { actions: actions.to_vec(), before, what })
        }
        _ => None,
    }
}

/// Searches the shortest session from `start` that fails like `actions`. Returns this session and its failure.
pub fn shrink(
    run: &mut Run<'_>,
    start: &Before,
    actions: Vec<Action>,
    what: String,
) -> (Vec<Action>, String) {
    let begun = Instant::now();
    let like = kind(&what);
    let Some(mut best) = fails(run, vec![start.clone()], &actions, &like) else {
        return (actions, what); // it does not fail again
    };
    let mut size = best.actions.len().div_ceil(2);
    while size > 0 {
        let mut from = best.actions.len().saturating_sub(size);
        let mut left_out = false;
        loop {
            if begun.elapsed() > PATIENCE || interrupt::is_requested() {
                return (best.actions, best.what);
            }
            let to = (from + size).min(best.actions.len());
            let shorter = [&best.actions[..from], &best.actions[to..]].concat();
            if from < to
                && !shorter.is_empty()
                && let Some(found) = fails(run, best.before[..=from].to_vec(), &shorter, &like)
            {
                best = found;
                left_out = true;
            }
            if from == 0 {
                break;
            }
            from = from.saturating_sub(size).min(best.actions.len());
        }
        size = if size == 1 && left_out { 1 } else { size / 2 };
    }
    (best.actions, best.what)
}
