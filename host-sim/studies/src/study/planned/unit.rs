//! A unit of work has a scene, a list of points, the program's sources and the schema. The SHA-256 of these parts is
//! the key of the unit. The result of a unit is one table. If a unit is made again, on any machine, the result has the
//! same bits.

use rayon::prelude::*;
use sha2::{Digest as _, Sha256};
use toml::Value;
use zwidth::{VelocitySettings, experiment::Ended};

use super::{Block, Measure, Point, SCHEMA, SOURCES, Study};
use crate::{
    engine::{Depth, Outcome},
    error::Error,
    scene::{NamedScene, Units},
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
    study::{
        How,
        sweep::{Plan, SweepResult, filters, sweep},
        walk_lanes::{Start, all_walks},
    },
    table::{Cell, Column, Kind, Table},
};

/// Largest number of changed scenes that are in memory at once.
const AT_ONCE: usize = 256;

/// The result of some points of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    pub table: Table,
    /// Number of hits that the points have requested.
    pub hits: u64,
}

/// SHA-256 of several parts. The length of each part is hashed before the part.
#[derive(Clone, Debug, Default)]
struct Hash(Sha256);

impl Hash {
    fn part(&mut self, part: impl AsRef<[u8]>) {
        let part = part.as_ref();
        self.0.update((part.len() as u64).to_le_bytes());
        self.0.update(part);
    }

