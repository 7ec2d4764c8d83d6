//! Recommends the cutoff with the largest area of [quiet](Criterion::Quiet) walls.
//!
//! First a list of cutoffs is walked. Then cutoffs between the best cutoff and its neighbours are walked, until the
//! neighbours are within 10 %. If the best cutoff is at an end of the list, cutoffs beyond this end are added. The
//! first walks use the scene's grid. If the steps of this grid are too coarse or too fine for the quiet walls, the
//! first walks give a new grid.

use rayon::prelude::*;
use zwidth::{VelocitySettings, experiment::Verdict, velocity::EstimatorName};

use super::{
    How,
    asked::prepare,
    boundary::BoundaryPoint,
    limits_asked::on_grid,
    probability::held,
    sweep::{CutoffResult, Plan, ascending, filters, sweep},
};
use crate::{
    error::Error,
    interrupt,
    notation::rounded,
    scene::{Criterion, NamedScene, Protocol, RmsOf, Scene, Walk, element::Friction},
    simulation::prepared::{HitError, PreparedScene, WallHit},
};

/// Smallest area that counts as equally good, as a share of the largest area.
pub const AS_GOOD: f64 = 0.97;
/// Largest ratio of the best cutoff to its neighbours at which the search ends.
const NEAR: f64 = 1.1;
/// Factor between two successive new cutoffs beyond the ends of a list.
const BEYOND: f64 = 1.25;
/// Largest number of times that cutoffs are added to the list.
const TRIES: usize = 12;
/// Smallest and largest number of steps that a boundary should have. The first pair is for K up to its peak, the second
/// is for B.
const STEPS: [[f64; 2]; 2] = [[24.0, 400.0], [16.0, 240.0]];
/// Largest number of times that the grid is changed.
const GRIDS: usize = 8;
/// Wanted number of steps of K and of B in a boundary, when a new grid is made.
const AIM: [f64; 2] = [48.0, 32.0];
/// Largest factor by which the next grid is finer. A boundary with few steps gives little information about its size.
const FINER: f64 = 8.0;
/// Number of values of K and of B of the single walls that are tried if a grid has no stable wall. The first values are
/// the largest that the walk allows.
const TRIED: [u32; 2] = [17, 13];
/// Ratio of a tried value of K or B to the value before it, see [`TRIED`].
const APART: f64 = 0.562;
/// If a neighbour of the best cutoff has less than the share `BROKEN` of the best area, the walk of this neighbour has
/// ended too early.
const BROKEN: f64 = 0.5;
/// Largest number of times that a grid begins at another wall, because a walk has ended too early.
const SEEDS: usize = 3;
/// Smallest area of a cutoff that is examined, as a share of the best area.
const PROMISING: f64 = 0.3;

/// All walks of a search for the recommended cutoff, with the result of the search.
#[derive(Clone, Debug)]
pub struct QuietStudy {
    pub walk: Walk,
    /// The results of the cutoffs in ascending order. Each cutoff has one walk for all pushes.
    pub cutoffs: Vec<CutoffResult>,
    /// The recommended cutoff, or the reason why no cutoff is recommended.
    pub recommended: Result<Recommended, String>,
    /// Free motion at the recommended cutoff, with the stiffest quiet wall set. `None` if no cutoff is recommended.
    pub free: Option<FreeMotion>,
    /// The stiffest quiet wall by each protocol. The scene's own protocol is left out.
    pub protocols: Vec<Held>,
}

/// The stiffest wall that is quiet by another protocol.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    pub protocol: Protocol,
    /// K of the stiffest quiet wall, in N/m. Its B is that of the given wall. Softer and softer walls are tried until
    /// one wall is quiet. The result is `Ok(None)` if no wall is quiet. It is `Err` with the reason if no wall can be
    /// tried.
    pub stiffest: Result<Option<f64>, String>,
}

impl Held {
    pub fn stiffness_n_per_m(&self) -> Option<f64> {
        self.stiffest.clone().ok().flatten()
    }
}

/// K of a tried wall divided by the K of the wall before.
const SOFTER: f64 = 0.9;
/// Largest number of walls that are tried.
const SOFTER_TRIES: i32 = 30;

