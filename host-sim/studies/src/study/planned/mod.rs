//! A study has many points, which are worked on in units. A point has a scene, an estimator, changed keys, a cutoff, a
//! start and a wall.
//!
//! A point is computed from its number when it is needed. So even a million points need no memory. The order is:
//! scenes, estimators, `[[list]]`, the keys of `[product]` in alphabetical order, cutoffs, starts, B, K. K changes
//! fastest. A scene with one estimator is a [`Block`]. A unit has consecutive points of one block. `docs/scenes.md`
//! describes the file, and [`mod@unit`] the unit.

mod file;
pub mod trial;
pub mod unit;

use std::path::PathBuf;

use rayon::prelude::*;
use toml::{Table, Value};
use zwidth::VelocitySettings;

pub use file::{Changes, Keys, Measure, StudyFile};

use crate::{
    error::Error,
    scene::{NamedScene, Scene, Units},
    simulation::prepared::WallHit,
    study::asked::{self, Names, Walls},
};

/// Version of the keys of units and of the files with their results.
pub const SCHEMA: u32 = 1;
/// SHA-256 of the sources of core and simulator. A result depends on these sources down to its bits.
pub const SOURCES: &str = env!("ZWIDTH_SOURCES");

/// Largest number of points that a study may have.
pub const POINTS_MAX: u64 = 1_000_000_000;
/// Largest number of changed scenes that a study may have. Each of them is checked before the first hit.
pub const VARIANTS_MAX: u64 = 1_000_000;
/// Largest number of units that a study may have.
pub const UNITS_MAX: u64 = 100_000;
/// Approximate number of samples in a unit with the default number of points. Such a unit takes some seconds in lanes,
/// and less than a minute without lanes.
const SAMPLES_PER_UNIT: f64 = 1e9;
/// Estimated number of hits of a walk. It gives the default number of points in a unit. Walks of the paper's devices
/// have 40 to 160 hits.
const HITS_PER_WALK: f64 = 100.0;

/// Names of options that error messages of a study use.
const NAMES: Names = Names {
    cutoff: "cutoffs_hz",
    stiffness: "stiffnesses",
    damping: "dampings",
    start_offset: "starts_counts",
};

/// A scene with one estimator, and all its points.
#[derive(Clone, Debug)]
pub struct Block {
    pub name: String,
    /// The keys of the scene's file, with this estimator. No other key is changed yet.
    pub table: Table,
    /// Text of the scene's felt curve; `None` if the scene names no curve.
    pub curve: Option<String>,
    pub units: Units,
    pub estimator: &'static str,
    /// Nominal cutoffs in Hz. An estimator without a cutoff has one element, which is `None`.
    pub cutoffs_hz: Vec<Option<f64>>,
    /// Number that the block's first point has in the study.
    pub first_point: u64,
    /// Number that the block's first unit has in the study.
    pub first_unit: u64,
    pub points: u64,
    /// Number of points in each unit of the block. The last unit may have fewer.
    pub points_per_unit: u64,
}

#[derive(Clone, Debug)]
pub struct Study {
    pub file: StudyFile,
    /// All combinations of a scene and an estimator.
    pub blocks: Vec<Block>,
    pub points: u64,
    pub units: u64,
    pub files: Vec<PathBuf>,
}

/// One point: a changed scene, and its cutoff, wall and start.
#[derive(Clone, Debug, Default)]
pub struct Point {
    pub number: u64,
    /// Index of the changed scene in its block.
    pub variant: u64,
    /// Nominal cutoff in Hz. `None` for an estimator without a cutoff, and in a sweep.
    pub cutoff_hz: Option<f64>,
    /// K in the scene's units. Only a hit uses it.
    pub stiffness: f64,
    /// B in the scene's units. Only a hit uses it.
    pub damping: f64,
    /// Distance from the scene's start, in counts.
    pub start_offset_counts: f64,
}

