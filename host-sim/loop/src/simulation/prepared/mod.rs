//! A scene prepared for wall hits: all values that are the same in every hit.

mod run;
mod varied;
mod watch;

use std::sync::{Arc, OnceLock};

use zwidth::{
    Design, SettingsError, VelocitySettings,
    experiment::{HitPlan, quiet},
    passivity::Passivity,
    units::{Force, Velocity},
};

use crate::{
    error::Error,
    plant::{AnyPlant, Moment, Plant},
    scene::{Criterion, Protocol, Scene},
    simulation::{
        Parts, Simulation,
        accelerometer::Readings,
        controller::Fixed,
        port::PortWatch,
        quantiser::Quantiser,
        senses::Full,
        twin::{self, Twin},
        window::Judge,
    },
};

pub use super::hit::{HitError, HitReport, Numeric, WallHit};

#[derive(Clone, Debug)]
pub struct PreparedScene {
    scene: Scene,
    design: Design,
    plan: HitPlan,
    parts: Parts<AnyPlant>,
    start_m: f64,
    judge: Judge,
    /// The wall's passivity controller, if the scene has one.
    passivity: Option<Passivity>,
    is_told: bool,
    /// The accelerometer's readings of a hit. They are computed when lanes first need them.
    readings: Arc<OnceLock<Option<Readings>>>,
    /// The scene at each push, if the criterion needs several pushes. Otherwise empty.
    pushes: Vec<PreparedScene>,
}

/// Upper bound of the speed that a handle can have at the wall, in m/s.
const ANY_SPEED_M_PER_S: f64 = 10.0;

impl PreparedScene {
    /// Prepares a scene.
    ///
    /// # Errors
    /// [`Error::Input`] if a value is out of range.
    pub fn new(scene: &Scene) -> Result<Self, Error> {
        scene.check_loop().map_err(Error::Input)?;
        let own = Self::of_one_push(scene)?;
        if scene.wall_hit.criterion != Criterion::Quiet {
            return Ok(own);
        }
        let pushes = quiet::PUSHES.iter().map(|share| {
            let wall_hit = scene.wall_hit.with_push(*share);
            let of = Self::of_one_push(&Scene { wall_hit, ..scene.clone() })?;
            Ok(Self { readings: Arc::clone(&own.readings), ..of })
        });
        Ok(Self { pushes: pushes.collect::<Result<_, Error>>()?, ..own })
    }

