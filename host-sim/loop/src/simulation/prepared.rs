//! A scene made ready to run wall hits: everything that does not change from hit to hit.

use std::{ops::ControlFlow, sync::Arc};

use zwidth::{
    Design, SettingsError, VelocitySettings,
    experiment::{Hit, HitPlan, Verdict},
    units::{Force, Position, Velocity},
};

use crate::{
    error::Error,
    plant::{AnyPlant, Moment, Plant, each_plant},
    scene::Scene,
    simulation::{
        Parts, Sample, Simulation,
        controller::{Controller, Fixed, Told},
        quantiser::Quantiser,
        senses::{AnySensing, Blind, Sensing},
        twin::{self, Twin},
        window::{Judge, Watch},
    },
};

pub use super::hit::{HitError, HitReport, Numeric, WallHit};

/// Sees every sample of a hit.
type Observer<'a> = dyn FnMut(&Sample) + 'a;

/// A scene made ready.
#[derive(Clone, Debug)]
pub struct PreparedScene {
    scene: Scene,
    design: Design,
    plan: HitPlan,
    parts: Parts<AnyPlant>,
    judge: Judge,
    /// The wall is told the true velocity.
    is_told: bool,
    /// Estimators in the place of the scene's; the cutoff of a hit is the number of its one.
    filters: Arc<[VelocitySettings]>,
}

/// No handle comes to its wall faster, m/s.
const ANY_SPEED_M_PER_S: f64 = 10.0;

/// How many samples pass between two looks for an early verdict.
const EARLY_CHECK_SAMPLES: u32 = 256;

