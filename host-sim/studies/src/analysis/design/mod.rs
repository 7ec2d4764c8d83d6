//! Finds the best velocity filter for a device: its form and not only its cutoff. The filter has one or two biquads
//! after the finite difference, in the core's fixed point. The filter is designed for the worst of several conditions.
//! A condition sets the push, the hand and the limit.
//!
//! * The quality of a filter is a ratio of areas. The filter's area is divided by the area of the reference, a finite
//!   difference and Butterworth filter at the best cutoff of `[sweep]`. The condition with the smallest ratio counts.
//!   With one condition, the best filter has the largest area.
//! * [`evolution`] is a global search over poles, lead and second zero ([`shape`]), for several limits of the gain peak
//!   (caps) together. The grid of the walk is so coarse that Butterworth's boundary has about 28 columns.
//! * The best filters of the first cap are refined on a grid with twice as many columns.
//! * The best filters of each cap are walked again on the scene's grid, from other starts. The best filters of these
//!   walks are walked once more, from the starts of a sweep. So the selection does not bias the area in the result. If
//!   there is only one repeat, all walks have the same start. Then the area is biased upwards.
//! * Roughness is measured as in [`compare`](super::compare), at the same wall. But for a design, Butterworth's cutoff
//!   is one of the cutoffs of `[sweep]`. The area with a frequency or damping that is wrong by [`MISTUNED_BY`] is also
//!   measured.

pub mod evolution;
mod references;
pub mod shape;

use std::{cell::RefCell, collections::HashMap, sync::atomic::AtomicBool};

use zwidth::{
    VelocitySettings,
    velocity::{Biquad, Estimator, EstimatorName, PARAMETERS},
};

use self::{
    evolution::{Field, Found, Place, evolve, refine},
    references::{coarser, references, rough, wall, with_biquad, with_low_pass},
    shape::{NUMBERS, Shape},
};
use super::compare::{Wall, looked::STARTS};
use crate::{
    engine::Engine,
    error::Error,
    numerics::whole,
    scene::Scene,
    simulation::prepared::{Numeric, PreparedScene},
    study::{
        How,
        boundary::{Boundaries, Boundary},
        filters::boundaries,
        sweep::starts,
    },
};

/// Number of columns of the reference's boundary on the grid of the search. Up to its peak the boundary has the same
/// number of rows.
const COLUMNS: f64 = 28.0;
/// The number of columns on the grid of the refinement.
const FINE_COLUMNS: f64 = 56.0;
/// Share of the budget that the refinement gets.
const REFINE: f64 = 0.2;
/// Positions at which the walks start that choose among the best filters, in counts. They are the starts of a search
/// and two starts between them.
const CHOICE: [f64; 4] =
    [0.118_033_988_749_895, 0.368_033_988_749_895, 0.618_033_988_749_895, 0.868_033_988_749_895];
/// Number of best filters that are walked again on the scene's grid, for each cap and for each grid of the search.
const CHOSEN: usize = 8;
/// The result also has the best filters below these caps on the gain peak, in dB. Only caps below the requested cap are
/// used.
const FRONT_DB: [f64; 6] = [12.0, 9.0, 6.0, 4.5, 3.0, 1.5];
/// Factor by which the frequency or the damping of a mistuned filter is too large or too small.
pub const MISTUNED_BY: f64 = 1.2;

/// The circumstances for which a filter is designed: the push, the hand and the limit.
#[derive(Clone, Debug)]
pub struct Condition {
    pub name: String,
    pub scene: Scene,
}

#[derive(Clone, Debug)]
pub struct Question {
    /// The conditions for which a filter is designed, one or more. All have the same device.
    pub conditions: Vec<Condition>,
    /// Largest allowed gain from the true velocity to the estimate, in dB.
    pub gain_peak_db: Option<f64>,
    /// Largest allowed delay of the estimate in a slow motion, in s.
    pub delay_s: Option<f64>,
    /// Largest allowed roughness of the force, in N.
    pub roughness_n: Option<f64>,
    /// Smallest area that a mistuned filter may have, as a share of the area of the correctly tuned filter.
    pub mistuned_share: Option<f64>,
    /// Number of sections of a filter, 1 or 2.
    pub sections: u8,
    /// Number of filters that the search walks.
    pub budget: u32,
    /// Number of walks of a result in each condition.
    pub repeats: u32,
    pub seed: u64,
    pub numeric: Numeric,
}

