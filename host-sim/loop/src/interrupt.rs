//! The flag that asks a command to end. A long computation checks this [`flag`] between two pieces of work.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::Error;

static REQUESTED: AtomicBool = AtomicBool::new(false);

pub fn flag() -> &'static AtomicBool {
    &REQUESTED
}

pub fn is_requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}

/// # Errors
/// [`Error::Interrupted`] if the command must end.
pub fn check() -> Result<(), Error> {
    unless(&REQUESTED)
}

/// # Errors
/// [`Error::Interrupted`] if `stop` is set.
pub fn unless(stop: &AtomicBool) -> Result<(), Error> {
    if stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}