/// The scene's filter at a point's cutoff.
fn filter(scene: &Scene, cutoff_hz: Option<f64>) -> VelocitySettings {
    scene.velocity.at(cutoff_hz.unwrap_or_default())
}

impl Point {
    fn hit(&self, scene: &Scene) -> WallHit {
        WallHit {
            velocity: filter(scene, self.cutoff_hz),
            stiffness_n_per_m: scene.units.stiffness_n_per_m(self.stiffness),
            damping_n_s_per_m: scene.units.damping_n_s_per_m(self.damping),
            start_offset_counts: self.start_offset_counts,
        }
    }
}

impl Study {
    /// Reads the scenes and checks every point.
    ///
    /// # Errors
    /// [`Error::Input`] with file, key, value, and what is allowed.
    pub fn new(file: StudyFile) -> Result<Self, Error> {
        let mut study = Self { file, blocks: vec![], points: 0, units: 0, files: vec![] };
        let file = &study.file;
        let refused = |what: String| Error::Input(format!("{}: {what}", file.origin));
        let variants = file.variants();
        if variants > VARIANTS_MAX {
            let what =
                format!("[product] and [[list]] make {variants} scenes, allowed {VARIANTS_MAX}");
            return Err(refused(what));
        }
        let (mut blocks, mut files): (Vec<Block>, Vec<PathBuf>) = (vec![], vec![]);
        for name in &file.keys.scenes {
            let scene = NamedScene::load(&file.place_of(name))
                .map_err(|error| error.of(&format!("{}: scenes", file.origin)))?;
            if blocks.iter().any(|block| block.name == scene.name) {
                return Err(refused(format!("scenes has two of the name {}", scene.name)));
            }
            let own = [Table::new()];
            let estimators = if file.estimators.is_empty() { &own[..] } else { &file.estimators };
            let of_scene: Result<Vec<Block>, Error> =
                estimators.iter().map(|estimator| file.block(&scene, estimator)).collect();
            blocks.extend(of_scene?);
            files.extend(scene.files);
        }
        let is_other = |block: &&Block| block.units.is_rotary() != blocks[0].units.is_rotary();
        if let Some(other) = blocks.iter().find(is_other) {
            let (first, other) = (&blocks[0].name, &other.name);
            let what =
                format!("scenes has {first} and {other}, one of them rotary; allowed is one kind");
            return Err(refused(what));
        }
        if file.keys.cutoffs_hz.is_some()
            && !blocks.iter().any(|block| block.cutoffs_hz[0].is_some())
        {
            let what =
                format!("cutoffs_hz is given, but the estimator {} has none", blocks[0].estimator);
            return Err(refused(what));
        }
        let (mut points, mut units) = (0u64, 0u64);
        for block in &mut blocks {
            (block.first_point, block.first_unit) = (points, units);
            points = points.saturating_add(block.points);
            units = units.saturating_add(block.points.div_ceil(block.points_per_unit));
        }
        if points > POINTS_MAX {
            return Err(refused(format!("the study has {points} points, allowed {POINTS_MAX}")));
        }
        if units > UNITS_MAX {
            let what =
                format!("the study has {units} units, allowed {UNITS_MAX}; raise points_per_unit");
            return Err(refused(what));
        }
        (study.blocks, study.points, study.units, study.files) = (blocks, points, units, files);
        for block in &study.blocks {
            // Of several errors, the one of the first scene is reported, whichever thread finds its error first.
            let check = |variant| study.checked(block, variant).err();
            if let Some(error) = (0..variants).into_par_iter().find_map_first(check) {
                return Err(error);
            }
        }
        Ok(study)
    }

