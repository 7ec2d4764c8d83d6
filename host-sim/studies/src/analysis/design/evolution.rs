//! Searches filters with differential evolution in a unit cube. Several populations evolve at once.
//!
//! R. Storn and K. Price, "Differential evolution: a simple and efficient heuristic for global optimization over
//! continuous spaces", J. Global Optimization 11, 1997. The scale of the differences is drawn again for each
//! generation, as in SciPy. Each member of a population has its own limit of the gain peak, its cap. So one search
//! finds the best filter for every cap. A member takes steps from the best known filter below its cap, or from another
//! member. A filter above the cap is not walked. Of two filters above the cap, the filter nearer to the cap stays (K.
//! Deb, Comput. Methods Appl. Mech. Engrg. 186, 2000).
//!
//! The result of a search is refined in rounds. Each round draws from a Gaussian with the mean and covariance of the
//! best filters below a cap (P. Larranaga and J. A. Lozano, "Estimation of distribution algorithms", 2002).
//!
//! All random numbers come from a seed in one fixed order. So the result depends only on the seed and the question.

use crate::{
    error::Error,
    numerics::{
        random::{gaussian, uniform},
        whole,
    },
};

/// Number of members that have the first cap.
const MAIN: usize = 24;
/// Number of members that have each further cap.
const EACH: usize = 8;
/// Share of a member's coordinates that change when the member tries a step.
const CROSSING: f64 = 0.8;

/// A point of the search. Each coordinate is 0 to 1.
pub type Place<const N: usize> = [f64; N];

/// What a search optimises: the quality of filters, and the limit of their gain peak.
pub trait Field<const N: usize> {
    /// The point at which a member begins. `drawn` is a random point.
    fn begin(&self, drawn: Place<N>) -> Place<N> {
        drawn
    }
    /// Gain peak of the filter at a point, in dB. It is infinite if there is no filter at this point.
    fn peak_db(&self, place: &Place<N>) -> f64;
    /// Quality of the filters at these points.
    fn worths(&mut self, places: &[Place<N>]) -> Result<Vec<f64>, Error>;
}

/// A member of a population: its point, its quality, and by how much its gain peak is above its cap.
#[derive(Clone, Copy, Debug)]
struct Member<const N: usize> {
    place: Place<N>,
    excess_db: f64,
    worth: f64,
}

impl<const N: usize> Member<N> {
    /// Whether this member is at least as good as `other`.
    fn beats(&self, other: &Self) -> bool {
        match self.excess_db == other.excess_db {
            true => self.worth >= other.worth,
            false => self.excess_db < other.excess_db,
        }
    }
}

/// All walked filters. Each has its point, its gain peak in dB, and its quality.
pub type Found<const N: usize> = Vec<(Place<N>, f64, f64)>;

/// Searches the best filters below each cap. Walks at least `budget` filters, and at most one generation more. The caps
/// are in dB. The first cap gets the most members.
///
/// # Errors
/// An error of [`Field::worths`].
pub fn evolve<const N: usize>(
    field: &mut impl Field<N>,
    caps_db: &[f64],
    budget: usize,
    seed: u64,
) -> Result<Found<N>, Error> {
    let mut drawn = 0;
    let mut random = || {
        drawn += 1;
        uniform(seed, drawn)
    };
    let caps: Vec<f64> = caps_db
        .iter()
        .enumerate()
        .flat_map(|(n, cap)| std::iter::repeat_n(*cap, if n == 0 { MAIN } else { EACH }))
        .collect();
    let mut found = Found::new();
    let first: Vec<Place<N>> =
        caps.iter().map(|_| field.begin(std::array::from_fn(|_| random()))).collect();
    let mut members = look(field, &first, &caps, &mut found)?;
    // If all members are above their caps, a generation walks no filter. So the number of generations is limited.
    for _ in 0..10 * budget.div_ceil(caps.len()).max(1) {
        if found.len() >= budget {
            break;
        }
        let best: Vec<Place<N>> =
            caps_db.iter().map(|cap| best_below(*cap, &found, &members)).collect();
        let scale = 0.4 + 0.6 * random();
        let trials: Vec<Place<N>> = (0..caps.len())
            .map(|n| {
                let mut any = || {
                    let number = whole(random() * caps.len() as f64);
                    members[number.min(caps.len() - 1)].place
                };
                let (one, other, base) = (any(), any(), any());
                let own = caps_db.iter().position(|cap| *cap == caps[n]).unwrap_or(0);
                let base = if random() < 0.5 { best[own] } else { base };
                let always = whole(random() * N as f64);
                std::array::from_fn(|k| {
                    let crossed = random() < CROSSING || k == always;
                    let step = base[k] + scale * (one[k] - other[k]);
                    let anywhere = random();
                    match (crossed, (0.0..=1.0).contains(&step)) {
                        (false, _) => members[n].place[k],
                        (true, true) => step,
                        (true, false) => anywhere,
                    }
                })
            })
            .collect();
        for (member, trial) in members.iter_mut().zip(look(field, &trials, &caps, &mut found)?) {
            if trial.beats(member) {
                *member = trial;
            }
        }
    }
    Ok(found)
}

/// Number of best filters from which the Gaussian is computed.
const SPREAD: usize = 12;
/// Number of points that are drawn in a round.
const ROUND: usize = 40;

