//! The boundary walk (paper, 2.2.3). K rises from a stable wall until a hit is unstable. Then B rises by one step, and
//! K rises or falls to the boundary at this B. The walk ends when no K is stable.
//!
//! K and B are on a grid, so the walk itself uses integers. [`WalkSettings`] turns a [`Cell`] into SI units. A hit
//! takes seconds on a board, so the walk returns one [`Cell`] at a time and takes the verdict of the hit at this cell.
//! Any code may run the hit.

use core::fmt;

use super::Verdict;
use crate::{SettingsError, limits, range::within};

/// Grid of a walk, in SI units. It has the first, the step and the largest value of K and B.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WalkSettings {
    /// First K, in N/m. It must be stable together with the first B.
    pub stiffness_start_n_per_m: f64,
    /// Step of K, in N/m.
    pub stiffness_step_n_per_m: f64,
    /// Largest K that is tried, in N/m.
    pub stiffness_max_n_per_m: f64,
    /// First B, in N s/m.
    pub damping_start_n_s_per_m: f64,
    /// Step of B, in N s/m.
    pub damping_step_n_s_per_m: f64,
    /// Largest B that is tried, in N s/m.
    pub damping_max_n_s_per_m: f64,
}

/// A point of the grid: the numbers of steps of K and of B from the start. The number for K may be negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    /// Number of steps of K from the start.
    pub stiffness: i32,
    /// Number of steps of B from the start.
    pub damping: i32,
}

impl WalkSettings {
    /// The largest number of points that a walk may have along K or along B.
    const STEPS_MAX: f64 = 1e6;
    /// The lowest allowed value where a number must be above 0. It is far below K and B of any wall, and it is easy to
    /// type.
    const SMALLEST: f64 = 1e-9;

    /// Checks every field. The first K must be above 0.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let k_max = self.stiffness_max_n_per_m;
        within("stiffness_max_n_per_m", k_max, Self::SMALLEST..=*limits::STIFFNESS_N_PER_M.end())?;
        let smallest = Self::SMALLEST..=k_max;
        within("stiffness_start_n_per_m", self.stiffness_start_n_per_m, smallest)?;
        let steps = |max: f64| f64::max(max / Self::STEPS_MAX, Self::SMALLEST)..=max;
        within("stiffness_step_n_per_m", self.stiffness_step_n_per_m, steps(k_max))?;
        let b_max = self.damping_max_n_s_per_m;
        within("damping_max_n_s_per_m", b_max, Self::SMALLEST..=*limits::DAMPING_N_S_PER_M.end())?;
        within("damping_start_n_s_per_m", self.damping_start_n_s_per_m, 0.0..=b_max)?;
        within("damping_step_n_s_per_m", self.damping_step_n_s_per_m, steps(b_max))?;
        Ok(())
    }

    /// K of a cell, in N/m.
    pub fn stiffness_n_per_m(&self, cell: Cell) -> f64 {
        self.stiffness_start_n_per_m + f64::from(cell.stiffness) * self.stiffness_step_n_per_m
    }

    /// B of a cell, in N s/m.
    pub fn damping_n_s_per_m(&self, cell: Cell) -> f64 {
        self.damping_start_n_s_per_m + f64::from(cell.damping) * self.damping_step_n_s_per_m
    }

    /// Area that a cell of the boundary adds to the area below the boundary. It is K dB, in N^2 s/m^2.
    pub fn area_n2_s_per_m2(&self, cell: Cell) -> f64 {
        self.stiffness_n_per_m(cell) * self.damping_step_n_s_per_m
    }

    /// Whether the walk may try the K of this cell. K must be above 0 and at most its largest value, apart from
    /// rounding.
    fn has_stiffness(&self, cell: Cell) -> bool {
        let slack = ROUNDING * self.stiffness_step_n_per_m;
        let k = self.stiffness_n_per_m(cell);
        k > slack && k <= self.stiffness_max_n_per_m + slack
    }

    /// Whether the walk may try the B of this cell. B must be at most its largest value, apart from rounding.
    fn has_damping(&self, cell: Cell) -> bool {
        let slack = ROUNDING * self.damping_step_n_s_per_m;
        self.damping_n_s_per_m(cell) <= self.damping_max_n_s_per_m + slack
    }
}

/// Allowed rounding error of a sum of decimal steps, as a part of a step. For example, 0.1 + 2 * 0.1 is not 0.3 in
/// `f64`. After a million steps the error is only some 1e-10 of a step.
const ROUNDING: f64 = 1e-6;

