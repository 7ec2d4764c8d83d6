//! Arguments that several commands have, and their checks.

use clap::Args;
use serde::Serialize;
use zwidth::VelocitySettings;

use super::{
    Common,
    list::{self, List},
};
use crate::{
    error::Error,
    scene::NamedScene,
    simulation::prepared::WallHit,
    study::asked::{self, Names, Walls, only_of_sweep},
};

/// Where a hit or a walk starts.
#[derive(Clone, Copy, Debug, Args)]
pub struct Start {
    /// Start this many counts beyond the scene's start; the repeats of a sweep use 0, 1/4, 1/2, 3/4.
    #[arg(long, value_name = "COUNTS", default_value_t = 0.0, allow_negative_numbers = true)]
    start_offset: f64,
}

impl Start {
    /// Counts of `--start-offset`, still to be checked.
    pub fn counts(self) -> f64 {
        self.start_offset
    }
}

/// What the options are called that describe a wall; a command with lists has others.
const NAMES: Names = Names {
    cutoff: "--cutoff",
    stiffness: "--stiffness",
    damping: "--damping",
    start_offset: "--start-offset",
};
const LISTS: Names =
    Names { cutoff: "--cutoffs", stiffness: "--stiffnesses", damping: "--dampings", ..NAMES };

/// A scene at one cutoff.
#[derive(Debug, Args)]
pub struct AtCutoff {
    /// Built-in scene or scene file.
    scene: String,
    /// Nominal cutoff of the velocity filter, Hz [default: `velocity.cutoff_hz` of the scene]; estimators without one take
    /// none.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    cutoff: Option<f64>,
    #[command(flatten)]
    start: Start,
}

impl AtCutoff {
    /// The scene, and the hit on a wall that it makes of its walk's start or of `[K, B]` in the scene's units.
    pub fn load(&self, wall: Option<[f64; 2]>) -> Result<(NamedScene, WallHit), Error> {
        let scene = NamedScene::load(&self.scene)?;
        let units = scene.scene.units;
        let wall = wall.map(|[k, b]| [units.stiffness_n_per_m(k), units.damping_n_s_per_m(b)]);
        let hit = asked::hit(&scene, self.cutoff, wall, self.start.counts(), NAMES)?;
        if self.cutoff.is_none() {
            note_old_place(&scene);
        }
        Ok((scene, hit))
    }
}

/// What was run, as every JSON object of a hit or a walk begins.
#[derive(Serialize)]
pub struct Subject<'a> {
    scene: &'a str,
    numeric: &'static str,
    estimator: &'static str,
    /// `null` if the estimator has none.
    cutoff_hz: Option<f64>,
    true_cutoff_hz: Option<f64>,
}

impl<'a> Subject<'a> {
    pub fn new(scene: &'a NamedScene, filter: &VelocitySettings, common: &Common) -> Self {
        Self {
            scene: &scene.name,
            numeric: common.numeric.name(),
            estimator: filter.name().text(),
            cutoff_hz: filter.cutoff_hz(),
            true_cutoff_hz: filter.true_cutoff_hz(scene.scene.control.rate_hz),
        }
    }
}

/// A scene at many cutoffs and dampings.
#[derive(Debug, Args)]
pub struct AtCutoffs {
    /// Built-in scene or scene file.
    scene: String,
    /// Nominal cutoffs, Hz: A,B,C or FROM:STEP:TO [default: `velocity.cutoff_hz` of the scene]; estimators without a cutoff
    /// take none.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    cutoffs: Option<List>,
    /// Dampings B of the wall, N s/m (of a rotary scene N m s/rad): A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    dampings: List,
}

/// What [`AtCutoffs`] names, checked.
pub struct Grid {
    pub scene: NamedScene,
    pub walls: Walls,
}

impl AtCutoffs {
    /// Loads the scene and checks every value of every list, before the first one is used.
    pub fn load(&self, stiffnesses: &[f64], start: Option<Start>) -> Result<Grid, Error> {
        let scene = NamedScene::load(&self.scene)?;
        let filters = match &self.cutoffs {
            Some(List(cutoffs_hz)) => asked::filters(&scene, cutoffs_hz)?,
            None => {
                let filter = asked::filter(&scene, None)?;
                note_old_place(&scene);
                vec![filter]
            }
        };
        let units = scene.scene.units;
        let dampings = self.dampings.0.iter().map(|&b| units.damping_n_s_per_m(b)).collect();
        let start_offset_counts = start.map_or(0.0, Start::counts);
        let stiffnesses = stiffnesses.iter().map(|&k| units.stiffness_n_per_m(k)).collect();
        let walls = Walls { filters, dampings, stiffnesses, start_offset_counts };
        walls.check(&scene, LISTS)?;
        Ok(Grid { scene, walls })
    }
}

/// Says that the cutoff of a scene has a key of its own, where the only one of `[sweep]` was taken.
fn note_old_place(scene: &NamedScene) {
    if let Some(cutoff_hz) = only_of_sweep(&scene.scene).and_then(|filter| filter.cutoff_hz()) {
        eprintln!(
            "note: {}: cutoff {cutoff_hz} Hz, the only one of sweep.cutoffs_hz; its place is velocity.cutoff_hz",
            scene.name
        );
    }
}

/// Refuses a filter that is out of range.
pub fn check_filters(scene: &NamedScene, filters: &[VelocitySettings]) -> Result<(), Error> {
    let wall = |&velocity: &VelocitySettings| WallHit {
        velocity,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        start_offset_counts: 0.0,
    };
    filters.iter().try_for_each(|filter| asked::check_wall(scene, &wall(filter), LISTS))
}
