//! Output of `passivity`: a table for programs, a table for people, a figure.

use std::fmt::Write as _;

use serde::Serialize;

use super::{
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    limits::{areas_in, grid_text, name, name_in},
    versioned,
};
use crate::{
    analysis::{
        explain::table::digits,
        passive::{Hits, PassiveRow, PassiveStudy},
    },
    scene::{NamedScene, Units},
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
            "limit {}; with the controller a contact gives at most {} mJ",
            first.map(name).unwrap_or_default(),
            digits(1e3 * study.reserve_j)
        ),
        marked: "ideal",
        legend: "Cutoff, controller".into(),
        curves: rows.map(curve).collect(),
    })
}

pub fn text(study: &PassiveStudy, units: Units) -> String {
    let (area_unit, factor) = areas_in(units);
    let mut text = format!(
        "with the controller a contact gives at most {} mJ\n  areas in {area_unit}, walks for each: {}; >: a cap of the \
         walk cuts the area\n  {}\n  hits at the walls of one boundary (found with or without the controller): the most \
         energy that a contact gave,\n  share of the force that was withheld, RMS of the motion, RMS of the force above \
         100 Hz\n",
        digits(1e3 * study.reserve_j),
        study.question.repeats,
        grid_text(&study.question.walk, units)
    );
    text += "           limit     cutoff controller     area  boundary  given, mJ  withheld  RMS, um  rough, N";
    for row in &study.rows {
        let cut = if row.boundaries.capped() > 0 { ">" } else { "" };
        let area = format!("{cut}{}", digits(factor * row.boundaries.area()));
        let controller = with(row.controller);
        let cutoff = cutoff(row.cutoff_hz);
        for (of, hits) in ["without", "with"].into_iter().zip(&row.hits) {
            if hits.walls == 0 {
                continue;
            }
            let _ = write!(
                text,
                "\n  {:>14} {cutoff:>10} {controller:>10} {area:>8}  {of:>8} {:>10} {:>7.2} % {:>8} {:>9}",
                name_in(row.limit, units),
                digits(1e3 * hits.given_j),
                100.0 * hits.withheld_fraction,
                digits(1e6 * hits.rms_motion_m),
                digits(hits.roughness_n)
            );
        }
    }
    text += "\n  hits of other lengths at the walls of the boundary without the controller: the most energy given, by the counts \
             and by the\n  true motion; power that the hum takes from the wall; share of the force withheld, mean and most; \
             sag: penetration\n  divided by push / K\n           limit     cutoff controller   length  given, mJ  by motion   hum, \
             mW  withheld      most    sag";
    for row in &study.lengths {
        let _ = write!(
            text,
            "\n  {:>14} {:>10} {:>10} {:>6} s {:>10} {:>10} {:>9} {:>7.2} % {:>7.2} % {:>6}",
            name_in(row.limit, units),
            cutoff(row.cutoff_hz),
            with(row.controller),
            row.settle_s,
            digits(1e3 * row.given_j),
            digits(1e3 * row.given_by_motion_j),
            digits(1e3 * row.fed_w),
            100.0 * row.withheld_fraction,
            100.0 * row.withheld_most_fraction,
            digits(row.sag)
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
