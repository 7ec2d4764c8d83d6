//! Walks of several velocity filters side by side, in several scenes.

use std::sync::atomic::{AtomicBool, Ordering};

use zwidth::VelocitySettings;

use super::{
    boundary::{Boundaries, Boundary},
    sweep::on_all_threads,
    walk_lanes::{Queue, Start, walks},
};
use crate::{
    engine::Engine,
    error::Error,
    simulation::prepared::{Numeric, PreparedScene},
};

/// Boundaries by scene, then by filter, from each of `starts` (counts beyond the scene's start). The result depends neither
/// on the number of threads nor on `engine`; `done` is called after each walk. Filters of a form that is not that of the
/// scene's own have no lanes.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn boundaries(
    engine: Engine,
    scenes: &[PreparedScene],
    numeric: Numeric,
    filters: &[VelocitySettings],
    starts: &[f64],
    stop: &AtomicBool,
    done: impl Fn(&Boundary) + Sync,
) -> Result<Vec<Vec<Boundaries>>, Error> {
    let begins: Vec<Start> = filters
        .iter()
        .flat_map(|&velocity| {
            starts.iter().map(move |&start_offset_counts| Start { velocity, start_offset_counts })
        })
        .collect();
    let queues: Vec<Queue<'_>> = scenes.iter().map(|scene| Queue::new(scene, &begins)).collect();
    let made = on_all_threads(queues.len(), |place, made| {
        walks(engine, numeric, &queues[place], stop, |walk, boundary| {
            if let Ok(boundary) = &boundary {
                done(boundary);
            }
            made.push(((place, walk), boundary));
        });
    });
    if stop.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    let mut made = made.into_values();
    let none = || Err(Error::Internal("a walk has no result".into()));
    let mut of_filter =
        || starts.iter().map(|_| made.next().unwrap_or_else(none)).collect::<Result<_, _>>();
    scenes.iter().map(|_| filters.iter().map(|_| of_filter()).collect()).collect()
}
