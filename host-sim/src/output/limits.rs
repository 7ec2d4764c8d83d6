//! What `sweep --limits` writes: a table for programs, one for people, one picture.

use std::fmt::Write as _;

use serde::Serialize;

use super::{
    SCHEMA_VERSION,
    figure::{Figure, FigureError, Mark, TradePanel, TradePlot, TradeSeries, trade},
};
use crate::{
    notation::three_digits,
    scene::{PushBy, Walk},
    study::{
        limits::{Limit, LimitResult, Question, Situation},
        limits_asked::grid,
    },
};

/// Areas of the tables are in this unit, N^2 s/m^2.
const MILLION: f64 = 1e6;
const HEADER: &str = "push,arm,limit,limit_unit,estimator,cutoff_hz,area_n2_s_per_m2,area_low_n2_s_per_m2,\
                      area_high_n2_s_per_m2,share_of_true_velocity,stiffness_peak_n_per_m,damping_max_n_s_per_m,\
                      capped_walks,ideal_cutoff_hz,ideal_low_hz,ideal_high_hz,rms_of,walks,\
                      stiffness_start_n_per_m,stiffness_step_n_per_m,stiffness_max_n_per_m,\
                      damping_start_n_s_per_m,damping_step_n_s_per_m,damping_max_tried_n_s_per_m,schema_version";

#[derive(Clone, Debug)]
pub struct LimitStudy {
    pub question: Question,
    /// One for each limit and situation.
    pub results: Vec<LimitResult>,
}

/// One limit in `summary.json`.
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

/// The grid of the walks, for people.
pub(super) fn grid_text(walk: &Walk) -> String {
    let [k, dk, k_max, b, db, b_max] = grid(walk);
    format!("K from {k} by {dk} to {k_max} N/m, B from {b} by {db} to {b_max} N s/m")
}

/// Who pushes, for people.
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
        let mut text = format!("{HEADER}\n");
        let Question { rms_of, repeats, .. } = self.question;
        let grid = grid(&self.question.walk).map(|value| value.to_string()).join(",");
        let tail = format!("{},{repeats},{grid},{SCHEMA_VERSION}", rms_of.name());
        let cell = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        for result in &self.results {
            let ideal = result.result.ideal;
            let (limit, unit) = result.limit.told();
            let estimated = result.result.cutoffs.iter();
            let estimated = estimated.map(|cutoff| (Some(cutoff.cutoff_hz), &cutoff.boundaries));
            let told = (!result.told.is_empty()).then_some((None, &result.told));
            for (cutoff_hz, boundaries) in estimated.chain(told) {
                let [low, high] = boundaries.area_range();
                let _ = writeln!(
                    text,
                    "{},{},{limit},{unit},{},{},{},{},{},{},{},{},{},{},{},{},{tail}",
                    push(result),
                    arm(result).unwrap_or_default(),
                    if cutoff_hz.is_some() { "scene" } else { "true-velocity" },
                    cell(cutoff_hz),
                    boundaries.area(),
                    low,
                    high,
                    cell(share(boundaries.area(), result)),
                    boundaries.stiffness_peak_n_per_m(),
                    boundaries.damping_max_n_s_per_m(),
                    boundaries.capped(),
                    cell(ideal.map(|ideal| ideal.cutoff_hz)),
                    cell(ideal.map(|ideal| ideal.range_hz[0])),
                    cell(ideal.map(|ideal| ideal.range_hz[1])),
                );
            }
        }
        text
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

    /// The table for people.
    pub fn text(&self) -> String {
        let Question { walk, rms_of, repeats, .. } = &self.question;
        let mut text = format!(
            "area by limit and cutoff, 10^6 N^2 s/m^2; * ideal cutoff, > cut at a cap; RMS of {}; {repeats} walks \
             each\n  {}",
            rms_of.name(),
            grid_text(walk)
        );
        let mut last = None;
        for result in &self.results {
            if last != Some(&result.situation) {
                last = Some(&result.situation);
                let _ = write!(text, "\n  {}\n  {:>12}", situation(result), "limit \\ Hz");
                for cutoff in &result.result.cutoffs {
                    let _ = write!(text, " {:>7}", cutoff.cutoff_hz);
                }
                let told = if result.told.is_empty() { "" } else { "   true velocity, share" };
                let _ = write!(text, "  {:>12}{told}", "ideal range");
            }
            let _ = write!(text, "\n  {:>12}", name(result.limit));
            let ideal = result.result.ideal;
            for cutoff in &result.result.cutoffs {
                let cut = if cutoff.boundaries.capped() > 0 { ">" } else { "" };
                let star = if ideal.is_some_and(|ideal| ideal.cutoff_hz == cutoff.cutoff_hz) {
                    "*"
                } else {
                    ""
                };
                let area = format!("{cut}{}{star}", millions(cutoff.boundaries.area()));
                let _ = write!(text, " {area:>7}");
            }
            let range = ideal.map_or("none".into(), |ideal| range(ideal.range_hz));
            let _ = write!(text, "  {range:>12}");
            if let Some(told) = result.told_area() {
                let cut = if result.told.capped() > 0 { ">" } else { "" };
                let share = share(result.area(), result).unwrap_or_default() * 100.0;
                let _ = write!(text, "   {:>8}, {share:.0} %", format!("{cut}{}", millions(told)));
            }
        }
        text
    }

    /// The sentence below the figure.
    pub const CAPTION: &str = "The smallest cutoff whose mean area is at least 98 % of the largest, for each limit of the \
                               RMS, and for each multiple of what a hand feels (a model, unless wall_hit.felt_curve names \
                               a curve).";

    /// The ideal cutoff against the limit: a panel for limits of RMS, one for levels; the scene's own hand.
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
        // One limit makes no curve.
        if series.iter().flat_map(|series| &series.points).all(|points| points.len() < 2) {
            return Ok(None);
        }
        let panel = |felt: &bool| TradePanel {
            title: if *felt { "Limit of what is felt (a model)" } else { "Limit of the RMS" }
                .into(),
            y_title: "Ideal cutoff [Hz]".into(),
            limit: None,
            floor: 1e-3,
            front: vec![],
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

/// `500`, or `400 to 500`.
pub(super) fn range([low, high]: [f64; 2]) -> String {
    if low == high { low.to_string() } else { format!("{low} to {high}") }
}

/// An area in 10^6 N^2 s/m^2, with three digits.
pub(super) fn millions(area: f64) -> String {
    three_digits(area / MILLION)
}