impl PreparedScene {
    /// Prepares a scene.
    ///
    /// # Errors
    /// [`Error::Input`] if a value is out of range.
    pub fn new(scene: &Scene) -> Result<Self, Error> {
        scene.check().map_err(Error::Input)?;
        let design = scene.design();
        let plan = scene.hit_settings().build(&design).map_err(Error::input)?;
        let latency = scene.actuator.latency;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 to 1000 by the check above"
        )]
        let whole = latency.floor() as u32;
        let parts = Parts {
            plant: AnyPlant::of(scene, 1.0 / design.rate_hz, latency.fract()),
            encoder: Quantiser::of(&scene.encoder),
            full_scale_n: design.full_scale_n,
            latency: whole,
            period: design.period,
        };
        let (scene, judge) = (scene.clone(), Judge::of(scene));
        let (is_told, filters) = (false, Arc::default());
        Ok(Self { scene, design, plan, parts, judge, is_told, filters })
    }

    /// The same with those estimators side by side in the place of the scene's, which all have its form: the cutoff of
    /// a hit is the number of its estimator.
    #[must_use]
    pub fn with_filters(mut self, filters: &[VelocitySettings]) -> Self {
        self.filters = filters.into();
        self
    }

    /// The same with the sensation level of every whole hit, where the window allows one.
    pub fn with_felt(mut self) -> Self {
        self.judge = self.judge.with_felt(&self.scene);
        self
    }

    /// The same with the measures of the window, whatever the verdict is by.
    pub fn with_measures(mut self) -> Self {
        self.judge = self.judge.with_measures();
        self
    }

    /// The scene with the true velocity in place of an estimate, always by the core itself: a sensor without noise,
    /// quantisation or delay beside the same counts.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn told(scene: &Scene) -> Result<Self, Error> {
        let velocity = VelocitySettings::Difference {}.into();
        let prepared = Self::new(&Scene { velocity, ..scene.clone() })?;
        Ok(Self { is_told: true, ..prepared })
    }

    /// Whether the wall is told the true velocity.
    pub fn is_told(&self) -> bool {
        self.is_told
    }

    /// How windows are judged.
    pub(crate) fn judge(&self) -> &Judge {
        &self.judge
    }

    /// Refuses a handle that comes to the wall faster than the core's velocity can say.
    ///
    /// # Errors
    /// [`Error::Input`] says how fast it may come.
    pub fn check_approach(&self) -> Result<(), Error> {
        let Design { rate_hz, resolution_m, .. } = self.design;
        let most_m_per_s = f64::from(Velocity::LIMIT) * resolution_m * rate_hz;
        if most_m_per_s > ANY_SPEED_M_PER_S {
            return Ok(());
        }
        let (plant, wall_m) = (&self.parts.plant, self.scene.wall.position_m);
        let push = f64::from(self.plan.push.bits()) / f64::from(Force::FULL_SCALE.bits());
        let push_n = push * self.design.full_scale_n;
        let mut state = plant.at_rest(self.scene.device.start_position_m);
        for _ in 0..self.samples() {
            state = plant.advance(&state, push_n);
            if plant.position_m(&state) > wall_m {
                break;
            }
            let speed_m_per_s = plant.speed_m_per_s(&state);
            if speed_m_per_s > most_m_per_s {
                return Err(Error::Input(format!(
                    "the handle comes to the wall with more than {most_m_per_s:.3} m/s, the largest velocity at \
                     encoder.resolution_m = {resolution_m} and control.rate_hz = {rate_hz}; raise one of them or \
                     lower wall_hit.push_n"
                )));
            }
        }
        Ok(())
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The core's design.
    pub fn design(&self) -> &Design {
        &self.design
    }

    /// The loop around the controller.
    pub(crate) fn parts(&self) -> &Parts<AnyPlant> {
        &self.parts
    }

    /// The hit in samples.
    pub fn plan(&self) -> &HitPlan {
        &self.plan
    }

    /// The loop around the core, ready for sample 0 of a hit.
    ///
    /// # Errors
    /// A setting of `hit` is out of range.
    pub fn fixed(&self, hit: &WallHit) -> Result<Simulation<Fixed>, SettingsError> {
        let parts = self.parts.clone();
        Ok(Simulation::new(parts, self.core(hit)?, self.sensing(), self.start_m(hit)))
    }

    /// The loop around the `f64` twin, ready for sample 0 of a hit.
    ///
    /// # Errors
    /// A setting of `hit` is out of range.
    pub fn twin(
        &self,
        hit: &WallHit,
        rounding: twin::Rounding,
    ) -> Result<Simulation<Twin>, SettingsError> {
        let twin = self.twin_of_core(hit, rounding)?;
        Ok(Simulation::new(self.parts.clone(), twin, self.sensing(), self.start_m(hit)))
    }

    pub(crate) fn sensing(&self) -> AnySensing {
        AnySensing::of(&self.scene)
    }

    /// The core at rest where the hit starts.
    pub fn core(&self, hit: &WallHit) -> Result<Fixed, SettingsError> {
        let count = self.first_count(hit);
        Fixed::new(&self.settings(hit), &self.design, self.plan.push, count)
    }

    pub(crate) fn twin_of_core(
        &self,
        hit: &WallHit,
        rounding: twin::Rounding,
    ) -> Result<Twin, SettingsError> {
        let count = self.first_count(hit);
        let push = f64::from(self.plan.push.bits()) / f64::from(Force::FULL_SCALE.bits());
        Twin::new(&self.settings(hit), &self.design, rounding, push, count)
    }

    /// What the encoder reads for sample 0: the controller starts at rest there.
    pub(crate) fn first_count(&self, hit: &WallHit) -> i32 {
        let plant = &self.parts.plant;
        let (index, before_n, after_n) = (0, 0.0, 0.0);
        let state = plant.at_rest(self.start_m(hit));
        self.parts.encoder.count(plant.reading_m(&state, &Moment { index, before_n, after_n }))
    }

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
        let whole = match numeric.twin() {
            _ if self.is_told => {
                self.any_hit(hit, Told::new(self.core(hit)?, &self.design), observe, false)
            }
            None => self.whole_hit(hit, self.core(hit)?, observe, false),
            Some(rounding) => {
                self.whole_hit(hit, self.twin_of_core(hit, rounding)?, observe, false)
            }
        }?;
        whole.ok_or(HitError::OutOfRange(0)) // never: it was run to its end
    }

    /// What a hit showed; `None` as soon as it is certain to be unstable.
    ///
    /// # Errors
    /// As [`verdict`](Self::verdict).
    pub fn bounded(&self, numeric: Numeric, hit: &WallHit) -> Result<Option<HitReport>, HitError> {
        match numeric.twin() {
            _ if self.is_told => {
                self.any_hit(hit, Told::new(self.core(hit)?, &self.design), None, true)
            }
            None => self.whole_hit(hit, self.core(hit)?, None, true),
            Some(rounding) => self.whole_hit(hit, self.twin_of_core(hit, rounding)?, None, true),
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
    pub fn early_verdict<C: Controller + Copy>(
        &self,
        hit: &WallHit,
        controller: C,
    ) -> Result<Verdict, HitError> {
        if !self.judge.is_plain() {
            return self.any_hit(hit, controller, None, true).map(judged);
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
        let (mut peak_penetration_m, mut clipped, mut last) = (0f64, 0u32, self.first_count(of));
        let (mut ended, mut left) = (ControlFlow::Continue(()), self.samples());
        while left > 0 && ended.is_continue() {
            let samples = left.min(if bounded { EARLY_CHECK_SAMPLES } else { left });
            left -= samples;
            ended = simulation.run(samples, |sample| {
                if let Some(observe) = &mut observe {
                    observe(sample);
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

    /// Samples of a whole hit.
    fn samples(&self) -> u32 {
        self.plan.settle + self.plan.window
    }

    pub(crate) fn start_m(&self, hit: &WallHit) -> f64 {
        self.scene.device.start_position_m + hit.start_offset_counts * self.design.resolution_m
    }

    fn settings(&self, hit: &WallHit) -> zwidth::Settings {
        let WallHit { cutoff_hz, stiffness_n_per_m, damping_n_s_per_m, .. } = *hit;
        let mut settings = self.scene.settings(cutoff_hz, stiffness_n_per_m, damping_n_s_per_m);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number")]
        if let Some(filter) = self.filters.get(cutoff_hz as usize) {
            settings.velocity = *filter;
        }
        settings
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
