//! Output of `explain`: a ranked table for programs, a table for people, a figure of the boundaries.

use std::fmt::Write as _;

use super::{
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    limits::stiffness_in,
    report, versioned,
};
use crate::{
    analysis::explain::{
        Change, Explained, Explanation, Kind,
        table::{Row, digits},
    },
    scene::Units,
};
use sim_studies::table::Cell;

/// A noise as text. The form suits numbers of any order of magnitude.
fn noise(value: f64) -> String {
    if (0.01..1e4).contains(&value) { digits(value) } else { format!("{value:.2e}") }
}

/// Number of changes whose boundaries the figure shows.
const DRAWN: usize = 4;

/// The factor by which the area changes, with its range. A `?` means that the start positions cannot distinguish the
/// factor from 1.
fn times(row: &Row<'_>) -> String {
    let Some(times) = row.times() else { return String::new() };
    let [mean, low, high] = times.map(digits);
    let mark = if row.better() == "unsure" { "?" } else { "" };
    format!("{mean}{mark} ({low} to {high})")
}

/// The area, multiplied by `times`. A `>` means that a cap of the walk limits the area.
fn area(row: &Row<'_>, times: f64) -> String {
    let cut = if row.one.boundaries.capped() > 0 { ">" } else { "" };
    format!("{cut}{}", digits(row.one.area()[0] * times))
}

/// Share of the core's time that the estimator takes, in percent.
fn share(row: &Row<'_>) -> String {
    row.share_of_core().map_or("?".into(), |share| format!("{:.2}", 100.0 * share))
}

/// Cells for people. Areas, stiffnesses and velocities are multiplied by the given factors.
fn cells(row: &Row<'_>, [area, k, v]: [f64; 3]) -> [String; 10] {
    [
        if row.rank == 0 { String::new() } else { row.rank.to_string() },
        row.one.change.text.clone(),
        times(row),
        self::area(row, area),
        row.scene_area().map_or_else(String::new, |of_scene| digits(area * of_scene)),
        digits(k * row.one.stiffness_peak()[0]),
        digits(k * row.stiffness()[0]),
        noise(v * row.one.noise_m_per_s),
        share(row),
        row.one.change.cost.clone(),
    ]
}

/// An explanation, with the names that its output needs.
pub struct ExplainReport<'a> {
    pub scene: &'a str,
    /// Name of the criterion that the search used.
    pub criterion: &'static str,
    pub units: Units,
    pub found: &'a Explanation,
}

/// The units that tables for people use, and the factor of the numbers for each unit.
struct Spoken {
    k: (&'static str, f64),
    v: (&'static str, f64),
    area_unit: String,
    area: f64,
}

/// Exponent of the largest power of 1000 that is at most the number.
fn thousands(value: f64) -> f64 {
    3.0 * (value.log10() / 3.0).floor()
}

impl ExplainReport<'_> {
    fn spoken(&self) -> Spoken {
        let k = stiffness_in(self.units);
        let v = match self.units {
            Units::Linear => ("mm/s", 1e3),
            Units::Rotary { .. } => self.units.written("m/s"),
        };
        let (unit, factor) = self.units.written("N² s/m²");
        let Explanation { base, changes, .. } = self.found;
        let areas = [base].into_iter().chain(changes).map(|one| one.area()[0] * factor);
        // The exponent follows from the scene's own area. If that is 0, it follows from the first area above 0.
        let power = areas.into_iter().find(|area| *area > 0.0).map_or(0.0, thousands);
        let area_unit = if power == 0.0 { unit.into() } else { format!("10^{power} {unit}") };
        Spoken { k, v, area_unit, area: factor / 10f64.powf(power) }
    }

    pub fn csv(&self) -> String {
        let mut table = self.found.table();
        for cell in table.rows.iter_mut().flatten() {
            if let Cell::Text(text) = cell {
                *text = text.replace(',', ";").into();
            }
        }
        versioned(table).csv()
    }

    /// The ranked table for people, and the answers.
    pub fn text(&self) -> String {
        let Spoken { k: (k_unit, k), v: (v_unit, v), area_unit, area } = self.spoken();
        let mut text = format!(
            "what limits the walls of {}, by the criterion {}; each row has its own best tuning\nareas in {area_unit}, K in \
             {k_unit}, noise in {v_unit}; K at B is at B = {}",
            self.scene,
            self.criterion,
            self.units.said(self.found.damping_n_s_per_m, "N s/m"),
        );
        text += "\nrank change                                                                 times the area      area by the scene    peak K    K at B     noise of core %  cost";
        for row in self.found.rows() {
            let [rank, what, times, area, own, peak, at_damping, noise, share, cost] =
                cells(&row, [area, k, v]);
            let _ = write!(
                text,
                "\n{rank:>4} {what:<60} {times:>24} {area:>9} {own:>12} {peak:>9} {at_damping:>9} {noise:>9} {share:>9}  {cost}",
            );
        }
        for answer in self.found.answers() {
            let _ = write!(text, "\n{answer}");
        }
        let hits: u64 = self.found.rows().iter().map(|row| row.one.hits).sum();
        let _ = write!(text, "\n{hits} wall hits");
        text
    }

    pub fn html(&self) -> String {
        let Spoken { k: (k_unit, k), v: (v_unit, v), area_unit, area } = self.spoken();
        let columns = [
            ("Rank", ""),
            ("Change", ""),
            ("Times the area", "mean (range)"),
            ("Area", area_unit.as_str()),
            ("By the scene", area_unit.as_str()),
            ("Peak K", k_unit),
            ("K at that B", k_unit),
            ("Noise", v_unit),
            ("Of the core", "%"),
            ("Cost", ""),
        ];
        let rows = self.found.rows().into_iter().map(|row| {
            let class = if row.rank == 0 { " class=\"ideal\"" } else { "" };
            (class, cells(&row, [area, k, v]).to_vec())
        });
        report::table(&columns, rows)
    }

    /// The boundaries of the scene and of the best changes.
    pub fn figure(&self) -> Result<Figure, FigureError> {
        let Explanation { base, changes, .. } = self.found;
        let curve = |one: &Explained| {
            let own = one.change.kind == Kind::Nothing;
            let Change { name, text, .. } = &one.change;
            let (name, text) = if own { ("as it is", "as it is") } else { (*name, text.as_str()) };
            Curve {
                name: name.into(),
                detail: format!("{text}, {}", one.settings.name().text()),
                ideal: own,
                points: one
                    .boundaries
                    .first()
                    .map(|first| first.points.clone())
                    .unwrap_or_default(),
            }
        };
        zwidth(&ZwidthPlot {
            title: format!("What limits the walls, {}", self.scene),
            units: self.units,
            subtitle: "one element changed at a time, each at its best tuning; bold: as it is"
                .into(),
            marked: "",
            legend: "Change".into(),
            curves: changes.iter().take(DRAWN).chain([base]).map(curve).collect(),
        })
    }
}
