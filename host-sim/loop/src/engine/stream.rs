//! Runs numbered, independent hits on all threads, and returns the outcomes in order. Only one block of hits is in
//! memory.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

use super::{Depth, Engine, Outcome, Work, run};
use crate::{
    error::Error,
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};

/// Number of hits of a block for each lane of each thread. At the end of a block, lanes wait for the block's last hit.
/// This wait takes 1 % of the time.
const HITS_PER_LANE: u64 = 64;

/// Runs the hits 0 .. `total` that `hit` describes, and passes each outcome to `sink`, in order. The outcomes depend
/// only on the hits, not on `engine` or the number of threads.
///
/// # Errors
/// `stop` was set, or `sink` returned an error.
#[expect(clippy::too_many_arguments, reason = "what, how and where to")]
pub fn stream(
    engine: Engine,
    prepared: &PreparedScene,
    numeric: Numeric,
    depth: Depth,
    total: u64,
    hit: impl Fn(u64) -> WallHit + Sync,
    stop: &AtomicBool,
    mut sink: impl FnMut(u64, Result<Outcome, HitError>) -> Result<(), Error>,
) -> Result<(), Error> {
    let threads = rayon::current_num_threads();
    let block = HITS_PER_LANE * (threads * engine.hits_at_once(prepared, numeric)) as u64;
    let mut begin = 0;
    while begin < total {
        let end = total.min(begin + block);
        let next = AtomicU64::new(begin);
        let mut outcomes: Vec<(u64, Result<Outcome, HitError>)> = (0..threads)
            .into_par_iter()
            .with_max_len(1)
            .flat_map_iter(|_| {
                let lanes = vec![];
                let mut work =
                    Numbered { next: &next, end, hit: &hit, stop, lanes, outcomes: vec![] };
                run(engine, prepared, numeric, depth, &mut work);
                work.outcomes
            })
            .collect();
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        outcomes.sort_unstable_by_key(|(number, _)| *number);
        for (number, outcome) in outcomes {
            sink(number, outcome)?;
        }
        begin = end;
    }
    Ok(())
}

struct Numbered<'a, F> {
    next: &'a AtomicU64,
    end: u64,
    hit: &'a F,
    stop: &'a AtomicBool,
    /// Number of the hit in each lane.
    lanes: Vec<u64>,
    outcomes: Vec<(u64, Result<Outcome, HitError>)>,
}

impl<F: Fn(u64) -> WallHit> Work for Numbered<'_, F> {
    fn next(&mut self, lane: usize) -> Option<WallHit> {
        if self.stop.load(Ordering::Relaxed) {
            return None;
        }
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        if number >= self.end {
            return None;
        }
        if self.lanes.len() <= lane {
            self.lanes.resize(lane + 1, 0);
        }
        *self.lanes.get_mut(lane)? = number;
        Some((self.hit)(number))
    }

    fn done(&mut self, lane: usize, outcome: Result<Outcome, HitError>) {
        if let Some(&number) = self.lanes.get(lane) {
            self.outcomes.push((number, outcome));
        }
    }
}
