//! Computes areas and ideal cutoffs for several limits of a stable wall. A limit is for the RMS or for the sensation
//! level. Areas and cutoffs are computed for each push and hand, and also with the true velocity.
//!
//! All walks of a scene at one cutoff and start share their hits, because the result of a hit serves every limit. A hit
//! ends early if it is certainly beyond the largest limit.

use std::{
    collections::HashMap,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
};

use zwidth::{VelocitySettings, experiment::Verdict};

use super::{
    How,
    boundary::{Boundaries, Boundary, Progress},
    sweep::{CutoffResult, SweepResult, start_offset_counts},
    walk_lanes::on_all_threads,
};
use crate::{
    engine::{Depth, Outcome, Work, run},
    error::Error,
    interrupt,
    scene::{self, Criterion, PushBy, RmsOf, Scene, Walk},
    simulation::prepared::{HitError, PreparedScene, WallHit},
};

/// A limit that decides about stability. A wall is stable if it stays below the limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// Limit of the RMS, in m.
    Rms(f64),
    /// Limit of the sensation level, in dB.
    Felt(f64),
    /// Limit of the force's RMS, in N. All other conditions of a [quiet](Criterion::Quiet) wall must hold too.
    Quiet(f64),
}

impl Limit {
    /// Whether both limits are of the same kind. If so, hits for the larger limit also serve the smaller limit.
    fn is_like(self, other: Self) -> bool {
        std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }

    pub fn set(self, hit: &mut scene::WallHit) {
        match self {
            Self::Rms(limit_m) => hit.rms_limit_m = limit_m,
            Self::Felt(limit_db) => {
                hit.criterion = Criterion::Felt;
                hit.felt_limit_db = limit_db;
            }
            Self::Quiet(limit_n) => {
                hit.criterion = Criterion::Quiet;
                hit.force_rms_limit_n = Some(limit_n);
            }
        }
    }

    fn value(self) -> f64 {
        self.told().0
    }

    pub fn told(self) -> (f64, &'static str) {
        match self {
            Self::Rms(metres) => (metres, "m"),
            Self::Felt(db) => (db, "dB"),
            Self::Quiet(newtons) => (newtons, "N"),
        }
    }
}

#[derive(Clone, Debug)]
pub struct Question {
    /// The limits, in any order.
    pub limits: Vec<Limit>,
    /// The signal whose RMS is limited.
    pub rms_of: RmsOf,
    /// Velocity filters, in ascending order of their cutoff.
    pub filters: Vec<VelocitySettings>,
    pub repeats: u32,
    pub walk: Walk,
    /// Combinations of a push and a hand. `None` for a hand means the scene's own hand.
    pub situations: Vec<Situation>,
    /// Whether the true velocity is walked too.
    pub told: bool,
}

impl Question {
    pub fn walks(&self) -> usize {
        let rows = self.filters.len() + usize::from(self.told);
        self.situations.len() * self.limits.len() * rows * self.repeats as usize
    }
}

/// A push and a hand.
#[derive(Clone, Debug, PartialEq)]
pub struct Situation {
    pub push: PushBy,
    /// Name of an arm in [`Scene::arms`]; `None` for the scene's own arm.
    pub arm: Option<String>,
}

#[derive(Clone, Debug)]
pub struct LimitResult {
    /// The push and the hand; `None` for the worst of all situations.
    pub situation: Option<Situation>,
    pub limit: Limit,
    /// Areas of all cutoffs, and the ideal cutoff with its range.
    pub result: SweepResult,
    /// Boundaries with the true velocity; empty if they were not requested.
    pub told: Boundaries,
}

impl LimitResult {
    /// Mean area with the true velocity, in N^2 s/m^2.
    pub fn told_area(&self) -> Option<f64> {
        (!self.told.is_empty()).then(|| self.told.area())
    }

    /// Mean area at the ideal cutoff, in N^2 s/m^2.
    pub fn area(&self) -> f64 {
        let ideal = self.result.ideal.map(|ideal| ideal.cutoff_hz);
        let mut cutoffs = self.result.cutoffs.iter();
        let ideal = cutoffs.find(|result| Some(result.cutoff_hz) == ideal);
        ideal.map_or(0.0, |result| result.boundaries.area())
    }
}

