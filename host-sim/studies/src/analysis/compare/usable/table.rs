//! Usable areas as a table and as JSON.

use serde::{Serialize, Serializer};

use super::{super::table::value_and_unit, Usable, UsableQuestion};
use crate::table::{Cell, Kind, Table, Told};

/// One estimator within one limit, with its rank and its number of walks. The largest mean area has rank 1.
#[derive(Clone, Copy, Debug)]
pub struct UsableArea<'a> {
    place: usize,
    usable: &'a Usable,
    walks: u32,
}

impl UsableArea<'_> {
    /// The tuned parameter with the index `n`, and its unit.
    fn parameter(&self, n: usize) -> [Cell; 2] {
        value_and_unit(&self.usable.settings, n)
    }

    fn least_or_most(&self, of: fn(f64, f64) -> f64) -> Cell {
        self.usable.areas.iter().copied().reduce(of).unwrap_or(0.0).into()
    }
}

impl UsableArea<'_> {
    /// All columns. The JSON leaves out the number of walks.
    const COLUMNS: [Told<Self>; 17] = [
        ("within_percent", Kind::Number, |a| {
            Cell::number(a.usable.limit.is_finite().then_some(100.0 * a.usable.limit))
        }),
        ("place", Kind::Whole, |a| Cell::count(a.place)),
        ("estimator", Kind::Text, |a| a.usable.entry.name().into()),
        ("tuning", Kind::Number, |a| a.parameter(0)[0].clone()),
        ("tuning_unit", Kind::Text, |a| a.parameter(0)[1].clone()),
        ("second", Kind::Number, |a| a.parameter(1)[0].clone()),
        ("second_unit", Kind::Text, |a| a.parameter(1)[1].clone()),
        ("search_settled", Kind::Flag, |a| a.usable.settled.into()),
        ("area_n2_s_per_m2", Kind::Number, |a| a.usable.area().into()),
        ("area_low_n2_s_per_m2", Kind::Number, |a| a.least_or_most(f64::min)),
        ("area_high_n2_s_per_m2", Kind::Number, |a| a.least_or_most(f64::max)),
        ("stable_area_n2_s_per_m2", Kind::Number, |a| a.usable.boundaries.area().into()),
        ("stiffness_peak_n_per_m", Kind::Number, |a| a.usable.stiffness_peak_n_per_m.into()),
        ("impedance_error_mean", Kind::Number, |a| a.usable.error_mean.into()),
        ("capped_walks", Kind::Whole, |a| Cell::count(a.usable.boundaries.capped())),
        ("walks", Kind::Whole, |a| Cell::Whole(a.walks.into())),
        ("hits", Kind::Whole, |a| Cell::Whole(a.usable.hits)),
    ];
}

impl Serialize for UsableArea<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let told = Self::COLUMNS.iter().filter(|(name, ..)| *name != "walks");
        serializer.collect_map(told.map(|(name, _, cell)| (name, cell(self))))
    }
}

#[derive(Clone, Debug)]
pub struct UsableStudy {
    pub question: UsableQuestion,
    /// The results, ordered by estimator, then by limit.
    pub found: Vec<Usable>,
}

impl UsableStudy {
    /// The results within one limit. The largest area comes first.
    pub fn ranked(&self, limit: f64) -> Vec<&Usable> {
        let mut ranked: Vec<&Usable> = self.found.iter().filter(|u| u.limit == limit).collect();
        ranked.sort_by(|a, b| b.area().total_cmp(&a.area()));
        ranked
    }

    /// Every area, ordered by limit, then by rank.
    pub fn areas(&self) -> Vec<UsableArea<'_>> {
        let walks = self.question.budget.repeats;
        let of_limit = |&limit: &f64| {
            (1..).zip(self.ranked(limit)).map(move |(place, usable)| UsableArea {
                place,
                usable,
                walks,
            })
        };
        self.question.limits.iter().flat_map(of_limit).collect()
    }

    pub fn table(&self) -> Table {
        Table::of(&UsableArea::COLUMNS, &self.areas())
    }
}

/// The tuned parameters, each with its unit.
pub fn parameters(usable: &Usable) -> [Option<(f64, &'static str)>; 2] {
    [0, 1].map(|n| usable.settings.parameter(n).map(|(of, value)| (value, of.unit)))
}
