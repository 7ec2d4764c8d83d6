//! Compares a measured walk with the walk that a scene predicts. Do the walks agree? If not, which number of the scene
//! explains the difference best?
//!
//! **Distance** of two walks, in N/m: `sqrt(sum over B of max(0, |K - K'| - step)^2 / n)`, where n is the number of
//! measured B. One step of K is subtracted, because a walk does not resolve smaller differences. If only one of the
//! walks reaches a B, the other walk has K = 0 at this B.
//!
//! **Do they agree?** The scene is walked from nineteen starts over one count. For each of these walks, the distance
//! from the mean of the other eighteen is computed. The measured walk disagrees with the scene if its distance from the
//! mean is larger than all these nineteen distances. If twenty walks differ only by their start, the measured walk has
//! the largest distance with a probability of one in twenty. So 5 % of agreeing walks are reported as different.
//!
//! **Which number?** Each [`Suspect`] is changed alone. The search first tries values around the scene's value, then
//! values between the best three values. At the end it refines the range of values that explain as much as the best
//! value. Each value needs four walks. A value explains the difference if the remaining distance is at most the largest
//! of the nineteen distances of the scene's own walks. Several suspects may explain the difference.

mod measured;
mod suspects;
mod told;

use std::{path::Path, sync::atomic::AtomicBool};

use rayon::prelude::*;

pub use measured::Measured;
pub use suspects::{Suspect, suspects};
pub use told::{SuspectRow, Told, WallRow};

use zwidth::VelocitySettings;

use crate::{
    engine::Engine,
    error::Error,
    scene::{NamedScene, Scene},
    simulation::prepared::{Numeric, PreparedScene},
    study::{asked, boundary::BoundaryPoint, sweep::starts, walk::walk},
};

/// Walks of the unchanged scene.
pub const STARTS: u32 = 19;
/// Walks of each value of a suspect.
const STARTS_OF_A_VALUE: u32 = 4;
/// The number of times that an interval of values is halved. The interval lies around the best value or around an end
/// of the range.
const HALVINGS: usize = 3;

/// A value of B in N s/m, and the K of both walks at this B in N/m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub damping_n_s_per_m: f64,
    /// Mean predicted K.
    pub predicted: f64,
    pub predicted_low: f64,
    pub predicted_high: f64,
    /// K of the measured walk. It is 0 if the measured walk does not reach this B.
    pub measured: f64,
}

/// Result of one suspect.
#[derive(Clone, Debug)]
pub struct Tried {
    /// The number of the scene that was changed.
    pub suspect: Suspect,
    /// The value in the middle of `range`. It is one of the tried values.
    pub value: f64,
    /// Smallest and largest tried value that explain the difference as well as the best value. With each of these
    /// values, the remaining distance is minimal or at most the scatter.
    pub range: [f64; 2],
    /// Whether `range` ends at the first or the last tried value. Values beyond it may explain the difference too.
    pub at_edge: bool,
    /// The distance that remains between the walks with this value, in N/m.
    pub left: f64,
    /// Mean predicted K in each row, with this value.
    pub predicted: Vec<f64>,
}

#[derive(Clone, Debug)]
pub struct Agreement {
    pub rows: Vec<Row>,
    /// Step of K in the scene's walk, in N/m.
    pub step: f64,
    /// Distance of the measured walk from the prediction, in N/m.
    pub distance: f64,
    /// The largest distance that one of the scene's own walks has from the mean of the others, in N/m.
    pub scatter: f64,
    /// The suspects, in ascending order of the remaining distance. The list is empty if the walks agree.
    pub tried: Vec<Tried>,
}

impl Agreement {
    /// Whether the measured walk differs from the prediction no more than the scene's own walks do.
    pub fn agrees(&self) -> bool {
        self.distance <= self.scatter
    }

    /// Whether a suspect explains the whole difference.
    pub fn explains(&self, tried: &Tried) -> bool {
        tried.left <= self.scatter
    }

    /// The suspects that explain the whole difference. If there is none, the list has the suspect that explains the
    /// largest part.
    pub fn best(&self) -> Vec<&Tried> {
        let all: Vec<&Tried> = self.tried.iter().filter(|tried| self.explains(tried)).collect();
        match self.tried.first() {
            Some(first) if all.is_empty() && first.left < self.distance => vec![first],
            _ => all,
        }
    }
}

/// The largest stable K at each step of B, for one walk.
type Stiffnesses = Vec<f64>;

struct Walker<'a, D> {
    engine: Engine,
    velocity: VelocitySettings,
    stop: &'a AtomicBool,
    done: D,
}

