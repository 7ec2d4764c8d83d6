//! Whether a command shall end. Long work looks at the [`flag`] between two pieces and ends by itself.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::Error;

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
