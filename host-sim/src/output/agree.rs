//! Output of `agree`: both walks as K at each B, whether they agree, and the best explanation of the difference.

use std::fmt::Write as _;

use super::{
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    versioned,
};
use crate::{
    analysis::agree::{Agreement, STARTS},
    notation::rounded,
    scene::Units,
    study::boundary::BoundaryPoint,
};

/// A comparison of two walks, with the names that its output needs.
#[derive(Clone, Copy, Debug)]
pub struct AgreeReport<'a> {
    pub scene: &'a str,
    pub units: Units,
    /// Name of the measured walk's file.
    pub measured: &'a str,
    pub found: &'a Agreement,
}

impl AgreeReport<'_> {
    pub fn text(&self) -> String {
        let ((k_unit, k), (b_unit, b)) = (self.units.written("N/m"), self.units.written("N s/m"));
        let kt = |value: f64| rounded(value * k, 3);
        let mut text = format!(
            "{}, predicted from {STARTS} starts, beside {}\n{:>14} {:>34} {:>16} {:>12}",
            self.scene,
            self.measured,
            format!("B, {b_unit}"),
            format!("predicted K, {k_unit} (range)"),
            "measured K",
            "difference",
        );
        for row in &self.found.rows {
            let range = format!(
                "{} ({} to {})",
                kt(row.predicted),
                kt(row.predicted_low),
                kt(row.predicted_high)
            );
            let _ = write!(
                text,
                "\n{:>14} {range:>34} {:>16} {:>12}",
                Units::told(row.damping_n_s_per_m, b),
                kt(row.measured),
                kt(row.measured - row.predicted),
            );
        }
        let Agreement { step, distance, scatter, .. } = self.found;
        let _ = write!(
            text,
            "\ndistance beyond a step of K ({} {k_unit}): {} {k_unit}; walks of the scene among themselves: up to {} {k_unit}",
            kt(*step),
            kt(*distance),
            kt(*scatter)
        );
        for answer in self.found.answers(self.units) {
            let _ = write!(text, "\n{answer}");
        }
        for row in self.found.suspects(self.units) {
            let edge = if row.at_edge { "; the range ends with what was tried" } else { "" };
            let scene = row.scene.map_or("none".into(), |own| rounded(own, 3).to_string());
            let _ = write!(
                text,
                "\n  {:<18} {} {} ({} to {}), scene {scene}: leaves {} {k_unit}{edge}",
                row.name,
                rounded(row.value, 3),
                row.unit,
                rounded(row.low, 3),
                rounded(row.high, 3),
                kt(row.left_n_per_m),
            );
        }
        text
    }

    /// The table that the option `--csv` writes.
    pub fn csv(&self) -> String {
        versioned(self.found.table()).csv()
    }

    /// Both boundaries, and the boundary that the best explanation predicts.
    pub fn figure(&self) -> Result<Figure, FigureError> {
        let curve = |name: &str, detail: String, of: &dyn Fn(usize) -> f64| {
            let point = |(place, row): (usize, &crate::analysis::agree::Row)| BoundaryPoint {
                damping_n_s_per_m: row.damping_n_s_per_m,
                stiffness_n_per_m: of(place),
            };
            let points = self.found.rows.iter().enumerate().map(point);
            let points = points.filter(|point| point.stiffness_n_per_m > 0.0).collect();
            Curve { name: name.into(), detail, ideal: false, points }
        };
        let rows = &self.found.rows;
        let starts = format!("mean of {STARTS} starts");
        let mut curves = vec![curve("predicted", starts, &|place| rows[place].predicted)];
        let mut subtitle = "they agree".to_owned();
        if let Some(best) = self.found.best().first() {
            let names: Vec<&str> =
                self.found.best().iter().map(|tried| tried.suspect.name).collect();
            let how = if self.found.explains(best) { "explained" } else { "explained in part" };
            subtitle = format!("they differ; {how} by {}", names.join(" or "));
            let detail = format!("what explains the difference best: {}", best.suspect.name);
            let name = format!("with another {}", best.suspect.name);
            let explained = |place: usize| best.predicted.get(place).copied().unwrap_or(0.0);
            curves.push(curve(&name, detail, &explained));
        } else if !self.found.agrees() {
            subtitle = "they differ; nothing that was tried explains it".into();
        }
        // The measured walk is drawn on top of its explanation.
        curves.push(curve("measured", self.measured.into(), &|place| rows[place].measured));
        zwidth(&ZwidthPlot {
            title: format!("Predicted and measured walls, {}", self.scene),
            units: self.units,
            subtitle,
            marked: "ideal",
            legend: "Walk".into(),
            curves,
        })
    }
}
