//! Usable areas as a table and as JSON.

use serde::Serialize;
use zwidth::velocity::EstimatorName;

use super::{Usable, UsableQuestion};
use crate::table::{Cell, Kind, Table};

/// One estimator within one limit.
#[derive(Clone, Debug, Serialize)]
pub struct UsableArea {
    /// Limit of the error, %; `null`: any error.
    within_percent: Option<f64>,
    /// By the mean area, from 1, within this limit.
    place: usize,
    estimator: String,
    tuning: Option<f64>,
    tuning_unit: Option<&'static str>,
    second: Option<f64>,
    second_unit: Option<&'static str>,
    search_settled: bool,
    area_n2_s_per_m2: f64,
    area_low_n2_s_per_m2: f64,
    area_high_n2_s_per_m2: f64,
    stable_area_n2_s_per_m2: f64,
    stiffness_peak_n_per_m: f64,
    impedance_error_mean: f64,
    capped_walks: usize,
    #[serde(skip)]
    walks: u32,
    hits: u64,
}

/// A column: its name, what it holds, and its cell of an area.
type Column = (&'static str, Kind, fn(&UsableArea) -> Cell);

const COLUMNS: [Column; 17] = [
    ("within_percent", Kind::Number, |a| Cell::number(a.within_percent)),
    ("place", Kind::Whole, |a| Cell::count(a.place)),
    ("estimator", Kind::Text, |a| a.estimator.clone().into()),
    ("tuning", Kind::Number, |a| Cell::number(a.tuning)),
    ("tuning_unit", Kind::Text, |a| Cell::text(a.tuning_unit)),
    ("second", Kind::Number, |a| Cell::number(a.second)),
    ("second_unit", Kind::Text, |a| Cell::text(a.second_unit)),
    ("search_settled", Kind::Flag, |a| a.search_settled.into()),
    ("area_n2_s_per_m2", Kind::Number, |a| a.area_n2_s_per_m2.into()),
    ("area_low_n2_s_per_m2", Kind::Number, |a| a.area_low_n2_s_per_m2.into()),
    ("area_high_n2_s_per_m2", Kind::Number, |a| a.area_high_n2_s_per_m2.into()),
    ("stable_area_n2_s_per_m2", Kind::Number, |a| a.stable_area_n2_s_per_m2.into()),
    ("stiffness_peak_n_per_m", Kind::Number, |a| a.stiffness_peak_n_per_m.into()),
    ("impedance_error_mean", Kind::Number, |a| a.impedance_error_mean.into()),
    ("capped_walks", Kind::Whole, |a| Cell::count(a.capped_walks)),
    ("walks", Kind::Whole, |a| Cell::Whole(a.walks.into())),
    ("hits", Kind::Whole, |a| Cell::Whole(a.hits)),
];

#[derive(Clone, Debug)]
pub struct UsableStudy {
    pub question: UsableQuestion,
    /// By estimator, then by limit.
    pub found: Vec<Usable>,
}

impl UsableStudy {
    /// Within one limit, the largest area first.
    pub fn ranked(&self, limit: f64) -> Vec<&Usable> {
        let mut ranked: Vec<&Usable> = self.found.iter().filter(|u| u.limit == limit).collect();
        ranked.sort_by(|a, b| b.area().total_cmp(&a.area()));
        ranked
    }

    /// Every area, by limit and place.
    pub fn areas(&self) -> Vec<UsableArea> {
        let limits = self.question.limits.iter();
        let placed = limits.flat_map(|&limit| (1..).zip(self.ranked(limit)));
        let walks = self.question.budget.repeats;
        placed.map(|(place, usable)| area(place, usable, walks)).collect()
    }

    /// The same as rows.
    pub fn table(&self) -> Table {
        let mut table = Table::new(COLUMNS.map(|(name, kind, _)| (name, kind)));
        let row = |area: &UsableArea| COLUMNS.iter().map(|(.., cell)| cell(area)).collect();
        table.rows = self.areas().iter().map(row).collect();
        table
    }
}

/// The values that its tuning has, with units.
pub fn parameters(usable: &Usable) -> [Option<(f64, &'static str)>; 2] {
    let (name, values) = EstimatorName::of(&usable.settings);
    let all = name.parameters();
    [0, 1].map(|n| all[n].map(|parameter| (values[n], parameter.unit)))
}

fn area(place: usize, usable: &Usable, walks: u32) -> UsableArea {
    let [tuning, second] = parameters(usable);
    let [low, high] =
        [f64::min, f64::max].map(|of| usable.areas.iter().copied().reduce(of).unwrap_or(0.0));
    UsableArea {
        within_percent: usable.limit.is_finite().then_some(100.0 * usable.limit),
        place,
        estimator: usable.entry.name(),
        tuning: tuning.map(|(value, _)| value),
        tuning_unit: tuning.map(|(_, unit)| unit),
        second: second.map(|(value, _)| value),
        second_unit: second.map(|(_, unit)| unit),
        search_settled: usable.settled,
        area_n2_s_per_m2: usable.area(),
        area_low_n2_s_per_m2: low,
        area_high_n2_s_per_m2: high,
        stable_area_n2_s_per_m2: usable.boundaries.area(),
        stiffness_peak_n_per_m: usable.stiffness_peak_n_per_m,
        impedance_error_mean: usable.error_mean,
        capped_walks: usable.boundaries.capped(),
        walks,
        hits: usable.hits,
    }
}
