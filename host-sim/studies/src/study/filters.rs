//! Walks of several velocity filters side by side, in several scenes.

use zwidth::VelocitySettings;

use super::{
    How,
    boundary::{Boundaries, Boundary},
    walk_lanes::{all_walks, each},
};
use crate::{error::Error, simulation::prepared::PreparedScene};

/// Boundaries by scene, then by filter, from each of `starts` (counts beyond the scene's start). The result depends neither
/// on the number of threads nor on `engine`; `done` is called after each walk. Filters of a form that is not that of the
/// scene's own have no lanes.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn boundaries(
    how: How<'_>,
    scenes: &[PreparedScene],
    filters: &[VelocitySettings],
    starts: &[f64],
    done: impl Fn(&Boundary) + Sync,
) -> Result<Vec<Vec<Boundaries>>, Error> {
    let begins = scenes.iter().map(|scene| (scene, each(filters, starts))).collect::<Vec<_>>();
    let made = all_walks(how, &begins, done)?.into_iter();
    let of_scene = |made: Vec<Result<Boundary, Error>>| {
        let mut made = made.into_iter();
        filters.iter().map(|_| made.by_ref().take(starts.len()).collect()).collect()
    };
    made.map(of_scene).collect()
}
