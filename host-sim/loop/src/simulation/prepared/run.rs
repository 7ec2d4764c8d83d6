//! Runs hits of a prepared scene, to the end or until the verdict is certain.

use std::ops::ControlFlow;

use zwidth::experiment::{Hit, Verdict};

use super::{
    PreparedScene,
    watch::{Judged, Shown},
};
use crate::{
    plant::{AnyPlant, Plant, each_plant},
    simulation::{
        Sample, Simulation,
        controller::{Controller, Told},
        hit::{HitError, HitReport, Numeric, WallHit, louder},
        passive::Passive,
        senses::{Blind, Sensing},
        window::Stiff,
    },
};

pub(super) type Observer<'a> = dyn FnMut(&Sample) + 'a;

/// Number of samples between two checks whether the verdict is certain.
const EARLY_CHECK_SAMPLES: u32 = 256;

impl PreparedScene {
    /// Runs a whole hit. `observe` gets every sample. With several pushes, `observe` gets only the samples of the hit
    /// with the scene's own push.
    ///
    /// # Errors
    /// A setting is out of range, or the handle leaves the core's range.
    pub fn hit(
        &self,
        numeric: Numeric,
        hit: &WallHit,
        mut observe: impl FnMut(&Sample),
    ) -> Result<HitReport, HitError> {
        let mut observe: Option<&mut Observer<'_>> = Some(&mut observe);
        let report = deciding(self.pushes().iter().map(|of| {
            let observe = if self.has_push_of(of) { observe.take() } else { None };
            of.by(numeric, hit, observe, false)
        }))?;
        if observe.is_some() {
            self.observed_hit(numeric, hit, observe)?; // a smaller push was unstable before the scene's own push was run
        }
        report.ok_or(HitError::OutOfRange(0)) // never an error: each hit was run to its end
    }

    /// The same as [`hit`](Self::hit), but without an observer.
    pub fn report(&self, numeric: Numeric, hit: &WallHit) -> Result<HitReport, HitError> {
        let report = self.at_pushes(numeric, hit, false)?;
        report.ok_or(HitError::OutOfRange(0)) // never an error: each hit was run to its end
    }

    /// Runs a whole hit at each push that the test of the wall needs. Returns each push in N with its report. `observe`
    /// gets every sample of the hit with the scene's own push.
    ///
    /// # Errors
    /// The errors of [`hit`](Self::hit).
    pub fn reports(
        &self,
        numeric: Numeric,
        hit: &WallHit,
        mut observe: impl FnMut(&Sample),
    ) -> Result<Vec<(f64, HitReport)>, HitError> {
        let report = |of: &Self| {
            let observe: Option<&mut Observer<'_>> =
                if self.has_push_of(of) { Some(&mut observe) } else { None };
            Ok((of.scene.wall_hit.push_n, of.observed_hit(numeric, hit, observe)?))
        };
        self.pushes().iter().map(report).collect()
    }

    fn has_push_of(&self, other: &Self) -> bool {
        self.scene.wall_hit.push_n.to_bits() == other.scene.wall_hit.push_n.to_bits()
    }

    /// Whether the handle touches the wall, before the window or in it.
    pub fn touches(&self, numeric: Numeric, hit: &WallHit) -> bool {
        self.report(numeric, hit).is_ok_and(|report| report.peak_penetration_m > 0.0)
    }

    /// Runs a hit with an observer. `observe` is a pointer, so the loops are compiled once and not for each caller.
    fn observed_hit(
        &self,
        numeric: Numeric,
        hit: &WallHit,
        observe: Option<&mut Observer<'_>>,
    ) -> Result<HitReport, HitError> {
        let whole = self.by(numeric, hit, observe, false)?;
        whole.ok_or(HitError::OutOfRange(0)) // never an error: the hit was run to its end
    }

    /// The report of a hit. The hit ends with `None` as soon as it is certain to be unstable.
    ///
    /// # Errors
    /// The errors of [`verdict`](Self::verdict).
    pub fn bounded(&self, numeric: Numeric, hit: &WallHit) -> Result<Option<HitReport>, HitError> {
        self.at_pushes(numeric, hit, true)
    }

    fn at_pushes(
        &self,
        numeric: Numeric,
        hit: &WallHit,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        deciding(self.pushes().iter().map(|of| of.by(numeric, hit, None, bounded)))
    }

