//! The best estimators of each criterion, among estimators with the same kind of inputs.
//!
//! The results of repeated walks and hits scatter. So some means cannot be distinguished from the best mean. Welch's
//! t-test decides, as in a sweep ([`crate::numerics::statistics`]). Two means are only distinguished if the test shows
//! that the worse mean is below 98 % of the better mean. If smaller values are better, the test is whether the better
//! mean is below 98 % of the worse mean.

use std::borrow::Cow;

use serde::Serialize;

use super::{
    Class, Compared, Place,
    table::{Better, CRITERIA, Criterion},
};
use crate::{
    numerics::statistics::{AS_GOOD_AS_BEST, Repeats},
    scene::Units,
};

/// The best estimators of one criterion in one class.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Winner {
    pub criterion: Cow<'static, str>,
    /// Inputs of the estimators: `position_only` or `more_than_position`.
    pub class: &'static str,
    /// The estimators with the best mean. There are several if their means are equal.
    pub best: Vec<String>,
    /// Further estimators. The repeats do not show that they are worse than the best.
    pub not_told_apart: Vec<String>,
    /// Mean value of the best estimator.
    pub value: f64,
    /// Rank of the finite difference and Butterworth filter in its class. The rank is 1 plus the number of estimators
    /// that are shown to be better. `null` if this estimator is not in the class or has no value.
    pub butterworth_rank: Option<usize>,
}

impl Winner {
    /// The same winner with its criterion and its value in `units`.
    #[must_use]
    pub fn told(&self, units: Units) -> Self {
        match units.key(&self.criterion) {
            None => self.clone(),
            Some((criterion, factor)) => Self {
                criterion: criterion.into(),
                value: Units::told(self.value, factor),
                ..self.clone()
            },
        }
    }
}

/// The winners of all criteria that rank estimators. Each class that has a member has its own winners.
pub fn winners(compared: &[Compared], place: &Place) -> Vec<Winner> {
    let mut winners = vec![];
    for criterion in &CRITERIA {
        for class in Class::ALL {
            winners.extend(winner(criterion, class, compared, place));
        }
    }
    winners
}

fn winner(
    criterion: &Criterion,
    class: Class,
    compared: &[Compared],
    place: &Place,
) -> Option<Winner> {
    let better = criterion.better?;
    let candidates: Vec<(String, Vec<f64>)> = compared
        .iter()
        .filter(|c| c.class() == class)
        .map(|c| (c.entry.name(), (criterion.values)(c, place)))
        .filter(|(_, values)| !values.is_empty())
        .collect();
    ranked(criterion.key, class, better, &candidates)
}

/// The winner of a criterion among estimators of one class, which are given by name and values.
fn ranked(
    criterion: &'static str,
    class: Class,
    better: Better,
    candidates: &[(String, Vec<f64>)],
) -> Option<Winner> {
    let repeats: Vec<(&str, Repeats)> = candidates
        .iter()
        .map(|(name, values)| (name.as_str(), Repeats::of(values.iter().copied())))
        .collect();
    let goodness = |mean: f64| match better {
        Better::More => mean,
        Better::Less => -mean,
        Better::NearerToZero => -mean.abs(),
    };
    // Values that were measured only once have no scatter. They are compared directly, without a test.
    let beats = |one: &Repeats, other: &Repeats| match better {
        Better::More => other.is_below(AS_GOOD_AS_BEST, one),
        Better::Less if one.count + other.count > 2.0 => one.is_below(AS_GOOD_AS_BEST, other),
        _ => goodness(one.mean) > goodness(other.mean),
    };
    let (_, best) =
        repeats.iter().max_by(|a, b| goodness(a.1.mean).total_cmp(&goodness(b.1.mean)))?;
    let is_best = |r: &Repeats| goodness(r.mean) == goodness(best.mean);
    let names = |of: &dyn Fn(&Repeats) -> bool| {
        let found = repeats.iter().filter(|(_, r)| of(r));
        found.map(|(name, _)| (*name).to_owned()).collect()
    };
    let butterworth = repeats.iter().find(|(name, _)| *name == "butterworth");
    Some(Winner {
        criterion: criterion.into(),
        class: class.name(),
        best: names(&|r| is_best(r)),
        not_told_apart: names(&|r| !is_best(r) && !beats(best, r)),
        value: best.mean,
        butterworth_rank: butterworth
            .map(|(_, own)| 1 + repeats.iter().filter(|(_, r)| beats(r, own)).count()),
    })
}

