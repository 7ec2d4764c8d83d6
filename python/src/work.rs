//! Runs work without the interpreter's lock. Ctrl-C ends the work, and the work reports its progress.

use std::{
    any::Any,
    mem, process,
    sync::{
        Arc, Mutex, OnceLock, PoisonError,
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
use rayon::ThreadPool;
use sim_loop::error::Error;

use crate::given::Progress;

/// Time between two checks for the interpreter's signals. Ctrl-C raises its exception within this time.
const LOOK: Duration = Duration::from_millis(50);

/// What the running work and its caller share: the request to stop, and the progress.
#[derive(Default)]
pub struct Course {
    /// Becomes true when the work must end, because no caller waits for the result any more.
    pub stop: AtomicBool,
    /// Number of pieces of work that are finished.
    done: AtomicU64,
    /// Number of pieces that are planned so far, if the number of all pieces is unknown.
    planned: AtomicU64,
}

impl Course {
    pub fn add(&self, pieces: u64) {
        self.done.fetch_add(pieces, Relaxed);
    }

    /// Sets the number of pieces that are planned so far.
    pub fn plan(&self, pieces: u64) {
        self.planned.store(pieces, Relaxed);
    }
}

/// Makes a Python exception from an error of the simulator. The message is the same.
pub fn raised(error: Error) -> PyErr {
    let line = sim_loop::error::one_line(&error.to_string());
    match error {
        Error::Input(_) => PyValueError::new_err(line),
        Error::File { .. } => PyOSError::new_err(line),
        Error::Internal(_) => PyRuntimeError::new_err(line),
        Error::Interrupted => PyKeyboardInterrupt::new_err(()),
    }
}

/// Runs `work` on another thread, with `threads` threads or with all cores. Calls `progress` when the number of
/// finished pieces changes. The arguments of `progress` are this number and `total`. If `total` is 0, the number of all
/// pieces is unknown: the second argument is then the number that is planned so far.
///
/// An exception of `progress` or of a signal is raised at once. The work ends later, when the work checks `stop`. So
/// the work must own its data, must not use Python objects, and must not write a file.
///
/// # Errors
/// The error of the work, of `progress`, or of a signal.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Progress>,
    total: u64,
    work: impl FnOnce(&Course) -> Result<T, Error> + Send + 'static,
) -> PyResult<T> {
    let pool = match threads {
        None => of_child()?,
        Some(0) => return Err(PyValueError::new_err("threads is 0, allowed 1 or more")),
        Some(threads) => Some(Arc::new(pool_of(threads)?)),
    };
    let course = Arc::new(Course::default());
    let (sender, mut receiver) = mpsc::channel();
    let of_work = Arc::clone(&course);
    let worker = thread::Builder::new().spawn(move || {
        let made = match &pool {
            None => work(&of_work),
            Some(pool) => pool.install(|| work(&of_work)),
        };
        let _ = sender.send(made); // after an exception no caller waits
    })?;
    let mut told = u64::MAX;
    let made = loop {
        let receiver = &mut receiver; // a receiver that is shared between threads cannot wait like this
        match py.detach(move || receiver.recv_timeout(LOOK)) {
            Ok(made) => break made,
            Err(RecvTimeoutError::Disconnected) => return Err(panicked(py, worker)),
            Err(RecvTimeoutError::Timeout) => {}
        }
        let looked =
            py.check_signals().and_then(|()| tell(py, progress, &course, &mut told, total));
        if let Err(error) = looked {
            course.stop.store(true, Relaxed);
            return Err(error);
        }
    };
    let made = made.map_err(raised)?;
    tell(py, progress, &course, &mut told, total)?;
    Ok(made)
}

/// A pool with this number of threads. If the number is 0, it uses all cores.
fn pool_of(threads: usize) -> PyResult<ThreadPool> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|error| PyRuntimeError::new_err(error.to_string()))
}

/// The thread pool of a process that was forked after the first work. The threads of rayon's global pool do not exist
/// in a forked process, so this process would wait for ever. Any other process uses only rayon's global pool.
///
/// `POOL` is locked only while the thread holds the interpreter's lock. A process forks only with the interpreter's
/// lock, so a child never finds `POOL` locked.
fn of_child() -> PyResult<Option<Arc<ThreadPool>>> {
    static FIRST: OnceLock<u32> = OnceLock::new();
    static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);
    let own = process::id();
    if *FIRST.get_or_init(|| own) == own {
        return Ok(None);
    }
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((process, pool)) = &*pool
        && *process == own
    {
        return Ok(Some(Arc::clone(pool)));
    }
    let made = Arc::new(pool_of(0)?);
    if let Some((_, of_parent)) = pool.replace((own, Arc::clone(&made))) {
        mem::forget(of_parent); // dropping it would wait for threads that do not exist
    }
    Ok(Some(made))
}

fn tell(
    py: Python<'_>,
    progress: Option<&Progress>,
    course: &Course,
    told: &mut u64,
    total: u64,
) -> PyResult<()> {
    let done = course.done.load(Relaxed);
    let total = if total == 0 { course.planned.load(Relaxed) } else { total };
    if let Some(progress) = progress.filter(|_| done != *told) {
        *told = done;
        progress.0.call1(py, (done, total))?;
    }
    Ok(())
}

/// An exception with the message with which a worker has panicked.
fn panicked(py: Python<'_>, worker: thread::JoinHandle<()>) -> PyErr {
    let said = py.detach(|| worker.join()).err();
    let of = |said: &Box<dyn Any + Send>| {
        let text = said.downcast_ref::<String>().map(String::as_str);
        text.or_else(|| said.downcast_ref::<&str>().copied()).map(str::to_owned)
    };
    let text = said.as_ref().and_then(of).unwrap_or_else(|| "no result".into());
    PyRuntimeError::new_err(format!("an error of the simulator, please report it: {text}"))
}