/// The reference in one condition: a finite difference and Butterworth filter.
#[derive(Clone, Debug)]
pub struct Reference {
    /// The cutoff with the largest area, in Hz.
    pub cutoff_hz: f64,
    pub boundaries: Boundaries,
}

/// A filter that the design returns, with its figures.
#[derive(Clone, Debug)]
pub struct Designed {
    pub shape: Shape,
    /// The filter's boundaries in each condition.
    pub boundaries: Vec<Boundaries>,
    /// The filter's area divided by the reference's area, in the condition where this ratio is smallest.
    pub worth: f64,
    /// Index of the condition in which the ratio of areas is smallest.
    pub worst: usize,
    /// Largest gain from the true velocity to the estimate, in dB.
    pub gain_peak_db: f64,
    /// RMS of the force above 100 Hz at the wall, in N. `None` if the wall is not stable with this filter.
    pub roughness_n: Option<f64>,
    /// Smallest area that a mistuned filter has in the worst condition, as a share of the area of the correctly tuned
    /// filter.
    pub mistuned_share: f64,
    /// The biquads with the coefficients that the core uses.
    pub sections: Vec<Biquad>,
}

impl Designed {
    /// Mean area in the worst condition, in N^2 s/m^2.
    pub fn area(&self) -> f64 {
        self.boundaries.get(self.worst).map_or(0.0, Boundaries::area)
    }
}

/// A filter that the search walked.
#[derive(Clone, Copy, Debug)]
pub struct Tried {
    pub shape: Shape,
    pub gain_peak_db: f64,
    /// Quality on the search's grid: the area divided by the reference's area, in the worst condition.
    pub worth: f64,
}

#[derive(Clone, Debug)]
pub struct DesignStudy {
    pub question: Question,
    /// The reference of each condition.
    pub references: Vec<Reference>,
    /// The wall at which roughness is measured. It belongs to the first condition.
    pub wall: Wall,
    /// First the best filter below the requested cap, then the best filters below lower caps on the gain peak.
    pub filters: Vec<Designed>,
    pub tried: Vec<Tried>,
    /// Roughness of the force with the reference at `wall`, in N.
    pub reference_roughness_n: Option<f64>,
}

/// What all walks share: how they run, and what is called after each.
struct Walker<'a, D> {
    how: How<'a>,
    done: D,
}

impl<D: Fn(&Boundary) + Sync> Walker<'_, D> {
    /// Walks the filters in each scene. Returns the boundaries, ordered by condition, then by filter.
    fn walk(
        &self,
        scenes: &[PreparedScene],
        filters: &[VelocitySettings],
        starts: &[f64],
    ) -> Result<Vec<Vec<Boundaries>>, Error> {
        boundaries(self.how, scenes, filters, starts, &self.done)
    }
}

/// Designs the filters. Calls `done` after each walk.
///
/// # Errors
/// The handle does not reach the wall, no filter is within the limits, or `stop` was set.
pub fn design(
    engine: Engine,
    question: Question,
    stop: &AtomicBool,
    done: impl Fn(&Boundary) + Sync,
) -> Result<DesignStudy, Error> {
    match question.sections {
        1 => of_numbers::<NUMBERS>(engine, question, stop, done),
        _ => of_numbers::<{ 2 * NUMBERS }>(engine, question, stop, done),
    }
}

