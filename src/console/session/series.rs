//! A series of hits: a `walk`, or a `hit` with the criterion `quiet`, which has several pushes. The task `render` runs
//! one hit at a time. The console chooses the next hit, and builds its settings as for any other command.

use super::{Awaited, Console};
use crate::{
    actuator::Actuator,
    console::{
        Port, Reply,
        lines::{self, JudgedHit},
    },
    experiment::{
        Activity, Criterion, Order, RunningVariance, Verdict, Walk, WalkError, WalkTotals,
        quiet::{FORCE_SHARE, PUSHES, QuietWindow, penetration_ratio},
    },
    port::Exchanged,
    safety::State,
    store::Stored,
};

#[derive(Clone, Copy, PartialEq, Eq)]
enum Next {
    /// Order the wall of the walk's present cell.
    Wall,
    Hit,
    Verdict,
}

#[derive(Clone, Copy)]
pub struct HitSeries {
    /// The walk, or `None` for a single hit at the wall in force.
    walk: Option<Walk>,
    totals: WalkTotals,
    next: Next,
    /// Number of the next push in [`PUSHES`].
    push: usize,
    /// Among the pushes at this wall so far, the hit with the largest RMS of the force.
    loudest: Option<JudgedHit>,
}

impl HitSeries {
    fn of(walk: Option<Walk>, next: Next) -> Self {
        Self { walk, totals: WalkTotals::default(), next, push: 0, loudest: None }
    }

    /// Activity to report while the series runs.
    pub(super) const fn activity(&self) -> Activity {
        if self.walk.is_some() { Activity::Walk } else { Activity::Pushes }
    }

    /// Returns `stored`, but with the wall of the walk's present cell and with the next push.
    #[inline(never)] // as `judged`
    fn settings(&self, mut stored: Stored) -> Stored {
        if let Some(walk) = &self.walk {
            let (grid, cell) = (walk.plan(), walk.cell());
            stored.settings.wall.stiffness_n_per_m = grid.stiffness_n_per_m(cell);
            stored.settings.wall.damping_n_s_per_m = grid.damping_n_s_per_m(cell);
        }
        if stored.criterion == Criterion::Quiet {
            stored.push_n *= PUSHES.get(self.push).copied().unwrap_or(1.0);
        }
        stored
    }
}

impl<P: Port> Console<P> {
    pub(in crate::console) fn begin_walk(&mut self) {
        let grid = self.stored.grid;
        if let Err(error) = grid.check() {
            return self.reply(Reply::Range(&error));
        }
        self.begin(HitSeries::of(Some(Walk::new(grid)), Next::Wall), "walk");
    }

    /// Begins a hit. With the criterion `quiet` this is a series with one hit for each push.
    pub(in crate::console) fn begin_hit(&mut self) {
        match (self.stored.criterion, self.device.hit_sequence(&self.stored, false)) {
            (Criterion::Quiet, _) => self.begin(HitSeries::of(None, Next::Hit), "hit"),
            (Criterion::Rms, Ok(plan)) => self.order(Order::Hit(plan), Awaited::Done("hit")),
            (Criterion::Rms, Err(error)) => self.reply(Reply::Range(&error)),
        }
    }

    fn begin(&mut self, series: HitSeries, name: &'static str) {
        if let Err(error) = self.device.hit_sequence(&self.stored, true) {
            return self.reply(Reply::Range(&error));
        }
        self.restore_wall = series.walk.is_some();
        self.series = Some(series);
        self.in_series.set(true);
        self.reply(Reply::Done(name));
    }

