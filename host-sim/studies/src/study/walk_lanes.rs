//! Makes many walks in the lanes of one thread. A lane runs the next hit of a waiting walk. If no walk waits, the lane
//! begins another walk. If all walks have begun, the lane runs a hit that a walk may need later ([`super::ahead`]).

use std::{
    collections::BTreeMap,
    sync::atomic::{AtomicBool, AtomicUsize, Ordering},
};

use rayon::prelude::*;
use zwidth::{VelocitySettings, experiment::Cell};

use super::{
    How,
    ahead::{Guide, Running, likeliest, place},
    boundary::{Boundary, Progress},
};
use crate::{
    engine::{Depth, Engine, Outcome, Work, run},
    error::Error,
    interrupt,
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    pub velocity: VelocitySettings,
    /// Distance from the scene's start, in counts.
    pub start_offset_counts: f64,
}

/// The walks of one scene. They wait for a lane. All threads share this queue.
pub struct Queue<'a> {
    pub prepared: &'a PreparedScene,
    pub starts: &'a [Start],
    /// Number of walks that have begun.
    begun: AtomicUsize,
}

impl<'a> Queue<'a> {
    pub fn new(prepared: &'a PreparedScene, starts: &'a [Start]) -> Self {
        Self { prepared, starts, begun: AtomicUsize::new(0) }
    }

    /// Takes the next walk from the end of the queue. The last walk has the highest cutoff and takes longest. If it
    /// began late, the other lanes would be empty at the end.
    fn next(&self) -> Option<usize> {
        let begun = self.begun.fetch_add(1, Ordering::Relaxed);
        self.starts.len().checked_sub(begun + 1)
    }
}

/// Makes walks of the queue in the lanes of this thread until the queue is empty or `stop` is set. Calls `done` with
/// the index in the queue and the result.
pub fn walks(
    engine: Engine,
    numeric: Numeric,
    queue: &Queue<'_>,
    stop: &AtomicBool,
    done: impl FnMut(usize, Result<Boundary, Error>),
) {
    let (running, lanes, last) = (BTreeMap::new(), vec![], Guide::default());
    let mut work = Walks { queue, numeric, stop, running, lanes, last, done };
    run(engine, queue.prepared, numeric, Depth::Verdict, &mut work);
}

/// Results of walks. Each result has two indices: that of the queue, and that of the walk in the queue.
pub(super) type Made = Vec<((usize, usize), Result<Boundary, Error>)>;

/// Calls `work` for all queues on each thread of the current pool. Each thread begins with another queue, so that fewer
/// threads share the end of a queue. Every walk runs to its end or until `stop` is set. So the reported error is the
/// error of the first walk in order, even if another error came earlier.
pub(super) fn on_all_threads(
    queues: usize,
    work: impl Fn(usize, &mut Made) + Sync,
) -> BTreeMap<(usize, usize), Result<Boundary, Error>> {
    let threads = rayon::current_num_threads();
    let on_one = |thread: usize| {
        let mut made = vec![];
        for n in 0..queues {
            work((n + thread * queues / threads) % queues, &mut made);
        }
        made
    };
    let made: Made = (0..threads).into_par_iter().with_max_len(1).flat_map_iter(on_one).collect();
    made.into_iter().collect()
}

/// Makes the walks of several scenes. It uses all threads of the current pool. The results are in order, and do not
/// depend on the number of threads or on the engine. Calls `done` after each walk.
///
/// # Errors
/// `stop` was set.
pub(super) fn all_walks(
    how: How<'_>,
    scenes: &[(&PreparedScene, Vec<Start>)],
    done: impl Fn(&Boundary) + Sync,
) -> Result<Vec<Vec<Result<Boundary, Error>>>, Error> {
    let How { engine, numeric, stop } = how;
    let queues: Vec<Queue<'_>> =
        scenes.iter().map(|(prepared, starts)| Queue::new(prepared, starts)).collect();
    let made = on_all_threads(queues.len(), |place, made| {
        walks(engine, numeric, &queues[place], stop, |walk, boundary| {
            boundary.iter().for_each(&done);
            made.push(((place, walk), boundary));
        });
    });
    interrupt::unless(stop)?;
    let mut made = made.into_values();
    let mut next =
        || made.next().unwrap_or_else(|| Err(Error::Internal("a walk has no result".into())));
    Ok(scenes.iter().map(|(_, starts)| starts.iter().map(|_| next()).collect()).collect())
}

