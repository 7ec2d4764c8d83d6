//! Output of `sweep --limits`: a table for programs, a table for people, a figure.

use std::fmt::Write as _;

use serde::Serialize;

use sim_studies::table::Cell;

use super::{
    Cells, area_cells, csv_of,
    figure::{Figure, FigureError, Mark, TradePanel, TradePlot, TradeSeries, trade},
    ideal_cells, reach_cells, version,
};
use crate::{
    notation::three_digits,
    scene::{PushBy, Units, Walk},
    study::{
        boundary::Boundaries,
        limits::{Limit, LimitResult, Question, Situation},
        limits_asked::{GRID, grid},
    },
};

/// Divisor of the areas in the tables for people. So their unit is 10^6 N^2 s/m^2.
const MILLION: f64 = 1e6;
/// Cells that give the limit, estimator and cutoff of a row. A row without a cutoff is for the true velocity.
pub(super) fn limit_cells(limit: Limit, cutoff_hz: Option<f64>) -> [(&'static str, Cell); 4] {
    let (value, unit) = limit.told();
    let estimator = if cutoff_hz.is_some() { "scene" } else { "true-velocity" };
    [
        ("limit", value.into()),
        ("limit_unit", unit.into()),
        ("estimator", estimator.into()),
        ("cutoff_hz", Cell::number(cutoff_hz)),
    ]
}

/// Cells that give the number of walks, and the grid of K and B of these walks.
pub(super) fn walk_cells(walks: u64, walk: &Walk) -> impl Iterator<Item = (&'static str, Cell)> {
    let grid = GRID.into_iter().zip(grid(walk).map(Cell::Number));
    [("walks", Cell::Whole(walks))].into_iter().chain(grid)
}

#[derive(Clone, Debug)]
pub struct LimitStudy {
    pub question: Question,
    /// One result for each limit and each situation.
    pub results: Vec<LimitResult>,
}

#[derive(Clone, Debug, Serialize)]
pub struct LimitSummary {
    push: &'static str,
    arm: Option<String>,
    limit: f64,
    limit_unit: &'static str,
    ideal_cutoff_hz: Option<f64>,
    ideal_cutoff_range_hz: Option<[f64; 2]>,
    area_at_ideal_n2_s_per_m2: f64,
    true_velocity_area_n2_s_per_m2: Option<f64>,
    share_of_true_velocity: Option<f64>,
}

fn push(result: &LimitResult) -> &'static str {
    result.situation.as_ref().map_or("worst", |situation| situation.push.name())
}

fn arm(result: &LimitResult) -> Option<&str> {
    result.situation.as_ref()?.arm.as_deref()
}

pub(super) fn name(limit: Limit) -> String {
    match limit {
        Limit::Rms(metres) => {
            let um: f64 = format!("{:.6e}", metres * 1e6).parse().unwrap_or(metres);
            format!("{um} um")
        }
        Limit::Felt(db) => format!("felt, {db} dB"),
        Limit::Quiet(newtons) => format!("quiet, {newtons:.3} N"),
    }
}

fn share(area: f64, result: &LimitResult) -> Option<f64> {
    result.told_area().filter(|told| *told > 0.0).map(|told| area / told)
}

/// The grid of K and B of the walks, as text for people.
pub(super) fn grid_text(walk: &Walk, units: Units) -> String {
    let [k, dk, k_max, b, db, b_max] = grid(walk);
    let k = [k, dk, k_max].map(|k| units.said(k, "N/m"));
    let b = [b, db, b_max].map(|b| units.said(b, "N s/m"));
    let axis =
        |name: &str, [from, by, to]: [String; 3]| format!("{name} from {from} by {by} to {to}");
    format!("{}; {}", axis("K", k), axis("B", b))
}

/// Unit of the areas in tables for people, and its factor.
pub(super) fn areas_in(units: Units) -> (&'static str, f64) {
    match units {
        Units::Linear => ("10^6 N^2 s/m^2", 1.0 / MILLION),
        Units::Rotary { .. } => units.written("N^2 s/m^2"),
    }
}