impl<D: Fn() + Sync> Walker<'_, D> {
    /// Makes one walk from each position in `starts`. The positions are in counts.
    fn walk(&self, prepared: &PreparedScene, starts: &[f64]) -> Result<Vec<Stiffnesses>, Error> {
        let of = |&start: &f64| {
            let walk = walk(self.engine, prepared, Numeric::Fixed, self.velocity, start, self.stop);
            (self.done)();
            Ok(stiffnesses(prepared.scene(), &walk?.points))
        };
        starts.iter().map(of).collect()
    }

    /// Makes the walks of a changed scene. `None` if the changed scene is not allowed.
    fn tried(&self, scene: &Scene) -> Result<Option<Stiffnesses>, Error> {
        let starts = starts(STARTS_OF_A_VALUE);
        let Some(prepared) = scene.check().ok().and_then(|()| PreparedScene::new(scene).ok())
        else {
            starts.iter().for_each(|_| (self.done)());
            return Ok(None);
        };
        match self.walk(&prepared, &starts) {
            Ok(walks) => Ok(Some(mean(&walks))),
            Err(Error::Interrupted) => Err(Error::Interrupted),
            Err(_) => Ok(None),
        }
    }
}

fn stiffnesses(scene: &Scene, points: &[BoundaryPoint]) -> Stiffnesses {
    let mut all = vec![];
    for point in points {
        if let Some(row) = measured::row_of(scene, point.damping_n_s_per_m) {
            if all.len() <= row {
                all.resize(row + 1, 0.0);
            }
            all[row] = point.stiffness_n_per_m;
        }
    }
    all
}

fn at(walk: &[f64], row: usize) -> f64 {
    walk.get(row).copied().unwrap_or(0.0)
}

fn mean(walks: &[Stiffnesses]) -> Stiffnesses {
    let rows = walks.iter().map(Vec::len).max().unwrap_or(0);
    let number = walks.len() as f64;
    (0..rows).map(|row| walks.iter().map(|walk| at(walk, row)).sum::<f64>() / number).collect()
}

/// Distance of two walks, in N/m, with the formula at the top of this file. `measured` is the number n of measured
/// rows.
fn distance(one: &[f64], other: &[f64], step: f64, measured: usize) -> f64 {
    let beyond = |row| ((at(one, row) - at(other, row)).abs() - step).max(0.0);
    let squares = (0..one.len().max(other.len())).map(|row| beyond(row).powi(2));
    (squares.sum::<f64>() / measured as f64).sqrt()
}

/// Largest number of walks that a comparison can need.
pub fn most_walks(scene: &Scene) -> u64 {
    let values = |suspect: Suspect| suspect.values.len() + 4 * HALVINGS;
    let values: usize = suspects(scene).into_iter().map(values).sum();
    u64::from(STARTS) + values as u64 * u64::from(STARTS_OF_A_VALUE)
}

/// Compares a measured walk in a file with the scene's walk.
///
/// # Errors
/// The file cannot be read or is no walk of this scene, or an error of [`agree`].
pub fn agree_with_file(
    engine: Engine,
    scene: &NamedScene,
    path: &Path,
    stop: &AtomicBool,
    done: impl Fn() + Sync,
) -> Result<(Measured, Agreement), Error> {
    let measured = Measured::load(path, scene)?;
    let found = agree(engine, scene, &measured, stop, done).map_err(|error| match error {
        Error::Input(why) if why.starts_with("cutoff_hz") => {
            Error::Input(why).of(&path.display().to_string())
        }
        other => other,
    })?;
    Ok((measured, found))
}

/// Compares a measured walk with the scene's walk. The result does not depend on the number of threads or on `engine`.
///
/// # Errors
/// The cutoff is out of range, the handle does not reach the wall, or `stop` was set.
pub fn agree(
    engine: Engine,
    scene: &NamedScene,
    measured: &Measured,
    stop: &AtomicBool,
    done: impl Fn() + Sync,
) -> Result<Agreement, Error> {
    let asked_cutoff = scene.scene.velocity.has_cutoff().then_some(measured.cutoff_hz);
    let names = asked::Names {
        cutoff: "cutoff_hz",
        stiffness: "stiffness",
        damping: "damping",
        start_offset: "start",
    };
    let velocity = asked::hit(scene, asked_cutoff, None, 0.0, names)?.velocity;
    let prepared = asked::prepare(scene)?;
    let walker = Walker { engine, velocity, stop, done };
    let own: Vec<Stiffnesses> = starts(STARTS)
        .par_iter()
        .map(|&start| Ok(walker.walk(&prepared, &[start])?.remove(0)))
        .collect::<Result<_, Error>>()
        .map_err(|error: Error| error.of(&scene.name))?;
    let plan = scene.scene.walk_plan();
    let step = plan.stiffness_step_n_per_m;
    let found = stiffnesses(&scene.scene, &measured.points);
    let to_measured = |walk: &[f64]| distance(walk, &found, step, measured.points.len());
    let predicted = mean(&own);
    let others = |place: usize| mean(&[&own[..place], &own[place + 1..]].concat());
    let apart = |place: usize| distance(&own[place], &others(place), step, measured.points.len());
    let scatter = (0..own.len()).map(apart).fold(0.0, f64::max);
    let mut agreement = Agreement {
        rows: rows(&scene.scene, &own, &predicted, &found),
        step,
        distance: to_measured(&predicted),
        scatter,
        tried: vec![],
    };
    if agreement.agrees() {
        return Ok(agreement);
    }
    let all = suspects(&scene.scene);
    let tried: Vec<Option<Tried>> = all
        .into_par_iter()
        .map(|suspect| search(&walker, &scene.scene, suspect, scatter, to_measured))
        .collect::<Result<_, Error>>()?;
    agreement.tried = tried.into_iter().flatten().collect();
    let far = |tried: &Tried| tried.suspect.far(tried.value);
    agreement.tried.sort_by(|a, b| a.left.total_cmp(&b.left).then(far(a).total_cmp(&far(b))));
    Ok(agreement)
}

