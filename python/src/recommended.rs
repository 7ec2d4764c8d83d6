//! Recommends a cutoff of the velocity filter.

use std::sync::Arc;

use host_sim::output::recommended::sentences;
use pyo3::prelude::*;
use sim_loop::error::Error;
use sim_studies::study::{How, recommended as study};

use crate::{
    given::{Given, Numbers, Progress},
    result::{Tuple, result},
    studies::{engine_of, numeric_of},
    work::{raised, run},
};

result! { value
    /// The recommended cutoff and its results. It is the cutoff with the largest area of quiet walls.
    Recommended {
        /// Name of the scene.
        scene: String,
        /// The recommended cutoff, in Hz.
        cutoff_hz: f64,
        /// Lowest and highest cutoff whose area is equally good, in Hz.
        range_hz: (f64, f64),
        /// Whether the range reaches the first cutoff that was tried, and whether it reaches the last one.
        range_is_open: (bool, bool),
        /// K of the stiffest quiet wall, in N/m.
        stiffness_n_per_m: f64,
        /// B of the stiffest quiet wall, in N s/m.
        damping_n_s_per_m: f64,
        /// Largest B of a quiet wall, in N s/m.
        damping_max_n_s_per_m: f64,
        /// Area of the quiet walls, in N^2 s/m^2.
        area: f64,
        /// Whether the largest K or B that the walk allows cuts off a part of the area.
        is_cut: bool,
        /// For each of the other protocols, its name and the largest K of a quiet wall in N/m. The wall has the B
        /// `damping_n_s_per_m`. None if there is no such wall, or the protocol cannot be tried.
        protocols: Tuple<(String, Option<f64>)>,
        /// RMS of the output in N, while the handle rests in free air.
        hum_n: f64,
        /// The sentences that the command line prints.
        sentences: Tuple<String>,
    }
}

/// Find the recommended cutoff. This cutoff has the largest area of walls that are quiet in motion and force.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment. The scene's own criterion and limit have no effect.
/// cutoffs : iterable of float, optional
///     Nominal cutoffs to begin with, Hz. Default: the scene's cutoffs. Cutoffs between the best cutoff and its
///     neighbours are tried too. Without a list, cutoffs beyond the ends are also tried.
/// engine, numeric, threads
///     As in `walk`.
/// progress : callable, optional
///     Called with the numbers of finished walks and of planned walks. The search plans more walks when it sees the
///     first results. An exception in this function ends the search.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, or there is no quiet wall. The message says what to change.
///
/// Examples
/// --------
/// >>> found = recommended(Scene.load("paper-1um"))
/// >>> found.cutoff_hz, found.range_hz, found.stiffness_n_per_m
/// (470.0, (450.0, 500.0), 54000.0)
#[pyfunction]
#[pyo3(signature = (
    scene, *, cutoffs = None, engine = "lanes", numeric = "fixed", threads = None, progress = None
))]
pub fn recommended(
    py: Python<'_>,
    scene: Given,
    cutoffs: Option<Numbers>,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Recommended> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let scene = scene.0;
    let goes_on = cutoffs.is_none();
    let cutoffs_hz = cutoffs.map_or_else(|| scene.scene.sweep.cutoffs_hz.clone(), |of| of.0);
    let of_work = Arc::clone(&scene);
    let found = run(py, threads, progress.as_ref(), 0, move |course| {
        let how = How { engine, numeric, stop: &course.stop };
        course.plan(cutoffs_hz.len() as u64);
        study::recommended(how, &of_work, &cutoffs_hz, goes_on, |planned| {
            course.plan(planned);
            course.add(1);
        })
    })?;
    let sentences = sentences(&scene, &found);
    let of = found.recommended.map_err(|why| raised(Error::Input(why).of(&scene.name)))?;
    let protocols = found.protocols.iter();
    Ok(Recommended {
        scene: scene.name.clone(),
        cutoff_hz: of.cutoff_hz,
        range_hz: of.range_hz.into(),
        range_is_open: of.is_open.into(),
        stiffness_n_per_m: of.stiffest.stiffness_n_per_m,
        damping_n_s_per_m: of.stiffest.damping_n_s_per_m,
        damping_max_n_s_per_m: of.damping_max_n_s_per_m,
        area: of.area,
        is_cut: of.is_cut,
        protocols: protocols
            .map(|held| (held.protocol.name().to_owned(), held.stiffness_n_per_m()))
            .collect(),
        hum_n: found.free.map_or(0.0, |free| free.hum_n),
        sentences: sentences.into_iter().collect(),
    })
}