/// Why a walk ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// At the last B no K above 0 was stable. So the boundary is closed.
    Closed,
    /// B reached its largest value. The boundary goes on beyond it.
    DampingMax,
    /// B reached its largest value. At one point or more before that, K had reached its largest value.
    BothMax,
    /// The boundary is closed, but at one point or more K reached its largest value.
    StiffnessMax,
}

impl Ended {
    /// Name of the end in reports. It is `closed`, `damping_max`, `stiffness_max` or `stiffness_and_damping_max`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Closed => "closed",
            Self::DampingMax => "damping_max",
            Self::StiffnessMax => "stiffness_max",
            Self::BothMax => "stiffness_and_damping_max",
        }
    }
}

/// What a verdict has added to the walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The point of the boundary that this verdict has found, if it found one.
    pub boundary: Option<Cell>,
    /// Why the walk ended, if it did.
    pub ended: Option<Ended>,
}

/// Why a walk cannot continue.
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
    First,
    /// K rises. The cell below the present one is stable.
    Up,
    /// B rose by a step, at the same K.
    Across,
    Down,
    /// The walk is over. Each further report gets the same answer.
    Over(Result<Ended, WalkError>),
}

/// A walk in progress.
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    plan: WalkSettings,
    phase: Phase,
    cell: Cell,
    stiffness_capped: bool,
}

impl Walk {
    /// Makes a walk whose first hit is still to come.
    pub fn new(plan: WalkSettings) -> Self {
        Self { plan, phase: Phase::First, cell: Cell::default(), stiffness_capped: false }
    }

    /// The grid of the walk.
    pub fn plan(&self) -> &WalkSettings {
        &self.plan
    }

    /// The cell for the next hit. When the walk is over, this is a cell within the largest K and B.
    pub fn cell(&self) -> Cell {
        self.cell
    }

    /// Takes the verdict of a hit at [`cell`](Self::cell), and chooses the next cell.
    ///
    /// # Errors
    /// The start is unstable, or a hit had no contact. The walk is then over.
    pub fn report(&mut self, verdict: Verdict) -> Result<Step, WalkError> {
        let here = self.cell;
        let stable = verdict == Verdict::Stable;
        let step = match (self.phase, stable) {
            (Phase::Over(Ok(ended)), _) => Step { boundary: None, ended: Some(ended) },
            (Phase::Over(Err(error)), _) => return Err(error),
            _ if verdict == Verdict::NoContact => {
                return Err(self.fail(WalkError::NoContact(here)));
            }
            (Phase::First, false) => return Err(self.fail(WalkError::FirstUnstable)),
            (Phase::First | Phase::Up | Phase::Across, true) => self.go_up(here),
            (Phase::Up, false) => {
                let below = Cell { stiffness: here.stiffness - 1, ..here };
                self.go_across(below)
            }
            (Phase::Across | Phase::Down, false) => self.go_down(here),
            (Phase::Down, true) => self.go_across(here),
        };
        Ok(step)
    }

    /// The cell `stable` is stable, so the next higher K is tried.
    fn go_up(&mut self, stable: Cell) -> Step {
        let above = Cell { stiffness: stable.stiffness.saturating_add(1), ..stable };
        if !self.plan.has_stiffness(above) {
            self.stiffness_capped = true;
            return self.go_across(stable);
        }
        self.phase = Phase::Up;
        self.cell = above;
        Step { boundary: None, ended: None }
    }

    /// The cell `boundary` has the largest stable K at its B, so the next B is tried.
    fn go_across(&mut self, boundary: Cell) -> Step {
        let next = Cell { damping: boundary.damping.saturating_add(1), ..boundary };
        if self.plan.has_damping(next) {
            self.phase = Phase::Across;
            self.cell = next;
            return Step { boundary: Some(boundary), ended: None };
        }
        Step { boundary: Some(boundary), ended: Some(self.end(boundary, Ended::DampingMax)) }
    }

    /// The cell `unstable` is unstable, and so is the cell above it. So the next lower K is tried, as long as it is
    /// positive.
    fn go_down(&mut self, unstable: Cell) -> Step {
        let below = Cell { stiffness: unstable.stiffness.saturating_sub(1), ..unstable };
        if self.plan.has_stiffness(below) {
            self.phase = Phase::Down;
            self.cell = below;
            Step { boundary: None, ended: None }
        } else {
            Step { boundary: None, ended: Some(self.end(unstable, Ended::Closed)) }
        }
    }