    /// Makes a changed scene of a block.
    ///
    /// # Errors
    /// [`Error::Input`] with the changes, key, value, and what is allowed.
    pub fn scene(&self, block: &Block, variant: u64) -> Result<NamedScene, Error> {
        let file = &self.file;
        let changes = file.changes(variant);
        let mut table = block.table.clone();
        for (key, value) in &changes {
            change(&mut table, key, value.clone())
                .map_err(|what| Error::Input(format!("{}: {what}", file.origin)))?;
        }
        let origin = format!("{}: {}", file.origin, described(block, &changes));
        NamedScene::of_table(block.name.clone(), table, &origin)
    }

    /// Makes a changed scene of a block, and checks every cutoff, wall and start of its points.
    fn checked(&self, block: &Block, variant: u64) -> Result<NamedScene, Error> {
        let scene = self.scene(block, variant)?;
        let named = |error: Error| error.of(&self.described(block, variant));
        let units = scene.scene.units;
        let walk = &scene.scene.walk;
        let (dampings, stiffnesses) = match self.file.keys.measure {
            Measure::Hit => (
                self.file.keys.dampings().iter().map(|&b| units.damping_n_s_per_m(b)).collect(),
                self.file.keys.stiffnesses().iter().map(|&k| units.stiffness_n_per_m(k)).collect(),
            ),
            _ => (vec![walk.damping_start_n_s_per_m], vec![walk.stiffness_start_n_per_m]),
        };
        let filters = block.cutoffs_hz.iter().map(|&hz| filter(&scene.scene, hz));
        let filters: Vec<VelocitySettings> = filters.collect();
        for &start_offset_counts in self.file.keys.starts_counts() {
            let (filters, dampings, stiffnesses) =
                (filters.clone(), Vec::clone(&dampings), Vec::clone(&stiffnesses));
            let walls = Walls { filters, dampings, stiffnesses, start_offset_counts };
            walls.check(&scene, NAMES).map_err(named)?;
        }
        asked::prepare(&scene).map_err(named)?;
        Ok(scene)
    }

    /// Text that names a changed scene in error messages.
    pub fn described(&self, block: &Block, variant: u64) -> String {
        format!("{}: {}", self.file.origin, described(block, &self.file.changes(variant)))
    }

    pub fn block_of(&self, unit: u64) -> &Block {
        let after = self.blocks.partition_point(|block| block.first_unit <= unit);
        &self.blocks[after.saturating_sub(1)]
    }

    /// The point of a block with the number `within`. The numbers begin at 0 in each block.
    #[expect(clippy::cast_possible_truncation, reason = "remainders by lengths")]
    pub fn point(&self, block: &Block, within: u64) -> Point {
        let file = &self.file;
        let mut rest = within;
        let mut digit = |length: usize| {
            let digit = rest % (length.max(1) as u64);
            rest /= length.max(1) as u64;
            digit as usize
        };
        let mut of = Point::default();
        if file.keys.measure != Measure::Sweep {
            if file.keys.measure == Measure::Hit {
                of.stiffness = file.keys.stiffnesses()[digit(file.keys.stiffnesses().len())];
                of.damping = file.keys.dampings()[digit(file.keys.dampings().len())];
            }
            of.start_offset_counts =
                file.keys.starts_counts()[digit(file.keys.starts_counts().len())];
            of.cutoff_hz = block.cutoffs_hz[digit(block.cutoffs_hz.len())];
        }
        Point { number: block.first_point + within, variant: rest, ..of }
    }
}

fn described(block: &Block, changes: &Changes) -> String {
    let changes: Vec<String> =
        changes.iter().map(|(key, value)| format!("{key} = {value}")).collect();
    let with = if changes.is_empty() { "" } else { " with " };
    format!("{}{with}{}", block.name, changes.join(", "))
}

/// Sets `value` at the dotted key of a table.
fn change(table: &mut Table, key: &str, value: Value) -> Result<(), String> {
    let mut at = table;
    let mut parts: Vec<&str> = key.split('.').collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        let entry = at.entry(part).or_insert_with(|| Value::Table(Table::new()));
        at = match entry {
            Value::Table(table) => table,
            _ => return Err(format!("{key}: {part} is no table of the scene")),
        };
    }
    at.insert(last.into(), value);
    Ok(())
}