impl Held {
    /// Tries the wall with every protocol except the scene's own protocol.
    fn each(how: How<'_>, scene: &Scene, wall: &WallHit) -> Result<Vec<Self>, Error> {
        let others = Protocol::ALL.into_par_iter().filter(|of| *of != scene.wall_hit.protocol);
        let held = |protocol| {
            let mut scene = scene.clone();
            scene.wall_hit.protocol = protocol;
            let prepared = match PreparedScene::new(&scene) {
                Ok(prepared) => prepared,
                Err(why) => return Ok(Self { protocol, stiffest: Err(why.to_string()) }),
            };
            for softer in 0..SOFTER_TRIES {
                interrupt::unless(how.stop)?;
                let stiffness_n_per_m = wall.stiffness_n_per_m * SOFTER.powi(softer);
                let softer = WallHit { stiffness_n_per_m, ..*wall };
                let verdict = match prepared.verdict(how.numeric, &softer) {
                    Err(HitError::OutOfRange(_)) => Verdict::Unstable,
                    verdict => verdict?,
                };
                if verdict == Verdict::Stable {
                    return Ok(Self { protocol, stiffest: Ok(Some(stiffness_n_per_m)) });
                }
            }
            Ok(Self { protocol, stiffest: Ok(None) })
        };
        let held: Vec<Result<Self, Error>> = others.map(held).collect();
        held.into_iter().collect()
    }
}

impl QuietStudy {
    pub fn cutoff_hz(&self) -> Option<f64> {
        self.recommended.as_ref().ok().map(|found| found.cutoff_hz)
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recommended {
    /// Nominal cutoff of the filter, in Hz.
    pub cutoff_hz: f64,
    /// Lowest and highest cutoff of the range around this cutoff, in Hz. All cutoffs in the range have at least
    /// [`AS_GOOD`] times the area at this cutoff.
    pub range_hz: [f64; 2],
    /// Whether the range reaches the first cutoff that was tried, and whether it reaches the last one.
    pub is_open: [bool; 2],
    /// The stiffest quiet wall.
    pub stiffest: BoundaryPoint,
    /// Largest B of a quiet wall, in N s/m.
    pub damping_max_n_s_per_m: f64,
    /// Area of the quiet walls, in N^2 s/m^2.
    pub area: f64,
    /// Whether a cap of the walk cuts off a part of the area.
    pub is_cut: bool,
}

/// What the hand feels in free motion. It is the lower end of the Z-width.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct FreeMotion {
    /// Mass of device and handle, in kg.
    pub mass_kg: f64,
    pub damping_n_s_per_m: f64,
    /// Dry friction while the handle slides, in N.
    pub friction_n: f64,
    /// RMS of the output around its mean, in N. The handle rests far from the wall.
    pub hum_n: f64,
}

impl FreeMotion {
    /// Measures the free motion in a scene with this wall. The handle rests far from the wall.
    ///
    /// # Errors
    /// The handle leaves the core's range without a push.
    fn of(how: How<'_>, scene: &Scene, wall: &WallHit) -> Result<Self, Error> {
        let mut free = scene.clone();
        free.wall_hit.judge(Criterion::Rms, None);
        free.wall_hit.push_n = 0.0;
        let report = PreparedScene::new(&free)?.report(how.numeric, wall)?;
        let sliding = |friction: Friction| friction.coulomb_n;
        Ok(Self {
            mass_kg: scene.device.mass_kg + scene.mode.map_or(0.0, |mode| mode.mass_kg),
            damping_n_s_per_m: scene.device.damping_n_s_per_m,
            friction_n: scene.friction.map_or(0.0, sliding),
            hum_n: report.force_rms_n,
        })
    }
}

/// Finds the recommended cutoff, beginning with a list. If `goes_on` is true, the search continues beyond the ends of
/// the list. Calls `done` after each walk, with the number of walks that are planned so far. The search plans more
/// walks when it sees the first results.
///
/// # Errors
/// `stop` was set, or an unexpected error.
pub fn recommended(
    how: How<'_>,
    scene: &NamedScene,
    cutoffs_hz: &[f64],
    goes_on: bool,
    done: impl Fn(u64) + Sync,
) -> Result<QuietStudy, Error> {
    let mut study = Search::new(how, quiet(scene), done);
    let recommended = match study.run(&ascending(cutoffs_hz), goes_on) {
        Err(Error::Input(why)) => Err(why),
        found => found?.ok_or_else(|| "no quiet wall at any cutoff".to_owned()),
    };
    let hit = |found: &Recommended| found.stiffest.hit(scene.scene.velocity.at(found.cutoff_hz));
    let stiffest = recommended.as_ref().ok().map(hit);
    let free = stiffest.as_ref().map(|wall| FreeMotion::of(how, &scene.scene, wall)).transpose()?;
    let protocols =
        stiffest.as_ref().map(|wall| Held::each(how, &study.scene.scene, wall)).transpose()?;
    Ok(QuietStudy {
        walk: study.scene.scene.walk,
        cutoffs: study.cutoffs,
        recommended,
        free,
        protocols: protocols.unwrap_or_default(),
    })
}

/// A scene whose criterion ranks estimators, filters and changes of the device.
#[derive(Clone, Debug)]
pub struct Ranked {
    pub scene: NamedScene,
    /// The unchanged scene, for comparison. It is `None` unless the ranking is by [`Quiet`](Criterion::Quiet) and the
    /// scene has another criterion.
    pub beside: Option<Scene>,
}

/// Prepares a scene for a ranking by a criterion. For [`Quiet`](Criterion::Quiet) the grid suits the quiet walls of
/// finite difference and Butterworth at the cutoffs of `[sweep]`. For other criteria the scene's own grid is used.
///
/// # Errors
/// There is no quiet wall, the scene does not allow the criterion, or `stop` was set.
pub fn ranked(
    how: How<'_>,
    scene: &NamedScene,
    by: Criterion,
    rms_of: Option<RmsOf>,
) -> Result<Ranked, Error> {
    let mut ranked = scene.clone();
    ranked.scene.wall_hit.judge(by, rms_of);
    ranked.scene.check().map_err(Error::Input)?;
    if by != Criterion::Quiet {
        return Ok(Ranked { scene: ranked, beside: None });
    }
    let mut butterworth = ranked.clone();
    butterworth.scene.velocity = EstimatorName::Butterworth.defaults().into();
    let mut search = Search::new(how, butterworth, |_| ());
    let mut cutoffs_hz = ascending(&scene.scene.sweep.cutoffs_hz);
    cutoffs_hz.retain(|hz| search.is_allowed(*hz));
    search.walk(&cutoffs_hz)?;
    search.fit_grid(&cutoffs_hz)?;
    if search.best().is_none() {
        let why = "no quiet wall at any cutoff of [sweep]; --criterion rms ranks by the paper's criterion";
        return Err(Error::input(why));
    }
    ranked.scene.walk = search.scene.scene.walk;
    let other = scene.scene.wall_hit.criterion != Criterion::Quiet;
    let beside = other.then(|| scene.scene.clone());
    Ok(Ranked { scene: ranked, beside })
}

/// The scene with the criterion for quiet walls.
fn quiet(scene: &NamedScene) -> NamedScene {
    let mut scene = scene.clone();
    scene.scene.wall_hit.judge(Criterion::Quiet, None);
    scene
}

struct Search<'a, D> {
    how: How<'a>,
    scene: NamedScene,
    done: D,
    cutoffs: Vec<CutoffResult>,
    /// Number of walks that are planned so far.
    planned: u64,
    /// Whether the grid begins at a wall of [`Self::first_walls`].
    is_seeded: bool,
}

