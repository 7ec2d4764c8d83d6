//! How the hits of a prepared scene run: to their end, or until the verdict is certain.

use std::ops::ControlFlow;

use zwidth::{
    experiment::{Hit, Verdict},
    units::{Position, Velocity},
};

use super::PreparedScene;
use crate::{
    plant::{AnyPlant, Plant, each_plant},
    simulation::{
        Sample, Simulation,
        controller::{Controller, Replaceable, Told},
        hit::{HitError, HitReport, Numeric, WallHit},
        passive::Passive,
        senses::{AnySensing, Blind, Sensing},
        window::Watch,
    },
};

/// Sees every sample of a hit.
type Observer<'a> = dyn FnMut(&Sample) + 'a;

/// How many samples pass between two looks for an early verdict.
const EARLY_CHECK_SAMPLES: u32 = 256;

impl PreparedScene {
    /// Runs a whole hit; `observe` sees every sample.
    ///
    /// # Errors
    /// A setting is out of range, or the handle leaves the core's range.
    pub fn hit(
        &self,
        numeric: Numeric,
        hit: &WallHit,
        mut observe: impl FnMut(&Sample),
    ) -> Result<HitReport, HitError> {
        self.observed_hit(numeric, hit, Some(&mut observe))
    }

    /// [`hit`](Self::hit) that nobody needs to look at.
    ///
    /// # Errors
    /// As [`hit`](Self::hit).
    pub fn report(&self, numeric: Numeric, hit: &WallHit) -> Result<HitReport, HitError> {
        self.observed_hit(numeric, hit, None)
    }

    /// Whether the handle comes to the wall at all, within the window or before it.
    pub fn touches(&self, numeric: Numeric, hit: &WallHit) -> bool {
        self.report(numeric, hit).is_ok_and(|report| report.peak_penetration_m > 0.0)
    }

    /// Through a pointer, so that the loops are compiled once and not for each caller.
    fn observed_hit(
        &self,
        numeric: Numeric,
        hit: &WallHit,
        observe: Option<&mut Observer<'_>>,
    ) -> Result<HitReport, HitError> {
        let whole = self.by(numeric, hit, observe, false)?;
        whole.ok_or(HitError::OutOfRange(0)) // never: it was run to its end
    }

    /// What a hit showed; `None` as soon as it is certain to be unstable.
    ///
    /// # Errors
    /// As [`verdict`](Self::verdict).
    pub fn bounded(&self, numeric: Numeric, hit: &WallHit) -> Result<Option<HitReport>, HitError> {
        self.by(numeric, hit, None, true)
    }

