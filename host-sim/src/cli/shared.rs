//! Arguments that several commands have, and their checks.

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    list::{self, List},
};
use crate::{
    error::Error,
    range::{refused, within},
    scene::NamedScene,
    simulation::prepared::{PreparedScene, WallHit},
};

/// Where a hit or a walk starts.
#[derive(Clone, Copy, Debug, Args)]
pub struct Start {
    /// Start this many counts beyond the scene's start; the repeats of a sweep use 0, 1/4, 1/2, 3/4.
    #[arg(long, value_name = "COUNTS", default_value_t = 0.0, allow_negative_numbers = true)]
    start_offset: f64,
}

impl Start {
    /// Refuses a start inside the wall.
    pub fn check(self, scene: &NamedScene) -> Result<(), Error> {
        let (device, wall) = (&scene.scene.device, &scene.scene.wall);
        let counts = (wall.position_m - device.start_position_m) / scene.scene.encoder.resolution_m;
        if self.start_offset <= counts {
            return Ok(());
        }
        Err(Error::Input(refused("--start-offset", self.start_offset, &(-1e6..=counts.min(1e6)))))
    }

    /// Counts of `--start-offset`, checked.
    pub fn counts(self) -> Result<f64, Error> {
        within("--start-offset", self.start_offset, -1e6..=1e6).map_err(Error::Input)?;
        Ok(self.start_offset)
    }
}

/// A scene at one cutoff.
#[derive(Debug, Args)]
pub struct AtCutoff {
    /// Built-in scene or scene file.
    scene: String,
    /// Nominal cutoff of the velocity filter, Hz; estimators without one take none.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    cutoff: Option<f64>,
    #[command(flatten)]
    start: Start,
}

impl AtCutoff {
    /// The scene, and the hit on a wall that it makes of its walk's start or of `[K, B]`.
    pub fn load(&self, wall: Option<[f64; 2]>) -> Result<(NamedScene, WallHit), Error> {
        let scene = NamedScene::load(&self.scene)?;
        let walk = &scene.scene.walk;
        let [stiffness_n_per_m, damping_n_s_per_m] =
            wall.unwrap_or([walk.stiffness_start_n_per_m, walk.damping_start_n_s_per_m]);
        let hit = WallHit {
            cutoff_hz: cutoff(&scene, self.cutoff)?,
            stiffness_n_per_m,
            damping_n_s_per_m,
            start_offset_counts: self.start.counts()?,
        };
        check_wall(&scene, &hit, ["--cutoff", "--stiffness", "--damping"])?;
        self.start.check(&scene)?;
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
    pub fn new(scene: &'a NamedScene, cutoff_hz: f64, common: &Common) -> Self {
        let velocity = scene.scene.velocity;
        let of_cutoff = |hz: f64| velocity.has_cutoff().then_some(hz);
        Self {
            scene: &scene.name,
            numeric: common.numeric.name(),
            estimator: velocity.name(),
            cutoff_hz: of_cutoff(cutoff_hz),
            true_cutoff_hz: of_cutoff(scene.scene.true_cutoff_hz(cutoff_hz)),
        }
    }
}

/// Prepares a person's scene: no hit of it may come to the wall faster than the core's velocity can say.
pub fn prepare(scene: &NamedScene) -> Result<PreparedScene, Error> {
    let prepared = PreparedScene::new(&scene.scene)?;
    prepared.check_approach()?;
    Ok(prepared)
}

/// A scene at many cutoffs and dampings.
#[derive(Debug, Args)]
pub struct AtCutoffs {
    /// Built-in scene or scene file.
    scene: String,
    /// Nominal cutoffs, Hz: A,B,C or FROM:STEP:TO; estimators without a cutoff take none.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    cutoffs: Option<List>,
    /// Dampings B of the wall, N s/m: A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    dampings: List,
}

/// What [`AtCutoffs`] names, checked.
pub struct Grid {
    pub scene: NamedScene,
    pub cutoffs_hz: Vec<f64>,
    pub dampings: Vec<f64>,
}

impl AtCutoffs {
    /// Loads the scene and checks every value of every list, before the first one is used.
    pub fn load(&self, stiffnesses: &[f64]) -> Result<Grid, Error> {
        let scene = NamedScene::load(&self.scene)?;
        let cutoffs_hz = match &self.cutoffs {
            Some(_) if !scene.scene.velocity.has_cutoff() => return Err(no_cutoff(&scene)),
            Some(List(cutoffs_hz)) => cutoffs_hz.clone(),
            None => vec![cutoff(&scene, None)?],
        };
        let dampings = self.dampings.0.clone();
        let (cutoff_hz, damping) = (cutoffs_hz[0], dampings[0]);
        let first = wall(cutoff_hz, stiffnesses[0], damping);
        let walls = (cutoffs_hz.iter().map(|&cutoff_hz| WallHit { cutoff_hz, ..first }))
            .chain(dampings.iter().map(|&b| WallHit { damping_n_s_per_m: b, ..first }))
            .chain(stiffnesses.iter().map(|&k| WallHit { stiffness_n_per_m: k, ..first }));
        for wall in walls {
            check_wall(&scene, &wall, ["--cutoffs", "--stiffnesses", "--dampings"])?;
        }
        Ok(Grid { scene, cutoffs_hz, dampings })
    }
}

fn wall(cutoff_hz: f64, stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> WallHit {
    WallHit { cutoff_hz, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 }
}

/// The cutoffs of `--cutoffs` or of the scene, checked.
pub fn check_cutoffs(scene: &NamedScene, cutoffs_hz: &[f64]) -> Result<(), Error> {
    if !scene.scene.velocity.has_cutoff() {
        return Err(no_cutoff(scene));
    }
    let checked = |&cutoff_hz| check_wall(scene, &wall(cutoff_hz, 0.0, 0.0), ["--cutoffs", "", ""]);
    cutoffs_hz.iter().try_for_each(checked)
}

/// The cutoff of the command line, which an estimator that has one needs and another one refuses;
/// 0 stands for none.
fn cutoff(scene: &NamedScene, asked: Option<f64>) -> Result<f64, Error> {
    let estimator = scene.scene.velocity;
    match (estimator.has_cutoff(), asked) {
        (true, Some(cutoff_hz)) => Ok(cutoff_hz),
        (false, None) => Ok(0.0),
        (true, None) => Err(Error::Input(format!(
            "{}: a cutoff is missing, the estimator {} needs it",
            scene.name,
            estimator.name()
        ))),
        (false, Some(_)) => Err(no_cutoff(scene)),
    }
}

/// Why a cutoff is refused.
fn no_cutoff(scene: &NamedScene) -> Error {
    Error::Input(format!(
        "{}: the estimator {} has no cutoff; its parameters are keys of [velocity]",
        scene.name,
        scene.scene.velocity.name()
    ))
}

/// A cutoff, K and B of the command line, checked by building the core's settings; `options` are what they came
/// from.
fn check_wall(scene: &NamedScene, wall: &WallHit, options: [&str; 3]) -> Result<(), Error> {
    scene
        .scene
        .settings(wall.cutoff_hz, wall.stiffness_n_per_m, wall.damping_n_s_per_m)
        .build(&scene.scene.design())
        .map(|_| ())
        .map_err(|error| {
            let option = match error.parameter {
                "cutoff_hz" => options[0],
                "stiffness_n_per_m" => options[1],
                "damping_n_s_per_m" => options[2],
                other => other,
            };
            Error::Input(refused(option, error.value, &error.range))
        })
}
