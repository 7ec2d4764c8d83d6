//! The cutoff to dial in: the one with the largest area of [quiet](Criterion::Quiet) walls.
//!
//! A list of cutoffs is walked, then what lies between the best one and its neighbours, until these are within 10 % of it;
//! where the best one is an end of the list, the list goes on beyond. The grid of the walks is the scene's, or where its
//! steps are too coarse or too fine for the quiet walls one that the first walks suggest.

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

/// Areas that are at least this share of the largest are as good.
pub const AS_GOOD: f64 = 0.97;
/// Neighbours of the best cutoff are within this ratio.
const NEAR: f64 = 1.1;
/// A list goes on in steps of this ratio, at most so many times.
const BEYOND: f64 = 1.25;
const TRIES: usize = 12;
/// Steps that a boundary should have, of K up to its peak and of B.
const STEPS: [[f64; 2]; 2] = [[24.0, 400.0], [16.0, 240.0]];
/// Grids that are tried.
const GRIDS: usize = 8;
/// What a new grid aims at.
const AIM: [f64; 2] = [48.0, 32.0];
/// A boundary of few steps says little of its size: the next grid is at most so many times finer.
const FINER: f64 = 8.0;
/// Without any wall on a grid, single walls are tried: so many of K and of B, each this part of the one before, from the
/// largest that can be quiet.
const TRIED: [u32; 2] = [17, 13];
const APART: f64 = 0.562;
/// Beside the best cutoff, a share of its area that says that a walk broke off.
const BROKEN: f64 = 0.5;
/// Then a grid begins elsewhere, so many times at most.
const SEEDS: usize = 3;
/// A cutoff is looked at if its walls have this share of the best one's area.
const PROMISING: f64 = 0.3;

/// What was tried, and what comes of it.
#[derive(Clone, Debug)]
pub struct QuietStudy {
    /// Grid of the walks.
    pub walk: Walk,
    /// Each cutoff, ascending, with one walk at all pushes.
    pub cutoffs: Vec<CutoffResult>,
    /// The cutoff to dial in, or why there is none.
    pub recommended: Result<Recommended, String>,
    /// Free motion beside the stiffest wall of that cutoff.
    pub free: Option<FreeMotion>,
    /// That wall by the protocols beside the scene's.
    pub protocols: Vec<Held>,
}

/// What is quiet by another protocol.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// How it was tried.
    pub protocol: Protocol,
    /// The stiffest wall that is, with the B of the one that was asked about, N/m: the first that is of ever softer ones,
    /// if any; or why none can be tried.
    pub stiffest: Result<Option<f64>, String>,
}

impl Held {
    /// K of that wall, N/m, if there is one.
    pub fn stiffness_n_per_m(&self) -> Option<f64> {
        self.stiffest.clone().ok().flatten()
    }
}

/// Softer walls that are tried, each this part of the one before.
const SOFTER: f64 = 0.9;
const SOFTER_TRIES: i32 = 30;

impl Held {
    /// That wall of a scene by every protocol but its own.
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
    /// The cutoff to dial in, Hz, if there is one.
    pub fn cutoff_hz(&self) -> Option<f64> {
        self.recommended.as_ref().ok().map(|found| found.cutoff_hz)
    }
}

/// A cutoff to dial in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recommended {
    /// Nominal cutoff of the filter, Hz.
    pub cutoff_hz: f64,
    /// The cutoffs beside it whose area is at least [`AS_GOOD`] of its own, Hz.
    pub range_hz: [f64; 2],
    /// The range goes on to the first or the last cutoff that was tried.
    pub is_open: [bool; 2],
    /// The stiffest quiet wall.
    pub stiffest: BoundaryPoint,
    /// Largest B of a quiet wall, N s/m.
    pub damping_max_n_s_per_m: f64,
    /// Area of the quiet walls, N^2 s/m^2.
    pub area: f64,
    /// A cap cuts that area.
    pub is_cut: bool,
}

/// What free motion feels like, the lower end of the Z-width.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct FreeMotion {
    /// Of device and handle, kg.
    pub mass_kg: f64,
    /// Viscous damping, N s/m.
    pub damping_n_s_per_m: f64,
    /// Dry friction while sliding, N.
    pub friction_n: f64,
    /// RMS of the output about its mean while the handle rests where no wall is, N.
    pub hum_n: f64,
}

