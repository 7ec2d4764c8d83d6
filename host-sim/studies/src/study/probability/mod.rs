//! Probability that a wall is stable, for many starts and random devices. A draw is a random device with a start.
//!
//! A walk finds one boundary from one start. Near the boundary the verdict depends on the start, by a part of a count.
//! The verdict also depends on device parameters that are not known exactly. So the same draws hit every cell of a grid
//! of K and B ([`Map`]). The stable share of the draws is the wall's probability. The integral of this probability over
//! K and B is an area in which each wall has its probability as weight. The area of a draw is the area of its stable
//! cells. So the draws also give the spread of the area and of the ideal cutoff.
//!
//! **Intervals of quantiles.** Drawn devices are independent. The starts of one device are spread evenly, so they are
//! no random sample. So quantiles over the starts of the scene's own device have no interval. For drawn devices, order
//! statistics give the interval of a quantile ([`ranks`]). With fewer than [`DRAWS_MIN`] devices, the 5 % quantile has
//! no lower confidence limit. A bootstrap tests the best cutoff in the worst draws: devices are drawn again from the
//! drawn devices. If another cutoff leads in too many of these samples, this cutoff cannot be distinguished from the
//! best cutoff.
//!
//! The contour of 95 % ([`contour`]) shows the walls that a firmware may render. This contour is fitted with fresh
//! draws, and tested with further draws.

pub mod contour;

use std::collections::BTreeMap;

use rayon::prelude::*;
use statrs::distribution::{Binomial, DiscreteCDF as _};
use zwidth::{VelocitySettings, experiment::Verdict};

use super::{
    How,
    sweep::{CutoffResult, SweepResult},
};
use crate::{
    engine::{Depth, Outcome},
    error::Error,
    interrupt,
    numerics::{random, statistics::AS_GOOD_AS_BEST, whole},
    scene::Scene,
    simulation::prepared::{HitError, PreparedScene, WallHit},
};

/// Number of cells of a map in each direction, from 0 to the largest value that the walks reach.
const CELLS: u32 = 40;
/// First extent of a map, as a multiple of the largest value that the walks reach.
const BEYOND: f64 = 1.1;
/// Number of rows or columns that are added if walls at the edge of the map are still stable.
const MORE: u32 = 8;
/// Seeds of the random numbers: for devices, for starts, and for the bootstrap.
const DEVICES: u64 = 0x5eed_0001;
const STARTS: u64 = 0x5eed_0002;
const AGAIN: u64 = 0x5eed_0003;
/// Share of the draws, the worst ones, on which a recommendation is based.
pub const WORST: f64 = 0.05;
/// Smallest number of devices for which the 5 % quantile ([`WORST`]) of the areas has a lower confidence limit.
pub const DRAWS_MIN: u32 = 72;
/// Probability, on each side, that a value is outside of its interval. It is also the share of the bootstrap samples in
/// which a cutoff must lead to count as equal to the best cutoff.
const MISS: f64 = 0.025;
/// Number of bootstrap samples.
const TIMES: u64 = 1000;

/// The devices and the starts of all draws.
#[derive(Clone, Debug)]
pub struct Draws {
    scene: Scene,
    /// Number of random devices; 0 if the scene's own device is used.
    devices: u32,
    /// Number of starts of each device.
    starts: u32,
}

/// A device, and the starts of its hits in counts.
#[derive(Clone, Debug)]
pub struct Drawn {
    prepared: PreparedScene,
    starts: Vec<f64>,
}

impl Draws {
    /// Draws for `devices` random devices, each with `starts` starts. If `devices` is 0, the scene's own device is
    /// used.
    ///
    /// # Errors
    /// Devices are requested, but the scene has no `[uncertainty]`.
    pub fn new(scene: &Scene, devices: u32, starts: u32) -> Result<Self, Error> {
        if devices > 0 && scene.uncertainty.is_none() {
            return Err(Error::input(
                "--uncertain needs a table [uncertainty] of standard deviations in the scene",
            ));
        }
        Ok(Self { scene: scene.clone(), devices, starts })
    }

    pub fn count(&self) -> u32 {
        self.devices.max(1) * self.starts
    }

    /// Makes all draws. The start positions of the handle are spread evenly over one encoder count. Each device shifts its
    /// own start positions.
    fn all(&self) -> Result<Vec<Drawn>, Error> {
        (0..u64::from(self.devices.max(1)))
            .into_par_iter()
            .map(|n| {
                let shift = if self.devices > 0 { random::uniform(STARTS, n) } else { 0.5 };
                let starts =
                    (0..self.starts).map(|s| (f64::from(s) + shift) / f64::from(self.starts));
                Ok(Drawn { prepared: self.device(n)?, starts: starts.collect() })
            })
            .collect()
    }