    /// Gives the next order of a series. After the end of a walk, the order puts the stored wall in force again.
    /// Returns whether there was an order to give.
    pub(super) fn pursue(&mut self) -> bool {
        if !self.is_mute()
            && let Some(series) = self.unread.take()
        {
            self.say_end(&series, "nobody read its results");
        }
        if !self.in_series.is_whole() {
            self.end_series("its state is damaged");
            self.in_series.set(false);
        }
        if !*self.in_series {
            self.series = None;
            self.restore_wall = false;
            return false;
        }
        let Some(series) = &self.series else {
            self.in_series.set(false);
            if core::mem::take(&mut self.restore_wall)
                && let Ok(order) = self.device.order(&self.stored)
            {
                self.order_settings(&{ *self.stored }, order, Awaited::Quiet);
                return true;
            }
            return false;
        };
        let armed = self.latest.is_some_and(|(now, _)| now.status.state == State::Armed);
        match series.next {
            Next::Verdict => return false,
            _ if !armed => self.end_series("the force went off: see status and faults"),
            // Nobody reads, so a line would be lost. The end of the series is reported when somebody reads again.
            _ if self.replies.is_mute(&mut self.port) => self.unread = self.series.take(),
            Next::Wall => {
                let stored = series.settings(*self.stored);
                match self.device.order(&stored) {
                    Ok(order) => self.order_settings(&stored, order, Awaited::Series),
                    Err(error) => {
                        // The line says `walk:` after `error:`. Without `walk:` it would look like the answer to a
                        // command.
                        self.write(&format_args!("walk: {}", self.spoken().refusal(&error)));
                        self.end_series("a wall is out of range");
                    }
                }
            }
            // A walk needs only the verdicts. So its hits may end as soon as their verdict is certain.
            Next::Hit => {
                let (stored, early) = (series.settings(*self.stored), series.walk.is_some());
                match self.device.hit_sequence(&stored, early) {
                    Ok(plan) => self.order(Order::Hit(plan), Awaited::Series),
                    Err(_) => self.end_series("a setting is out of range"),
                }
            }
        }
        true
    }

    /// Makes a state that only flipped bits could make. The console seems to be in a walk, or to have a wall to
    /// restore, although no walk was begun.
    #[cfg(test)]
    pub(in crate::console) fn damage(&mut self, in_walk: bool) {
        let series = HitSeries::of(Some(Walk::new(self.stored.grid)), Next::Hit);
        self.series = in_walk.then_some(series);
        self.restore_wall = true;
    }

    /// Chooses the next step. The last order of the series was accepted.
    pub(super) fn advance(&mut self) {
        if let Some(series) = &mut self.series {
            series.next = match series.next {
                Next::Wall => Next::Hit,
                Next::Hit | Next::Verdict => Next::Verdict,
            };
        }
    }

    /// Takes the result of a hit that is over. With the criterion `quiet` the verdict also depends on the output codes,
    /// which come later.
    pub(super) fn hit_over(&mut self, verdict: Verdict, counts: RunningVariance, port: Exchanged) {
        let hit = JudgedHit { verdict, counts, port, quiet: None };
        match self.stored.criterion {
            Criterion::Rms => self.judged(hit),
            Criterion::Quiet => self.over = Some(hit),
        }
    }

    /// Takes the output codes of the hit that is over, and judges the hit.
    #[inline(never)] // f64 here would make every pass save the floating-point registers
    pub(super) fn hit_codes(&mut self, codes: RunningVariance) {
        // Without a series, the series of this hit was stopped meanwhile.
        let (Some(mut hit), Some(series)) = (self.over.take(), self.series) else { return };
        let stored = series.settings(*self.stored);
        hit.quiet = self.quiet_window(&stored, &hit.counts, &codes);
        // Without a limit in the settings, the limit is a share of the push in the settings, not of this hit's push.
        let share_n = FORCE_SHARE * libm::fabs(self.stored.push_n);
        let limit_n = stored.force_rms_limit_n.unwrap_or(share_n);
        let is_loud = hit.quiet.is_some_and(|quiet| !quiet.is_quiet(limit_n));
        if hit.verdict == Verdict::Stable && is_loud {
            hit.verdict = Verdict::Unstable;
        }
        self.judged(hit);
    }

