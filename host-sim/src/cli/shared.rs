//! Arguments that several commands share, and their checks.

use std::{fmt::Display, path::PathBuf};

use clap::Args;
use serde::Serialize;
use zwidth::VelocitySettings;

use super::{
    Common,
    list::{self, List},
};
use crate::{
    error::Error,
    output::{
        figure::Figure,
        files::{FolderPlace, MANIFEST, Outputs, json},
        manifest::Manifest,
    },
    scene::NamedScene,
    simulation::prepared::{Numeric, WallHit},
    study::asked::{self, Names, Walls, only_of_sweep},
};

/// Where a hit or a walk starts.
#[derive(Clone, Copy, Debug, Args)]
pub struct Start {
    /// Start this number of counts after the scene's start. The repeats of a sweep use 0, 1/4, 1/2, 3/4.
    #[arg(long, value_name = "COUNTS", default_value_t = 0.0, allow_negative_numbers = true)]
    pub start_offset: f64,
}

/// Names of the options that describe one wall. Commands with lists have other names.
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
    /// Nominal cutoff of the velocity filter in Hz [default: `velocity.cutoff_hz` of the scene]. Not for estimators
    /// without a cutoff.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    cutoff: Option<f64>,
    #[command(flatten)]
    start: Start,
}

impl AtCutoff {
    /// Loads the scene and makes a hit on the wall `[K, B]`, in the scene's units. With `None`, the wall is the first
    /// of the scene's walk.
    pub fn load(&self, wall: Option<[f64; 2]>) -> Result<(NamedScene, WallHit), Error> {
        let scene = NamedScene::load(&self.scene)?;
        let units = scene.scene.units;
        let wall = wall.map(|[k, b]| [units.stiffness_n_per_m(k), units.damping_n_s_per_m(b)]);
        let hit = asked::hit(&scene, self.cutoff, wall, self.start.start_offset, NAMES)?;
        if self.cutoff.is_none() {
            note_old_place(&scene);
        }
        Ok((scene, hit))
    }
}

/// What a hit or a walk was made with: the first fields of the JSON object.
#[derive(Serialize)]
pub struct Subject<'a> {
    scene: &'a str,
    numeric: &'static str,
    estimator: &'static str,
    /// Cutoff in Hz. `null` if the estimator has no cutoff.
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
    /// Nominal cutoffs in Hz: A,B,C or FROM:STEP:TO [default: `velocity.cutoff_hz` of the scene]. Not for estimators
    /// without a cutoff.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    cutoffs: Option<List>,
    /// Dampings B of the wall in N s/m (for a rotary scene in N m s/rad): A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    dampings: List,
}

impl AtCutoffs {
    /// Loads the scene. Checks all values of all lists before the first value is used.
    pub fn load(
        &self,
        stiffnesses: &[f64],
        start: Option<Start>,
    ) -> Result<(NamedScene, Walls), Error> {
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
        let start_offset_counts = start.map_or(0.0, |start| start.start_offset);
        let stiffnesses = stiffnesses.iter().map(|&k| units.stiffness_n_per_m(k)).collect();
        let walls = Walls { filters, dampings, stiffnesses, start_offset_counts };
        walls.check(&scene, LISTS)?;
        Ok((scene, walls))
    }
}

/// Prints a note if the cutoff is the only value of `[sweep]`. The note names the right key.
fn note_old_place(scene: &NamedScene) {
    if let Some(cutoff_hz) = only_of_sweep(&scene.scene).and_then(|filter| filter.cutoff_hz()) {
        eprintln!(
            "note: {}: cutoff {cutoff_hz} Hz, the only one of sweep.cutoffs_hz; its place is velocity.cutoff_hz",
            scene.name
        );
    }
}

pub fn check_filters(scene: &NamedScene, filters: &[VelocitySettings]) -> Result<(), Error> {
    let wall = |&velocity: &VelocitySettings| WallHit {
        velocity,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        start_offset_counts: 0.0,
    };
    filters.iter().try_for_each(|filter| asked::check_wall(scene, &wall(filter), LISTS))
}

/// The folder of a result. Its files are still drafts, and are not in the folder yet.
pub struct Filled {
    outputs: Outputs,
    to: FolderPlace,
    path: PathBuf,
}

impl Common {
    /// Reserves the folder for a scene's result. The folder is `--out`, or the default folder for this `kind`.
    pub fn fill(&self, scene: &NamedScene, kind: &str, files: &[&str]) -> Result<Filled, Error> {
        let default = || PathBuf::from("zwidth-out").join(&scene.name).join(kind);
        let path = self.out.clone().unwrap_or_else(default);
        let mut outputs = self.outputs(&scene.files)?;
        let to = outputs.folder(&path, scene.scene.units, files)?;
        Ok(Filled { outputs, to, path })
    }

    /// Checks that the arithmetic is fixed point, as on the board.
    pub fn only_fixed(&self, command: &str) -> Result<(), Error> {
        match self.numeric {
            Numeric::Fixed => Ok(()),
            _ => Err(Error::Input(format!(
                "--numeric: {command} runs the fixed-point core only, allowed fixed"
            ))),
        }
    }
}

impl Filled {
    pub fn add(&mut self, name: &str, text: String) -> Result<(), Error> {
        self.outputs.add(self.to, name, text)
    }

    pub fn figure(&mut self, stem: &str, figure: &Figure) -> Result<(), Error> {
        self.outputs.add_figure(self.to, stem, figure)
    }

    /// Adds the manifest and moves all files to the folder. Returns a line for people that names the folder.
    pub fn finish(mut self, manifest: &Manifest) -> Result<String, Error> {
        self.outputs.add(self.to, MANIFEST, json(manifest)?)?;
        self.outputs.commit()?;
        Ok(format!("results in {}", self.path.display()))
    }
}

/// A command, as text of a command line for the manifest.
pub struct Typed(pub String);

impl Typed {
    pub fn new(command: &str, scene: &str) -> Self {
        Self(format!("{command} {scene}"))
    }

    pub fn with(self, option: &str, value: impl Display) -> Self {
        Self(format!("{} --{option} {value}", self.0))
    }

    pub fn maybe(self, option: &str, value: Option<impl Display>) -> Self {
        match value {
            Some(value) => self.with(option, value),
            None => self,
        }
    }

    pub fn flag(self, option: &str, is_set: bool) -> Self {
        if is_set { Self(format!("{} --{option}", self.0)) } else { self }
    }

    /// Adds options that are already text.
    pub fn and(self, typed: &str) -> Self {
        Self(self.0 + typed)
    }

    /// The whole text. It includes the engine that runs the hits.
    pub fn by(self, common: &Common) -> String {
        self.with("engine", common.how().engine.name()).0
    }
}

/// Joins the values of an option with commas. Returns `None` without values.
pub fn listed<T: Display>(values: &[T]) -> Option<String> {
    let texts: Vec<String> = values.iter().map(T::to_string).collect();
    (!texts.is_empty()).then(|| texts.join(","))
}
