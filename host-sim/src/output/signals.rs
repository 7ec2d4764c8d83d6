//! Ctrl-C, SIGTERM and SIGHUP, which ask a command to end. What does not come to a place where it looks at the flag in
//! time (a read that blocks, one long hit, a large matrix) is ended from outside.

use std::{
    process,
    sync::atomic::Ordering,
    thread,
    time::{Duration, Instant},
};

use crate::{
    error::{Error, INTERRUPTED},
    interrupt,
};

/// Time that a command has to end by itself; with [`LAST_WORDS`] well below a second.
const GRACE: Duration = Duration::from_millis(400);
/// Time to say so where the reader of stderr may hang.
const LAST_WORDS: Duration = Duration::from_millis(100);

/// Listens to the signals from now on. Where the command has not ended 0.4 s after one, `clean` takes away what
/// must not stay, `report` says so, and the process ends with [`INTERRUPTED`].
///
/// # Errors
/// The system refuses, or this has been called before.
pub fn watch(clean: fn(), report: fn()) -> Result<(), Error> {
    let ended = move || {
        interrupt::flag().store(true, Ordering::Relaxed);
        thread::sleep(GRACE);
        clean();
        let words = thread::spawn(report);
        let ends = Instant::now() + LAST_WORDS;
        while !words.is_finished() && Instant::now() < ends {
            thread::sleep(Duration::from_millis(1));
        }
        process::exit(INTERRUPTED.into());
    };
    set_handler(ended)
}

#[cfg(not(target_family = "wasm"))]
fn set_handler(ended: impl FnMut() + Send + 'static) -> Result<(), Error> {
    ctrlc::set_handler(ended)
        .map_err(|error| Error::Internal(format!("cannot watch for Ctrl-C: {error}")))
}

/// A page has no signals: whoever stops its worker ends it.
#[cfg(target_family = "wasm")]
fn set_handler(_: impl FnMut() + Send + 'static) -> Result<(), Error> {
    Ok(())
}
