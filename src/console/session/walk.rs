//! `walk`: the core's boundary walk. The output task runs one hit at a time; which one is next is decided
//! here, with the settings built as for any other command.

use super::{Awaited, Console};
use crate::{
    console::{Port, Reply, lines},
    experiment::{Order, RunningVariance, Verdict, Walk, WalkError, WalkTotals},
    safety::State,
    store::Stored,
};

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
pub struct WalkSession {
    walk: Walk,
    totals: WalkTotals,
    next: Next,
}

impl WalkSession {
    /// Those settings with the wall of the walk's cell.
    #[inline(never)] // as `judged`
    fn with_wall(&self, mut stored: Stored) -> Stored {
        let (grid, cell) = (self.walk.plan(), self.walk.cell());
        stored.settings.wall.stiffness_n_per_m = grid.stiffness_n_per_m(cell);
        stored.settings.wall.damping_n_s_per_m = grid.damping_n_s_per_m(cell);
        stored
    }
}

impl<P: Port> Console<P> {
    pub(in crate::console) fn begin_walk(&mut self) {
        let walk = Walk::new(self.stored.grid);
        let valid = walk.plan().check().and_then(|()| self.device.hit_sequence(&self.stored, true));
        if let Err(error) = valid {
            return self.reply(Reply::Range(&error));
        }
        self.walking = Some(WalkSession { walk, totals: WalkTotals::default(), next: Next::Wall });
        self.restore_wall = true;
        self.walks.set(true);
        self.reply(Reply::Done("walk"));
    }

    /// Gives the next order of a walk, or brings the stored wall back after one; says whether it did.
    pub(super) fn pursue(&mut self) -> bool {
        if let Some(totals) = self.pending_totals
            && !self.is_mute()
        {
            self.pending_totals = None;
            self.write(&lines::WalkOver(totals, Err("nobody read its results"), self.spoken()));
        }
        if !self.walks.is_whole() {
            self.end_walk("its state is damaged");
            self.walks.set(false);
        }
        if !*self.walks {
            self.walking = None;
            self.restore_wall = false;
            return false;
        }
        let Some(walking) = &self.walking else {
            self.walks.set(false);
            if core::mem::take(&mut self.restore_wall)
                && let Ok(order) = self.device.order(&self.stored)
            {
                self.order_settings(&{ *self.stored }, order, Awaited::Quiet);
                return true;
            }
            return false;
        };
        let armed = self.latest.is_some_and(|report| report.status.state == State::Armed);
        match walking.next {
            Next::Verdict => return false,
            _ if !armed => self.end_walk("the force went off: see status and faults"),
            // Said once somebody reads again: said now it would be lost.
            _ if self.replies.is_mute(&mut self.port) => {
                self.pending_totals = self.walking.take().map(|walking| walking.totals);
            }
            Next::Wall => {
                let stored = walking.with_wall(*self.stored);
                match self.device.order(&stored) {
                    Ok(order) => self.order_settings(&stored, order, Awaited::Cell),
                    Err(error) => {
                        self.reply(Reply::Range(&error));
                        self.end_walk("a wall is out of range");
                    }
                }
            }
            Next::Hit => match self.device.hit_sequence(&self.stored, true) {
                Ok(plan) => self.order(Order::Hit(plan), Awaited::Cell),
                Err(_) => self.end_walk("a setting is out of range"),
            },
        }
        true
    }

    /// As bits that flip could leave it: in a walk, and with a wall to bring back, though nobody has begun one.
    #[cfg(test)]
    pub(in crate::console) fn damage(&mut self, in_walk: bool) {
        let (walk, totals) = (Walk::new(self.stored.grid), WalkTotals::default());
        self.walking = in_walk.then_some(WalkSession { walk, totals, next: Next::Hit });
        self.restore_wall = true;
    }

    /// The last order of the walk was met.
    pub(super) fn advance(&mut self) {
        if let Some(walking) = &mut self.walking {
            walking.next = match walking.next {
                Next::Wall => Next::Hit,
                Next::Hit | Next::Verdict => Next::Verdict,
            };
        }
    }

    /// A hit of the walk is over.
    #[inline(never)] // f64 here would make every pass save the floating-point registers
    pub(super) fn judged(&mut self, verdict: Verdict, window: &RunningVariance) {
        let Some(mut walking) = self.walking else { return };
        let plan = *walking.walk.plan();
        let cell = walking.walk.cell();
        let number = walking.totals.hits.saturating_add(1);
        let rms_m = window.rms_counts() * self.device.design.resolution_m;
        self.write(&lines::CellJudged(number, &plan, cell, verdict, rms_m, self.spoken()));
        match walking.walk.report(verdict) {
            Ok(step) => {
                walking.totals.add(&plan, &step);
                if let Some(cell) = step.boundary {
                    self.write(&lines::BoundaryPoint(
                        walking.totals.points,
                        &plan,
                        cell,
                        self.spoken(),
                    ));
                }
                walking.next = Next::Wall;
                self.walking = Some(walking);
                if let Some(ended) = step.ended {
                    self.walking = None;
                    self.write(&lines::WalkOver(walking.totals, Ok(ended), self.spoken()));
                }
            }
            Err(error) => {
                walking.totals.hits = number;
                self.walking = Some(walking);
                self.end_walk(match error {
                    WalkError::FirstUnstable => {
                        "the first point is unstable: lower kstart or bstart"
                    }
                    WalkError::NoContact(_) => {
                        "the push does not bring the handle to the wall: raise push"
                    }
                });
            }
        }
    }

    /// Ends the walk, if there is one, without a result.
    pub(super) fn end_walk(&mut self, why: &'static str) {
        if let Some(walking) = self.walking.take() {
            self.write(&lines::WalkOver(walking.totals, Err(why), self.spoken()));
        }
    }
}
