//! The hits of an engine, their outcomes, and the scalar loop.

use zwidth::experiment::Verdict;

use crate::simulation::{
    hit::louder,
    prepared::{HitError, HitReport, Numeric, PreparedScene, WallHit},
    window::Measures,
};

/// How far a hit is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// The hit runs until the verdict is certain. If the handle leaves the core's range, the hit is unstable.
    Verdict,
    /// The hit runs until it is certain to be unstable. A hit that is not unstable runs to its end and gives measures.
    /// If the handle leaves the core's range, the hit is unstable.
    Bounded,
    /// The hit runs to its end, so that the RMS can be computed. If the handle leaves the core's range, the hit is an
    /// error.
    Whole,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    pub verdict: Verdict,
    /// Population RMS over the window in m. Only given with [`Depth::Whole`].
    pub rms_m: Option<f64>,
    /// Measures of the window, if the scene uses more than the counts. They are given with [`Depth::Whole`]. With
    /// [`Depth::Bounded`], they are given for hits that are not unstable.
    pub measures: Option<Measures>,
}

impl Outcome {
    pub fn of(verdict: Verdict) -> Self {
        Self { verdict, rms_m: None, measures: None }
    }
}

/// How many hits were run in lanes, and how many in the scalar loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Hits that stayed in their lanes to the end.
    pub in_lanes: u64,
    /// Hits that were run in the scalar loop, and hits with an error.
    pub scalar: u64,
}

/// Gives hits to the lanes, and receives the outcomes.
pub trait Work {
    /// The next hit for a free lane. After `None` the lane is not used again.
    fn next(&mut self, lane: usize) -> Option<WallHit>;
    /// Takes the outcome of this lane's last hit.
    fn done(&mut self, lane: usize, outcome: Result<Outcome, HitError>);
}

#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    pub prepared: &'a PreparedScene,
    pub numeric: Numeric,
    pub depth: Depth,
}

pub fn one_by_one(task: Task<'_>, work: &mut Pushes<'_>) -> Tally {
    let mut tally = Tally::default();
    while let Some((hit, prepared)) = work.next(0) {
        tally.scalar += 1;
        let outcome = scalar(Task { prepared, ..task }, &hit);
        work.done(0, outcome);
    }
    tally
}

/// Work whose walls are tested at several pushes. A lane tests a wall at one push of the scene after another, until the
/// wall fails or has passed all pushes.
pub struct Pushes<'a> {
    work: &'a mut dyn Work,
    pushes: &'a [PreparedScene],
    lanes: Vec<Option<Begun>>,
}

/// A wall that was stable at the first pushes. The next pushes are still to be tested.
struct Begun {
    hit: WallHit,
    next: usize,
    worst: Option<Outcome>,
}

impl<'a> Pushes<'a> {
    pub fn new(prepared: &'a PreparedScene, work: &'a mut dyn Work) -> Self {
        Self { work, pushes: prepared.pushes(), lanes: vec![] }
    }

    /// The next hit for a free lane, and the scene with the push of this hit. After `None` the lane is not used again.
    pub fn next(&mut self, lane: usize) -> Option<(WallHit, &'a PreparedScene)> {
        if self.lanes.len() <= lane {
            self.lanes.resize_with(lane + 1, || None);
        }
        let begun = self.lanes.get_mut(lane)?;
        if begun.is_none() {
            let hit = self.work.next(lane)?;
            *begun = Some(Begun { hit, next: 0, worst: None });
        }
        let begun = begun.as_ref()?;
        Some((begun.hit, self.pushes.get(begun.next)?))
    }

    pub fn done(&mut self, lane: usize, outcome: Result<Outcome, HitError>) {
        let Some(place) = self.lanes.get_mut(lane) else { return };
        let Some(begun) = place else { return };
        begun.next += 1;
        let outcome = match outcome {
            Ok(held) if held.verdict == Verdict::Stable => {
                let force_n = |of: &Outcome| of.measures.map(|measures| measures.force_rms_n);
                let worst = louder(begun.worst, held, force_n);
                begun.worst = Some(worst);
                if begun.next < self.pushes.len() {
                    return;
                }
                Ok(worst)
            }
            failed => failed,
        };
        *place = None;
        self.work.done(lane, outcome);
    }
}

pub fn scalar(task: Task<'_>, hit: &WallHit) -> Result<Outcome, HitError> {
    let Task { prepared, numeric, depth } = task;
    match depth {
        Depth::Verdict => match prepared.verdict(numeric, hit) {
            // the handle may leave the range after an engine was certain of the verdict
            Err(HitError::OutOfRange(_)) => Ok(Verdict::Unstable),
            verdict => verdict,
        }
        .map(Outcome::of),
        Depth::Bounded => match prepared.bounded(numeric, hit) {
            Err(HitError::OutOfRange(_)) => Ok(None),
            bounded => bounded,
        }
        .map(|report| match report {
            None => Outcome::of(Verdict::Unstable),
            Some(report) => {
                Outcome { measures: measures(prepared, &report), ..Outcome::of(report.verdict) }
            }
        }),
        Depth::Whole => match prepared.rms(numeric, hit)? {
            Some((verdict, rms_m)) => Ok(Outcome { verdict, rms_m: Some(rms_m), measures: None }),
            None => prepared.report(numeric, hit).map(|report| Outcome {
                verdict: report.verdict,
                rms_m: Some(report.rms_m),
                measures: measures(prepared, &report),
            }),
        },
    }
}

fn measures(prepared: &PreparedScene, report: &HitReport) -> Option<Measures> {
    (!prepared.judge().is_plain()).then_some(report.measures)
}