    fn hex(self) -> String {
        self.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Hashes a scene with its estimator: its name, its keys in alphabetical order, and its felt curve. The content of the
/// curve replaces the path of the curve.
fn scene_part(hash: &mut Hash, block: &Block) {
    let mut table = block.table.clone();
    if let Some(Value::Table(hit)) = table.get_mut("wall_hit") {
        hit.remove("felt_curve");
    }
    hash.part(&block.name);
    hash.part(table.to_string());
    hash.part(block.curve.as_deref().unwrap_or_default());
}

/// Hashes the cutoffs. For an estimator without a cutoff, a single 0 is hashed.
fn cutoffs_part(hash: &mut Hash, block: &Block) {
    let cutoffs_hz = block.cutoffs_hz.iter().map(|hz| hz.unwrap_or_default());
    numbers_part(hash, &cutoffs_hz.collect::<Vec<_>>());
}

fn numbers_part(hash: &mut Hash, numbers: &[f64]) {
    hash.part(numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>());
}

impl Study {
    fn head_part(&self, numeric: Numeric) -> Hash {
        let mut hash = Hash::default();
        for part in ["zwidth study", &SCHEMA.to_string(), SOURCES] {
            hash.part(part);
        }
        hash.part(self.file.keys.measure.name());
        hash.part(numeric.name());
        hash
    }

    /// Key of the study. Two studies with the same key have the same units, and their results have the same bits.
    pub fn key(&self, numeric: Numeric) -> String {
        let mut hash = self.head_part(numeric);
        let file = &self.file;
        for block in &self.blocks {
            scene_part(&mut hash, block);
            cutoffs_part(&mut hash, block);
            hash.part(block.points_per_unit.to_le_bytes());
        }
        for numbers in [file.keys.starts_counts(), file.keys.stiffnesses(), file.keys.dampings()] {
            numbers_part(&mut hash, numbers);
        }
        hash.part(file.keys.repeat().to_le_bytes());
        for (key, values) in &file.product {
            hash.part(key);
            hash.part(Value::Array(values.clone()).to_string());
        }
        for (key, value) in file.list.iter().flatten() {
            hash.part(key);
            hash.part(value.to_string());
        }
        hash.hex()
    }

    pub fn unit_key(&self, unit: u64, numeric: Numeric) -> String {
        let mut hash = self.head_part(numeric);
        let block = self.block_of(unit);
        scene_part(&mut hash, block);
        if self.file.keys.measure == Measure::Sweep {
            cutoffs_part(&mut hash, block);
            hash.part(self.file.keys.repeat().to_le_bytes());
        }
        let mut last = None;
        for point in self.points_of(unit) {
            if last != Some(point.variant) {
                last = Some(point.variant);
                for (key, value) in self.file.changes(point.variant) {
                    hash.part(key);
                    hash.part(value.to_string());
                }
            }
            hash.part(point.number.to_le_bytes());
            let Point { cutoff_hz, stiffness, damping, start_offset_counts, .. } = point;
            let numbers = [cutoff_hz.unwrap_or_default(), stiffness, damping, start_offset_counts];
            numbers_part(&mut hash, &numbers);
        }
        hash.hex()
    }

    pub fn points_of(&self, unit: u64) -> impl Iterator<Item = Point> {
        let block = self.block_of(unit);
        let first = (unit - block.first_unit) * block.points_per_unit;
        (first..block.points.min(first + block.points_per_unit))
            .map(move |within| self.point(block, within))
    }

    /// Makes a unit. It uses all threads of the current pool.
    ///
    /// # Errors
    /// The handle does not reach the wall, leaves the core's range in a walk, or `stop` was set.
    pub fn run(&self, unit: u64, how: How<'_>) -> Result<Made, Error> {
        let points: Vec<Point> = self.points_of(unit).collect();
        self.make(self.block_of(unit), &points, how)
    }

    pub fn columns(&self, block: &Block) -> Vec<Column> {
        use Kind::{Number, Text, Whole};
        let fixed = |columns: &[(&str, Kind)]| -> Vec<Column> {
            columns.iter().map(|&(name, kind)| Column { name: name.into(), kind }).collect()
        };
        let told = |columns: &[(&str, Kind)]| -> Vec<Column> {
            let told = |name: &str| block.units.key(name).map_or(name.into(), |(name, _)| name);
            columns.iter().map(|&(name, kind)| Column { name: told(name), kind }).collect()
        };
        let mut columns = fixed(&[("point", Whole), ("scene", Text), ("estimator", Text)]);
        for (key, value) in self.file.changes(0) {
            columns.push(Column { name: key, kind: kind_of(&value) });
        }
        columns.extend(told(match self.file.keys.measure {
            Measure::Walk => &[
                ("cutoff_hz", Number),
                ("start_offset_counts", Number),
                ("area_n2_s_per_m2", Number),
                ("stiffness_peak_n_per_m", Number),
                ("damping_max_n_s_per_m", Number),
                ("hits", Whole),
                ("ended_by", Text),
            ],
            Measure::Hit => &[
                ("cutoff_hz", Number),
                ("start_offset_counts", Number),
                ("damping_n_s_per_m", Number),
                ("stiffness_n_per_m", Number),
                ("verdict", Text),
                ("rms_m", Number),
            ],
            Measure::Sweep => &[
                ("cutoff_hz", Number),
                ("true_cutoff_hz", Number),
                ("area_n2_s_per_m2", Number),
                ("area_low_n2_s_per_m2", Number),
                ("area_high_n2_s_per_m2", Number),
                ("stiffness_peak_n_per_m", Number),
                ("damping_max_n_s_per_m", Number),
                ("hits", Whole),
                ("ideal_cutoff_hz", Number),
                ("ideal_low_hz", Number),
                ("ideal_high_hz", Number),
            ],
        }));
        columns
    }

    /// Makes points of a block. It uses all threads of the current pool.
    ///
    /// # Errors
    /// An error of [`run`](Self::run).
    pub fn make(&self, block: &Block, points: &[Point], how: How<'_>) -> Result<Made, Error> {
        let columns = self.columns(block);
        let mut made = Made { table: Table { columns, rows: vec![] }, hits: 0 };
        let variants: Vec<&[Point]> = points.chunk_by(|a, b| a.variant == b.variant).collect();
        for variants in variants.chunks(AT_ONCE) {
            let prepare = |&points| {
                let points: &[Point] = points;
                let scene = self.scene(block, points[0].variant)?;
                let prepared = PreparedScene::new(&scene.scene)?;
                let name = self.described(block, points[0].variant);
                Ok(Variant { study: self, block, scene, prepared, name, points })
            };
            // Of several errors, the one of the first scene is reported, whichever thread finds its error first.
            let variants: Vec<Result<Variant<'_>, Error>> =
                variants.par_iter().map(prepare).collect();
            let variants = variants.into_iter().collect::<Result<Vec<_>, _>>()?;
            match self.file.keys.measure {
                Measure::Walk => walk(&variants, how, &mut made)?,
                Measure::Hit => hit(&variants, how, &mut made)?,
                Measure::Sweep => swept(&variants, how, &mut made)?,
            }
        }
        Ok(made)
    }
}

fn kind_of(value: &Value) -> Kind {
    match value {
        Value::String(_) => Kind::Text,
        Value::Boolean(_) => Kind::Flag,
        _ => Kind::Number,
    }
}

/// A changed scene of a study, and its points.
struct Variant<'a> {
    study: &'a Study,
    block: &'a Block,
    scene: NamedScene,
    prepared: PreparedScene,
    name: String,
    points: &'a [Point],
}

impl Variant<'_> {
    /// The first cells of a row: the point's number, the scene, the estimator and the changes.
    fn cells(&self, point: &Point) -> Vec<Cell> {
        let mut cells = vec![
            Cell::Whole(point.number),
            Cell::Text(self.block.name.clone().into()),
            Cell::Text(self.block.estimator.into()),
        ];
        cells.extend(self.study.file.changes(point.variant).into_iter().map(
            |(_, value)| match value {
                Value::String(text) => Cell::Text(text.into()),
                Value::Boolean(flag) => Cell::Flag(flag),
                Value::Integer(number) => Cell::Number(number as f64),
                Value::Float(number) => Cell::Number(number),
                _ => Cell::Empty,
            },
        ));
        cells
    }

