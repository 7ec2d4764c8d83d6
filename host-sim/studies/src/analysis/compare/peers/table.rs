//! The areas of other systems' defaults as a table and as JSON.

use serde::Serialize;

use super::{PeerStudy, Row};
use crate::{
    study::limits_asked::{GRID, grid},
    table::{Cell, Kind, Table},
};

#[derive(Clone, Debug, Serialize)]
pub struct PeerArea {
    /// Name of the loop: the scene's own, or that of a board.
    #[serde(rename = "loop")]
    pub of_loop: String,
    /// Samples from the reading of the encoder to the force.
    pub latency_samples: f64,
    pub push: &'static str,
    /// Who has this default; the scene's own estimator; the true velocity.
    pub estimator: String,
    pub does: String,
    pub source: &'static str,
    /// Limit of the RMS of the motion, or of the sensation level.
    pub limit: f64,
    pub limit_unit: &'static str,
    /// Mean of the walks.
    pub area_n2_s_per_m2: f64,
    pub area_low_n2_s_per_m2: f64,
    pub area_high_n2_s_per_m2: f64,
    /// Area over that of the true velocity in this loop, at this limit.
    pub share_of_true_velocity: Option<f64>,
    /// Largest K of any walk.
    pub stiffness_peak_n_per_m: f64,
    /// Walks that a cap cut.
    pub capped_walks: usize,
}

/// A column: its name, what it holds, and its cell of an area.
type Column = (&'static str, Kind, fn(&PeerArea) -> Cell);

const COLUMNS: [Column; 14] = [
    ("loop", Kind::Text, |a| a.of_loop.clone().into()),
    ("latency_samples", Kind::Number, |a| a.latency_samples.into()),
    ("push", Kind::Text, |a| a.push.into()),
    ("estimator", Kind::Text, |a| a.estimator.clone().into()),
    ("does", Kind::Text, |a| Cell::Quoted(a.does.clone().into())),
    ("source", Kind::Text, |a| Cell::Quoted(a.source.into())),
    ("limit", Kind::Number, |a| a.limit.into()),
    ("limit_unit", Kind::Text, |a| a.limit_unit.into()),
    ("area_n2_s_per_m2", Kind::Number, |a| a.area_n2_s_per_m2.into()),
    ("area_low_n2_s_per_m2", Kind::Number, |a| a.area_low_n2_s_per_m2.into()),
    ("area_high_n2_s_per_m2", Kind::Number, |a| a.area_high_n2_s_per_m2.into()),
    ("share_of_true_velocity", Kind::Number, |a| Cell::number(a.share_of_true_velocity)),
    ("stiffness_peak_n_per_m", Kind::Number, |a| a.stiffness_peak_n_per_m.into()),
    ("capped_walks", Kind::Whole, |a| Cell::count(a.capped_walks)),
];

impl PeerStudy {
    pub fn areas(&self) -> Vec<PeerArea> {
        let rows =
            self.rows.iter().flat_map(|row| (0..row.boundaries.len()).map(move |n| (row, n)));
        rows.map(|(row, n)| self.area(row, n)).collect()
    }

    /// That of a row at the limit of that place.
    pub fn area(&self, row: &Row, limit: usize) -> PeerArea {
        let of_loop = &self.question.loops[row.of_loop];
        let boundaries = &row.boundaries[limit];
        let [low, high] = boundaries.area_range();
        let (limit_value, limit_unit) = self.question.limits[limit].told();
        let told = self.told_area(row.of_loop, limit).filter(|told| *told > 0.0);
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

    /// Every area, with walks and grid.
    pub fn table(&self) -> Table {
        let own = COLUMNS.map(|(name, kind, _)| (name, kind));
        let grid_columns = GRID.map(|name| (name, Kind::Number));
        let mut table =
            Table::new(own.into_iter().chain([("walks", Kind::Whole)]).chain(grid_columns));
        for area in self.areas() {
            let mut row: Vec<Cell> = COLUMNS.iter().map(|(.., cell)| cell(&area)).collect();
            row.push(Cell::Whole(self.question.repeats.into()));
            row.extend(grid(&self.question.walk).map(Cell::Number));
            table.rows.push(row);
        }
        table
    }
}