    /// Ends the walk. It stays at `last`, a cell within the largest K and B.
    fn end(&mut self, last: Cell, reason: Ended) -> Ended {
        let ended = match (reason, self.stiffness_capped) {
            (Ended::Closed, true) => Ended::StiffnessMax,
            (Ended::DampingMax, true) => Ended::BothMax,
            (reason, _) => reason,
        };
        self.cell = last;
        self.phase = Phase::Over(Ok(ended));
        ended
    }

    fn fail(&mut self, error: WalkError) -> WalkError {
        self.phase = Phase::Over(Err(error));
        error
    }
}

/// Totals of a walk up to now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WalkTotals {
    /// Hits that were made so far.
    pub hits: u32,
    /// Points of the boundary.
    pub points: u32,
    /// Sum of K dB over all points, in N^2 s/m^2.
    pub area: f64,
    /// Largest K of the points, in N/m.
    pub stiffness_peak_n_per_m: f64,
    /// Largest B of the points, in N s/m.
    pub damping_max_n_s_per_m: f64,
}

impl WalkTotals {
    /// Adds the result of a hit.
    pub fn add(&mut self, plan: &WalkSettings, step: &Step) {
        self.hits = self.hits.saturating_add(1);
        let Some(cell) = step.boundary else { return };
        let (k, b) = (plan.stiffness_n_per_m(cell), plan.damping_n_s_per_m(cell));
        self.points = self.points.saturating_add(1);
        self.area += plan.area_n2_s_per_m2(cell);
        self.stiffness_peak_n_per_m = f64::max(self.stiffness_peak_n_per_m, k);
        self.damping_max_n_s_per_m = f64::max(self.damping_max_n_s_per_m, b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{vec, vec::Vec};

    const PLAN: WalkSettings = WalkSettings {
        stiffness_start_n_per_m: 2000.0,
        stiffness_step_n_per_m: 2000.0,
        stiffness_max_n_per_m: 1e5,
        damping_start_n_s_per_m: 10.0,
        damping_step_n_s_per_m: 10.0,
        damping_max_n_s_per_m: 1000.0,
    };

    /// Walks along a boundary, which is given as the largest stable K at each B.
    fn walk(plan: WalkSettings, k_max: impl Fn(f64) -> f64) -> (Vec<(f64, f64)>, usize, Ended) {
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
        // The hits, with K in 1000 N/m: 2, 4, 6 at B=10; 4, 6, 8, 10 at B=20; 8, 6, 4, 2 at B=30; 2 at B=40.
        assert_eq!(hits, 12);
    }

    #[test]
    fn totals_add_up_the_points_and_count_the_hits() {
        let mut walk = Walk::new(PLAN);
        let mut totals = WalkTotals::default();
        for verdict in [Verdict::Stable, Verdict::Stable, Verdict::Unstable, Verdict::Unstable] {
            totals.add(&PLAN, &walk.report(verdict).unwrap());
        }
        // B=10: 2, 4, 6 (unstable); B=20: 4 (unstable), so down to 2
        assert_eq!((totals.hits, totals.points), (4, 1));
        totals.add(&PLAN, &walk.report(Verdict::Stable).unwrap());
        assert_eq!((totals.points, totals.area), (2, (4000.0 + 2000.0) * 10.0));
        assert_eq!((totals.stiffness_peak_n_per_m, totals.damping_max_n_s_per_m), (4000.0, 20.0));
    }

    #[test]
    fn a_grid_that_cannot_be_is_refused_by_name() {
        assert_eq!(PLAN.check(), Ok(()));
        let named = |plan: WalkSettings| plan.check().unwrap_err().parameter;
        let base = PLAN;
        for (plan, name) in [
            (WalkSettings { stiffness_start_n_per_m: 0.0, ..base }, "stiffness_start_n_per_m"),
            (WalkSettings { stiffness_step_n_per_m: f64::NAN, ..base }, "stiffness_step_n_per_m"),
            (WalkSettings { stiffness_step_n_per_m: 0.01, ..base }, "stiffness_step_n_per_m"),
            (WalkSettings { stiffness_max_n_per_m: 1e8, ..base }, "stiffness_max_n_per_m"),
            (WalkSettings { damping_start_n_s_per_m: -1.0, ..base }, "damping_start_n_s_per_m"),
            (WalkSettings { damping_step_n_s_per_m: 2000.0, ..base }, "damping_step_n_s_per_m"),
            (WalkSettings { damping_max_n_s_per_m: 2e4, ..base }, "damping_max_n_s_per_m"),
        ] {
            assert_eq!(named(plan), name);
        }
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
        let plan = WalkSettings { stiffness_start_n_per_m: 5000.0, ..PLAN };
        let (points, _, ended) = walk(plan, |b| if b < 15.0 { 5000.0 } else { 1500.0 });
        assert_eq!(points[..2], [(10.0, 5000.0), (20.0, 1000.0)]);
        assert_eq!(ended, Ended::DampingMax);
    }

    #[test]
    fn decimal_grids_reach_their_caps_and_never_k_zero() {
        let plan = WalkSettings {
            stiffness_start_n_per_m: 0.1,
            stiffness_step_n_per_m: 0.1,
            stiffness_max_n_per_m: 0.3,
            damping_start_n_s_per_m: 0.1,
            damping_step_n_s_per_m: 0.1,
            damping_max_n_s_per_m: 0.3,
        };
        let (points, _, ended) = walk(plan, |_| 1.0);
        assert_eq!((points.len(), ended), (3, Ended::BothMax));
        assert!(points.iter().all(|&(_, k)| (k - 0.3).abs() < 1e-12));
        // In `f64`, 1401.4 - 14 * 100.1 is not 0 but 2e-13.
        let plan =
            WalkSettings { stiffness_start_n_per_m: 1401.4, stiffness_step_n_per_m: 100.1, ..PLAN };
        let (_, hits, ended) = walk(plan, |b| if b < 15.0 { 1401.4 } else { -1.0 });
        // The hits are the start and one up, one across, then 13 cells down to 100.1.
        assert_eq!((hits, ended), (2 + 1 + 13, Ended::Closed));
    }

    /// The steps are 100, so a millionth of a step is 1e-4.
    #[test]
    fn a_cell_may_miss_an_end_of_the_walk_by_a_millionth_of_a_step() {
        let steps = WalkSettings {
            stiffness_step_n_per_m: 100.0,
            damping_step_n_s_per_m: 100.0,
            damping_max_n_s_per_m: 500.0,
            ..PLAN
        };
        let slack = ROUNDING * 100.0;
        for (k, allowed) in [
            (slack, false),
            (1.5 * slack, true),
            (PLAN.stiffness_max_n_per_m + 0.5e-4, true),
            (PLAN.stiffness_max_n_per_m + 1.5e-4, false),
        ] {
            let plan = WalkSettings { stiffness_start_n_per_m: k, ..steps };
            assert_eq!(plan.has_stiffness(Cell::default()), allowed, "{k}");
        }
        for (b, allowed) in [(0.0, true), (500.0 + 0.5e-4, true), (500.0 + 1.5e-4, false)] {
            let plan = WalkSettings { damping_start_n_s_per_m: b, ..steps };
            assert_eq!(plan.has_damping(Cell::default()), allowed, "{b}");
        }
    }

    #[test]
    fn a_walk_that_is_over_stays_within_its_caps_and_repeats_its_answer() {
        let mut over = Walk::new(WalkSettings { damping_max_n_s_per_m: 10.0, ..PLAN });
        over.report(Verdict::Stable).unwrap();
        assert_eq!(over.report(Verdict::Unstable).unwrap().ended, Some(Ended::DampingMax));
        for verdict in [Verdict::Stable, Verdict::Unstable, Verdict::NoContact] {
            assert_eq!(over.report(verdict).unwrap().ended, Some(Ended::DampingMax));
            assert!(PLAN.damping_n_s_per_m(over.cell()) <= 10.0);
        }
    }

    #[test]
    fn a_walk_that_cannot_go_on_says_why_and_keeps_saying_it() {
        assert_eq!(Walk::new(PLAN).report(Verdict::Unstable), Err(WalkError::FirstUnstable));
        let mut walk = Walk::new(PLAN);
        walk.report(Verdict::Stable).unwrap();
        let cell = walk.cell();
        for verdict in [Verdict::NoContact, Verdict::Stable] {
            assert_eq!(walk.report(verdict), Err(WalkError::NoContact(cell)));
        }
        for (error, text) in [
            (WalkError::FirstUnstable, "the first point of the walk is unstable"),
            (WalkError::NoContact(cell), "the push does not bring the handle to the wall"),
        ] {
            assert_eq!(std::format!("{error}"), text);
        }
    }
}