    /// Makes a fresh draw, one that [`all`](Self::all) does not make.
    fn fresh(&self, number: u64) -> Result<Drawn, Error> {
        let number = u64::from(u32::MAX) + number;
        Ok(Drawn { prepared: self.device(number)?, starts: vec![random::uniform(STARTS, number)] })
    }

    fn device(&self, number: u64) -> Result<PreparedScene, Error> {
        let scene = match self.devices {
            0 => self.scene.clone(),
            _ => self.scene.drawn(DEVICES, number).map_err(Error::Input)?,
        };
        PreparedScene::new(&scene)
    }
}

/// Hits the walls of each scene on all threads. Returns whether each wall is stable.
pub(super) fn held(
    how: How<'_>,
    tasks: &[(&PreparedScene, Vec<WallHit>)],
) -> Result<Vec<Vec<bool>>, Error> {
    let of_scene = |(prepared, hits): &(&PreparedScene, Vec<WallHit>)| {
        let mut held = Vec::with_capacity(hits.len());
        let sink = |outcome: Result<Outcome, HitError>| {
            held.push(match outcome {
                Err(HitError::OutOfRange(_)) => false,
                outcome => outcome?.verdict == Verdict::Stable,
            });
            Ok(())
        };
        how.run(prepared, Depth::Verdict, hits, sink)?;
        Ok(held)
    };
    // Of several errors, the one of the first task is reported, whichever thread finds its error first.
    let all: Vec<Result<Vec<bool>, Error>> =
        tasks.par_iter().with_max_len(1).map(of_scene).collect();
    interrupt::unless(how.stop)?;
    all.into_iter().collect()
}

/// For each wall `[K, B]`, which draws are stable there. Draws are in the order of the devices. The draws of one device
/// are in the order of its starts.
///
/// # Errors
/// A setting is out of range, or the run was interrupted.
pub fn at_walls(
    how: How<'_>,
    draws: &Draws,
    filter: VelocitySettings,
    walls: &[[f64; 2]],
) -> Result<Vec<Vec<bool>>, Error> {
    holds(how, &draws.all()?, filter, walls)
}

fn holds(
    how: How<'_>,
    drawn: &[Drawn],
    velocity: VelocitySettings,
    walls: &[[f64; 2]],
) -> Result<Vec<Vec<bool>>, Error> {
    let hits = |drawn: &Drawn| {
        let of_wall = |&[stiffness_n_per_m, damping_n_s_per_m]: &[f64; 2]| {
            drawn.starts.clone().into_iter().map(move |start_offset_counts| WallHit {
                velocity,
                stiffness_n_per_m,
                damping_n_s_per_m,
                start_offset_counts,
            })
        };
        walls.iter().flat_map(of_wall).collect::<Vec<_>>()
    };
    let tasks: Vec<(&PreparedScene, Vec<WallHit>)> =
        drawn.iter().map(|drawn| (&drawn.prepared, hits(drawn))).collect();
    let held = held(how, &tasks)?;
    let of_wall = |wall: usize| {
        let each = drawn.iter().zip(&held).flat_map(move |(drawn, held)| {
            let starts = drawn.starts.len();
            held[wall * starts..(wall + 1) * starts].iter().copied()
        });
        each.collect()
    };
    Ok((0..walls.len()).map(of_wall).collect())
}

/// The share of the draws that is stable at each K and B, for one cutoff.
#[derive(Clone, Debug)]
pub struct Map {
    /// Nominal cutoff of the filter, in Hz.
    pub cutoff_hz: f64,
    pub velocity: VelocitySettings,
    /// Size of a cell: its K in N/m and its B in N s/m. A wall is in the middle of its cell.
    pub step: [f64; 2],
    /// Number of cells along K and along B.
    pub cells: [u32; 2],
    pub trials: u32,
    /// Number of random devices. Each has the same number of consecutive draws. It is 0 if the draws are starts of the
    /// scene's own device.
    pub devices: u32,
    /// The stable area of each draw, in N^2 s/m^2.
    pub areas: Vec<f64>,
    /// Whether a cap of `[walk]` cuts off a part of the map.
    pub is_capped: bool,
    held: BTreeMap<(u32, u32), u32>,
}