    fn of_one_push(scene: &Scene) -> Result<Self, Error> {
        let design = scene.design();
        let plan = scene.hit_settings().build(&design).map_err(Error::input)?;
        let passivity = scene.passivity().map_err(Error::input)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 to 1000 by the check above"
        )]
        let whole = scene.actuator.latency.floor() as u32;
        let plant = Self::plant(scene);
        let start_m = match scene.wall_hit.protocol {
            Protocol::Taps => varied::tap_start_m(scene, &plant),
            _ => scene.device.start_position_m,
        };
        let parts = Parts {
            plant,
            encoder: Quantiser::of(&scene.encoder),
            full_scale_n: design.full_scale_n,
            latency: whole,
            period: design.period,
        };
        let (scene, judge) = (scene.clone(), Judge::of(scene));
        let (is_told, readings, pushes) = (false, Arc::default(), vec![]);
        Ok(Self {
            scene,
            design,
            plan,
            parts,
            start_m,
            judge,
            passivity,
            is_told,
            readings,
            pushes,
        })
    }

    fn plant(scene: &Scene) -> AnyPlant {
        AnyPlant::of(scene, 1.0 / scene.control.rate_hz, scene.actuator.latency.fract())
    }

    /// The scene at each push that the test of a wall needs.
    pub(crate) fn pushes(&self) -> &[Self] {
        if self.pushes.is_empty() { std::slice::from_ref(self) } else { &self.pushes }
    }

    /// Applies `change` to this scene and to the scene at each of its pushes.
    fn each(mut self, change: impl Fn(Self) -> Self) -> Self {
        let pushes = std::mem::take(&mut self.pushes);
        Self { pushes: pushes.into_iter().map(&change).collect(), ..change(self) }
    }

    /// Computes the sensation level of every whole hit too, if the length of the window allows it.
    pub fn with_felt(self) -> Self {
        self.each(|of| Self { judge: of.judge.clone().with_felt(&of.scene), ..of })
    }

    /// Computes the measures of the window too, for any criterion.
    pub fn with_measures(self) -> Self {
        self.each(|of| Self { judge: of.judge.clone().with_measures(), ..of })
    }

    /// Prepares the scene with the true velocity instead of an estimate. The core itself always runs such a scene. The
    /// true velocity corresponds to a velocity sensor without noise, quantisation or delay. The counts stay the same.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new).
    pub fn told(scene: &Scene) -> Result<Self, Error> {
        let velocity = VelocitySettings::Difference {}.into();
        let prepared = Self::new(&Scene { velocity, ..scene.clone() })?;
        Ok(prepared.each(|of| Self { is_told: true, ..of }))
    }

    /// Whether the wall uses the true velocity.
    pub fn is_told(&self) -> bool {
        self.is_told
    }

    pub(crate) fn judge(&self) -> &Judge {
        &self.judge
    }

    /// Checks that the core's velocity can represent the speed of the handle at the wall.
    ///
    /// # Errors
    /// [`Error::Input`] names the largest speed.
    pub fn check_approach(&self) -> Result<(), Error> {
        let Design { rate_hz, resolution_m, .. } = self.design;
        let most_m_per_s = f64::from(Velocity::LIMIT) * resolution_m * rate_hz;
        if most_m_per_s > ANY_SPEED_M_PER_S {
            return Ok(());
        }
        let (plant, wall_m) = (&self.parts.plant, self.scene.wall.position_m);
        let push = f64::from(self.plan.push.bits()) / f64::from(Force::FULL_SCALE.bits());
        let push_n = push * self.design.full_scale_n;
        let mut state = plant.at_rest(self.start_m);
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

    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    pub fn design(&self) -> &Design {
        &self.design
    }

    /// The loop without its controller.
    pub fn parts(&self) -> &Parts<AnyPlant> {
        &self.parts
    }

    /// Times of a hit, in samples.
    pub fn plan(&self) -> &HitPlan {
        &self.plan
    }

    /// The loop around the core, ready for sample 0 of a hit.
    pub fn fixed(&self, hit: &WallHit) -> Result<Simulation<Fixed>, SettingsError> {
        let parts = self.parts.clone();
        Ok(Simulation::new(parts, self.core(hit)?, self.sensing(hit), self.start_m(hit)))
    }

    /// The loop around the `f64` twin, ready for sample 0 of a hit.
    pub fn twin(
        &self,
        hit: &WallHit,
        rounding: twin::Rounding,
    ) -> Result<Simulation<Twin>, SettingsError> {
        let twin = self.twin_of_core(hit, rounding)?;
        Ok(Simulation::new(self.parts.clone(), twin, self.sensing(hit), self.start_m(hit)))
    }

    pub(crate) fn sensing(&self, hit: &WallHit) -> Full {
        Full::new(&self.scene, hit.velocity.name().sense())
    }

    /// Sensor and noise of the scene's accelerometer, for lanes. They are computed only once.
    pub(crate) fn readings(&self) -> Option<&Readings> {
        let readings = || Full::new(&self.scene, None).readings(self.samples());
        self.readings.get_or_init(readings).as_ref()
    }

    /// The core, at rest at the start of the hit.
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

    /// Count at sample 0. The controller starts at rest at this count.
    pub(crate) fn first_count(&self, hit: &WallHit) -> i32 {
        let plant = &self.parts.plant;
        let (index, before_n, after_n) = (0, 0.0, 0.0);
        let state = plant.at_rest(self.start_m(hit));
        self.parts.encoder.count(plant.reading_m(&state, &Moment { index, before_n, after_n }))
    }

    /// Prepares the measurement of the energy that wall and hand exchange. No sample of the hit has run yet.
    pub(in crate::simulation) fn port_watch(&self, hit: &WallHit, surface: i32) -> PortWatch {
        let design = &self.design;
        let latency = self.scene.actuator.latency_samples();
        PortWatch::new(design, latency, surface, self.first_count(hit))
    }

    fn samples(&self) -> u32 {
        self.plan.settle + self.plan.window
    }

    pub(crate) fn start_m(&self, hit: &WallHit) -> f64 {
        self.start_m + hit.start_offset_counts * self.design.resolution_m
    }

    fn settings(&self, hit: &WallHit) -> zwidth::Settings {
        self.scene.settings(hit.velocity, hit.stiffness_n_per_m, hit.damping_n_s_per_m)
    }
}
