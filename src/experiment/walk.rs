//! The boundary walk (paper, 2.2.3): from a stable wall, K up until a hit is unstable; then B up,
//! and K up or down to the boundary again, until no K is stable.
//!
//! K and B live on a grid, so the walk itself is integer; [`WalkPlan`] turns a [`Cell`] into SI
//! units. One hit costs seconds on a board, so the walk asks for one [`Cell`] at a time and takes
//! its verdict; it neither knows nor cares who runs the hit.

use core::fmt;

use super::Verdict;

/// Grid and caps of a walk, SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WalkPlan {
    /// First K, N/m; must be stable together with the first B.
    pub stiffness_start_n_per_m: f64,
    /// Step of K, N/m.
    pub stiffness_step_n_per_m: f64,
    /// Largest K that is tried, N/m.
    pub stiffness_max_n_per_m: f64,
    /// First B, N s/m.
    pub damping_start_n_s_per_m: f64,
    /// Step of B, N s/m.
    pub damping_step_n_s_per_m: f64,
    /// Largest B that is tried, N s/m.
    pub damping_max_n_s_per_m: f64,
}

/// A point of the grid: steps of K (may be negative) and of B from the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    /// Steps of K from its start.
    pub stiffness: i32,
    /// Steps of B from its start.
    pub damping: i32,
}

impl WalkPlan {
    /// K of a cell, N/m.
    pub fn stiffness_n_per_m(&self, cell: Cell) -> f64 {
        self.stiffness_start_n_per_m + f64::from(cell.stiffness) * self.stiffness_step_n_per_m
    }

    /// B of a cell, N s/m.
    pub fn damping_n_s_per_m(&self, cell: Cell) -> f64 {
        self.damping_start_n_s_per_m + f64::from(cell.damping) * self.damping_step_n_s_per_m
    }

    fn is_beyond_stiffness(&self, cell: Cell) -> bool {
        self.stiffness_n_per_m(cell) > self.stiffness_max_n_per_m
    }

    fn is_beyond_damping(&self, cell: Cell) -> bool {
        self.damping_n_s_per_m(cell) > self.damping_max_n_s_per_m
    }
}

/// Why a walk ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// No K > 0 was stable at the last B: the boundary is closed.
    Closed,
    /// B reached its cap; the boundary goes on beyond it.
    DampingMax,
    /// B reached its cap, and K had reached its own at one point or more before.
    BothMax,
    /// The boundary is closed, but K reached its cap at one point or more.
    StiffnessMax,
}

impl Ended {
    /// Name in reports: `closed`, `damping_max`, `stiffness_max`, `stiffness_and_damping_max`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Closed => "closed",
            Self::DampingMax => "damping_max",
            Self::StiffnessMax => "stiffness_max",
            Self::BothMax => "stiffness_and_damping_max",
        }
    }
}

/// What a verdict led to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// A point of the boundary that is now known.
    pub boundary: Option<Cell>,
    /// The walk is over.
    pub ended: Option<Ended>,
}

/// Why a walk cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WalkError {
    /// The wall of the start cell is not stable.
    FirstUnstable,
    /// The handle did not reach the wall at this cell.
    NoContact(Cell),
}

impl fmt::Display for WalkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FirstUnstable => f.write_str("the first point of the walk is unstable"),
            Self::NoContact(_) => f.write_str("the push does not bring the handle to the wall"),
        }
    }
}

impl core::error::Error for WalkError {}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// The start cell.
    First,
    /// K goes up; the cell below the present one is stable.
    Up,
    /// B went up at the same K.
    Across,
    /// K goes down.
    Down,
    Over,
}

/// A walk in progress.
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    plan: WalkPlan,
    phase: Phase,
    cell: Cell,
    stiffness_capped: bool,
}

impl Walk {
    /// A walk whose first hit is still to come.
    pub fn new(plan: WalkPlan) -> Self {
        Self { plan, phase: Phase::First, cell: Cell::default(), stiffness_capped: false }
    }

    /// The grid and caps.
    pub fn plan(&self) -> &WalkPlan {
        &self.plan
    }

    /// The cell to hit next.
    pub fn cell(&self) -> Cell {
        self.cell
    }

    /// Takes the verdict of a hit at [`cell`](Self::cell) and moves on.
    ///
    /// # Errors
    /// The start is unstable, or a hit had no contact; the walk is then over.
    pub fn report(&mut self, verdict: Verdict) -> Result<Step, WalkError> {
        let here = self.cell;
        let stable = match verdict {
            Verdict::Stable => true,
            Verdict::Unstable => false,
            Verdict::NoContact => {
                self.phase = Phase::Over;
                return Err(WalkError::NoContact(here));
            }
        };
        let step = match (self.phase, stable) {
            (Phase::First, false) => {
                self.phase = Phase::Over;
                return Err(WalkError::FirstUnstable);
            }
            (Phase::First | Phase::Up | Phase::Across, true) => self.go_up(here),
            (Phase::Up, false) => {
                let below = Cell { stiffness: here.stiffness - 1, ..here };
                self.go_across(below)
            }
            (Phase::Across | Phase::Down, false) => self.go_down(here),
            (Phase::Down, true) => self.go_across(here),
            (Phase::Over, _) => Step { boundary: None, ended: Some(self.ended(Ended::Closed)) },
        };
        Ok(step)
    }