    /// Runs a hit. The arithmetic determines which controller runs.
    fn by(
        &self,
        numeric: Numeric,
        hit: &WallHit,
        observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        match numeric.twin() {
            _ if self.is_told => {
                self.rare_hit(hit, Told::new(self.core(hit)?, &self.design), observe, bounded)
            }
            None if self.is_rare() => self.rare_hit(hit, self.core(hit)?, observe, bounded),
            Some(rounding) if self.is_rare() => {
                self.rare_hit(hit, self.twin_of_core(hit, rounding)?, observe, bounded)
            }
            None => self.whole_hit(hit, self.core(hit)?, observe, bounded),
            Some(rounding) => {
                self.whole_hit(hit, self.twin_of_core(hit, rounding)?, observe, bounded)
            }
        }
    }

    /// Whether the scene is rare: it has a passivity controller or a varying push.
    fn is_rare(&self) -> bool {
        self.passivity.is_some() || self.scene.wall_hit.protocol.varies()
    }

    /// Runs a hit of a rare scene, with the passivity controller if the scene has one.
    fn rare_hit<C: Controller + Copy>(
        &self,
        hit: &WallHit,
        controller: C,
        observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        match self.passivity {
            None => self.any_hit(hit, controller, observe, bounded),
            Some(plan) => {
                let passive = Passive::new(controller, plan, self.first_count(hit));
                self.any_hit(hit, passive, observe, bounded)
            }
        }
    }

    /// The verdict of a hit. The hit ends as soon as the verdict is certain.
    ///
    /// # Errors
    /// A setting is out of range, or the handle leaves the core's range.
    pub fn verdict(&self, numeric: Numeric, hit: &WallHit) -> Result<Verdict, HitError> {
        match numeric.twin() {
            _ if !self.judge.is_plain() || self.is_told => self.bounded(numeric, hit).map(judged),
            None => self.early_verdict(hit, self.core(hit)?),
            Some(rounding) => self.early_verdict(hit, self.twin_of_core(hit, rounding)?),
        }
    }

    /// Runs a whole hit. The type of the plant is selected here, once per run and outside the loop. Few scenes have
    /// inputs in addition to the count. The hits of these scenes share one loop for all plants.
    fn whole_hit<C: Controller + Copy>(
        &self,
        hit: &WallHit,
        controller: C,
        observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        let start_m = self.start_m(hit);
        let sensing = self.sensing(hit);
        if sensing.looks() {
            let parts = self.parts.clone();
            let simulation = Simulation::new(parts, controller, sensing, start_m);
            return self.run_whole(hit, simulation, observe, bounded);
        }
        each_plant!(&self.parts.plant, plant => {
            let parts = self.parts.with(plant);
            let simulation = Simulation::new(parts, controller, Blind, start_m);
            self.run_whole(hit, simulation, observe, bounded)
        })
    }

    /// The same as [`whole_hit`](Self::whole_hit), for any plant and any inputs. The function is compiled once, for
    /// rare cases.
    fn any_hit<C: Controller>(
        &self,
        hit: &WallHit,
        controller: C,
        observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        if self.scene.wall_hit.protocol.varies() {
            return self.varied_hit(hit, controller, observe, bounded);
        }
        let parts = self.parts.clone();
        let simulation = Simulation::new(parts, controller, self.sensing(hit), self.start_m(hit));
        self.run_whole(hit, simulation, observe, bounded)
    }

    /// The verdict of a hit with any controller. The controller must be at rest at the hit's start.
    pub fn early_verdict<C: Controller + Copy>(
        &self,
        hit: &WallHit,
        controller: C,
    ) -> Result<Verdict, HitError> {
        if !self.judge.is_plain() || self.is_rare() {
            return self.rare_hit(hit, controller, None, true).map(judged);
        }
        self.counted(hit, controller, true).map(|(verdict, _)| verdict)
    }

    /// The verdict of a whole hit, and the RMS of its counts in m. The function needs half the time of
    /// [`report`](Self::report). Returns `None` if the verdict needs more than counts.
    ///
    /// # Errors
    /// The errors of [`verdict`](Self::verdict).
    pub fn rms(&self, numeric: Numeric, hit: &WallHit) -> Result<Option<(Verdict, f64)>, HitError> {
        if !self.judge.is_plain() || self.is_told || self.passivity.is_some() {
            return Ok(None);
        }
        let (verdict, whole) = match numeric.twin() {
            None => self.counted(hit, self.core(hit)?, false)?,
            Some(rounding) => self.counted(hit, self.twin_of_core(hit, rounding)?, false)?,
        };
        Ok(Some((verdict, whole.scatter().rms_counts() * self.design.resolution_m)))
    }

