//! Walks several velocity filters in parallel, in several scenes.

use zwidth::VelocitySettings;

use super::{
    How,
    boundary::{Boundaries, Boundary},
    walk_lanes::{all_walks, each},
};
use crate::{error::Error, simulation::prepared::PreparedScene};

/// Walks every filter in every scene from each of `starts`, which are in counts from the scene's start. Returns the
/// boundaries, ordered by scene, then by filter. The result does not depend on the number of threads or on `engine`.
/// Calls `done` after each walk. If the form of a filter differs from the scene's own filter, the filter runs without
/// lanes.
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
