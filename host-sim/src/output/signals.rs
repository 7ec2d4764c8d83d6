//! Ctrl-C, SIGTERM and SIGHUP ask a command to end. A command may not check the flag in time, for example during a
//! blocking read, one long hit, or work on a large matrix. Then this module ends the process.

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

/// Time within which a command should end. This time and [`LAST_WORDS`] together are well below a second.
const GRACE: Duration = Duration::from_millis(400);
/// Time in which the error message must be printed, because the reader of stderr may hang.
const LAST_WORDS: Duration = Duration::from_millis(100);

/// Starts to listen to signals. A command has 0.4 s to end after a signal. If the command does not end, `clean` removes
/// unfinished files, `report` prints the error, and the process ends with [`INTERRUPTED`].
///
/// # Errors
/// The system does not allow this program to listen, or this function was called before.
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

/// Does nothing, because a web page has no signals. To stop a command, the page ends its worker.
#[cfg(target_family = "wasm")]
fn set_handler(_: impl FnMut() + Send + 'static) -> Result<(), Error> {
    Ok(())
}