    /// Runs a hit, and evaluates only its counts.
    fn counted<C: Controller>(
        &self,
        hit: &WallHit,
        controller: C,
        early: bool,
    ) -> Result<(Verdict, Hit), HitError> {
        let start_m = self.start_m(hit);
        match (self.sensing(hit), &self.parts.plant) {
            (sensing, _) if !sensing.looks() => {}
            (sensing, AnyPlant::Plain(plant)) => {
                let simulation =
                    Simulation::new(self.parts.with(plant), controller, sensing, start_m);
                return self.run_counted(simulation, early);
            }
            (sensing, _) => {
                let simulation = Simulation::new(self.parts.clone(), controller, sensing, start_m);
                return self.run_counted(simulation, early);
            }
        }
        each_plant!(&self.parts.plant, plant => {
            let parts = self.parts.with(plant);
            self.run_counted(Simulation::new(parts, controller, Blind, start_m), early)
        })
    }

    fn run_whole<C: Controller, S: Sensing, P: Plant>(
        &self,
        of: &WallHit,
        mut simulation: Simulation<C, S, P>,
        mut observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        let surface = simulation.controller().surface();
        let surface_m = f64::from(surface) * self.design.resolution_m;
        let mut judged = Judged::new(self.plan, surface);
        let mut shown = Shown::new(self.judge.listens(), self.first_count(of));
        let mut port = self.port_watch(of, surface);
        let mut left = self.samples();
        while left > 0 {
            let samples = left.min(if bounded { EARLY_CHECK_SAMPLES } else { left });
            left -= samples;
            let ended = simulation.blocks(samples, observe.is_some(), |block| {
                if let Some(observe) = &mut observe {
                    block.each().for_each(|sample| observe(&sample));
                }
                if !bounded {
                    port.block(block);
                }
                shown.block(block, judged.settle());
                judged.block(block)
            });
            if let ControlFlow::Break(error) = ended {
                return Err(error);
            }
            let early = bounded && left > 0;
            let watch = &shown.watch;
            if early && self.judge.certain_verdict(&judged.hit(), watch, self.plan.window).is_some()
            {
                return Ok(None);
            }
        }
        let hit = judged.hit();
        let scatter = hit.scatter();
        let motion = || std::mem::take(&mut shown.motion);
        let wall = Stiff { stiffness_n_per_m: of.stiffness_n_per_m, surface };
        let measures = self.judge.measures(&hit, wall, &shown.watch, motion);
        let verdict = self.judge.verdict(&hit, wall, &measures);
        let report = HitReport {
            verdict,
            measures,
            mean_m: scatter.mean_counts() * self.design.resolution_m,
            peak_penetration_m: (shown.deepest_m - surface_m).max(0.0),
            saturated_fraction: f64::from(shown.saturated) / f64::from(shown.outputs),
            contact_fraction: f64::from(hit.contact_samples()) / f64::from(scatter.samples()),
            velocity_clipped_fraction: f64::from(shown.clipped) / f64::from(self.samples()),
            port: port.report(shown.last),
        };
        Ok((!bounded || verdict != Verdict::Unstable).then_some(report))
    }

    /// Runs to the end of the hit, or until the verdict is certain.
    fn run_counted<C: Controller, S: Sensing, P: Plant>(
        &self,
        mut simulation: Simulation<C, S, P>,
        early: bool,
    ) -> Result<(Verdict, Hit), HitError> {
        let mut judged = Judged::new(self.plan, simulation.controller().surface());
        let mut left = self.samples();
        while left > 0 {
            let samples = left.min(if early { EARLY_CHECK_SAMPLES } else { left });
            left -= samples;
            let ended = simulation.blocks(samples, false, |block| judged.block(block));
            if let ControlFlow::Break(error) = ended {
                return Err(error);
            }
            if left > 0
                && let Some(certain) = judged.hit().certain_verdict()
            {
                return Ok((certain, judged.hit()));
            }
        }
        Ok((judged.hit().verdict(), judged.hit()))
    }
}

/// Runs a hit at each push, one after another. Returns the first hit that is not stable; later hits are not run. If all
/// hits are stable, returns the hit with the largest force RMS.
fn deciding(
    hits: impl Iterator<Item = Result<Option<HitReport>, HitError>>,
) -> Result<Option<HitReport>, HitError> {
    let mut worst = None;
    for hit in hits {
        match hit? {
            Some(report) if report.is_stable() => {
                worst = Some(louder(worst, report, |report| Some(report.force_rms_n)));
            }
            failed => return Ok(failed),
        }
    }
    Ok(worst)
}

/// The verdict that a bounded run gives. `None` means that the hit is certain to be unstable.
fn judged(bounded: Option<HitReport>) -> Verdict {
    bounded.map_or(Verdict::Unstable, |report| report.verdict)
}