/// The starts of walks: each filter with each start.
pub(super) fn each(filters: &[VelocitySettings], starts: &[f64]) -> Vec<Start> {
    let of_filter = |&velocity: &VelocitySettings| {
        starts.iter().map(move |&start_offset_counts| Start { velocity, start_offset_counts })
    };
    filters.iter().flat_map(of_filter).collect()
}

struct Walks<'a, D> {
    queue: &'a Queue<'a>,
    numeric: Numeric,
    stop: &'a AtomicBool,
    /// Walks that have begun. The key is the walk's index in the queue.
    running: BTreeMap<usize, Running>,
    /// For each lane, the walk and the cell that run in it; `None` for a free lane.
    lanes: Vec<Option<(usize, Cell)>>,
    /// Boundary of the walk that was the last one to end in these lanes.
    last: Guide,
    done: D,
}

impl<D: FnMut(usize, Result<Boundary, Error>)> Walks<'_, D> {
    /// Chooses the walk and the cell that a free lane runs next.
    fn choose(&mut self) -> Option<(usize, Cell)> {
        let waits = |(number, walk): (&usize, &Running)| {
            let cell = walk.progress.walk().cell();
            (!walk.running.contains(&cell)).then_some((*number, cell))
        };
        if let Some(waiting) = self.running.iter().find_map(waits) {
            return Some(waiting);
        }
        if let Some(walk) = self.queue.next() {
            let Start { velocity, start_offset_counts } = *self.queue.starts.get(walk)?;
            let progress = Progress::new(self.queue.prepared, velocity, start_offset_counts);
            let cell = progress.walk().cell();
            let (guide, neighbour) = (Guide::default(), self.last.clone());
            let (known, running) = (BTreeMap::new(), vec![]);
            self.running.insert(walk, Running { progress, guide, neighbour, known, running });
            return Some((walk, cell));
        }
        likeliest(&self.running)
    }

    fn end(&mut self, number: usize, ended: Result<Boundary, Error>) {
        if let Some(walk) = self.running.remove(&number) {
            self.last = walk.guide;
        }
        (self.done)(number, ended);
    }
}

impl<D: FnMut(usize, Result<Boundary, Error>)> Work for Walks<'_, D> {
    fn next(&mut self, lane: usize) -> Option<WallHit> {
        if self.lanes.len() <= lane {
            self.lanes.resize(lane + 1, None);
        }
        if self.stop.load(Ordering::Relaxed) {
            while let Some((&number, _)) = self.running.first_key_value() {
                self.end(number, Err(Error::Interrupted));
            }
            return None;
        }
        let (number, cell) = self.choose()?;
        let walk = self.running.get_mut(&number)?;
        walk.running.push(cell);
        self.lanes[lane] = Some((number, cell));
        Some(walk.progress.hit_at(cell))
    }

    fn done(&mut self, lane: usize, outcome: Result<Outcome, HitError>) {
        let Some((number, cell)) = self.lanes.get_mut(lane).and_then(Option::take) else { return };
        // A walk that has ended needs no more verdicts.
        let Some(walk) = self.running.get_mut(&number) else { return };
        walk.running.retain(|other| *other != cell);
        walk.known.insert(place(cell), outcome.map(|outcome| outcome.verdict));
        let prepared = self.queue.prepared;
        let touches = |hit: &WallHit| prepared.touches(self.numeric, hit);
        while let Some(verdict) = walk.known.remove(&place(walk.progress.walk().cell())) {
            let ended = walk.progress.report(verdict, touches);
            walk.guide.follow(walk.progress.last_point());
            if let Some(ended) = ended {
                self.end(number, ended);
                return;
            }
        }
    }
}