    /// A hit by the controller of that arithmetic.
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
            None if self.passivity.is_some() => {
                self.rare_hit(hit, self.core(hit)?, observe, bounded)
            }
            Some(rounding) if self.passivity.is_some() => {
                self.rare_hit(hit, self.twin_of_core(hit, rounding)?, observe, bounded)
            }
            None => self.whole_hit(hit, self.core(hit)?, observe, bounded),
            Some(rounding) => {
                self.whole_hit(hit, self.twin_of_core(hit, rounding)?, observe, bounded)
            }
        }
    }

    /// A hit whose controller few scenes have, with the passivity controller where the scene has one.
    fn rare_hit<C: Replaceable + Copy>(
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

    /// The verdict of a hit, found as early as it is certain.
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

    /// The plant is told apart here, once per run, and not in its loop; with senses, which few scenes need, it is
    /// not.
    fn whole_hit<C: Controller + Copy>(
        &self,
        hit: &WallHit,
        controller: C,
        observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        let start_m = self.start_m(hit);
        if let AnySensing::Full(full) = self.sensing() {
            let parts = self.parts.clone();
            let simulation = Simulation::new(parts, controller, full, start_m);
            return self.run_whole(hit, simulation, observe, bounded);
        }
        each_plant!(&self.parts.plant, plant => {
            let parts = self.parts.with(plant);
            let simulation = Simulation::new(parts, controller, Blind, start_m);
            self.run_whole(hit, simulation, observe, bounded)
        })
    }

    /// The same compiled once for all plants and senses: for what is asked rarely.
    fn any_hit<C: Controller + Copy>(
        &self,
        hit: &WallHit,
        controller: C,
        observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        let parts = self.parts.clone();
        let simulation = Simulation::new(parts, controller, self.sensing(), self.start_m(hit));
        self.run_whole(hit, simulation, observe, bounded)
    }

    /// The verdict with any controller that is at rest where the hit starts.
    pub fn early_verdict<C: Replaceable + Copy>(
        &self,
        hit: &WallHit,
        controller: C,
    ) -> Result<Verdict, HitError> {
        if !self.judge.is_plain() || self.passivity.is_some() {
            return self.rare_hit(hit, controller, None, true).map(judged);
        }
        let start_m = self.start_m(hit);
        match (self.sensing(), &self.parts.plant) {
            (AnySensing::Blind, _) => {}
            (AnySensing::Full(full), AnyPlant::Plain(plant)) => {
                let parts = self.parts.with(plant);
                return self.run_to_verdict(Simulation::new(parts, controller, full, start_m));
            }
            (AnySensing::Full(full), _) => {
                let parts = self.parts.clone();
                return self.run_to_verdict(Simulation::new(parts, controller, full, start_m));
            }
        }
        each_plant!(&self.parts.plant, plant => {
            let parts = self.parts.with(plant);
            self.run_to_verdict(Simulation::new(parts, controller, Blind, start_m))
        })
    }

    fn run_whole<C: Controller + Copy, S: Sensing, P: Plant>(
        &self,
        of: &WallHit,
        mut simulation: Simulation<C, S, P>,
        mut observe: Option<&mut Observer<'_>>,
        bounded: bool,
    ) -> Result<Option<HitReport>, HitError> {
        let surface = simulation.controller().surface();
        let surface_m = f64::from(surface) * self.design.resolution_m;
        let (mut hit, settle) = (Hit::new(self.plan), u64::from(self.plan.settle));
        let (mut watch, mut motion, listens) = (Watch::default(), vec![], self.judge.listens());
        let (mut outputs, mut saturated) = (0u32, 0u32);
        let mut port = self.port_watch(of, surface);
        let (mut peak_penetration_m, mut clipped, mut last) = (0f64, 0u32, self.first_count(of));
        let (mut ended, mut left) = (ControlFlow::Continue(()), self.samples());
        while left > 0 && ended.is_continue() {
            let samples = left.min(if bounded { EARLY_CHECK_SAMPLES } else { left });
            left -= samples;
            ended = simulation.run(samples, |sample| {
                if let Some(observe) = &mut observe {
                    observe(sample);
                }
                if !bounded {
                    port.sample(sample);
                }
                if let Some(rendered) = sample.rendered {
                    outputs += 1;
                    saturated += u32::from(rendered.saturated);
                }
                peak_penetration_m = peak_penetration_m.max(sample.position_m - surface_m);
                clipped += u32::from(sample.count.abs_diff(last) > Velocity::LIMIT.unsigned_abs());
                last = sample.count;
                if sample.index >= settle {
                    if sample.index == settle {
                        watch.origin_m = sample.position_m;
                    }
                    watch.sample(sample.position_m, sample.rendered.map(|r| r.output));
                    if listens {
                        motion.push(sample.position_m);
                    }
                }
                judge(&mut hit, sample, surface)
            });
            let early = bounded && ended.is_continue();
            if early && self.judge.certain_verdict(&hit, &watch, self.plan.window).is_some() {
                return Ok(None);
            }
        }
        verdict(ended, &hit)?;
        let scatter = hit.scatter();
        let measures = self.judge.measures(&hit, &watch, || motion);
        let verdict = self.judge.verdict(&hit, &measures);
        let report = HitReport {
            verdict,
            rms_m: measures.rms_m,
            mean_m: scatter.mean_counts() * self.design.resolution_m,
            peak_penetration_m,
            saturated_fraction: f64::from(saturated) / f64::from(outputs),
            contact_fraction: f64::from(hit.contact_samples()) / f64::from(scatter.samples()),
            rms_motion_m: measures.rms_motion_m,
            at_limit_fraction: measures.at_limit_fraction,
            sensation_db: measures.sensation_db,
            velocity_clipped_fraction: f64::from(clipped) / f64::from(self.samples()),
            port: port.report(last),
        };
        Ok((!bounded || verdict != Verdict::Unstable).then_some(report))
    }

    fn run_to_verdict<C: Controller + Copy, S: Sensing, P: Plant>(
        &self,
        mut simulation: Simulation<C, S, P>,
    ) -> Result<Verdict, HitError> {
        let surface = simulation.controller().surface();
        let mut hit = Hit::new(self.plan);
        let mut left = self.samples();
        while left > 0 {
            let samples = left.min(EARLY_CHECK_SAMPLES);
            left -= samples;
            let mut here = hit; // a copy, so that it can live in registers
            let ended = simulation.run(samples, |sample| judge(&mut here, sample, surface));
            hit = here;
            if ended.is_break() {
                return verdict(ended, &hit);
            }
            if let Some(certain) = hit.certain_verdict() {
                return Ok(certain);
            }
        }
        verdict(ControlFlow::Continue(()), &hit)
    }
}

/// The verdict of a hit that was run until it was certain.
fn judged(bounded: Option<HitReport>) -> Verdict {
    bounded.map_or(Verdict::Unstable, |report| report.verdict)
}

/// Feeds one sample to the hit; breaks with its verdict.
#[inline]
fn judge(hit: &mut Hit, sample: &Sample, surface: i32) -> ControlFlow<Result<Verdict, HitError>> {
    let position = Position::from_counts(sample.count);
    if !position.in_range() {
        return ControlFlow::Break(Err(HitError::OutOfRange(sample.index)));
    }
    match hit.sample(position, sample.count > surface) {
        Some(verdict) => ControlFlow::Break(Ok(verdict)),
        None => ControlFlow::Continue(()),
    }
}

/// How a run ended. A run of all samples breaks with its last one.
fn verdict(ended: ControlFlow<Result<Verdict, HitError>>, hit: &Hit) -> Result<Verdict, HitError> {
    match ended {
        ControlFlow::Break(verdict) => verdict,
        ControlFlow::Continue(()) => Ok(hit.verdict()),
    }
}
