//! Areas of other systems' defaults, as a table and as JSON.

use serde::{Serialize, Serializer};

use super::{PeerStudy, Row};
use crate::{
    study::{
        boundary::Boundaries,
        limits_asked::{GRID, grid},
    },
    table::{Cell, Kind, Table, Told},
};

/// The area that an estimator reaches at one limit. `limit` is the limit's index.
#[derive(Clone, Copy, Debug)]
pub struct PeerArea<'a> {
    study: &'a PeerStudy,
    row: &'a Row,
    limit: usize,
}

impl PeerArea<'_> {
    pub fn boundaries(&self) -> &Boundaries {
        &self.row.boundaries[self.limit]
    }

    /// Area divided by the area that the true velocity reaches in the same loop at the same limit.
    pub fn share_of_true_velocity(&self) -> Option<f64> {
        let told = self.study.told_area(self.row.of_loop, self.limit).filter(|told| *told > 0.0);
        told.map(|told| self.boundaries().area() / told)
    }

    fn limit(&self) -> (f64, &'static str) {
        self.study.question.limits[self.limit].told()
    }

    fn scene(&self) -> &crate::scene::Scene {
        &self.study.question.loops[self.row.of_loop].1
    }
}

impl PeerArea<'_> {
    const COLUMNS: [Told<Self>; 14] = [
        ("loop", Kind::Text, |a| a.study.question.loops[a.row.of_loop].0.clone().into()),
        ("latency_samples", Kind::Number, |a| a.scene().actuator.latency.into()),
        ("push", Kind::Text, |a| a.scene().wall_hit.push_by.name().into()),
        ("estimator", Kind::Text, |a| a.row.name.clone().into()),
        ("does", Kind::Text, |a| Cell::Quoted(a.row.does.clone().into())),
        ("source", Kind::Text, |a| Cell::Quoted(a.row.source.into())),
        ("limit", Kind::Number, |a| a.limit().0.into()),
        ("limit_unit", Kind::Text, |a| a.limit().1.into()),
        ("area_n2_s_per_m2", Kind::Number, |a| a.boundaries().area().into()),
        ("area_low_n2_s_per_m2", Kind::Number, |a| a.boundaries().area_range()[0].into()),
        ("area_high_n2_s_per_m2", Kind::Number, |a| a.boundaries().area_range()[1].into()),
        ("share_of_true_velocity", Kind::Number, |a| Cell::number(a.share_of_true_velocity())),
        ("stiffness_peak_n_per_m", Kind::Number, |a| {
            a.boundaries().stiffness_peak_n_per_m().into()
        }),
        ("capped_walks", Kind::Whole, |a| Cell::count(a.boundaries().capped())),
    ];
}

impl Serialize for PeerArea<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(Self::COLUMNS.iter().map(|(name, _, cell)| (name, cell(self))))
    }
}

impl PeerStudy {
    pub fn areas(&self) -> Vec<PeerArea<'_>> {
        let limits = 0..self.question.limits.len();
        let of = |row| limits.clone().map(move |limit| self.area(row, limit));
        self.rows.iter().flat_map(of).collect()
    }

    /// The area that an estimator reaches at the limit with this index.
    pub fn area<'a>(&'a self, row: &'a Row, limit: usize) -> PeerArea<'a> {
        PeerArea { study: self, row, limit }
    }

    /// Every area, with the number of walks and the grid.
    pub fn table(&self) -> Table {
        let mut table = Table::of(&PeerArea::COLUMNS, &self.areas());
        let numbers = GRID.map(|name| (name, Kind::Number));
        table
            .columns
            .extend(Table::new([("walks", Kind::Whole)].into_iter().chain(numbers)).columns);
        for row in &mut table.rows {
            row.push(Cell::Whole(self.question.repeats.into()));
            row.extend(grid(&self.question.walk).map(Cell::Number));
        }
        table
    }
}
