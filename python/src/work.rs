//! Work without the interpreter's lock, that Ctrl-C ends and that says how far it is.

use std::{
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::Duration,
};

use pyo3::{
    exceptions::{PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError},
    prelude::*,
};
use sim_loop::error::Error;

/// Time between two looks at the interpreter's signals; Ctrl-C ends work some of these later.
const LOOK: Duration = Duration::from_millis(50);

/// What work is told and tells.
pub struct Course<'a> {
    /// Set once it shall end.
    pub stop: &'a AtomicBool,
    /// Pieces done.
    pub done: &'a AtomicU64,
}

/// An error of the simulator as an exception, with the simulator's line.
pub fn raised(error: Error) -> PyErr {
    let line = sim_loop::error::one_line(&error.to_string());
    match error {
        Error::Input(_) => PyValueError::new_err(line),
        Error::File { .. } => PyOSError::new_err(line),
        Error::Internal(_) => PyRuntimeError::new_err(line),
        Error::Interrupted => PyKeyboardInterrupt::new_err(()),
    }
}

/// Does `work` on another thread, and on `threads` threads if that is not all of them. `progress` is called with
/// pieces done and `total` (0: not known) as they change; what it raises ends the work.
///
/// # Errors
/// Of the work, of `progress`, or a signal's.
pub fn run<T: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    total: u64,
    work: impl FnOnce(&Course<'_>) -> Result<T, Error> + Send,
) -> PyResult<T> {
    let (stop, done) = (AtomicBool::new(false), AtomicU64::new(0));
    let pool = match threads {
        None => None,
        Some(0) => return Err(PyValueError::new_err("threads is 0, allowed 1 or more")),
        Some(threads) => {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            Some(pool.map_err(|error| PyRuntimeError::new_err(error.to_string()))?)
        }
    };
    let course = Course { stop: &stop, done: &done };
    thread::scope(|scope| {
        let (sender, mut receiver) = mpsc::channel();
        scope.spawn(move || {
            let made = match &pool {
                None => work(&course),
                Some(pool) => pool.install(|| work(&course)),
            };
            let _ = sender.send(made); // nobody waits if the interpreter is gone
        });
        let (mut raised_here, mut told) = (None, u64::MAX);
        let made = loop {
            let receiver = &mut receiver; // one that another thread may look at too has no such waiting
            let received = py.detach(move || receiver.recv_timeout(LOOK));
            match received {
                Ok(made) => break Some(made),
                Err(RecvTimeoutError::Disconnected) => break None,
                Err(RecvTimeoutError::Timeout) => {}
            }
            if raised_here.is_some() {
                continue; // it ends
            }
            if let Err(error) = look(py, progress, &done, &mut told, total) {
                stop.store(true, Relaxed);
                raised_here = Some(error);
            }
        };
        if let Some(error) = raised_here {
            return Err(error);
        }
        let made =
            made.ok_or_else(|| PyRuntimeError::new_err("the work ended without a result"))?;
        let made = made.map_err(raised)?;
        tell(progress, done.load(Relaxed), &mut told, total)?;
        Ok(made)
    })
}

fn look(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    done: &AtomicU64,
    told: &mut u64,
    total: u64,
) -> PyResult<()> {
    py.check_signals()?;
    tell(progress, done.load(Relaxed), told, total)
}

fn tell(
    progress: Option<&Bound<'_, PyAny>>,
    done: u64,
    told: &mut u64,
    total: u64,
) -> PyResult<()> {
    if let Some(progress) = progress.filter(|_| done != *told) {
        *told = done;
        progress.call1((done, total))?;
    }
    Ok(())
}