fn of_numbers<const N: usize>(
    engine: Engine,
    question: Question,
    stop: &AtomicBool,
    done: impl Fn(&Boundary) + Sync,
) -> Result<DesignStudy, Error> {
    let walker = Walker { how: How { engine, numeric: question.numeric, stop }, done };
    let scenes: Vec<Scene> = question.conditions.iter().map(|c| with_biquad(&c.scene, N)).collect();
    let prepared = |scenes: &[Scene]| -> Result<Vec<PreparedScene>, Error> {
        scenes.iter().map(PreparedScene::new).collect()
    };
    let fine = prepared(&scenes)?;
    // A Butterworth low-pass does not have the form of two biquads. So the low-passes need scenes of their own.
    let plain: Vec<Scene> = question.conditions.iter().map(|c| with_low_pass(&c.scene)).collect();
    let references = references(&walker, &question, &prepared(&plain)?)?;
    let cutoffs: Vec<VelocitySettings> = references.iter().map(Reference::settings).collect();
    let first = scenes.first().ok_or_else(|| Error::input("no condition"))?;
    let wall = wall(first, &references);
    let mut search: Search<'_, _, N> = Search {
        walker: &walker,
        question: &question,
        scene: first,
        scenes: vec![],
        scale: vec![],
        wall,
        kept: RefCell::default(),
    };
    let on_a_grid_of = |columns: f64, search: &mut Search<'_, _, N>| -> Result<(), Error> {
        let on_grid = |scenes: &[Scene]| {
            let both = scenes.iter().zip(&references);
            let coarse: Vec<Scene> =
                both.map(|(scene, of)| coarser(scene, &of.boundaries, columns)).collect();
            prepared(&coarse)
        };
        search.scenes = on_grid(&scenes)?;
        let known = walker.walk(&on_grid(&plain)?, &cutoffs, question.spread(&STARTS))?;
        let areas = known.iter().enumerate().map(|(n, of)| of[n].area().max(f64::MIN_POSITIVE));
        search.scale = areas.collect();
        search.kept.borrow_mut().clear();
        Ok(())
    };
    let asked = question.gain_peak_db.unwrap_or(f64::MAX);
    let caps: Vec<f64> =
        std::iter::once(asked).chain(FRONT_DB.into_iter().filter(|cap| *cap < asked)).collect();
    let kept = whole(REFINE * f64::from(question.budget));
    on_a_grid_of(COLUMNS, &mut search)?;
    let mut found = evolve(&mut search, &caps, question.budget as usize - kept, question.seed)?;
    found.sort_by(|a, b| b.2.total_cmp(&a.2));
    let best: Vec<Place<N>> = found.iter().map(|(place, ..)| *place).collect();
    on_a_grid_of(FINE_COLUMNS, &mut search)?;
    let refined = refine(&mut search, asked, &best, kept, question.seed)?;
    let rate_hz = first.control.rate_hz;
    let tried = |found: &Found<N>| {
        let one = |(place, gain_peak_db, worth): &(Place<N>, f64, f64)| Tried {
            shape: Shape::at(place, rate_hz),
            gain_peak_db: *gain_peak_db,
            worth: *worth,
        };
        let mut tried: Vec<Tried> = found.iter().map(one).collect();
        tried.sort_by(|a, b| b.worth.total_cmp(&a.worth));
        tried
    };
    let (coarse, fine_tried) = (tried(&found), tried(&refined));
    let scale = references.iter().map(|of| of.boundaries.area()).collect();
    let last = Last { walker: &walker, question: &question, scenes: &fine, scale };
    let filters = last.choose([&fine_tried, &coarse], &caps)?.into_iter();
    let tried = [fine_tried, coarse].concat();
    let mut filters = filters
        .map(|(shape, boundaries)| last.finish(first, wall, shape, boundaries))
        .collect::<Result<Vec<Designed>, Error>>()?;
    filters.sort_by(|a, b| b.worth.total_cmp(&a.worth));
    if filters.first().is_none_or(|best| best.worth <= 0.0) {
        return Err(Error::input(
            "no filter of the search keeps to the limits and has a stable wall",
        ));
    }
    let settings = references.first().map(Reference::settings);
    let reference_roughness_n =
        settings.map(|settings| rough(first, &settings, wall, stop)).transpose()?.flatten();
    Ok(DesignStudy { question, references, wall, filters, tried, reference_roughness_n })
}