impl Map {
    /// The wall `[K, B]` in the middle of a cell.
    pub fn wall(&self, [k, b]: [u32; 2]) -> [f64; 2] {
        [(f64::from(k) + 0.5) * self.step[0], (f64::from(b) + 0.5) * self.step[1]]
    }

    /// Number of draws that are stable in a cell.
    pub fn held(&self, [k, b]: [u32; 2]) -> u32 {
        self.held.get(&(k, b)).copied().unwrap_or(0)
    }

    /// Integral of the stable share over K and B, in N^2 s/m^2.
    pub fn area(&self) -> f64 {
        let held: u32 = self.held.values().sum();
        f64::from(held) / f64::from(self.trials) * self.step[0] * self.step[1]
    }

    /// Share of the cells that are undecided. Only cells in which more than one draw in twenty is stable are counted. A
    /// cell is undecided if more than one draw in twenty is unstable too.
    pub fn undecided_share(&self) -> f64 {
        let few = WORST * f64::from(self.trials);
        let (hold, fail) =
            (|held: u32| f64::from(held) > few, |held: u32| f64::from(self.trials - held) > few);
        let any = self.held.values().filter(|held| hold(**held)).count();
        let some = self.held.values().filter(|held| hold(**held) && fail(**held)).count();
        some as f64 / any.max(1) as f64
    }

    /// A quantile of the areas of the draws, in N^2 s/m^2. `share` is the share of the draws below it.
    pub fn quantile(&self, share: f64) -> f64 {
        quantile(&self.areas, share)
    }

    /// The 95 % interval of a quantile. An end is `None` if there are too few devices.
    pub fn interval(&self, share: f64) -> [Option<f64>; 2] {
        let ends = ranks(self.devices, share);
        ends.map(|end| end.map(|share| quantile(&self.areas, share)))
    }

    /// The areas that one bootstrap sample of the devices gives. `time` is the number of the sample. The same
    /// number gives the same sample in each map.
    fn again(&self, time: u64) -> Vec<f64> {
        let devices = u64::from(self.devices);
        let starts = u64::from(self.trials) / devices;
        let drawn = (0..devices).flat_map(|n| {
            let first = random::bits(AGAIN, time * devices + n) % devices * starts;
            first..first + starts
        });
        drawn.filter_map(|draw| self.areas.get(usize::try_from(draw).ok()?)).copied().collect()
    }
}

/// The 95 % interval of a quantile. Its ends are positions in the sorted draws, from 0 to 1. This interval is valid for
/// any distribution (Conover, *Practical Nonparametric Statistics*, 1999, section 3.2). An end is `None` if it has no
/// bound.
pub fn ranks(draws: u32, share: f64) -> [Option<f64>; 2] {
    let Ok(below) = Binomial::new(share, draws.into()) else { return [None; 2] };
    // Among n sorted draws, rank r has the position (r - 1) / (n - 1).
    let at = |rank: u32| (f64::from(rank) - 1.0) / (f64::from(draws) - 1.0).max(1.0);
    let low = (1..=draws).rev().find(|rank| below.cdf(u64::from(rank - 1)) <= MISS);
    let high = (1..=draws).find(|rank| below.cdf(u64::from(rank - 1)) >= 1.0 - MISS);
    [low.map(at), high.map(at)]
}

/// A quantile of the values. It is interpolated linearly between the sorted values.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let at = share * last as f64;
    let below = whole(at);
    let above = (below + 1).min(last);
    sorted[below] + (sorted[above] - sorted[below]) * at.fract()
}

/// Makes a map at each cutoff of a sweep. The walks of the sweep show how far the maps must extend. Calls `done` after
/// each map.
///
/// # Errors
/// A setting is out of range, or the run was interrupted.
pub fn maps(
    how: How<'_>,
    draws: &Draws,
    swept: &SweepResult,
    mut done: impl FnMut(),
) -> Result<Vec<Map>, Error> {
    let drawn = draws.all()?;
    let mut maps = vec![];
    for cutoff in &swept.cutoffs {
        let extent =
            [cutoff.boundaries.stiffness_peak_n_per_m(), cutoff.boundaries.damping_max_n_s_per_m()];
        maps.push(map(how, draws, &drawn, cutoff, extent)?);
        done();
    }
    Ok(maps)
}