/// What is known about a hit. `INFINITY` means that the value is beyond the largest limit.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    no_contact: bool,
    rms_m: Option<f64>,
    level_db: Option<f64>,
    /// Whether the wall is quiet. A question has at most one limit for quiet walls.
    quiet: Option<Verdict>,
}

impl Known {
    fn verdict(&self, limit: Limit) -> Option<Verdict> {
        let value = match limit {
            Limit::Felt(_) => self.level_db,
            Limit::Rms(_) => self.rms_m,
            Limit::Quiet(_) => return self.quiet,
        };
        let stable = value? < limit.value();
        Some(match (self.no_contact, stable) {
            (true, _) => Verdict::NoContact,
            (false, true) => Verdict::Stable,
            (false, false) => Verdict::Unstable,
        })
    }
}

/// What is known about the hits of one scene, cutoff and start. The key is the cell of the hit.
type Shared = Mutex<HashMap<(i32, i32), Known>>;

/// The walks of one prepared scene, for all its limits of one kind.
struct Field {
    prepared: PreparedScene,
    limits: Vec<Limit>,
    filters: Vec<VelocitySettings>,
    /// Index of the shared hits that belong to the first filter and the first start.
    shared: usize,
    begun: AtomicUsize,
}

impl Field {
    fn jobs(&self, repeats: usize) -> usize {
        self.limits.len() * self.filters.len() * repeats
    }
}

/// One walk: its number, its limit, and the index of its shared hits.
#[derive(Clone, Copy)]
struct Job {
    number: usize,
    limit: Limit,
    shared: usize,
}

/// Makes all walks of the question. It uses all threads of the current pool. The result does not depend on the number
/// of threads or on `engine`. Calls `done` after each walk.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn limits(
    how: How<'_>,
    scene: &Scene,
    question: &Question,
    done: impl Fn() + Sync,
) -> Result<Vec<LimitResult>, Error> {
    let (fields, hits) = fields(scene, question)?;
    let shared: Vec<Shared> = (0..hits).map(|_| Shared::default()).collect();
    // In each scene, the limits of the sensation level come first, because their hits give all other results too.
    let made = on_all_threads(fields.len(), |place, made| {
        let field = &fields[place];
        let mut work = Walks {
            field,
            how,
            repeats: question.repeats,
            shared: &shared,
            lanes: vec![],
            done: |job: &Job, boundary| {
                done();
                made.push(((place, job.number), boundary));
            },
        };
        // All limits of a field are of one kind.
        let depth = match field.limits[0] {
            Limit::Felt(_) => Depth::Whole,
            Limit::Rms(_) => Depth::Bounded,
            Limit::Quiet(_) if field.limits.len() == 1 => Depth::Verdict,
            Limit::Quiet(_) => Depth::Bounded,
        };
        run(how.engine, &field.prepared, how.numeric, depth, &mut work);
    });
    interrupt::unless(how.stop)?;
    let mut made = made.into_values();
    let mut boundaries = || -> Result<Boundaries, Error> {
        let mut next =
            || made.next().unwrap_or_else(|| Err(Error::Internal("a walk has no result".into())));
        (0..question.repeats).map(|_| next()).collect()
    };
    let rate_hz = scene.control.rate_hz;
    let kinds = kinds(question);
    let mut results: Vec<LimitResult> = vec![];
    for situation in &question.situations {
        let first = results.len();
        for &limit in kinds.iter().flatten() {
            let filters = question.filters.iter();
            let cutoffs = filters.map(|&own| Ok(CutoffResult::of(own, rate_hz, boundaries()?)));
            let result = SweepResult::of(cutoffs.collect::<Result<_, Error>>()?);
            let (situation, told) = (Some(situation.clone()), Boundaries::default());
            results.push(LimitResult { situation, limit, result, told });
        }
        for result in results[first..].iter_mut().filter(|_| question.told) {
            result.told = boundaries()?;
        }
    }
    if question.situations.len() > 1 {
        let worst: Vec<LimitResult> =
            kinds.iter().flatten().filter_map(|limit| worst(&results, *limit)).collect();
        results.extend(worst);
    }
    Ok(results)
}

