//! Finds walls that a walk may need later, so that a free lane can run them.
//!
//! A walk continues from verdict to verdict. A future verdict is guessed from the boundary so far, and from the
//! boundary of a neighbour. A neighbour is a walk with another start or another tuning. The wall that is most likely
//! needed is run. A wrong guess only uses a lane that would be idle. The guess changes no boundary and no number of
//! hits.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
};

use zwidth::experiment::{Cell, Verdict, Walk};

use super::boundary::Progress;
use crate::simulation::prepared::HitError;

/// Expected error of a guess of the boundary's K, in steps.
const OFF_STEPS: f64 = 1.2;
/// Probability that a wall is stable before the boundary is reached. Most of these walls are stable.
const STABLE_BEFORE: f64 = 0.9;
/// Largest number of cells that are examined. Without a limit the same cell could be examined many times, because
/// several possible walks may reach it.
const LOOKED_AT_MAX: usize = 400;

/// The K of a boundary at each B, in steps.
#[derive(Clone, Debug, Default)]
pub struct Guide(Vec<i32>);

impl Guide {
    /// Adds the last point of a boundary if it is new. `last` is the K of this point and the number of points. The
    /// points are in the order of B.
    pub fn follow(&mut self, last: Option<(i32, usize)>) {
        if let Some((stiffness, _)) = last.filter(|(_, points)| *points > self.0.len()) {
            self.0.push(stiffness);
        }
    }

    fn at(&self, damping: i32) -> Option<f64> {
        self.0.get(usize::try_from(damping).ok()?).map(|k| f64::from(*k))
    }

    /// Guesses K at a B that the boundary has not reached yet. The guess follows the trend of a neighbour or the
    /// boundary's own trend.
    fn guess(&self, neighbour: &Self, damping: i32) -> Option<f64> {
        let last = i32::try_from(self.0.len()).ok()?.checked_sub(1)?;
        let here = self.at(last)?;
        let trend = match (neighbour.at(last), neighbour.at(damping)) {
            (Some(then), Some(there)) => there - then,
            _ => {
                let before = self.at((last - TREND).max(0)).unwrap_or(here);
                (here - before) / f64::from(TREND.min(last).max(1)) * f64::from(damping - last)
            }
        };
        Some(here + trend)
    }
}

/// Range of B over which a trend is computed, in steps.
const TREND: i32 = 4;

/// A walk that has begun. It has cells with a known verdict and cells that are running.
pub struct Running {
    pub progress: Progress,
    /// The boundary of this walk so far.
    pub guide: Guide,
    /// The boundary of a walk with another start or another tuning.
    pub neighbour: Guide,
    /// Verdicts of cells that the walk has not reached yet.
    pub known: BTreeMap<(i32, i32), Result<Verdict, HitError>>,
    /// Cells that are running in lanes.
    pub running: Vec<Cell>,
}

impl Running {
    fn known(&self, cell: Cell) -> Option<Verdict> {
        let verdict = self.known.get(&place(cell))?;
        Some(verdict.as_ref().copied().unwrap_or(Verdict::Unstable))
    }
}

pub fn place(cell: Cell) -> (i32, i32) {
    (cell.stiffness, cell.damping)
}

/// Finds the walk and the cell that are most likely needed next. The cell has no verdict yet, and does not run in a
/// lane.
pub fn likeliest(running: &BTreeMap<usize, Running>) -> Option<(usize, Cell)> {
    // Possible continuations of the walks. The most likely comes first. If two are equally likely, the continuation of
    // the first walk comes first. A probability is not negative, so its bits have the same order.
    let mut walks: Vec<Walk> = running.values().map(|of| of.progress.walk()).collect();
    let start = |(place, of)| (1f64.to_bits(), Reverse(of), Reverse(place));
    let mut heap: BinaryHeap<_> = running.keys().copied().enumerate().map(start).collect();
    for _ in 0..LOOKED_AT_MAX {
        let (chance, Reverse(of), Reverse(place)) = heap.pop()?;
        let (walking, walk) = (running.get(&of)?, walks[place]);
        let cell = walk.cell();
        let known = walking.known(cell);
        if known.is_none() && !walking.running.contains(&cell) {
            return Some((of, cell));
        }
        let stable = match known {
            Some(verdict) => f64::from(u8::from(verdict == Verdict::Stable)),
            None => stable([&walking.guide, &walking.neighbour], cell),
        };
        for (verdict, share) in [(Verdict::Stable, stable), (Verdict::Unstable, 1.0 - stable)] {
            let mut walk = walk;
            if share > 0.0 && walk.report(verdict).is_ok_and(|step| step.ended.is_none()) {
                let chance = f64::from_bits(chance) * share;
                heap.push((chance.to_bits(), Reverse(of), Reverse(walks.len())));
                walks.push(walk);
            }
        }
    }
    None
}

fn stable([own, neighbour]: [&Guide; 2], cell: Cell) -> f64 {
    let guess = own.guess(neighbour, cell.damping).or_else(|| neighbour.at(cell.damping));
    guess.map_or(STABLE_BEFORE, |k| {
        1.0 / (1.0 + ((f64::from(cell.stiffness) - k - 0.5) / OFF_STEPS).exp())
    })
}