impl<'a, D: Fn(u64) + Sync> Search<'a, D> {
    fn new(how: How<'a>, scene: NamedScene, done: D) -> Self {
        Self { how, scene, done, cutoffs: vec![], planned: 0, is_seeded: false }
    }

    fn run(&mut self, cutoffs_hz: &[f64], goes_on: bool) -> Result<Option<Recommended>, Error> {
        self.walk(cutoffs_hz)?;
        self.fit_grid(cutoffs_hz)?;
        let mut anew = 0..SEEDS;
        for _ in 0..TRIES {
            let looks_anew = self.breaks_off() && anew.next().is_some();
            if looks_anew {
                let tried: Vec<f64> = self.cutoffs.iter().map(|result| result.cutoff_hz).collect();
                if self.seed(&tried)? {
                    self.walk_anew(&tried)?;
                    self.fit_grid(&tried)?;
                }
            }
            let more = self.more(goes_on);
            if !more.is_empty() {
                self.walk(&more)?;
            } else if !looks_anew {
                break;
            }
        }
        Ok(self.best().map(|best| self.of(best)))
    }

    fn walk(&mut self, cutoffs_hz: &[f64]) -> Result<(), Error> {
        let How { engine, numeric, stop } = self.how;
        let prepared = prepare(&self.scene)?;
        let filters = filters(&self.scene.scene.velocity, cutoffs_hz);
        let plan = Plan { name: &self.scene.name, prepared: &prepared, filters: &filters };
        self.planned += filters.len() as u64;
        let (done, planned) = (&self.done, self.planned);
        let results = sweep(engine, &[plan], numeric, 1, stop, |_| done(planned))?;
        self.cutoffs.extend(results.into_iter().flat_map(|result| result.cutoffs));
        self.cutoffs.sort_by(|a, b| a.cutoff_hz.total_cmp(&b.cutoff_hz));
        Ok(())
    }

