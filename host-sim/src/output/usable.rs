//! What `compare --usable` writes: a table for programs, one for people, one picture.

use std::fmt::Write as _;

use serde::Serialize;
use zwidth::velocity::EstimatorName;

use super::{
    SCHEMA_VERSION,
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    limits::millions,
};
use crate::{
    analysis::compare::{
        Entry,
        usable::{Usable, UsableQuestion},
    },
    scene::NamedScene,
};

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
    hits: u64,
}

/// A finished study.
#[derive(Clone, Debug)]
pub struct UsableStudy {
    /// What was asked.
    pub question: UsableQuestion,
    /// By estimator, then by limit.
    pub found: Vec<Usable>,
}

impl UsableStudy {
    /// Within one limit, the largest area first.
    fn ranked(&self, limit: f64) -> Vec<&Usable> {
        let mut ranked: Vec<&Usable> = self.found.iter().filter(|u| u.limit == limit).collect();
        ranked.sort_by(|a, b| b.area().total_cmp(&a.area()));
        ranked
    }

    /// Every area, by limit and place.
    pub fn areas(&self) -> Vec<UsableArea> {
        let limits = self.question.limits.iter();
        let placed = limits.flat_map(|&limit| (1..).zip(self.ranked(limit)));
        placed.map(|(place, usable)| area(place, usable)).collect()
    }

    /// `usable.csv`.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "within_percent,place,estimator,tuning,tuning_unit,second,second_unit,search_settled,\
             area_n2_s_per_m2,area_low_n2_s_per_m2,area_high_n2_s_per_m2,stable_area_n2_s_per_m2,\
             stiffness_peak_n_per_m,impedance_error_mean,capped_walks,walks,hits,schema_version\n",
        );
        let cell = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        for a in self.areas() {
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{SCHEMA_VERSION}",
                cell(a.within_percent),
                a.place,
                a.estimator,
                cell(a.tuning),
                a.tuning_unit.unwrap_or_default(),
                cell(a.second),
                a.second_unit.unwrap_or_default(),
                a.search_settled,
                a.area_n2_s_per_m2,
                a.area_low_n2_s_per_m2,
                a.area_high_n2_s_per_m2,
                a.stable_area_n2_s_per_m2,
                a.stiffness_peak_n_per_m,
                a.impedance_error_mean,
                a.capped_walks,
                self.question.budget.repeats,
                a.hits
            );
        }
        text
    }

    /// The largest usable K over B of each estimator, within the first limit that is one.
    ///
    /// # Errors
    /// It cannot be drawn.
    pub fn figure(&self, scene: &NamedScene) -> Result<Figure, FigureError> {
        let limits = self.question.limits.iter().copied();
        let limit = limits.reduce(f64::min).unwrap_or(f64::INFINITY);
        let best = self.ranked(limit).first().map(|best| best.entry);
        let entries: &[Entry] = &self.question.entries;
        let of = |entry: &Entry| self.found.iter().find(|u| u.entry == *entry && u.limit == limit);
        let curve = |usable: &Usable| Curve {
            name: usable.entry.name(),
            detail: format!("{}, {}", usable.entry.name(), tuning(usable)),
            ideal: best == Some(usable.entry),
            points: usable.outline.clone(),
        };
        zwidth(&ZwidthPlot {
            units: scene.scene.units,
            title: format!("Largest usable K, {}", scene.name),
            subtitle: format!(
                "stable, and rendered within {} of K + jwB from 1 to 30 Hz; ideal: the largest area",
                name(limit)
            ),
            legend: "Estimator".into(),
            curves: entries.iter().filter_map(of).map(curve).collect(),
        })
    }

    /// The tables for people.
    pub fn text(&self) -> String {
        let mut text = format!(
            "usable area, 10^6 N^2 s/m^2: walls that are stable and rendered as commanded; {} walks each, > cut at a cap",
            self.question.budget.repeats
        );
        for &limit in &self.question.limits {
            let _ = write!(text, "\n  within {}", name(limit));
            let _ = write!(
                text,
                "\n  {:>2}  {:20} {:>10} {:>10} {:>9} {:>9}  tuning",
                "", "", "area", "stable", "K, kN/m", "error, %"
            );
            for (place, usable) in (1..).zip(self.ranked(limit)) {
                let cut = if usable.boundaries.capped() > 0 { ">" } else { "" };
                let _ = write!(
                    text,
                    "\n  {place:>2}. {:20} {:>10} {:>10} {:>9.1} {:>9.2}  {}",
                    usable.entry.name(),
                    format!("{cut}{}", millions(usable.area())),
                    millions(usable.boundaries.area()),
                    usable.stiffness_peak_n_per_m / 1e3,
                    100.0 * usable.error_mean,
                    tuning(usable)
                );
            }
        }
        let hits: u64 = self.found.iter().map(|usable| usable.hits).sum();
        let _ = write!(text, "\n{hits} wall hits");
        for usable in self.found.iter().filter(|usable| !usable.settled) {
            let (who, limit) = (usable.entry.name(), name(usable.limit));
            let _ = write!(
                text,
                "\n  note: the search for {who} within {limit} has not settled; raise --budget"
            );
        }
        text
    }
}

fn name(limit: f64) -> String {
    if limit.is_finite() { format!("{} %", 100.0 * limit) } else { "any error".into() }
}

/// The values that its tuning has, with units.
fn parameters(usable: &Usable) -> [Option<(f64, &'static str)>; 2] {
    let (name, values) = EstimatorName::of(&usable.settings);
    let all = name.parameters();
    [0, 1].map(|n| all[n].map(|parameter| (values[n], parameter.unit)))
}

fn tuning(usable: &Usable) -> String {
    let of = |(value, unit): (f64, &str)| match unit {
        "1" => format!("{value:.3}"),
        _ => format!("{value:.3} {unit}"),
    };
    parameters(usable).into_iter().flatten().map(of).collect::<Vec<String>>().join(", ")
}

fn area(place: usize, usable: &Usable) -> UsableArea {
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
        hits: usable.hits,
    }
}