impl StudyFile {
    /// The name of a built-in scene, or the path of a scene relative to the study's file.
    fn place_of(&self, name: &str) -> String {
        let is_built_in = crate::scene::BUILT_IN.iter().any(|(known, _)| {
            name.strip_prefix(known).is_some_and(|rest| rest.is_empty() || rest.starts_with(':'))
        });
        if is_built_in {
            name.into()
        } else {
            self.folder.join(name).to_string_lossy().into_owned()
        }
    }

    /// Number of changed scenes that each scene gives.
    pub fn variants(&self) -> u64 {
        let product = self.product.iter().map(|(_, values)| values.len() as u64);
        product.fold(self.list.len() as u64, u64::saturating_mul)
    }

    /// The changes that belong to this number.
    #[expect(clippy::cast_possible_truncation, reason = "remainders by lengths")]
    pub fn changes(&self, variant: u64) -> Changes {
        let mut rest = variant;
        let mut product = vec![];
        for (key, values) in self.product.iter().rev() {
            product.push((key.clone(), values[(rest % values.len() as u64) as usize].clone()));
            rest /= values.len() as u64;
        }
        let mut changes = self.list[rest as usize % self.list.len()].clone();
        changes.extend(product.into_iter().rev());
        changes
    }

    /// The block of a scene with an estimator. An empty table keeps the scene's own estimator. The points of the block
    /// have no numbers yet.
    fn block(&self, scene: &NamedScene, estimator: &Table) -> Result<Block, Error> {
        let mut table = scene.table()?;
        if !estimator.is_empty() {
            table.insert("velocity".into(), Value::Table(estimator.clone()));
        }
        let origin = format!("{}: {}", self.origin, scene.name);
        let origin = match estimator.is_empty() {
            true => origin,
            false => format!("{origin} with the estimator {}", Value::Table(estimator.clone())),
        };
        let with = NamedScene::of_table(scene.name.clone(), table.clone(), &origin)?;
        let velocity = with.scene.velocity;
        let own = self.keys.cutoffs_hz.as_ref().unwrap_or(&with.scene.sweep.cutoffs_hz);
        let cutoffs_hz = match velocity.has_cutoff() {
            true => own.iter().copied().map(Some).collect(),
            false => vec![None],
        };
        let (walls, starts) = match self.keys.measure {
            Measure::Hit => (
                self.keys.stiffnesses().len() * self.keys.dampings().len(),
                self.keys.starts_counts().len(),
            ),
            Measure::Walk => (1, self.keys.starts_counts().len()),
            Measure::Sweep => (1, 1),
        };
        let cutoffs = if self.keys.measure == Measure::Sweep { 1 } else { cutoffs_hz.len() };
        let of_variant = [cutoffs, starts, walls].map(|n| n as u64);
        let points = of_variant.into_iter().fold(self.variants(), u64::saturating_mul);
        let hit = &with.scene.wall_hit;
        let samples = hit.times_s().iter().sum::<f64>() * with.scene.control.rate_hz;
        let hits = match self.keys.measure {
            Measure::Hit => 1.0,
            Measure::Walk => HITS_PER_WALK,
            Measure::Sweep => {
                HITS_PER_WALK * cutoffs_hz.len() as f64 * f64::from(self.keys.repeat())
            }
        };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 10^9")]
        let fitting = (SAMPLES_PER_UNIT / (samples * hits)).clamp(1.0, 1e6) as u64;
        Ok(Block {
            name: scene.name.clone(),
            table,
            curve: with.scene.wall_hit.felt.text().map(str::to_owned),
            units: with.scene.units,
            estimator: velocity.name(),
            cutoffs_hz,
            first_point: 0,
            first_unit: 0,
            points,
            points_per_unit: self.keys.points_per_unit.unwrap_or(fitting),
        })
    }
}

#[cfg(test)]
mod tests;