/// For each cutoff, takes the results of the situation in which the mean area is smallest.
fn worst(results: &[LimitResult], limit: Limit) -> Option<LimitResult> {
    let of_limit = || results.iter().filter(move |result| result.limit == limit);
    let mut result = of_limit().next()?.clone();
    result.situation = None;
    for (place, cutoff) in result.result.cutoffs.iter_mut().enumerate() {
        let all = of_limit().filter_map(|other| other.result.cutoffs.get(place));
        if let Some(least) = all.min_by(|a, b| a.boundaries.area().total_cmp(&b.boundaries.area()))
        {
            *cutoff = least.clone();
        }
    }
    result.result = SweepResult::of(result.result.cutoffs);
    let told = of_limit().map(|other| &other.told);
    let least = told.min_by(|a, b| a.area().total_cmp(&b.area()));
    result.told = least.cloned().unwrap_or_default();
    Some(result)
}

/// The limits, sorted by kind. Limits of the sensation level come first. In each kind, the largest limit comes first.
/// So later walks can use the hits of earlier walks.
fn kinds(question: &Question) -> Vec<Vec<Limit>> {
    let of = |kind: Limit| {
        let mut limits: Vec<Limit> = question.limits.clone();
        limits.retain(|limit| limit.is_like(kind));
        limits.sort_by(|a, b| b.value().total_cmp(&a.value()));
        limits.dedup();
        limits
    };
    let kinds = [Limit::Felt(0.0), Limit::Rms(0.0), Limit::Quiet(0.0)];
    kinds.map(of).into_iter().filter(|limits| !limits.is_empty()).collect()
}

/// All fields, and the number of sets of shared hits. The fields are sorted by situation, then by velocity, then by
/// kind of limit. The estimate comes before the true velocity.
fn fields(scene: &Scene, question: &Question) -> Result<(Vec<Field>, usize), Error> {
    let (mut fields, mut shared) = (vec![], 0);
    for situation in &question.situations {
        let scene = situation.of(scene, question)?;
        for told in [false, true] {
            if told && !question.told {
                continue;
            }
            let filters = match told {
                true => vec![VelocitySettings::Difference {}],
                false => question.filters.clone(),
            };
            let groups = filters.len() * question.repeats as usize;
            for limits in kinds(question) {
                let mut scene = scene.clone();
                limits[0].set(&mut scene.wall_hit);
                let prepared =
                    if told { PreparedScene::told(&scene)? } else { PreparedScene::new(&scene)? };
                let prepared = prepared.with_measures();
                let filters = filters.clone();
                let begun = AtomicUsize::new(0);
                fields.push(Field { prepared, limits, filters, shared, begun });
            }
            shared += groups;
        }
    }
    Ok((fields, shared))
}

impl Situation {
    /// The scene with this push and hand, and with the question's grid.
    fn of(&self, scene: &Scene, question: &Question) -> Result<Scene, Error> {
        let mut scene = scene.clone();
        scene.wall_hit.push_by = self.push;
        scene.wall_hit.criterion = Criterion::Rms;
        scene.wall_hit.rms_of = Some(question.rms_of);
        scene.walk = question.walk;
        if let Some(name) = &self.arm {
            scene.arm = Some(scene.named_arm(name).map_err(Error::Input)?);
        }
        Ok(scene)
    }
}

struct Walks<'a, D> {
    field: &'a Field,
    how: How<'a>,
    repeats: u32,
    shared: &'a [Shared],
    lanes: Vec<Option<(Job, Progress)>>,
    done: D,
}

