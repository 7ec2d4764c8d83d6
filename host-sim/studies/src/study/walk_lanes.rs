//! Walks side by side, a lane each: a walk asks for its next hit once it knows the verdict of the last.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::walk::{Boundary, Progress};
use crate::{
    engine::{Depth, Engine, Outcome, Work, run},
    error::Error,
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};

/// Where a walk begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Nominal cutoff, Hz.
    pub cutoff_hz: f64,
    /// Counts beyond the scene's start.
    pub start_offset_counts: f64,
}

/// Walks of one scene that wait for a lane, in any thread.
pub struct Queue<'a> {
    /// The scene.
    pub prepared: &'a PreparedScene,
    /// All its walks.
    pub starts: &'a [Start],
    /// How many have begun.
    begun: AtomicUsize,
}

impl<'a> Queue<'a> {
    /// Nothing has begun.
    pub fn new(prepared: &'a PreparedScene, starts: &'a [Start]) -> Self {
        Self { prepared, starts, begun: AtomicUsize::new(0) }
    }

    /// The next walk. The last one first: its cutoff is the highest, its walk long, and a long walk that
    /// begins late leaves lanes empty.
    fn next(&self) -> Option<usize> {
        let begun = self.begun.fetch_add(1, Ordering::Relaxed);
        self.starts.len().checked_sub(begun + 1)
    }
}

/// Makes walks of the queue in the lanes of this thread until none is left or `stop` is set. `done` gets
/// each with its place in the queue.
pub fn walks(
    engine: Engine,
    numeric: Numeric,
    queue: &Queue<'_>,
    stop: &AtomicBool,
    done: impl FnMut(usize, Result<Boundary, Error>),
) {
    let lanes = vec![];
    let mut work = Walks { queue, numeric, stop, lanes, done };
    run(engine, queue.prepared, numeric, Depth::Verdict, &mut work);
}

struct Walks<'a, D> {
    queue: &'a Queue<'a>,
    numeric: Numeric,
    stop: &'a AtomicBool,
    lanes: Vec<Option<(usize, Progress)>>,
    done: D,
}

impl<D: FnMut(usize, Result<Boundary, Error>)> Work for Walks<'_, D> {
    fn next(&mut self, lane: usize) -> Option<WallHit> {
        if self.lanes.len() <= lane {
            self.lanes.resize_with(lane + 1, || None);
        }
        let place = self.lanes.get_mut(lane)?;
        if self.stop.load(Ordering::Relaxed) {
            if let Some((walk, _)) = place.take() {
                (self.done)(walk, Err(Error::Interrupted));
            }
            return None;
        }
        if place.is_none() {
            let walk = self.queue.next()?;
            let Start { cutoff_hz, start_offset_counts } = *self.queue.starts.get(walk)?;
            *place =
                Some((walk, Progress::new(self.queue.prepared, cutoff_hz, start_offset_counts)));
        }
        place.as_ref().map(|(_, progress)| progress.hit())
    }

    fn done(&mut self, lane: usize, outcome: Result<Outcome, HitError>) {
        let Some(place) = self.lanes.get_mut(lane) else { return };
        let Some((walk, progress)) = place else { return };
        let verdict = outcome.map(|outcome| outcome.verdict);
        let prepared = self.queue.prepared;
        let touches = |hit: &WallHit| prepared.touches(self.numeric, hit);
        if let Some(ended) = progress.report(verdict, touches) {
            let walk = *walk;
            *place = None;
            (self.done)(walk, ended);
        }
    }
}