impl FreeMotion {
    /// Of a scene that would render that wall.
    ///
    /// # Errors
    /// The handle leaves the range of the core without a push.
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

/// Looks for the cutoff to dial in among those of a list; `goes_on`: and beyond its ends. `done` is called after each
/// walk.
///
/// # Errors
/// `stop` was set, or something failed that no scene should make fail.
pub fn recommended(
    how: How<'_>,
    scene: &NamedScene,
    cutoffs_hz: &[f64],
    goes_on: bool,
    done: impl Fn() + Sync,
) -> Result<QuietStudy, Error> {
    let mut study = Search { how, scene: quiet(scene), done, cutoffs: vec![], is_seeded: false };
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

/// A scene as its estimators, filters and changes are ranked.
#[derive(Clone, Debug)]
pub struct Ranked {
    /// The scene that is walked.
    pub scene: NamedScene,
    /// The scene with its own criterion and grid, which stands beside; `None` where that is no other.
    pub beside: Option<Scene>,
}

/// Ranked by a criterion. [`Quiet`](Criterion::Quiet): on a grid that suits these walls, that of finite difference and
/// Butterworth at the cutoffs of `[sweep]`; another one on the scene's.
///
/// # Errors
/// There is no quiet wall, the scene cannot have the criterion, or `stop` was set.
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
    let mut search =
        Search { how, scene: butterworth, done: || (), cutoffs: vec![], is_seeded: false };
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

/// The scene, judged by what a person would call a wall.
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
    /// The grid begins at a wall of [`Self::first_walls`].
    is_seeded: bool,
}

impl<D: Fn() + Sync> Search<'_, D> {
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

    /// Walks those cutoffs as well.
    fn walk(&mut self, cutoffs_hz: &[f64]) -> Result<(), Error> {
        let How { engine, numeric, stop } = self.how;
        let prepared = prepare(&self.scene)?;
        let filters = filters(&self.scene.scene.velocity, cutoffs_hz);
        let plan = Plan { name: &self.scene.name, prepared: &prepared, filters: &filters };
        let done = &self.done;
        let results = sweep(engine, &[plan], numeric, 1, stop, |_| done())?;
        self.cutoffs.extend(results.into_iter().flat_map(|result| result.cutoffs));
        self.cutoffs.sort_by(|a, b| a.cutoff_hz.total_cmp(&b.cutoff_hz));
        Ok(())
    }

    /// Walks anew where the grid does not suit the walls.
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

    /// A cutoff next to the best one has almost no walls. An area changes little over a quarter of the frequency: a walk
    /// broke off there, at a soft wall that does not come to rest in time.
    fn breaks_off(&self) -> bool {
        let Some(best) = self.best().map(|best| &self.cutoffs[best]) else { return false };
        self.cutoffs.iter().any(|other| {
            let apart = other.cutoff_hz / best.cutoff_hz;
            (1.0 / BEYOND..=BEYOND).contains(&apart)
                && other.boundaries.area() < BROKEN * best.boundaries.area()
        })
    }

    /// Has the grid begin at a wall of [`Self::first_walls`]; whether there is one.
    fn seed(&mut self, cutoffs_hz: &[f64]) -> Result<bool, Error> {
        let Some(walk) = self.first_walls(cutoffs_hz)? else { return Ok(false) };
        self.scene.scene.walk = walk;
        self.is_seeded = true;
        Ok(true)
    }

    /// A grid that begins at a wall that is quiet at most cutoffs that promise something, found among single walls.
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

    /// The place of the largest area.
    fn best(&self) -> Option<usize> {
        let area = |place: &usize| self.cutoffs[*place].boundaries.area();
        (0..self.cutoffs.len())
            .max_by(|a, b| area(a).total_cmp(&area(b)))
            .filter(|at| area(at) > 0.0)
    }

    /// The cutoffs that are still to be tried beside the best one.
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

/// The cutoff halfway between two that are not [`NEAR`] each other.
fn between(one_hz: f64, other_hz: f64) -> Option<f64> {
    let (low, high) = (one_hz.min(other_hz), one_hz.max(other_hz));
    let half = tidy(libm::sqrt(low * high));
    (high / low > NEAR && half > low && half < high).then_some(half)
}

/// A cutoff that a person would type.
fn tidy(hz: f64) -> f64 {
    rounded(hz, 2)
}

/// The nearest of 1, 2 and 5 times a power of ten.
fn round(step: f64) -> f64 {
    let power = libm::pow(10.0, libm::floor(libm::log10(step)));
    let whole = step / power;
    let digits = [(1.5, 1.0), (3.5, 2.0), (7.5, 5.0)];
    let digit = digits.iter().find(|(below, _)| whole < *below);
    digit.map_or(10.0, |(_, digit)| *digit) * power
}