    /// Walks again with other grids until the grid is fine enough and not too fine for the walls.
    fn fit_grid(&mut self, cutoffs_hz: &[f64]) -> Result<(), Error> {
        for _ in 0..GRIDS {
            let walk = self.scene.scene.walk;
            let steps = [walk.stiffness_step_n_per_m, walk.damping_step_n_s_per_m];
            let largest = self.best().map(|best| {
                let found = &self.cutoffs[best].boundaries;
                [found.stiffness_peak_n_per_m(), found.damping_max_n_s_per_m()]
            });
            match largest {
                Some(most) => {
                    let suits = |axis: usize| {
                        let [least, most_steps] = STEPS[axis];
                        (least..=most_steps).contains(&(most[axis] / steps[axis]))
                    };
                    if suits(0) && suits(1) {
                        return Ok(());
                    }
                    let steps = [0, 1].map(|axis| {
                        let finest = steps[axis] / FINER;
                        if suits(axis) {
                            steps[axis]
                        } else {
                            round((most[axis] / AIM[axis]).max(finest))
                        }
                    });
                    let starts = [walk.stiffness_start_n_per_m, walk.damping_start_n_s_per_m];
                    let starts = if self.is_seeded { starts } else { steps };
                    self.scene.scene.walk = on_grid(&walk, starts, steps);
                }
                None if !self.is_seeded && self.seed(cutoffs_hz)? => {}
                None => return Ok(()),
            }
            self.walk_anew(cutoffs_hz)?;
        }
        Ok(())
    }

    fn walk_anew(&mut self, cutoffs_hz: &[f64]) -> Result<(), Error> {
        self.cutoffs.clear();
        self.walk(cutoffs_hz)
    }

    /// Whether a cutoff near the best cutoff has much less area. A change of the cutoff by a quarter normally changes
    /// the area little. So the walk of the cutoff with the small area has ended too early, at a soft wall at which the
    /// handle does not come to rest in time.
    fn breaks_off(&self) -> bool {
        let Some(best) = self.best().map(|best| &self.cutoffs[best]) else { return false };
        self.cutoffs.iter().any(|other| {
            let apart = other.cutoff_hz / best.cutoff_hz;
            (1.0 / BEYOND..=BEYOND).contains(&apart)
                && other.boundaries.area() < BROKEN * best.boundaries.area()
        })
    }

    /// Sets a grid that begins at a wall of [`Self::first_walls`]. Returns whether [`Self::first_walls`] has found a
    /// wall.
    fn seed(&mut self, cutoffs_hz: &[f64]) -> Result<bool, Error> {
        let Some(walk) = self.first_walls(cutoffs_hz)? else { return Ok(false) };
        self.scene.scene.walk = walk;
        self.is_seeded = true;
        Ok(true)
    }

    /// Makes a grid that begins at a single wall. Several walls are tried. The grid begins at one that is quiet at the
    /// most promising cutoffs. `None` if none is quiet.
    fn first_walls(&self, cutoffs_hz: &[f64]) -> Result<Option<Walk>, Error> {
        let (prepared, scene) = (prepare(&self.scene)?, &self.scene.scene);
        let caps = scene.walk_plan();
        let axis = |most: f64, number: u32| -> Vec<f64> {
            (0..number).map(|n| rounded(most * APART.powf(f64::from(n)), 2)).collect()
        };
        let stiffnesses = axis(caps.stiffness_max_n_per_m, TRIED[0]);
        let dampings = axis(caps.damping_max_n_s_per_m, TRIED[1]);
        let walls: Vec<[f64; 2]> = dampings
            .iter()
            .rev()
            .flat_map(|b| stiffnesses.iter().rev().map(|k| [*k, *b]))
            .collect();
        let hits = |velocity: VelocitySettings| {
            let hit = |&[stiffness_n_per_m, damping_n_s_per_m]: &[f64; 2]| {
                BoundaryPoint { stiffness_n_per_m, damping_n_s_per_m }.hit(velocity)
            };
            (&prepared, walls.iter().map(hit).collect())
        };
        let filters = filters(&scene.velocity, cutoffs_hz).into_iter();
        let mut quiet = held(self.how, &filters.map(hits).collect::<Vec<_>>())?;
        let area = |held: &Vec<bool>| -> f64 {
            walls.iter().zip(held).filter(|(_, held)| **held).map(|([k, b], _)| k * b).sum()
        };
        let most = quiet.iter().map(area).fold(0.0, f64::max);
        if most == 0.0 {
            return Ok(None);
        }
        quiet.retain(|held| area(held) >= PROMISING * most);
        let holding = |place: usize| quiet.iter().filter(|held| held[place]).count();
        let all = (0..walls.len()).map(holding).max().unwrap_or(0);
        let first = (0..walls.len()).find(|place| holding(*place) == all);
        let largest = |axis: usize| {
            let held = (0..walls.len()).filter(|place| holding(*place) > 0);
            held.map(|place| walls[place][axis]).fold(0.0, f64::max)
        };
        let steps = [0, 1].map(|axis| round(largest(axis) / AIM[axis]));
        Ok(first.map(|place| on_grid(&scene.walk, walls[place], steps)))
    }