/// Refines the filters at the points `from`, and stays below the cap. The qualities that the search found are not used,
/// because the search had another grid. The refinement walks `budget` filters, and at least one round.
///
/// # Errors
/// An error of [`Field::worths`].
pub fn refine<const N: usize>(
    field: &mut impl Field<N>,
    cap_db: f64,
    from: &[Place<N>],
    budget: usize,
    seed: u64,
) -> Result<Found<N>, Error> {
    let mut drawn = 0;
    let mut random = || {
        drawn += 1;
        gaussian(seed ^ 0x5eed, drawn)
    };
    let mut found = Found::new();
    let known: Vec<Place<N>> = from.iter().take(ROUND).copied().collect();
    look(field, &known, &vec![cap_db; known.len()], &mut found)?;
    for _ in 0..budget.div_ceil(ROUND).saturating_sub(1) {
        found.sort_by(|a, b| b.2.total_cmp(&a.2));
        let best: Vec<Place<N>> = found.iter().take(SPREAD).map(|(place, ..)| *place).collect();
        let number = best.len().max(1) as f64;
        let mean: Place<N> =
            std::array::from_fn(|k| best.iter().map(|place| place[k]).sum::<f64>() / number);
        let draws: Vec<Place<N>> = (0..ROUND)
            .map(|_| {
                let mut place = mean;
                for one in &best {
                    let part = random() / number.sqrt();
                    for k in 0..N {
                        place[k] += part * (one[k] - mean[k]);
                    }
                }
                place.map(|x| x.clamp(0.0, 1.0))
            })
            .collect();
        look(field, &draws, &vec![cap_db; draws.len()], &mut found)?;
    }
    Ok(found)
}

/// Walks the filters that are below their caps.
fn look<const N: usize>(
    field: &mut impl Field<N>,
    places: &[Place<N>],
    caps: &[f64],
    found: &mut Found<N>,
) -> Result<Vec<Member<N>>, Error> {
    let peaks: Vec<f64> = places.iter().map(|place| field.peak_db(place)).collect();
    let below = || (0..places.len()).filter(|&n| peaks[n] <= caps[n]);
    let asked: Vec<Place<N>> = below().map(|n| places[n]).collect();
    let worths = field.worths(&asked)?;
    found.extend(below().zip(&worths).map(|(n, worth)| (places[n], peaks[n], *worth)));
    let mut worths = worths.into_iter();
    let members = (0..places.len()).map(|n| {
        let excess_db = (peaks[n] - caps[n]).max(0.0);
        let worth = if excess_db > 0.0 { 0.0 } else { worths.next().unwrap_or(0.0) };
        Member { place: places[n], excess_db, worth }
    });
    Ok(members.collect())
}

/// The point of the best walked filter below a cap. If there is none, the point of the first member.
fn best_below<const N: usize>(cap_db: f64, found: &Found<N>, members: &[Member<N>]) -> Place<N> {
    let below = found.iter().filter(|(_, peak, _)| *peak <= cap_db);
    let best = below.max_by(|a, b| a.2.total_cmp(&b.2)).map(|(place, ..)| *place);
    best.unwrap_or_else(|| members.first().map_or([0.5; N], |member| member.place))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ridge whose height grows with the gain peak. The gain peak in dB is 10 times the first coordinate.
    struct Ridge(usize);

    impl Field<4> for Ridge {
        fn peak_db(&self, place: &Place<4>) -> f64 {
            if place[3] > 0.9 { f64::INFINITY } else { 10.0 * place[0] }
        }

        fn worths(&mut self, places: &[Place<4>]) -> Result<Vec<f64>, Error> {
            self.0 += places.len();
            Ok(places
                .iter()
                .map(|[a, b, c, d]| {
                    let off =
                        (b - 0.3 - 0.4 * a).powi(2) + (c - 0.7 * b).powi(2) + (d - 0.2).powi(2);
                    (1.0 + a) * (-20.0 * off).exp()
                })
                .collect())
        }
    }

    #[test]
    fn each_cap_gets_its_best_and_nothing_above_all_caps_is_walked() {
        for seed in 0..5 {
            let mut field = Ridge(0);
            let found = evolve(&mut field, &[6.0, 3.0, 1.0], 1200, seed).unwrap();
            assert!(found.len() == field.0 && (1200..1300).contains(&field.0), "{}", field.0);
            for cap in [6.0, 3.0, 1.0] {
                let best = found.iter().filter(|(_, peak, _)| *peak <= cap);
                let best = best.map(|(.., worth)| *worth).fold(0.0, f64::max);
                let height = 1.0 + cap / 10.0;
                assert!(best > 0.98 * height && best <= height, "{cap} dB: {best} of {height}");
            }
            assert!(found.iter().all(|(_, peak, _)| *peak <= 6.0));
        }
    }

    #[test]
    fn what_is_found_is_refined() {
        let mut field = Ridge(0);
        let rough = evolve(&mut field, &[6.0], 150, 1).unwrap();
        let best = |found: &Found<4>| found.iter().map(|(.., worth)| *worth).fold(0.0, f64::max);
        let mut sorted = rough.clone();
        sorted.sort_by(|a, b| b.2.total_cmp(&a.2));
        let from: Vec<Place<4>> = sorted.iter().map(|(place, ..)| *place).collect();
        let fine = refine(&mut field, 6.0, &from, 300, 1).unwrap();
        assert!(best(&fine) > 1.001 * best(&rough), "{} {}", best(&fine), best(&rough));
        assert!(fine.iter().all(|(_, peak, _)| *peak <= 6.0));
    }

    #[test]
    fn the_seed_says_all() {
        let run = |seed| evolve(&mut Ridge(0), &[6.0, 2.0], 300, seed).unwrap();
        assert_eq!(run(3), run(3));
        assert_ne!(run(3), run(4));
    }
}