    /// `stable` is stable: try the next K.
    fn go_up(&mut self, stable: Cell) -> Step {
        let above = Cell { stiffness: stable.stiffness.saturating_add(1), ..stable };
        if self.plan.is_beyond_stiffness(above) {
            self.stiffness_capped = true;
            return self.go_across(stable);
        }
        self.phase = Phase::Up;
        self.cell = above;
        Step { boundary: None, ended: None }
    }

    /// `boundary` is the last stable K at its B: try the next B.
    fn go_across(&mut self, boundary: Cell) -> Step {
        let next = Cell { damping: boundary.damping.saturating_add(1), ..boundary };
        let ended = self.plan.is_beyond_damping(next).then(|| self.ended(Ended::DampingMax));
        self.phase = if ended.is_some() { Phase::Over } else { Phase::Across };
        self.cell = next;
        Step { boundary: Some(boundary), ended }
    }

    /// `unstable` is unstable and so was what lay above it: try the K below, while it is positive.
    fn go_down(&mut self, unstable: Cell) -> Step {
        let below = Cell { stiffness: unstable.stiffness.saturating_sub(1), ..unstable };
        if self.plan.stiffness_n_per_m(below) > 0.0 {
            self.phase = Phase::Down;
            self.cell = below;
            Step { boundary: None, ended: None }
        } else {
            self.phase = Phase::Over;
            Step { boundary: None, ended: Some(self.ended(Ended::Closed)) }
        }
    }

    fn ended(&self, reason: Ended) -> Ended {
        match (reason, self.stiffness_capped) {
            (Ended::Closed, true) => Ended::StiffnessMax,
            (Ended::DampingMax, true) => Ended::BothMax,
            (reason, _) => reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{vec, vec::Vec};

    const PLAN: WalkPlan = WalkPlan {
        stiffness_start_n_per_m: 2000.0,
        stiffness_step_n_per_m: 2000.0,
        stiffness_max_n_per_m: 1e5,
        damping_start_n_s_per_m: 10.0,
        damping_step_n_s_per_m: 10.0,
        damping_max_n_s_per_m: 1000.0,
    };

    /// Walks along a boundary given as the largest stable K at each B.
    fn walk(plan: WalkPlan, k_max: impl Fn(f64) -> f64) -> (Vec<(f64, f64)>, usize, Ended) {
        let mut walk = Walk::new(plan);
        let (mut points, mut hits) = (vec![], 0);
        loop {
            let cell = walk.cell();
            let stable = plan.stiffness_n_per_m(cell) <= k_max(plan.damping_n_s_per_m(cell));
            hits += 1;
            let step = walk.report(if stable { Verdict::Stable } else { Verdict::Unstable });
            let step = step.unwrap();
            points.extend(
                step.boundary.map(|c| (plan.damping_n_s_per_m(c), plan.stiffness_n_per_m(c))),
            );
            if let Some(ended) = step.ended {
                return (points, hits, ended);
            }
        }
    }

    #[test]
    fn it_follows_a_boundary_up_and_down_and_closes() {
        let k_max = |b: f64| match b {
            10.0 => 5000.0,
            20.0 => 9000.0,
            30.0 => 3000.0,
            _ => 0.0,
        };
        let (points, hits, ended) = walk(PLAN, k_max);
        assert_eq!(points, [(10.0, 4000.0), (20.0, 8000.0), (30.0, 2000.0)]);
        assert_eq!(ended, Ended::Closed);
        // B=10: 2, 4, 6; B=20: 4, 6, 8, 10; B=30: 8, 6, 4, 2; B=40: 2
        assert_eq!(hits, 12);
    }

    #[test]
    fn caps_end_it_and_are_named() {
        let (points, _, ended) = walk(PLAN, |b| 4000.0 + b);
        assert_eq!((points.len(), ended), (100, Ended::DampingMax));
        let (points, _, ended) = walk(PLAN, |b| if b > 500.0 { 0.0 } else { 1e9 });
        assert!(points.iter().all(|&(_, k)| k == 1e5));
        assert_eq!((points.len(), ended), (50, Ended::StiffnessMax));
        assert_eq!(walk(PLAN, |_| 1e9).2, Ended::BothMax);
    }

    #[test]
    fn k_goes_below_its_start_but_stays_positive() {
        let plan = WalkPlan { stiffness_start_n_per_m: 5000.0, ..PLAN };
        let (points, _, ended) = walk(plan, |b| if b < 15.0 { 5000.0 } else { 1500.0 });
        assert_eq!(points[..2], [(10.0, 5000.0), (20.0, 1000.0)]);
        assert_eq!(ended, Ended::DampingMax);
    }

    #[test]
    fn a_walk_that_cannot_begin_says_why() {
        assert_eq!(Walk::new(PLAN).report(Verdict::Unstable), Err(WalkError::FirstUnstable));
        let mut walk = Walk::new(PLAN);
        walk.report(Verdict::Stable).unwrap();
        let cell = walk.cell();
        assert_eq!(walk.report(Verdict::NoContact), Err(WalkError::NoContact(cell)));
        assert!(walk.report(Verdict::Stable).unwrap().ended.is_some());
    }
}