    /// A cell with a number of this column, converted to the units of the scene.
    fn told(&self, column: &str, value: f64) -> Cell {
        let factor = self.scene.scene.units.key(column).map_or(1.0, |(_, factor)| factor);
        Cell::Number(Units::told(value, factor))
    }
}

fn walk(variants: &[Variant<'_>], how: How<'_>, made: &mut Made) -> Result<(), Error> {
    let begins = |variant: &'_ Variant<'_>| {
        let start = |point: &Point| {
            let WallHit { velocity, start_offset_counts, .. } = point.hit(&variant.scene.scene);
            Start { velocity, start_offset_counts }
        };
        variant.points.iter().map(start).collect()
    };
    let begins: Vec<(&PreparedScene, Vec<Start>)> =
        variants.iter().map(|variant| (&variant.prepared, begins(variant))).collect();
    for (variant, found) in variants.iter().zip(all_walks(how, &begins, |_| ())?) {
        for (point, boundary) in variant.points.iter().zip(found) {
            let boundary = boundary.map_err(|error| error.of(&variant.name))?;
            let mut row = variant.cells(point);
            row.extend([
                Cell::number(point.cutoff_hz),
                Cell::Number(point.start_offset_counts),
                variant.told("area_n2_s_per_m2", boundary.area),
                variant.told("stiffness_peak_n_per_m", boundary.stiffness_peak_n_per_m()),
                variant.told("damping_max_n_s_per_m", boundary.damping_max_n_s_per_m()),
                Cell::Whole(boundary.hits),
                Cell::Text(boundary.ended.map_or(UNSTABLE, Ended::name).into()),
            ]);
            made.hits += boundary.hits;
            made.table.rows.push(row);
        }
    }
    Ok(())
}

/// Reason for the end of a walk whose first wall is unstable. The area of such a walk is 0.
const UNSTABLE: &str = "first_unstable";
/// Verdict of a hit in which the handle has left the core's range.
const OUT_OF_RANGE: &str = "out_of_range";

fn hit(variants: &[Variant<'_>], how: How<'_>, made: &mut Made) -> Result<(), Error> {
    let rows = |variant: &Variant<'_>| -> Result<Vec<Vec<Cell>>, Error> {
        let of = |point: &Point| point.hit(&variant.scene.scene);
        let hits: Vec<WallHit> = variant.points.iter().map(of).collect();
        let mut rows = Vec::with_capacity(hits.len());
        let sink = |outcome: Result<Outcome, HitError>| {
            let (verdict, rms_m) = match outcome {
                Ok(outcome) => (outcome.verdict.name(), outcome.rms_m),
                Err(HitError::OutOfRange(_)) => (OUT_OF_RANGE, None),
                Err(error) => return Err(error.into()),
            };
            let point = &variant.points[rows.len()];
            let mut row = variant.cells(point);
            row.extend([
                Cell::number(point.cutoff_hz),
                Cell::Number(point.start_offset_counts),
                Cell::Number(point.damping),
                Cell::Number(point.stiffness),
                Cell::Text(verdict.into()),
                rms_m.map_or(Cell::Empty, |rms_m| variant.told("rms_m", rms_m)),
            ]);
            rows.push(row);
            Ok(())
        };
        how.run(&variant.prepared, Depth::Whole, &hits, sink)
            .map_err(|error| error.of(&variant.name))?;
        Ok(rows)
    };
    let rows: Vec<Result<Vec<Vec<Cell>>, Error>> = variants.par_iter().map(rows).collect();
    for rows in rows {
        let rows = rows?;
        made.hits += rows.len() as u64;
        made.table.rows.extend(rows);
    }
    Ok(())
}

fn swept(variants: &[Variant<'_>], how: How<'_>, made: &mut Made) -> Result<(), Error> {
    let of = |variant: &Variant<'_>| {
        let cutoffs_hz: Vec<f64> = variant.block.cutoffs_hz.iter().flatten().copied().collect();
        filters(&variant.scene.scene.velocity, &cutoffs_hz)
    };
    let asked: Vec<Vec<VelocitySettings>> = variants.iter().map(of).collect();
    let plans: Vec<Plan<'_>> = variants
        .iter()
        .zip(&asked)
        .map(|(Variant { name, prepared, .. }, filters)| Plan { name, prepared, filters })
        .collect();
    let Some(repeat) = variants.first().map(|variant| variant.study.file.keys.repeat()) else {
        return Ok(());
    };
    let results = sweep(how.engine, &plans, how.numeric, repeat, how.stop, |_| ())?;
    for (variant, SweepResult { cutoffs, ideal }) in variants.iter().zip(results) {
        let has_cutoff = variant.scene.scene.velocity.has_cutoff();
        let ideal = |of: fn(&crate::study::sweep::Ideal) -> f64| {
            Cell::number(ideal.as_ref().filter(|_| has_cutoff).map(of))
        };
        for result in cutoffs {
            let boundaries = &result.boundaries;
            let mut row = variant.cells(&variant.points[0]);
            let [low, high] = boundaries.area_range();
            row.extend([
                Cell::number(has_cutoff.then_some(result.cutoff_hz)),
                Cell::number(has_cutoff.then_some(result.true_cutoff_hz)),
                variant.told("area_n2_s_per_m2", boundaries.area()),
                variant.told("area_low_n2_s_per_m2", low),
                variant.told("area_high_n2_s_per_m2", high),
                variant.told("stiffness_peak_n_per_m", boundaries.stiffness_peak_n_per_m()),
                variant.told("damping_max_n_s_per_m", boundaries.damping_max_n_s_per_m()),
                Cell::Whole(boundaries.hits()),
                ideal(|ideal| ideal.cutoff_hz),
                ideal(|ideal| ideal.range_hz[0]),
                ideal(|ideal| ideal.range_hz[1]),
            ]);
            made.hits += boundaries.hits();
            made.table.rows.push(row);
        }
    }
    Ok(())
}