    #[inline(never)] // as `hit_codes`
    fn judged(&mut self, hit: JudgedHit) {
        let Some(mut series) = self.series else { return self.say_hit(&hit) };
        let verdict = hit.verdict;
        if series.walk.is_none() {
            let push_n = series.settings(*self.stored).push_n;
            self.write(&lines::PushJudged(series.push, push_n, self.said(&hit)));
        }
        let deciding = match series.loudest {
            Some(before)
                if verdict == Verdict::Stable && before.force_rms_n() > hit.force_rms_n() =>
            {
                before
            }
            _ => hit,
        };
        series.push += 1;
        if hit.quiet.is_some() && verdict == Verdict::Stable && series.push < PUSHES.len() {
            (series.loudest, series.next) = (Some(deciding), Next::Hit);
            self.series = Some(series);
            return;
        }
        (series.push, series.loudest) = (0, None);
        match series.walk {
            Some(walk) => self.walk_on(series, walk, &deciding),
            None => {
                self.series = None;
                self.say_hit(&deciding);
            }
        }
    }

    /// Computes force and wall of a hit's window for the criterion `quiet`. Returns `None` if a setting is out of
    /// range.
    fn quiet_window(
        &self,
        stored: &Stored,
        counts: &RunningVariance,
        codes: &RunningVariance,
    ) -> Option<QuietWindow> {
        let design = self.device.design(stored).ok()?;
        let actuator = Actuator::new(design.output).ok()?;
        let wall = &stored.settings.wall;
        let surface = design.position("position_m", wall.position_m).ok()?;
        let code_n = design.full_scale_n / f64::from(actuator.codes_per_full_scale());
        let pushed_n = (codes.mean_counts() - f64::from(actuator.zero().code())) * code_n;
        let count_n = wall.stiffness_n_per_m * design.resolution_m;
        let behind = counts.mean_counts() - f64::from(surface.counts());
        let wall_force_n = stored.push_n - pushed_n;
        Some(QuietWindow {
            force_rms_n: codes.rms_counts() * code_n,
            wall_force_n,
            penetration_ratio: penetration_ratio(behind * count_n, wall_force_n),
            count_n,
        })
    }

    fn walk_on(&mut self, mut series: HitSeries, mut walk: Walk, hit: &JudgedHit) {
        let (plan, cell, spoken) = (*walk.plan(), walk.cell(), self.spoken());
        let number = series.totals.hits.saturating_add(1);
        self.write(&lines::CellJudged(number, &plan, cell, self.said(hit)));
        let step = walk.report(hit.verdict);
        series.walk = Some(walk);
        match step {
            Ok(step) => {
                series.totals.add(&plan, &step);
                if let Some(cell) = step.boundary {
                    self.write(&lines::BoundaryPoint(series.totals.points, &plan, cell, spoken));
                }
                series.next = Next::Wall;
                self.series = Some(series);
                if let Some(ended) = step.ended {
                    self.series = None;
                    self.write(&lines::WalkOver(series.totals, Ok(ended), spoken));
                }
            }
            Err(error) => {
                series.totals.hits = number;
                self.series = Some(series);
                self.end_series(match error {
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

    fn said(&self, hit: &JudgedHit) -> lines::SaidHit {
        lines::SaidHit {
            hit: *hit,
            resolution_m: self.device.design.resolution_m,
            spoken: self.spoken(),
        }
    }

    fn say_hit(&mut self, hit: &JudgedHit) {
        self.write(&lines::HitOver(self.said(hit), self.stored.full_scale_n));
    }

    /// Ends the series without a result, if a series is running. `why` is the reason.
    pub(super) fn end_series(&mut self, why: &'static str) {
        if let Some(series) = self.series.take() {
            self.say_end(&series, why);
        }
    }

    fn say_end(&mut self, series: &HitSeries, why: &'static str) {
        match series.walk {
            Some(_) => self.write(&lines::WalkOver(series.totals, Err(why), self.spoken())),
            None => self.write(&format_args!("error: hit: {why}")),
        }
    }
}
