//! Output of `compare --usable`: a table for programs, a table for people, a figure.

use std::fmt::Write as _;

use super::{
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    limits::{area_text, areas_in, stiffness_in},
    versioned,
};
use crate::{
    analysis::compare::{
        Entry,
        usable::{Usable, UsableStudy, parameters},
    },
    scene::{NamedScene, Units},
};

pub fn csv(study: &UsableStudy) -> String {
    versioned(study.table()).csv()
}

/// The largest usable K of each estimator over B, within the smallest error limit.
pub fn figure(study: &UsableStudy, scene: &NamedScene) -> Result<Figure, FigureError> {
    let limits = study.question.limits.iter().copied();
    let limit = limits.reduce(f64::min).unwrap_or(f64::INFINITY);
    let best = study.ranked(limit).first().map(|best| best.entry);
    let entries: &[Entry] = &study.question.entries;
    let of = |entry: &Entry| study.found.iter().find(|u| u.entry == *entry && u.limit == limit);
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
        marked: "ideal",
        legend: "Estimator".into(),
        curves: entries.iter().filter_map(of).map(curve).collect(),
    })
}

pub fn text(study: &UsableStudy, units: Units) -> String {
    let (stiffness_unit, stiffness_factor) = stiffness_in(units);
    let mut text = format!(
        "usable area, {}: walls that are stable and rendered as commanded; {} walks each, > cut at a cap",
        areas_in(units).0,
        study.question.budget.repeats
    );
    for &limit in &study.question.limits {
        let _ = write!(text, "\n  within {}", name(limit));
        let _ = write!(
            text,
            "\n                                 area     stable  {:>8}  error, %  tuning",
            format!("K, {stiffness_unit}")
        );
        for (place, usable) in (1..).zip(study.ranked(limit)) {
            let cut = if usable.boundaries.capped() > 0 { ">" } else { "" };
            let _ = write!(
                text,
                "\n  {place:>2}. {:20} {:>10} {:>10} {:>9.1} {:>9.2}  {}",
                usable.entry.name(),
                format!("{cut}{}", area_text(usable.area(), units)),
                area_text(usable.boundaries.area(), units),
                usable.stiffness_peak_n_per_m * stiffness_factor,
                100.0 * usable.error_mean,
                tuning(usable)
            );
        }
    }
    let hits: u64 = study.found.iter().map(|usable| usable.hits).sum();
    let _ = write!(text, "\n{hits} wall hits");
    for usable in study.found.iter().filter(|usable| !usable.settled) {
        let (who, limit) = (usable.entry.name(), name(usable.limit));
        let _ = write!(
            text,
            "\n  note: the search for {who} within {limit} has not settled; raise --budget"
        );
    }
    text
}

fn name(limit: f64) -> String {
    if limit.is_finite() { format!("{} %", 100.0 * limit) } else { "any error".into() }
}

fn tuning(usable: &Usable) -> String {
    let of = |(value, unit): (f64, &str)| match unit {
        "1" => format!("{value:.3}"),
        _ => format!("{value:.3} {unit}"),
    };
    parameters(usable).into_iter().flatten().map(of).collect::<Vec<String>>().join(", ")
}