/// Unit of K in tables for people, and its factor.
pub(super) fn stiffness_in(units: Units) -> (&'static str, f64) {
    match units {
        Units::Linear => ("kN/m", 1e-3),
        Units::Rotary { .. } => units.written("N/m"),
    }
}

/// A limit as text in the scene's units.
pub(super) fn name_in(limit: Limit, units: Units) -> String {
    match limit {
        Limit::Rms(metres) if units.is_rotary() => units.said(1e6 * metres, "um"),
        Limit::Quiet(newtons) if units.is_rotary() => {
            format!("quiet, {}", units.said(newtons, "N"))
        }
        _ => name(limit),
    }
}

/// Who pushes, as text for people.
fn situation(result: &LimitResult) -> String {
    let pushes = match result.situation.as_ref().map(|situation| situation.push) {
        None => return "the worst of all of these".into(),
        Some(PushBy::Motor) => "the motor pushes",
        Some(PushBy::Hand) => "a hand pushes",
    };
    arm(result).map_or(pushes.into(), |arm| format!("{pushes}, arm `{arm}`"))
}

impl LimitStudy {
    pub fn csv(&self) -> String {
        let Question { rms_of, repeats, walk, .. } = &self.question;
        let row = |result: &LimitResult, cutoff_hz, boundaries: &Boundaries| {
            let arm = arm(result).unwrap_or_default().to_owned();
            let mut row: Cells = vec![("push", push(result).into()), ("arm", arm.into())];
            row.extend(limit_cells(result.limit, cutoff_hz));
            row.extend(area_cells(boundaries));
            let share = share(boundaries.area(), result);
            row.push(("share_of_true_velocity", Cell::number(share)));
            row.extend(reach_cells(boundaries));
            row.extend(ideal_cells(result.result.ideal));
            row.push(("rms_of", rms_of.name().into()));
            row.extend(walk_cells((*repeats).into(), walk));
            row.push(version());
            row
        };
        csv_of(self.results.iter().flat_map(|result| {
            let estimated = result.result.cutoffs.iter();
            let estimated = estimated.map(|cutoff| (Some(cutoff.cutoff_hz), &cutoff.boundaries));
            let told = (!result.told.is_empty()).then_some((None, &result.told));
            estimated
                .chain(told)
                .map(move |(cutoff_hz, boundaries)| row(result, cutoff_hz, boundaries))
        }))
    }

    pub fn summary(&self) -> Vec<LimitSummary> {
        let summary = |result: &LimitResult| {
            let (limit, limit_unit) = result.limit.told();
            LimitSummary {
                push: push(result),
                arm: arm(result).map(str::to_owned),
                limit,
                limit_unit,
                ideal_cutoff_hz: result.result.ideal.map(|ideal| ideal.cutoff_hz),
                ideal_cutoff_range_hz: result.result.ideal.map(|ideal| ideal.range_hz),
                area_at_ideal_n2_s_per_m2: result.area(),
                true_velocity_area_n2_s_per_m2: result.told_area(),
                share_of_true_velocity: share(result.area(), result),
            }
        };
        self.results.iter().map(summary).collect()
    }

    pub fn text(&self, units: Units) -> String {
        let Question { walk, rms_of, repeats, .. } = &self.question;
        let (unit, _) = areas_in(units);
        let area_of = |boundaries: &Boundaries| walked_area(boundaries, units);
        let mut text = format!(
            "area by limit and cutoff, in {unit}; limit of the RMS of {}, walks for each area: {repeats}\n  *: ideal cutoff; \
             >: a cap of the walk cuts the area\n  {}",
            rms_of.name(),
            grid_text(walk, units)
        );
        let mut last = None;
        for result in &self.results {
            if last != Some(&result.situation) {
                last = Some(&result.situation);
                let _ = write!(text, "\n  {}\n  {:>12}", situation(result), "limit \\ Hz");
                for cutoff in &result.result.cutoffs {
                    let _ = write!(text, " {:>7}", cutoff.cutoff_hz);
                }
                let told =
                    if result.told.is_empty() { "" } else { "   true velocity, ideal's share" };
                let _ = write!(text, "  {:>12}{told}", "ideal range");
            }
            let _ = write!(text, "\n  {:>12}", name_in(result.limit, units));
            let ideal = result.result.ideal;
            for cutoff in &result.result.cutoffs {
                let star = if ideal.is_some_and(|ideal| ideal.cutoff_hz == cutoff.cutoff_hz) {
                    "*"
                } else {
                    ""
                };
                let area = format!("{}{star}", area_of(&cutoff.boundaries));
                let _ = write!(text, " {area:>7}");
            }
            let range = ideal.map_or("none".into(), |ideal| range(ideal.range_hz));
            let _ = write!(text, "  {range:>12}");
            if result.told_area().is_some() {
                let share = share(result.area(), result).unwrap_or_default() * 100.0;
                let _ = write!(text, "   {:>8}, {share:.0} %", area_of(&result.told));
            }
        }
        text
    }

