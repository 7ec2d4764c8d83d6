//! Ctrl-C, SIGTERM and SIGHUP. Long work looks at the [`flag`] between two pieces and ends by itself. What does not
//! come to such a place in time (a read that blocks, one long hit, a large matrix) is ended from outside.

use std::{
    process,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use crate::error::{Error, INTERRUPTED};

/// Time that a command has to end by itself; with [`LAST_WORDS`] well below a second.
const GRACE: Duration = Duration::from_millis(400);
/// Time to say so where the reader of stderr may hang.
const LAST_WORDS: Duration = Duration::from_millis(100);

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// Set once the command shall end.
pub fn flag() -> &'static AtomicBool {
    &REQUESTED
}

/// Whether the command shall end.
pub fn is_requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}

/// # Errors
/// [`Error::Interrupted`] if the command shall end.
pub fn check() -> Result<(), Error> {
    unless(&REQUESTED)
}

/// # Errors
/// [`Error::Interrupted`] if `stop` is set.
pub fn unless(stop: &AtomicBool) -> Result<(), Error> {
    if stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}

/// Listens to the signals from now on. Where the command has not ended 0.4 s after one, `clean` takes away what
/// must not stay, `report` says so, and the process ends with [`INTERRUPTED`].
///
/// # Errors
/// The system refuses, or this has been called before.
pub fn watch(clean: fn(), report: fn()) -> Result<(), Error> {
    let ended = move || {
        REQUESTED.store(true, Ordering::Relaxed);
        thread::sleep(GRACE);
        clean();
        let words = thread::spawn(report);
        let ends = Instant::now() + LAST_WORDS;
        while !words.is_finished() && Instant::now() < ends {
            thread::sleep(Duration::from_millis(1));
        }
        process::exit(INTERRUPTED.into());
    };
    ctrlc::set_handler(ended)
        .map_err(|error| Error::Internal(format!("cannot watch for Ctrl-C: {error}")))
}