fn map(
    how: How<'_>,
    draws: &Draws,
    drawn: &[Drawn],
    &CutoffResult { velocity, cutoff_hz, .. }: &CutoffResult,
    extent: [f64; 2],
) -> Result<Map, Error> {
    let walk = &draws.scene.walk;
    let caps = [walk.stiffness_max_n_per_m, walk.damping_max_n_s_per_m];
    // Even a boundary with one wall or none gives a map.
    let least = [walk.stiffness_step_n_per_m, walk.damping_step_n_s_per_m];
    let step = [0, 1].map(|n| BEYOND * extent[n].max(least[n]).min(caps[n]) / f64::from(CELLS));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "of some cells")]
    let most = [0, 1].map(|n| (caps[n] / step[n]).floor().clamp(1.0, 1e4) as u32);
    let trials = draws.count();
    let mut map = Map {
        cutoff_hz,
        velocity,
        step,
        cells: [0, 0],
        trials,
        devices: draws.devices,
        areas: vec![0.0; trials as usize],
        is_capped: false,
        held: BTreeMap::new(),
    };
    let mut wanted = most.map(|most| most.min(CELLS));
    loop {
        let fresh: Vec<[u32; 2]> = (0..wanted[1])
            .flat_map(|b| (0..wanted[0]).map(move |k| [k, b]))
            .filter(|[k, b]| *k >= map.cells[0] || *b >= map.cells[1])
            .collect();
        let walls: Vec<[f64; 2]> = fresh.iter().map(|&cell| map.wall(cell)).collect();
        for (cell, holds) in fresh.iter().zip(holds(how, drawn, velocity, &walls)?) {
            let mut count = 0;
            for (area, _) in map.areas.iter_mut().zip(&holds).filter(|(_, holds)| **holds) {
                *area += step[0] * step[1];
                count += 1;
            }
            map.held.insert((cell[0], cell[1]), count);
        }
        map.cells = wanted;
        let at_edge = [0, 1].map(|n| {
            let last = map.cells[n] - 1;
            map.held.iter().any(|((k, b), held)| [*k, *b][n] == last && *held > 0)
        });
        let further = [0, 1].map(|n| at_edge[n] && map.cells[n] < most[n]);
        if further == [false; 2] {
            map.is_capped = at_edge != [false; 2];
            return Ok(map);
        }
        for n in 0..2 {
            if further[n] {
                wanted[n] = (wanted[n] + MORE).min(most[n]);
            }
        }
    }
}

/// What the draws say about the cutoffs.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdicts {
    /// For each cutoff, the number of draws in which it has the largest area.
    pub best: Vec<u32>,
    /// For each cutoff, the number of draws in which it is ideal. A draw's ideal cutoff is the lowest one within 2 % of
    /// the draw's largest area.
    pub ideal: Vec<u32>,
    /// The cutoff with the largest area in the worst 5 % of the draws; `None` if no wall is stable.
    pub leading: Option<usize>,
    /// The cutoffs that the draws cannot distinguish from the leading cutoff.
    pub alike: Vec<usize>,
}

/// Compares maps that have the same draws. The cutoffs are in ascending order.
pub fn verdicts(maps: &[Map]) -> Verdicts {
    let (mut best, mut ideal) = (vec![0; maps.len()], vec![0; maps.len()]);
    let draws = maps.first().map_or(0, |map| map.areas.len());
    for draw in 0..draws {
        let area = |map: &Map| map.areas[draw];
        let largest = maps.iter().map(area).fold(0.0, f64::max);
        let first = |share: f64| {
            maps.iter().position(|map| area(map) >= share * largest).filter(|_| largest > 0.0)
        };
        for (counts, share) in [(&mut best, 1.0), (&mut ideal, AS_GOOD_AS_BEST)] {
            if let Some(place) = first(share) {
                counts[place] += 1;
            }
        }
    }
    let leading = leader(maps.iter().map(|map| map.quantile(WORST)));
    let mut leads = vec![0.0; maps.len()];
    let is_drawn = maps.first().is_some_and(|map| map.devices > 0);
    for time in (0..TIMES).filter(|_| is_drawn) {
        let areas = maps.iter().map(|map| quantile(&map.again(time), WORST));
        if let Some(place) = leader(areas) {
            leads[place] += 1.0 / TIMES as f64;
        }
    }
    let is_alike = |place: &usize| leads[*place] >= MISS || leading == Some(*place);
    let alike = (0..maps.len()).filter(is_alike).filter(|_| leading.is_some()).collect();
    Verdicts { best, ideal, leading, alike }
}

/// Index of the largest area; `None` if no area is above 0.
fn leader(areas: impl Iterator<Item = f64>) -> Option<usize> {
    let largest = areas.enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b));
    largest.filter(|(_, area)| *area > 0.0).map(|(place, _)| place)
}

#[cfg(test)]
mod tests;
