//! Which walls a walk may ask for next, so that lanes which no walk needs run those.
//!
//! A walk goes from verdict to verdict. What a verdict will be is guessed from the boundary so far, and from that of a
//! neighbour if there is one (another start, another tuning); of all walls that may come the likeliest is taken. A wrong
//! guess costs a hit in a lane that had nothing to do. It changes no boundary and no count of hits.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
};

use zwidth::experiment::{Cell, Verdict, Walk};

use super::boundary::Progress;
use crate::simulation::prepared::HitError;

/// How far a guess of the boundary's K may be off, steps.
const OFF_STEPS: f64 = 1.2;
/// Before the boundary is reached most walls are stable.
const STABLE_BEFORE: f64 = 0.9;
/// Bounds the search where walks meet in the same cells again.
const LOOKED_AT_MAX: usize = 400;

/// The K at each B of a boundary, steps.
#[derive(Clone, Debug, Default)]
pub struct Guide(Vec<i32>);

impl Guide {
    /// Takes the last point of a boundary and how many it has, B ascending from the first, if it is new.
    pub fn follow(&mut self, last: Option<(i32, usize)>) {
        if let Some((stiffness, _)) = last.filter(|(_, points)| *points > self.0.len()) {
            self.0.push(stiffness);
        }
    }

    fn at(&self, damping: i32) -> Option<f64> {
        self.0.get(usize::try_from(damping).ok()?).map(|k| f64::from(*k))
    }

    /// A guess of its K at a B beyond, along its own trend or that of a neighbour.
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

/// B over which a trend is taken, steps.
const TREND: i32 = 4;

/// A walk that has begun, and looks ahead.
pub struct Running {
    pub progress: Progress,
    /// Its boundary so far, and that of a neighbour.
    pub guide: Guide,
    pub neighbour: Guide,
    /// Verdicts of cells that it has not come to yet.
    pub known: BTreeMap<(i32, i32), Result<Verdict, HitError>>,
    /// Cells that lanes have.
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

/// The walk and the cell that is most likely to be needed, of those that are neither known nor running.
pub fn likeliest(running: &BTreeMap<usize, Running>) -> Option<(usize, Cell)> {
    // Walks that may come to be; the likeliest is looked at first, of two alike that of the first walk. A chance is not
    // below 0, so its bits are in its order.
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

/// How likely a wall is to be stable.
fn stable([own, neighbour]: [&Guide; 2], cell: Cell) -> f64 {
    let guess = own.guess(neighbour, cell.damping).or_else(|| neighbour.at(cell.damping));
    guess.map_or(STABLE_BEFORE, |k| {
        1.0 / (1.0 + ((f64::from(cell.stiffness) - k - 0.5) / OFF_STEPS).exp())
    })
}