impl Question {
    /// The positions at which walks start. They are `starts`, or a single position if the question has one repeat.
    fn spread<'a>(&self, starts: &'a [f64]) -> &'a [f64] {
        if self.repeats == 1 { &[0.0] } else { starts }
    }
}

impl Reference {
    fn settings(&self) -> VelocitySettings {
        VelocitySettings::Butterworth { cutoff_hz: self.cutoff_hz }
    }
}

/// Divides each area by its scale. Returns the smallest ratio and its index.
fn worth(areas: impl Iterator<Item = f64>, scale: &[f64]) -> (f64, usize) {
    let shares = areas.zip(scale).map(|(area, scale)| area / scale).enumerate();
    let least = shares.min_by(|a, b| a.1.total_cmp(&b.1));
    least.map_or((0.0, 0), |(place, share)| (share, place))
}

struct Search<'a, D, const N: usize> {
    walker: &'a Walker<'a, D>,
    question: &'a Question,
    scene: &'a Scene,
    scenes: Vec<PreparedScene>,
    /// The area of the reference on the grid of the search, for each condition.
    scale: Vec<f64>,
    wall: Wall,
    /// Known answers of `keeps`: whether a filter is within the limits of roughness and mistuning. The key is the
    /// filter's parameters.
    kept: RefCell<HashMap<[u64; PARAMETERS], bool>>,
}

impl<D: Fn(&Boundary) + Sync, const N: usize> Search<'_, D, N> {
    fn shape(&self, place: &Place<N>) -> Shape {
        Shape::at(place, self.scene.control.rate_hz)
    }

    fn of(&self, shapes: &[Shape]) -> Result<Vec<f64>, Error> {
        let settings: Vec<VelocitySettings> = shapes.iter().map(Shape::settings).collect();
        let walked = self.walker.walk(&self.scenes, &settings, self.question.spread(&STARTS))?;
        let areas = |n: usize| walked.iter().map(move |of_filter| of_filter[n].area());
        Ok((0..shapes.len()).map(|n| worth(areas(n), &self.scale).0).collect())
    }

    /// Whether a filter is within the limits of roughness and mistuning. `own` is the area of the filter itself.
    fn keeps(&self, shape: &Shape, own: f64) -> Result<bool, Error> {
        let Question { roughness_n, mistuned_share, .. } = self.question;
        if roughness_n.is_none() && mistuned_share.is_none() {
            return Ok(true);
        }
        let key = EstimatorName::of(&shape.settings()).1.map(f64::to_bits);
        if let Some(kept) = self.kept.borrow().get(&key) {
            return Ok(*kept);
        }
        let mut kept = true;
        if let Some(most) = roughness_n {
            let found = rough(self.scene, &shape.settings(), self.wall, self.walker.how.stop)?;
            kept &= found.is_some_and(|found| found <= *most);
        }
        if let (true, Some(share)) = (kept, mistuned_share) {
            let wrong = shape.mistuned(MISTUNED_BY, &self.scene.design());
            kept &= self.of(&wrong)?.into_iter().all(|worth| worth >= share * own);
        }
        self.kept.borrow_mut().insert(key, kept);
        Ok(kept)
    }
}

impl<D: Fn(&Boundary) + Sync, const N: usize> Field<N> for Search<'_, D, N> {
    /// Half of the members begin without a second section, because a good filter with one section is a good start for
    /// two sections.
    fn begin(&self, mut drawn: Place<N>) -> Place<N> {
        if N > NUMBERS && drawn[NUMBERS + 1] < 0.5 {
            Shape::without_second(&mut drawn, self.scene.control.rate_hz);
        }
        drawn
    }

    fn peak_db(&self, place: &Place<N>) -> f64 {
        let shape = self.shape(place);
        // A filter's parameters are rounded to four digits, so the limit has a tolerance of 1e-9.
        if self.question.delay_s.is_some_and(|most| -shape.led_s() > most + 1e-9) {
            return f64::INFINITY;
        }
        shape.gain_peak_db(&self.scene.design()).unwrap_or(f64::INFINITY)
    }

    fn worths(&mut self, places: &[Place<N>]) -> Result<Vec<f64>, Error> {
        let shapes: Vec<Shape> = places.iter().map(|place| self.shape(place)).collect();
        let worths = self.of(&shapes)?;
        let checked = shapes
            .iter()
            .zip(worths)
            .map(|(shape, worth)| Ok(if self.keeps(shape, worth)? { worth } else { 0.0 }));
        checked.collect()
    }
}

