//! What `compare --peers` writes: a table for programs, one for people.

use std::fmt::Write as _;

use serde::Serialize;

use super::{
    SCHEMA_VERSION,
    limits::{grid, grid_text, millions, name, value},
};
use crate::analysis::compare::peers::{PeerStudy, Row};

/// One area.
#[derive(Clone, Debug, Serialize)]
pub struct PeerArea {
    /// Name of the loop: the scene's own, or that of a board.
    #[serde(rename = "loop")]
    of_loop: String,
    /// Samples from the reading of the encoder to the force.
    latency_samples: f64,
    push: &'static str,
    /// Who has this default; the scene's own estimator; the true velocity.
    estimator: String,
    does: String,
    source: &'static str,
    limit: f64,
    limit_unit: &'static str,
    area_n2_s_per_m2: f64,
    area_low_n2_s_per_m2: f64,
    area_high_n2_s_per_m2: f64,
    share_of_true_velocity: Option<f64>,
    stiffness_peak_n_per_m: f64,
    capped_walks: usize,
}

/// A finished study of the defaults of other systems.
#[derive(Clone, Debug)]
pub struct Peers(pub PeerStudy);

impl Peers {
    /// Every area.
    pub fn areas(&self) -> Vec<PeerArea> {
        let rows =
            self.0.rows.iter().flat_map(|row| (0..row.boundaries.len()).map(move |n| (row, n)));
        rows.map(|(row, n)| self.area(row, n)).collect()
    }

    fn area(&self, row: &Row, limit: usize) -> PeerArea {
        let of_loop = &self.0.question.loops[row.of_loop];
        let boundaries = &row.boundaries[limit];
        let [low, high] = boundaries.area_range();
        let (limit_value, limit_unit) = value(self.0.question.limits[limit]);
        let told = self.0.told_area(row.of_loop, limit).filter(|told| *told > 0.0);
        PeerArea {
            of_loop: of_loop.name.clone(),
            latency_samples: of_loop.scene.actuator.latency,
            push: of_loop.scene.wall_hit.push_by.name(),
            estimator: row.name.clone(),
            does: row.does.clone(),
            source: row.source,
            limit: limit_value,
            limit_unit,
            area_n2_s_per_m2: boundaries.area(),
            area_low_n2_s_per_m2: low,
            area_high_n2_s_per_m2: high,
            share_of_true_velocity: told.map(|told| boundaries.area() / told),
            stiffness_peak_n_per_m: boundaries.stiffness_peak_n_per_m(),
            capped_walks: boundaries.capped(),
        }
    }

    /// `peers.csv`.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "loop,latency_samples,push,estimator,does,source,limit,limit_unit,area_n2_s_per_m2,\
             area_low_n2_s_per_m2,area_high_n2_s_per_m2,share_of_true_velocity,stiffness_peak_n_per_m,\
             capped_walks,walks,stiffness_start_n_per_m,stiffness_step_n_per_m,stiffness_max_n_per_m,\
             damping_start_n_s_per_m,damping_step_n_s_per_m,damping_max_tried_n_s_per_m,schema_version\n",
        );
        let grid = grid(&self.0.question.walk).map(|value| value.to_string()).join(",");
        for a in self.areas() {
            let share = a.share_of_true_velocity.map(|share| share.to_string()).unwrap_or_default();
            let _ = writeln!(
                text,
                "{},{},{},{},\"{}\",\"{}\",{},{},{},{},{},{share},{},{},{},{grid},{SCHEMA_VERSION}",
                a.of_loop,
                a.latency_samples,
                a.push,
                a.estimator,
                a.does,
                a.source,
                a.limit,
                a.limit_unit,
                a.area_n2_s_per_m2,
                a.area_low_n2_s_per_m2,
                a.area_high_n2_s_per_m2,
                a.stiffness_peak_n_per_m,
                a.capped_walks,
                self.0.question.repeats
            );
        }
        text
    }

    /// The tables for people.
    pub fn text(&self) -> String {
        let mut text = format!(
            "area by limit of the motion, 10^6 N^2 s/m^2, and its share of what the true velocity reaches; > cut at a cap\n  \
             untuned defaults; {} walks each; {}",
            self.0.question.repeats,
            grid_text(&self.0.question.walk)
        );
        let width = self.0.rows.iter().map(|row| row.name.len()).max().unwrap_or(0);
        for (place, of_loop) in self.0.question.loops.iter().enumerate() {
            let _ = write!(
                text,
                "\n  loop of {}, latency {} samples, the {} pushes\n  {:width$}",
                of_loop.name,
                of_loop.scene.actuator.latency,
                of_loop.scene.wall_hit.push_by.name(),
                ""
            );
            for limit in &self.0.question.limits {
                let _ = write!(text, "  {:>14}", name(*limit));
            }
            for row in self.0.rows.iter().filter(|row| row.of_loop == place) {
                let _ = write!(text, "\n  {:width$}", row.name);
                for n in 0..row.boundaries.len() {
                    let a = self.area(row, n);
                    let cut = if a.capped_walks > 0 { ">" } else { "" };
                    let share = a.share_of_true_velocity.unwrap_or_default() * 100.0;
                    let digits = usize::from(share < 9.95);
                    let cell = format!("{cut}{} {share:5.digits$} %", millions(a.area_n2_s_per_m2));
                    let _ = write!(text, "  {cell:>14}");
                }
            }
        }
        text.push_str("\n  where each stands");
        for row in self.0.rows.iter().filter(|row| row.of_loop == 0) {
            let source = if row.source.is_empty() { "" } else { "; " };
            let _ = write!(text, "\n  {:width$}  {}{source}{}", row.name, row.does, row.source);
        }
        for note in &self.0.notes {
            let _ = write!(text, "\n  note: {note}");
        }
        text
    }
}
