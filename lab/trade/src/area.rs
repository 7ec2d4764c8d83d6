//! The stability boundary of a scene with another velocity filter in the controller.

use std::sync::atomic::AtomicBool;

use filter_forms::Filter;
use rayon::prelude::*;
use zwidth::{VelocitySettings, units::Velocity, velocity::Senses};

use super::{Bench, Variant};
use crate::{
    error::Error,
    numerics::statistics::Repeats,
    scene::Scene,
    sim_plant::RUN,
    simulation::{
        controller::{Controller, ControllerOutput, Fixed, Readings, counts_per_sample},
        prepared::{HitError, PreparedScene},
    },
    study::{boundary::Boundary, sweep::start_offset_counts, walk::walk_with},
};

/// A controller with the core's finite difference and, after it, a filter of any format. Wall, saturation and output
/// codes are the core's. So it differs from the core only in the filter. With the core's own filter, the result equals
/// the core's result.
#[derive(Clone, Copy, Debug)]
pub struct Filtered {
    core: Fixed,
    filter: Filter,
}

impl Filtered {
    /// Puts `filter` after the velocity estimator of `core`, which must be the plain finite difference.
    pub fn new(core: Fixed, filter: Filter) -> Self {
        Self { core, filter }
    }
}

impl Controller for Filtered {
    fn samples(&mut self, readings: Readings<'_>, velocities: Option<&mut [f64; RUN]>) {
        let mut taken = [Velocity::ZERO; RUN];
        self.core.take(readings, &mut taken);
        let mut taken = taken.map(Velocity::bits);
        if let Some(taken) = taken.get_mut(..readings.counts.len()) {
            self.filter.update_all(taken);
            if let Some(last) = taken.last() {
                self.core.set_velocity(Velocity::saturating_from_bits(*last));
            }
        }
        if let Some(velocities) = velocities {
            *velocities = taken.map(|bits| counts_per_sample(Velocity::saturating_from_bits(bits)));
        }
    }

    #[inline]
    fn sample(&mut self, count: i32, senses: &Senses) -> bool {
        let due = self.core.sample(count, senses);
        let difference = self.core.motion().velocity;
        let bits = self.filter.update(difference.bits());
        self.core.set_velocity(Velocity::saturating_from_bits(bits));
        due
    }

    #[inline]
    fn render(&mut self) -> ControllerOutput {
        self.core.render()
    }

    #[inline]
    fn velocity(&self) -> f64 {
        self.core.velocity()
    }

    fn surface(&self) -> i32 {
        self.core.surface()
    }

    fn set_push(&mut self, push: f64) {
        self.core.set_push(push);
    }

    fn push(&self) -> f64 {
        self.core.push()
    }

    fn put_out(&self, force: f64) -> f64 {
        self.core.put_out(force)
    }
}

/// Areas under the boundary of the walks from several starts, in N^2 s/m^2.
#[derive(Clone, Debug, PartialEq)]
pub struct Areas(pub Vec<f64>);

impl Areas {
    pub fn mean(&self) -> f64 {
        Repeats::of(self.0.iter().copied()).mean
    }

    /// The largest area minus the smallest area, divided by the mean area. It is 0 if the mean is 0.
    pub fn spread(&self) -> f64 {
        let low = self.0.iter().copied().fold(f64::INFINITY, f64::min);
        let high = self.0.iter().copied().fold(0.0, f64::max);
        if self.mean() > 0.0 { (high - low) / self.mean() } else { 0.0 }
    }

    /// Relative difference of this mean area from the reference's mean area. `None` if the reference has no area.
    pub fn change(&self, reference: &Self) -> Option<f64> {
        (reference.mean() > 0.0).then(|| self.mean() / reference.mean() - 1.0)
    }
}

/// Prepares the scene with the finite difference as its only estimator.
pub fn prepare(scene: &Scene) -> Result<PreparedScene, Error> {
    let mut scene = scene.clone();
    scene.velocity = VelocitySettings::Difference {}.into();
    PreparedScene::new(&scene)
}

/// Runs one walk with `filter`. `start` shifts the start position by a part of a count: it is at least 0 and below 1.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn boundary(
    prepared: &PreparedScene,
    filter: &Filter,
    start: f64,
    stop: &AtomicBool,
) -> Result<Boundary, Error> {
    walk_with(prepared, VelocitySettings::Difference {}, start, stop, |hit| {
        let core = prepared.core(hit).map_err(HitError::Settings)?;
        prepared.early_verdict(hit, Filtered::new(core, *filter))
    })
}

/// Measures the areas of each variant at each cutoff. The result begins with all cutoffs of the first variant, then has
/// all cutoffs of the second variant, and so on. An entry is `None` if the format cannot have the cutoff. `done` is
/// called after each walk.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn measure(
    prepared: &PreparedScene,
    bench: &Bench,
    cutoffs_hz: &[f64],
    repeats: u32,
    stop: &AtomicBool,
    done: impl Fn() + Sync,
) -> Result<Vec<Option<Areas>>, Error> {
    // Walks at high cutoffs take longest, so these walks start first.
    let jobs: Vec<(usize, usize, u32)> = (0..cutoffs_hz.len())
        .rev()
        .flat_map(|cutoff| (0..Variant::ALL.len()).map(move |variant| (cutoff, variant)))
        .flat_map(|(cutoff, variant)| (0..repeats).map(move |repeat| (cutoff, variant, repeat)))
        .collect();
    let found: Vec<Result<Option<f64>, Error>> = jobs
        .par_iter()
        .with_max_len(1)
        .map(|&(cutoff, variant, repeat)| {
            let cutoff_hz = cutoffs_hz[cutoff];
            let filter = bench.filter(Variant::ALL[variant], cutoff_hz);
            let start = start_offset_counts(repeat, repeats);
            let area = filter
                .ok()
                .map(|filter| boundary(prepared, &filter, start, stop).map(|b| b.area))
                .transpose();
            done();
            area
        })
        .collect();
    let mut areas: Vec<Option<Areas>> = vec![None; cutoffs_hz.len() * Variant::ALL.len()];
    for ((cutoff, variant, _), area) in jobs.into_iter().zip(found) {
        if let Some(area) = area? {
            let place = variant * cutoffs_hz.len() + cutoff;
            areas[place].get_or_insert_with(|| Areas(vec![])).0.push(area);
        }
    }
    Ok(areas)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        engine::Engine, scene::NamedScene, simulation::prepared::Numeric, study::walk::walk,
    };

    #[test]
    fn with_the_cores_filter_the_walk_is_the_cores() {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        scene.walk.stiffness_step_n_per_m = 8000.0;
        scene.walk.damping_step_n_s_per_m = 60.0;
        let stop = AtomicBool::new(false);
        let bench = Bench::of(&scene);
        let core = walk(
            Engine::lanes(),
            &PreparedScene::new(&scene).unwrap(),
            Numeric::Fixed,
            scene.velocity.at(1500.0),
            0.25,
            &stop,
        )
        .unwrap();
        let prepared = prepare(&scene).unwrap();
        let filter = bench.filter(Variant::ALL[0], 1500.0).unwrap();
        assert_eq!(boundary(&prepared, &filter, 0.25, &stop).unwrap(), core);
        assert!(core.area > 1e7, "{core:?}");
        // Another filter must give another boundary. This shows that the walk uses the filter's velocity.
        let low = bench.filter(Variant::ALL[0], 50.0).unwrap();
        assert!(boundary(&prepared, &low, 0.25, &stop).unwrap().area < 0.2 * core.area);
    }
}
