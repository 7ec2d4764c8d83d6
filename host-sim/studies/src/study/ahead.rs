//! Which walls a walk may ask for next, so that lanes which no walk needs run those.
//!
//! A walk goes from verdict to verdict. What a verdict will be is guessed from the boundary so far, and from that of a
//! neighbour if there is one (another start, another tuning); of all walls that may come the likeliest is taken. A wrong
//! guess costs a hit in a lane that had nothing to do. It changes no boundary and no count of hits.

use std::{cmp::Ordering, collections::BinaryHeap};

use zwidth::experiment::{Cell, Verdict, Walk};

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

/// A walk that may come to be, and how likely it is.
struct Likely {
    chance: f64,
    of: usize,
    walk: Walk,
}

impl PartialEq for Likely {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Likely {}

impl PartialOrd for Likely {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Likely {
    fn cmp(&self, other: &Self) -> Ordering {
        self.chance.total_cmp(&other.chance).then_with(|| other.of.cmp(&self.of))
    }
}

/// A walk that looks ahead.
pub trait Walking {
    fn walk(&self) -> Walk;
    /// The verdict of a cell, if it is known.
    fn known(&self, cell: Cell) -> Option<Verdict>;
    /// A lane has it.
    fn is_running(&self, cell: Cell) -> bool;
    /// Its own boundary so far, and that of a neighbour.
    fn guides(&self) -> [&Guide; 2];
}

/// The walk and the cell that is most likely to be needed, of those that are neither known nor running.
pub fn likeliest<'a, W: Walking + 'a>(
    walks: impl Iterator<Item = (usize, &'a W)> + Clone,
) -> Option<(usize, Cell)> {
    let start = |(of, walking): (usize, &W)| Likely { chance: 1.0, of, walk: walking.walk() };
    let mut heap: BinaryHeap<Likely> = walks.clone().map(start).collect();
    for _ in 0..LOOKED_AT_MAX {
        let Likely { chance, of, walk } = heap.pop()?;
        let (_, walking) = walks.clone().find(|(number, _)| *number == of)?;
        let cell = walk.cell();
        let known = walking.known(cell);
        if known.is_none() && !walking.is_running(cell) {
            return Some((of, cell));
        }
        let stable = match known {
            Some(verdict) => f64::from(u8::from(verdict == Verdict::Stable)),
            None => stable(walking.guides(), cell),
        };
        for (verdict, share) in [(Verdict::Stable, stable), (Verdict::Unstable, 1.0 - stable)] {
            let mut walk = walk;
            if share > 0.0 && walk.report(verdict).is_ok_and(|step| step.ended.is_none()) {
                heap.push(Likely { chance: chance * share, of, walk });
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
