//! `walk`: the core's boundary walk. `render` runs one hit at a time; which one is next is decided
//! here, with the settings built as for any other command.

use zwidth::{
    console::Reply,
    experiment::{Cell, RunningVariance, Verdict, Walk, WalkError, WalkTotals},
    safety::State,
    store::Stored,
};

use super::{Awaited, Link, lines};
use crate::task::{device, envelope, order::Order};

/// What a walk does next.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Next {
    /// The wall of its cell.
    Wall,
    /// The hit.
    Hit,
    /// Wait for the verdict.
    Verdict,
}

/// A walk in progress.
#[derive(Clone, Copy)]
pub struct Walking {
    walk: Walk,
    totals: WalkTotals,
    next: Next,
}

impl Link {
    pub(super) fn begin_walk(&mut self) {
        let grid = self.stored.grid;
        let valid = grid.check().and_then(|()| device::trial(&self.stored, true).map(|_| ()));
        if let Err(error) = valid {
            return self.reply(Reply::Range(&error));
        }
        self.walking = Some(Walking {
            walk: Walk::new(grid),
            totals: WalkTotals::default(),
            next: Next::Wall,
        });
        self.strayed = true;
        self.reply(Reply::Done("walk"));
    }

    /// Gives the next order of a walk, or brings the stored wall back after one; says whether it did.
    pub(super) fn pursue(&mut self) -> bool {
        if let Some(totals) = self.unheard
            && !self.replies.is_mute()
        {
            self.unheard = None;
            self.write(&lines::WalkOver(totals, Err("nobody read its results")));
        }
        let Some(walking) = self.walking else {
            if core::mem::take(&mut self.strayed)
                && let Ok(order) = envelope::order(&self.stored)
            {
                self.order(order, Awaited::Quiet);
                return true;
            }
            return false;
        };
        let armed = self.latest.is_some_and(|report| report.status.state == State::Armed);
        match walking.next {
            Next::Verdict => return false,
            _ if !armed => self.break_walk("the force went off: see status and faults"),
            // Said once somebody reads again: said now it would be lost.
            _ if self.replies.is_mute() => {
                self.unheard = self.walking.take().map(|walking| walking.totals);
            }
            Next::Wall => match envelope::order(&self.cell(walking.walk.cell())) {
                Ok(order) => self.order(order, Awaited::Cell),
                Err(error) => {
                    self.reply(Reply::Range(&error));
                    self.break_walk("a wall is out of range");
                }
            },
            Next::Hit => match device::trial(&self.stored, true) {
                Ok(plan) => self.order(Order::Hit(plan), Awaited::CellHit),
                Err(_) => self.break_walk("a setting is out of range"),
            },
        }
        true
    }

    /// The stored settings with the wall of a cell.
    fn cell(&self, cell: Cell) -> Stored {
        let mut stored = self.stored;
        let grid = stored.grid;
        stored.settings.wall.stiffness_n_per_m = grid.stiffness_n_per_m(cell);
        stored.settings.wall.damping_n_s_per_m = grid.damping_n_s_per_m(cell);
        stored
    }

    /// `render` has met the last order.
    pub(super) fn advance(&mut self) {
        if let Some(walking) = &mut self.walking {
            walking.next = match walking.next {
                Next::Wall => Next::Hit,
                Next::Hit | Next::Verdict => Next::Verdict,
            };
        }
    }

    /// A hit of the walk is over.
    pub(super) fn judged(&mut self, verdict: Verdict, scatter: &RunningVariance) {
        let Some(mut walking) = self.walking else { return };
        let plan = *walking.walk.plan();
        let cell = walking.walk.cell();
        let number = walking.totals.hits.saturating_add(1);
        self.write(&lines::CellJudged(number, &plan, cell, verdict, scatter));
        match walking.walk.report(verdict) {
            Ok(step) => {
                walking.totals.add(&plan, &step);
                if let Some(cell) = step.boundary {
                    self.write(&lines::Boundary(walking.totals.points, &plan, cell));
                }
                walking.next = Next::Wall;
                self.walking = Some(walking);
                if let Some(ended) = step.ended {
                    self.walking = None;
                    self.write(&lines::WalkOver(walking.totals, Ok(ended)));
                }
            }
            Err(error) => {
                walking.totals.hits = number;
                self.walking = Some(walking);
                self.break_walk(match error {
                    WalkError::FirstUnstable => {
                        "the first point is unstable: lower kstart or bstart"
                    }
                    WalkError::NoContact(_) => {
                        "the push does not bring the handle to the wall: raise push"
                    }
                })
            }
        }
    }

    /// Ends the walk without a result.
    pub(super) fn break_walk(&mut self, why: &'static str) {
        if let Some(walking) = self.walking.take() {
            self.write(&lines::WalkOver(walking.totals, Err(why)));
        }
    }
}