impl<D: FnMut(&Job, Result<Boundary, Error>)> Walks<'_, D> {
    fn begin(&self) -> Option<(Job, Progress)> {
        let Self { field, repeats, .. } = self;
        let number = field.begun.fetch_add(1, Ordering::Relaxed);
        if number >= field.jobs(*repeats as usize) {
            return None;
        }
        let groups = field.filters.len() * *repeats as usize;
        let (limit, group) = (field.limits[number / groups], number % groups);
        let velocity = field.filters[group / *repeats as usize];
        #[expect(clippy::cast_possible_truncation, reason = "below `repeats`")]
        let repeat = (group % *repeats as usize) as u32;
        let start = start_offset_counts(repeat, *repeats);
        let job = Job { number, limit, shared: field.shared + group };
        Some((job, Progress::new(&field.prepared, velocity, start)))
    }

    fn known(&self, job: &Job, place: (i32, i32)) -> Option<Known> {
        let shared = self.shared.get(job.shared)?;
        shared.lock().unwrap_or_else(PoisonError::into_inner).get(&place).copied()
    }

    /// Stores the result of a hit. A hit without measurements has ended early. Its RMS is beyond the largest limit, and
    /// its sensation level is unknown. A hit with an error is beyond all limits.
    fn learn(&self, job: &Job, place: (i32, i32), outcome: &Result<Outcome, HitError>) {
        let beyond = Known {
            no_contact: false,
            rms_m: Some(f64::INFINITY),
            level_db: Some(f64::INFINITY),
            quiet: None,
        };
        let known = match outcome {
            outcome if matches!(job.limit, Limit::Quiet(_)) => Known {
                quiet: Some(outcome.as_ref().map_or(Verdict::Unstable, |outcome| outcome.verdict)),
                ..Known::default()
            },
            Err(_) => beyond,
            Ok(Outcome { measures: None, .. }) => Known { level_db: None, ..beyond },
            Ok(Outcome { verdict, measures: Some(measures), .. }) => Known {
                no_contact: *verdict == Verdict::NoContact,
                rms_m: Some(match self.field.prepared.scene().wall_hit.rms_of() {
                    RmsOf::Counts => measures.rms_m,
                    RmsOf::Motion => measures.rms_motion_m,
                }),
                level_db: measures.sensation_db,
                quiet: None,
            },
        };
        if let Some(shared) = self.shared.get(job.shared) {
            let mut shared = shared.lock().unwrap_or_else(PoisonError::into_inner);
            let entry = shared.entry(place).or_default();
            entry.no_contact |= known.no_contact;
            entry.quiet = entry.quiet.or(known.quiet);
            entry.rms_m = entry.rms_m.or(known.rms_m);
            entry.level_db = entry.level_db.or(known.level_db);
        }
    }
}

impl<D: FnMut(&Job, Result<Boundary, Error>)> Work for Walks<'_, D> {
    fn next(&mut self, lane: usize) -> Option<WallHit> {
        if self.lanes.len() <= lane {
            self.lanes.resize_with(lane + 1, || None);
        }
        loop {
            if self.how.stop.load(Ordering::Relaxed) {
                return None;
            }
            if self.lanes[lane].is_none() {
                self.lanes[lane] = Some(self.begin()?);
            }
            let (job, place) = self.lanes[lane].as_ref().map(|(job, p)| (*job, p.place()))?;
            let verdict = self.known(&job, place).and_then(|known| known.verdict(job.limit));
            let (_, progress) = self.lanes[lane].as_mut()?;
            let Some(verdict) = verdict else { return Some(progress.hit()) };
            let (field, numeric) = (self.field, self.how.numeric);
            let touches = |hit: &WallHit| field.prepared.touches(numeric, hit);
            if let Some(ended) = progress.report(Ok(verdict), touches) {
                self.lanes[lane] = None;
                (self.done)(&job, ended);
            }
        }
    }

    fn done(&mut self, lane: usize, outcome: Result<Outcome, HitError>) {
        let Some(Some((job, progress))) = self.lanes.get(lane) else { return };
        let (job, place) = (*job, progress.place());
        if let Err(error @ HitError::Settings(_)) = outcome {
            self.lanes[lane] = None;
            (self.done)(&job, Err(error.into()));
            return;
        }
        self.learn(&job, place, &outcome);
    }
}