fn rows(scene: &Scene, own: &[Stiffnesses], predicted: &[f64], found: &[f64]) -> Vec<Row> {
    let plan = scene.walk_plan();
    let row = |row: usize| {
        let of = |pick: fn(f64, f64) -> f64| own.iter().map(|walk| at(walk, row)).reduce(pick);
        Row {
            damping_n_s_per_m: plan.damping_start_n_s_per_m
                + row as f64 * plan.damping_step_n_s_per_m,
            predicted: at(predicted, row),
            predicted_low: of(f64::min).unwrap_or(0.0),
            predicted_high: of(f64::max).unwrap_or(0.0),
            measured: at(found, row),
        }
    };
    (0..predicted.len().max(found.len())).map(row).collect()
}

/// A tried value of a suspect, the remaining distance, and the walk with this value. Lists of these are sorted by the
/// value.
struct Value {
    value: f64,
    left: f64,
    walk: Stiffnesses,
}

/// Searches the best value of a suspect. `None` if the core accepts none of the changed scenes.
fn search(
    walker: &Walker<'_, impl Fn() + Sync>,
    scene: &Scene,
    suspect: Suspect,
    scatter: f64,
    to_measured: impl Fn(&[f64]) -> f64,
) -> Result<Option<Tried>, Error> {
    let mut tried: Vec<Value> = vec![];
    let add = |tried: &mut Vec<Value>, value: f64| {
        if let Some(walk) = walker.tried(&suspect.with(scene, value))? {
            let place = tried.partition_point(|other| other.value < value);
            tried.insert(place, Value { value, left: to_measured(&walk), walk });
        }
        Ok::<(), Error>(())
    };
    for &value in &suspect.values {
        add(&mut tried, value)?;
    }
    let nearest = |a: &Value, b: &Value| {
        let nearer = || suspect.far(a.value).total_cmp(&suspect.far(b.value));
        a.left.total_cmp(&b.left).then_with(nearer)
    };
    let best = |tried: &[Value]| (0..tried.len()).min_by(|&a, &b| nearest(&tried[a], &tried[b]));
    for _ in 0..HALVINGS {
        let Some(place) = best(&tried) else { return Ok(None) };
        if tried[place].left <= scatter {
            break;
        }
        let value = tried[place].value;
        let neighbours = [place.checked_sub(1), place.checked_add(1)];
        let beside: Vec<f64> =
            neighbours.iter().flatten().filter_map(|&n| tried.get(n)).map(|t| t.value).collect();
        for other in beside {
            add(&mut tried, (value * other).sqrt())?;
        }
    }
    for _ in 0..HALVINGS {
        let Some(place) = best(&tried) else { return Ok(None) };
        let [low, high] = explaining(&tried, place, scatter);
        let between = |inside: usize, outside: Option<usize>| {
            let other = outside.and_then(|place| tried.get(place))?;
            Some((tried[inside].value * other.value).sqrt())
        };
        let ends = [between(low, low.checked_sub(1)), between(high, high.checked_add(1))];
        for value in ends.into_iter().flatten() {
            add(&mut tried, value)?;
        }
    }
    let Some(place) = best(&tried) else { return Ok(None) };
    let [low, high] = explaining(&tried, place, scatter);
    let range = [tried[low].value, tried[high].value];
    let at_edge = low == 0 || high + 1 == tried.len();
    let middle = (range[0] * range[1]).sqrt();
    let from_middle = |value: &Value| (value.value / middle).ln().abs();
    let in_range = tried.drain(low..=high);
    let middle = in_range.min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)));
    Ok(middle.map(|Value { value, left, walk }| Tried {
        suspect,
        value,
        range,
        at_edge,
        left,
        predicted: walk,
    }))
}

/// The indices of the first and the last value around the best value that explain as much as the best value does. With
/// each of these values, the remaining distance is minimal or at most the scatter.
fn explaining(tried: &[Value], best: usize, scatter: f64) -> [usize; 2] {
    let least = tried[best].left.max(scatter);
    let good = |place: &usize| tried[*place].left <= least;
    let low = (0..=best).rev().take_while(good).last().unwrap_or(best);
    let high = (best..tried.len()).take_while(good).last().unwrap_or(best);
    [low, high]
}

#[cfg(test)]
mod tests;
