//! Studies with many wall hits: the boundary walk, the sweep over cutoffs, the sensitivity of the sweep's result to
//! assumptions, and the firmware's envelope.

mod ahead;
pub mod asked;
pub mod board_envelope;
pub mod boundary;
pub mod envelope;
pub mod filters;
pub mod levers;
pub mod limits;
pub mod limits_asked;
pub mod list;
pub mod loops;
pub mod planned;
pub mod probability;
pub mod rates;
pub mod recommended;
pub mod schedule;
pub mod sensitivity;
pub mod sweep;
pub mod walk;
mod walk_lanes;

use std::sync::atomic::AtomicBool;

use crate::{
    engine::{Depth, Engine, Outcome, stream},
    error::Error,
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};

/// How the hits of a study are run. Engine and number of threads do not change the result.
#[derive(Clone, Copy, Debug)]
pub struct How<'a> {
    pub engine: Engine,
    pub numeric: Numeric,
    /// Becomes true when the study must end early.
    pub stop: &'a AtomicBool,
}

impl How<'_> {
    /// Runs hits of a scene on all threads of the current pool. `sink` gets the results in order.
    fn run(
        self,
        prepared: &PreparedScene,
        depth: Depth,
        hits: &[WallHit],
        mut sink: impl FnMut(Result<Outcome, HitError>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let Self { engine, numeric, stop } = self;
        #[expect(clippy::cast_possible_truncation, reason = "an index of `hits`")]
        let hit = |number: u64| hits[number as usize];
        let sink = |_, outcome| sink(outcome);
        stream(engine, prepared, numeric, depth, hits.len() as u64, hit, stop, sink)
    }
}
