//! Tries properties for a chosen time, on all cores.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    panic,
    sync::{Mutex, MutexGuard, OnceLock, PoisonError},
    thread,
    time::{Duration, Instant},
};

use crate::Property;

#[derive(Clone, Debug)]
pub struct Campaign {
    pub extent: Extent,
    pub seed: u64,
    pub properties: Vec<&'static Property>,
}

/// How much of each property is tried.
#[derive(Clone, Copy, Debug)]
pub enum Extent {
    /// Until the time is over, but at least one batch of each property. The property with the least time so far comes
    /// next.
    Time(Duration),
    /// The first batches of each property. The cases are the same on every machine.
    Batches(u64),
    /// The batch of this number only.
    Batch(u64),
}

#[derive(Clone, Debug, Default)]
struct Progress {
    batches: u64,
    cases: u64,
    seconds: f64,
    failed: bool,
}

#[derive(Debug, Default)]
struct Count {
    seed: u64,
    begun: Option<Instant>,
    of: BTreeMap<&'static str, Progress>,
}

static COUNT: Mutex<Count> = Mutex::new(Count { seed: 0, begun: None, of: BTreeMap::new() });

/// The last panic of each thread, with its position in the source.
static PANICS: OnceLock<Mutex<BTreeMap<String, String>>> = OnceLock::new();

fn count() -> MutexGuard<'static, Count> {
    COUNT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stores the position of the last panic, and does not print each panic. A failed check is a panic, and a case that is
/// made smaller causes thousands of panics.
fn keep_panics_quiet() {
    panic::set_hook(Box::new(|info| {
        let name = thread::current().name().unwrap_or_default().to_owned();
        let place = info.location().map(ToString::to_string).unwrap_or_default();
        if let Ok(mut panics) = PANICS.get_or_init(Mutex::default).lock() {
            panics.insert(name, place);
        }
    }));
}

/// A table with the number of cases that were tried so far for each property.
pub fn summary() -> String {
    let count = count();
    let mut text = String::new();
    let (mut cases, mut failed) = (0, 0);
    for (name, progress) in &count.of {
        let Progress { cases: of, seconds, .. } = *progress;
        let state = if progress.failed { "FAILED" } else { "holds" };
        let _ = writeln!(text, "{name:<44} {of:>10} cases {seconds:>7.1} s  {state}");
        cases += of;
        failed += u32::from(progress.failed);
    }
    let lasted = count.begun.map_or(0.0, |begun| begun.elapsed().as_secs_f64());
    let _ = writeln!(
        text,
        "seed {}: {} properties, {cases} cases, {lasted:.0} s, {failed} failed",
        count.seed,
        count.of.len()
    );
    text
}

impl Campaign {
    /// Tries all properties and prints failures at once. Returns whether all properties hold.
    pub fn run(&self) -> bool {
        keep_panics_quiet();
        let begun = Instant::now();
        {
            let mut count = count();
            (count.seed, count.begun) = (self.seed, Some(begun));
            for property in &self.properties {
                count.of.insert(property.title(), Progress::default());
            }
        }
        let cores = thread::available_parallelism().map_or(1, usize::from);
        thread::scope(|scope| {
            for core in 0..cores {
                let work = move || while self.try_next(begun) {};
                let builder = thread::Builder::new().name(format!("core {core}"));
                let started = builder.spawn_scoped(scope, work);
                started.expect("the system starts a thread for each core");
            }
        });
        count().of.values().all(|progress| !progress.failed)
    }

    /// The property that had the least time so far, and the number of its next batch. `None` if all is done.
    fn next(&self, begun: Instant) -> Option<(&'static Property, u64)> {
        let mut count = count();
        let mut open = self.properties.iter().filter_map(|property| {
            let progress = count.of.get(property.title())?;
            let due = match self.extent {
                Extent::Time(lasts) => begun.elapsed() < lasts,
                Extent::Batches(most) => progress.batches < most,
                Extent::Batch(_) => false,
            };
            let due = due || progress.batches == 0;
            (due && !progress.failed).then_some((property, progress.batches, progress.seconds))
        });
        let first = open.next()?;
        let (property, number, _) =
            open.fold(first, |least, other| if other.2 < least.2 { other } else { least });
        if let Some(progress) = count.of.get_mut(property.title()) {
            progress.batches += 1;
            // An estimate until the true time is known. So other cores try other properties.
            progress.seconds += 1.0;
        }
        let Extent::Batch(only) = self.extent else { return Some((property, number)) };
        Some((property, only))
    }

    fn try_next(&self, begun: Instant) -> bool {
        let Some((property, number)) = self.next(begun) else { return false };
        let started = Instant::now();
        let outcome = property.batch(self.seed, number);
        let mut count = count();
        let Some(progress) = count.of.get_mut(property.title()) else { return false };
        progress.seconds += started.elapsed().as_secs_f64() - 1.0;
        progress.cases += u64::from(property.cases);
        if let Err(text) = outcome
            && !progress.failed
        {
            progress.failed = true;
            let name = thread::current().name().unwrap_or_default().to_owned();
            let panics = PANICS.get_or_init(Mutex::default).lock();
            let place = panics.ok().and_then(|panics| panics.get(&name).cloned());
            println!(
                "{}\nat {}, {:.1} s after the start, batch {number} of {} cases\n",
                property.failure(&text, self.seed, number),
                place.unwrap_or_default(),
                begun.elapsed().as_secs_f64(),
                property.cases,
            );
        }
        true
    }
}