/// The last walks of a design. They use the scenes' own grids.
struct Last<'a, D> {
    walker: &'a Walker<'a, D>,
    question: &'a Question,
    scenes: &'a [PreparedScene],
    /// The area of the reference for each condition.
    scale: Vec<f64>,
}

impl<D: Fn(&Boundary) + Sync> Last<'_, D> {
    /// Chooses the best filter below each cap. Returns each filter with its boundaries in each condition.
    fn choose(
        &self,
        tried: [&[Tried]; 2],
        caps: &[f64],
    ) -> Result<Vec<(Shape, Vec<Boundaries>)>, Error> {
        let Self { walker, question, scenes, scale } = self;
        let mut shapes: Vec<(Shape, f64)> = vec![];
        for cap in caps {
            for grid in tried {
                let below = grid.iter().filter(|one| one.gain_peak_db <= *cap && one.worth > 0.0);
                for one in below.take(CHOSEN) {
                    if shapes.iter().all(|(shape, _)| *shape != one.shape) {
                        shapes.push((one.shape, one.gain_peak_db));
                    }
                }
            }
        }
        let settings: Vec<VelocitySettings> =
            shapes.iter().map(|(shape, _)| shape.settings()).collect();
        let walked = walker.walk(scenes, &settings, question.spread(&CHOICE))?;
        let areas = |n: usize| walked.iter().map(move |of_filter| of_filter[n].area());
        let worths: Vec<f64> = (0..shapes.len()).map(|n| worth(areas(n), scale).0).collect();
        let mut best: Vec<usize> = vec![];
        for cap in caps {
            let below = (0..shapes.len()).filter(|&n| shapes[n].1 <= *cap);
            if let Some(n) = below.max_by(|&a, &b| worths[a].total_cmp(&worths[b]))
                && !best.contains(&n)
            {
                best.push(n);
            }
        }
        let settings: Vec<VelocitySettings> = best.iter().map(|&n| settings[n]).collect();
        let walked = walker.walk(scenes, &settings, &starts(question.repeats))?;
        let of = |place: usize| walked.iter().map(|of_filter| of_filter[place].clone()).collect();
        Ok(best.iter().enumerate().map(|(place, &n)| (shapes[n].0, of(place))).collect())
    }

    fn finish(
        &self,
        first: &Scene,
        wall: Wall,
        shape: Shape,
        boundaries: Vec<Boundaries>,
    ) -> Result<Designed, Error> {
        let Self { walker, question, scenes, scale } = self;
        let design = first.design();
        let (worth, worst) = worth(boundaries.iter().map(Boundaries::area), scale);
        let wrong: Vec<VelocitySettings> =
            shape.mistuned(MISTUNED_BY, &design).iter().map(Shape::settings).collect();
        let walked = walker.walk(&scenes[worst..=worst], &wrong, &starts(question.repeats))?;
        let own = boundaries[worst].area();
        let left = walked.iter().flatten().map(|of| of.area() / own).fold(f64::INFINITY, f64::min);
        let sections = match shape.settings().build(&design).map_err(Error::input)? {
            Estimator::LowPass(biquad) => vec![biquad],
            Estimator::Cascade(cascade) => cascade.sections().to_vec(),
            _ => return Err(Error::Internal("a biquad is a low-pass to the core".into())),
        };
        Ok(Designed {
            shape,
            boundaries,
            worth,
            worst,
            gain_peak_db: shape.gain_peak_db(&design).unwrap_or(f64::INFINITY),
            roughness_n: rough(first, &shape.settings(), wall, walker.how.stop)?,
            mistuned_share: left,
            sections,
        })
    }
}
