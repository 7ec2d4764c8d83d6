//! Output of `passivity`: a table for programs, a table for people, a figure.

use std::fmt::Write as _;

use serde::Serialize;

use super::{
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    limits::{grid_text, millions, name},
    versioned,
};
use crate::{
    analysis::passive::{Hits, PassiveRow, PassiveStudy},
    scene::NamedScene,
};

#[derive(Clone, Debug, Serialize)]
pub struct PassiveArea {
    cutoff_hz: Option<f64>,
    limit: f64,
    limit_unit: &'static str,
    controller: bool,
    area_n2_s_per_m2: f64,
    area_low_n2_s_per_m2: f64,
    area_high_n2_s_per_m2: f64,
    stiffness_peak_n_per_m: f64,
    capped_walks: usize,
    /// Hits on the boundary's walls without the controller.
    at_boundary_without: Hits,
    /// Hits on the boundary's walls with the controller. `None` if the controller is off.
    at_boundary_with: Option<Hits>,
}

pub fn areas(study: &PassiveStudy) -> Vec<PassiveArea> {
    study.rows.iter().map(area).collect()
}

pub fn csv(study: &PassiveStudy) -> String {
    versioned(study.table()).csv()
}

pub fn lengths_csv(study: &PassiveStudy) -> String {
    versioned(study.length_table()).csv()
}

/// The boundaries for the first limit, without and with the controller.
pub fn figure(study: &PassiveStudy, scene: &NamedScene) -> Result<Figure, FigureError> {
    let first = study.rows.first().map(|row| row.limit);
    let rows = study.rows.iter().filter(|row| Some(row.limit) == first);
    let curve = |row: &PassiveRow| Curve {
        name: told(row),
        detail: told(row),
        ideal: false,
        points: row.boundaries.first().map(|first| first.points.clone()).unwrap_or_default(),
    };
    zwidth(&ZwidthPlot {
        units: scene.scene.units,
        title: format!("Stable walls with a passivity controller, {}", scene.name),
        subtitle: format!(
            "limit {}; a contact gives at most {:.3e} J with it",
            first.map(name).unwrap_or_default(),
            study.reserve_j
        ),
        marked: "ideal",
        legend: "Cutoff, controller".into(),
        curves: rows.map(curve).collect(),
    })
}

pub fn text(study: &PassiveStudy) -> String {
    let mut text = format!(
        "with the controller a contact gives at most {:.3e} J; {} walks each, > cut at a cap\n  {}\n  hits at walls of \
         the boundary: most given in a contact, force withheld, RMS of the motion, force above 100 Hz\n",
        study.reserve_j,
        study.question.repeats,
        grid_text(&study.question.walk)
    );
    text += "           limit     cutoff controller     area  walls of    given, J  withheld  RMS, um  rough, N";
    for row in &study.rows {
        let cut = if row.boundaries.capped() > 0 { ">" } else { "" };
        let area = format!("{cut}{}", millions(row.boundaries.area()));
        let controller = with(row.controller);
        let cutoff = cutoff(row.cutoff_hz);
        for (of, hits) in ["without", "with"].into_iter().zip(&row.hits) {
            if hits.walls == 0 {
                continue;
            }
            let _ = write!(
                text,
                "\n  {:>14} {cutoff:>10} {controller:>10} {area:>8}  {of:>8} {:>11.3e} {:>7.2} % {:>8.2} {:>9.4}",
                name(row.limit),
                hits.given_j,
                100.0 * hits.withheld_fraction,
                1e6 * hits.rms_motion_m,
                hits.roughness_n
            );
        }
    }
    text += "\n  area in 10^6 N^2 s/m^2\n  the walls of the boundary without, by the length of the hit: most given by counts and by \
             the motion, fed by the hum,\n  force withheld, mean and most, and how far the wall sags";
    for row in &study.lengths {
        let _ = write!(
            text,
            "\n  {:>14} {:>10} {:>10} {:>6} s {:>11.3e} J {:>11.3e} J {:>11.3e} W {:>7.2} % {:>7.2} % {:>6.3}",
            name(row.limit),
            cutoff(row.cutoff_hz),
            with(row.controller),
            row.settle_s,
            row.given_j,
            row.given_by_motion_j,
            row.fed_w,
            100.0 * row.withheld_fraction,
            100.0 * row.withheld_most_fraction,
            row.sag
        );
    }
    text
}

fn told(row: &PassiveRow) -> String {
    format!("{}, {}", cutoff(row.cutoff_hz), with(row.controller))
}

fn with(controller: bool) -> &'static str {
    if controller { "with" } else { "without" }
}

fn cutoff(cutoff_hz: Option<f64>) -> String {
    cutoff_hz.map_or_else(|| "no cutoff".into(), |cutoff_hz| format!("{cutoff_hz} Hz"))
}

fn area(row: &PassiveRow) -> PassiveArea {
    let (limit, limit_unit) = row.limit.told();
    let [low, high] = row.boundaries.area_range();
    let [without, with] = row.hits;
    PassiveArea {
        cutoff_hz: row.cutoff_hz,
        limit,
        limit_unit,
        controller: row.controller,
        area_n2_s_per_m2: row.boundaries.area(),
        area_low_n2_s_per_m2: low,
        area_high_n2_s_per_m2: high,
        stiffness_peak_n_per_m: row.boundaries.stiffness_peak_n_per_m(),
        capped_walks: row.boundaries.capped(),
        at_boundary_without: without,
        at_boundary_with: row.controller.then_some(with),
    }
}