    pub const CAPTION: &str = "The smallest cutoff whose mean area is at least 98 % of the largest, for each limit of the \
                               RMS, and for each multiple of what a hand feels (a model, unless wall_hit.felt_curve names \
                               a curve).";

    /// The figure. It shows the ideal cutoff over the limit. The hand is the scene's own. One panel has the RMS limits,
    /// the other panel has the sensation levels.
    pub fn figure(&self, scene: &str) -> Result<Option<Figure>, FigureError> {
        let kinds = [false, true].into_iter().filter(|felt| {
            self.results.iter().any(|result| matches!(result.limit, Limit::Felt(_)) == *felt)
        });
        let kinds: Vec<bool> = kinds.collect();
        let points = |push: PushBy, felt: bool| -> Vec<[f64; 2]> {
            let own = Some(Situation { push, arm: None });
            let points = self.results.iter().filter(|result| result.situation == own);
            let points = points.filter_map(|result| {
                let x = match result.limit {
                    Limit::Rms(metres) if !felt => metres * 1e6,
                    Limit::Felt(db) if felt => 10f64.powf(db / 20.0),
                    _ => return None,
                };
                Some([x, result.result.ideal?.cutoff_hz])
            });
            let mut points: Vec<_> = points.collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            points
        };
        let series: Vec<TradeSeries> = PushBy::ALL
            .into_iter()
            .enumerate()
            .map(|(colour, push)| TradeSeries {
                name: push.name().into(),
                colour,
                mark: if push == PushBy::Motor { Mark::Circle } else { Mark::Diamond },
                points: kinds.iter().map(|felt| points(push, *felt)).collect(),
            })
            .collect();
        // A curve needs at least two limits.
        if series.iter().flat_map(|series| &series.points).all(|points| points.len() < 2) {
            return Ok(None);
        }
        let panel = |felt: &bool| {
            let title = if *felt { "Limit of what is felt (a model)" } else { "Limit of the RMS" };
            TradePanel::new(title, "Ideal cutoff [Hz]", 1e-3)
        };
        trade(&TradePlot {
            title: format!("Ideal cutoff against the limit, {scene}"),
            subtitle: format!(
                "RMS of {}, sensation level of the motion",
                self.question.rms_of.name()
            ),
            legend: "Who pushes".into(),
            x_title: match kinds[..] {
                [false] => "RMS [µm]",
                [true] => "Motion over threshold",
                _ => "RMS [µm]; motion over threshold",
            }
            .into(),
            panels: kinds.iter().map(panel).collect(),
            series,
            lines: true,
        })
        .map(Some)
    }
}

/// A range as text: `500`, or `400 to 500`.
pub(super) fn range([low, high]: [f64; 2]) -> String {
    if low == high { low.to_string() } else { format!("{low} to {high}") }
}

/// The area of walked boundaries, in the unit that [`areas_in`] gives, after `>` if a cap of the walk cuts it.
pub(super) fn walked_area(boundaries: &Boundaries, units: Units) -> String {
    let cut = if boundaries.capped() > 0 { ">" } else { "" };
    format!("{cut}{}", area_text(boundaries.area(), units))
}

/// An area in the unit that [`areas_in`] gives.
pub(super) fn area_text(area: f64, units: Units) -> String {
    three_digits(area * areas_in(units).1)
}