pub fn sentence(winner: &Winner) -> String {
    let name = CRITERIA.iter().find(|c| c.key == winner.criterion).map_or("", |c| c.name);
    let class = Class::ALL.into_iter().find(|class| class.name() == winner.class);
    let mut text = format!("{name}, {}: {}", class.map_or("", Class::text), winner.best.join(", "));
    if !winner.not_told_apart.is_empty() {
        text.push_str(&format!("; cannot be told apart: {}", winner.not_told_apart.join(", ")));
    }
    match winner.butterworth_rank {
        Some(1) | None => {}
        Some(rank) => text.push_str(&format!("; {} are better than butterworth", rank - 1)),
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(better: Better, candidates: &[(&str, &[f64])]) -> Winner {
        let candidates: Vec<(String, Vec<f64>)> =
            candidates.iter().map(|(name, values)| ((*name).into(), values.to_vec())).collect();
        ranked("area_n2_s_per_m2", Class::PositionOnly, better, &candidates).unwrap()
    }

    #[test]
    fn walks_that_scatter_are_not_told_apart_and_do_not_change_a_rank() {
        let winner = of(
            Better::More,
            &[
                ("butterworth", &[96.0, 103.0, 92.0, 101.0]),
                ("kalman-2", &[100.0, 101.0, 99.0, 100.0]),
                ("taylor-2", &[50.0, 51.0, 49.0, 50.0]),
                ("kalman-3", &[98.5, 98.6, 98.4, 98.5]),
            ],
        );
        assert_eq!(winner.best, ["kalman-2"]);
        assert_eq!(winner.not_told_apart, ["butterworth", "kalman-3"]);
        assert_eq!(winner.butterworth_rank, Some(1));
        // The same means without scatter. Here the test shows that two estimators are better than Butterworth.
        let winner = of(
            Better::More,
            &[("butterworth", &[94.0; 4]), ("kalman-2", &[100.0; 4]), ("kalman-3", &[99.0; 4])],
        );
        assert_eq!(winner.not_told_apart, ["kalman-3"]);
        assert_eq!(winner.butterworth_rank, Some(3));
        assert!(sentence(&winner).contains("2 are better than butterworth"));
    }

    #[test]
    fn hits_that_scatter_are_ranked_as_walks_are() {
        let winner = of(
            Better::Less,
            &[
                ("butterworth", &[133.0, 141.0, 154.0, 148.0]),
                ("kalman-2", &[123.0, 150.0, 140.0, 135.0]),
                ("difference", &[317.0, 300.0, 320.0, 330.0]),
                ("foaw-end", &[138.0, 138.1, 138.0, 138.2]),
            ],
        );
        assert_eq!(winner.best, ["kalman-2"]);
        assert_eq!(winner.not_told_apart, ["butterworth", "foaw-end"]);
        assert_eq!(winner.butterworth_rank, Some(1));
        let winner = of(
            Better::Less,
            &[("butterworth", &[144.0, 143.0, 145.0, 144.0]), ("a", &[39.0, 40.0, 41.0, 40.0])],
        );
        assert!(winner.not_told_apart.is_empty());
        assert_eq!(winner.butterworth_rank, Some(2));
    }

    #[test]
    fn what_is_measured_once_has_one_best_unless_it_is_the_same() {
        let winner = of(Better::Less, &[("a", &[1.0]), ("b", &[1.001]), ("butterworth", &[2.0])]);
        assert_eq!((winner.best.len(), winner.butterworth_rank), (1, Some(3)));
        assert!(winner.not_told_apart.is_empty());
        let winner = of(Better::NearerToZero, &[("a", &[-0.5]), ("b", &[0.6]), ("c", &[0.5])]);
        assert_eq!(winner.best, ["a", "c"]);
    }
}