    /// Index of the cutoff with the largest area.
    fn best(&self) -> Option<usize> {
        let area = |place: &usize| self.cutoffs[*place].boundaries.area();
        (0..self.cutoffs.len())
            .max_by(|a, b| area(a).total_cmp(&area(b)))
            .filter(|at| area(at) > 0.0)
    }

    /// Further cutoffs to try. They lie between the best cutoff and its neighbours, or beyond the list.
    fn more(&self, goes_on: bool) -> Vec<f64> {
        let Some(best) = self.best() else { return vec![] };
        let hz = |place: usize| self.cutoffs.get(place).map(|result| result.cutoff_hz);
        let Some(best_hz) = hz(best) else { return vec![] };
        let mut more = vec![];
        for (neighbour, beyond_hz) in
            [(best.checked_sub(1), best_hz / BEYOND), (Some(best + 1), best_hz * BEYOND)]
        {
            match neighbour.and_then(hz) {
                Some(other_hz) => more.extend(between(best_hz, other_hz)),
                None if goes_on && self.is_allowed(beyond_hz) => more.push(tidy(beyond_hz)),
                None => {}
            }
        }
        more
    }

    fn is_allowed(&self, cutoff_hz: f64) -> bool {
        let Scene { velocity, .. } = &self.scene.scene;
        let settings = self.scene.scene.settings(velocity.at(cutoff_hz), 0.0, 0.0);
        settings.build(&self.scene.scene.design()).is_ok()
    }

    fn of(&self, best: usize) -> Recommended {
        let area = |result: &CutoffResult| result.boundaries.area();
        let enough = AS_GOOD * area(&self.cutoffs[best]);
        let good = |result: &&CutoffResult| area(result) >= enough;
        let below = self.cutoffs[..best].iter().rev().take_while(good).count();
        let above = self.cutoffs[best..].iter().take_while(good).count();
        let (first, last) = (best - below, best + above - 1);
        let boundaries = &self.cutoffs[best].boundaries;
        let stiffer = |a: BoundaryPoint, b: BoundaryPoint| {
            if b.stiffness_n_per_m > a.stiffness_n_per_m { b } else { a }
        };
        let points = boundaries.iter().flat_map(|boundary| &boundary.points).copied();
        let nothing = BoundaryPoint { damping_n_s_per_m: 0.0, stiffness_n_per_m: 0.0 };
        Recommended {
            cutoff_hz: self.cutoffs[best].cutoff_hz,
            range_hz: [self.cutoffs[first].cutoff_hz, self.cutoffs[last].cutoff_hz],
            is_open: [first == 0, last + 1 == self.cutoffs.len()],
            stiffest: points.fold(nothing, stiffer),
            damping_max_n_s_per_m: boundaries.damping_max_n_s_per_m(),
            area: boundaries.area(),
            is_cut: boundaries.capped() > 0,
        }
    }
}

/// A cutoff in the middle of two others; `None` if their ratio is within [`NEAR`].
fn between(one_hz: f64, other_hz: f64) -> Option<f64> {
    let (low, high) = (one_hz.min(other_hz), one_hz.max(other_hz));
    let half = tidy(libm::sqrt(low * high));
    (high / low > NEAR && half > low && half < high).then_some(half)
}

/// The cutoff rounded to two digits.
fn tidy(hz: f64) -> f64 {
    rounded(hz, 2)
}

/// Rounds to 1, 2 or 5 times a power of ten, whichever is nearest.
fn round(step: f64) -> f64 {
    let power = libm::pow(10.0, libm::floor(libm::log10(step)));
    let whole = step / power;
    let digits = [(1.5, 1.0), (3.5, 2.0), (7.5, 5.0)];
    let digit = digits.iter().find(|(below, _)| whole < *below);
    digit.map_or(10.0, |(_, digit)| *digit) * power
}
