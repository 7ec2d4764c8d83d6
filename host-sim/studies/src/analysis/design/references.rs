//! The reference for designed filters: Butterworth at its best cutoff. This file also has the grids and the wall of the
//! comparison.

use std::sync::atomic::AtomicBool;

use zwidth::VelocitySettings;

use super::{
    Question, Reference, Walker,
    shape::{NUMBERS, Second, Shape},
};
use crate::{
    analysis::compare::{Wall, damping_of, looked::STARTS, roughness, with_filter},
    error::Error,
    numerics::statistics::Repeats,
    scene::Scene,
    simulation::prepared::{Numeric, PreparedScene},
    study::{
        boundary::{Boundaries, Boundary},
        sweep::starts,
    },
};

/// The scene with the biquad estimator. All designed filters use this estimator.
pub(super) fn with_biquad(scene: &Scene, numbers: usize) -> Scene {
    let second = Second { ratio: 1.0, damping: 1.0, lead_s: 0.0, zero: 0.0 };
    let own = Shape {
        frequency_hz: 0.05 * scene.control.rate_hz,
        damping: 0.5,
        lead_s: 0.0,
        zero: 0.0,
        second: (numbers > NUMBERS).then_some(second),
    };
    with_filter(scene, &own.settings())
}

pub(super) fn with_low_pass(scene: &Scene) -> Scene {
    let settings = VelocitySettings::Butterworth { cutoff_hz: 0.05 * scene.control.rate_hz };
    with_filter(scene, &settings)
}

/// Finds the best cutoff of `[sweep]` in each condition. For this search, each cutoff is walked from one start on the
/// scene's grid. The best cutoff is then walked from all starts.
pub(super) fn references<D: Fn(&Boundary) + Sync>(
    walker: &Walker<'_, D>,
    question: &Question,
    scenes: &[PreparedScene],
) -> Result<Vec<Reference>, Error> {
    let settings = |cutoff_hz: &f64| VelocitySettings::Butterworth { cutoff_hz: *cutoff_hz };
    let cutoffs_hz: Vec<f64> = question.conditions.first().map_or(vec![], |condition| {
        let design = condition.scene.design();
        let all = condition.scene.sweep.cutoffs_hz.iter().copied();
        all.filter(|hz| settings(hz).build(&design).is_ok()).collect()
    });
    let filters: Vec<VelocitySettings> = cutoffs_hz.iter().map(settings).collect();
    let looked = walker.walk(scenes, &filters, &question.spread(&STARTS)[..1])?;
    let best = looked.iter().map(|of_filter| {
        let best =
            of_filter.iter().zip(&cutoffs_hz).max_by(|a, b| a.0.area().total_cmp(&b.0.area()));
        best.map_or(0.0, |(_, hz)| *hz)
    });
    let best: Vec<f64> = best.collect();
    let filters: Vec<VelocitySettings> = best.iter().map(settings).collect();
    let walked = walker.walk(scenes, &filters, &starts(question.repeats))?;
    let own = best.into_iter().zip(walked).enumerate();
    Ok(own
        .map(|(n, (cutoff_hz, mut of_filter))| Reference {
            cutoff_hz,
            boundaries: of_filter.swap_remove(n),
        })
        .collect())
}

/// The scene with a coarser grid. The reference's boundary has about `columns` columns and rows on this grid.
pub(super) fn coarser(scene: &Scene, reference: &Boundaries, columns: f64) -> Scene {
    let mut scene = scene.clone();
    let walk = &mut scene.walk;
    let times =
        |reached: f64, start: f64, step: f64| ((reached - start) / step / columns).round().max(1.0);
    let b = Repeats::of(reference.dampings_max_n_s_per_m().into_iter()).mean;
    let k = Repeats::of(reference.stiffness_peaks_n_per_m().into_iter()).mean;
    walk.damping_step_n_s_per_m *=
        times(b, walk.damping_start_n_s_per_m, walk.damping_step_n_s_per_m);
    walk.stiffness_step_n_per_m *=
        times(k, walk.stiffness_start_n_per_m, walk.stiffness_step_n_per_m);
    scene
}

/// The wall at which roughness is measured. [`damping_of`] gives B. K is half of the K that the reference reaches at
/// this B.
pub(super) fn wall(scene: &Scene, references: &[Reference]) -> Wall {
    let boundaries = references.first().map(|reference| &reference.boundaries);
    Wall::half_of(boundaries, scene, damping_of(boundaries, scene))
}

/// Mean roughness of the force with a filter at the wall, in N. `None` if the wall is not stable.
pub(super) fn rough(
    scene: &Scene,
    settings: &VelocitySettings,
    wall: Wall,
    stop: &AtomicBool,
) -> Result<Option<f64>, Error> {
    let prepared = PreparedScene::new(&with_filter(scene, settings))?;
    let contact = roughness::measure(&prepared, Numeric::Fixed, &wall.hit(*settings), stop)?;
    Ok(contact.stable.then(|| Repeats::of(contact.roughness_n.into_iter()).mean))
}
