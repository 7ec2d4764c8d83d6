//! Output of `sweep --levers`: a table for programs, a table for people, a figure.

use std::fmt::Write as _;

use serde::Serialize;

use sim_studies::table::Cell;

use super::{
    Cells, area_cells, csv_of,
    figure::{Figure, FigureError, Mark, TradePanel, TradePlot, TradeSeries, trade},
    ideal_cells,
    limits::{areas_in, limit_cells, name_in, range, walk_cells, walked_area},
    reach_cells, version,
};
use crate::{
    notation::three_digits,
    scene::{PushBy, Scene, Units},
    study::{
        levers::{Between, Lever, LeverQuestion, LeverResult, Walked},
        limits::Limit,
    },
};

#[derive(Clone, Debug)]
pub struct LeverStudy {
    pub question: LeverQuestion,
    /// One result for each loop, limit and push.
    pub results: Vec<LeverResult>,
}

/// The result of one loop with one limit and push, in `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct LeverSummary {
    #[serde(rename = "loop")]
    of_loop: String,
    output_period_samples: u32,
    latency_samples: f64,
    between: &'static str,
    push: &'static str,
    limit: f64,
    limit_unit: &'static str,
    ideal_cutoff_hz: Option<f64>,
    ideal_cutoff_range_hz: Option<[f64; 2]>,
    area_at_ideal_n2_s_per_m2: f64,
    /// Area divided by the area of the unchanged scene.
    times_the_scene: Option<f64>,
    stiffness_peak_n_per_m: f64,
    is_capped: bool,
    true_velocity_area_n2_s_per_m2: Option<f64>,
}

/// Cells that give the output period and the latency of a loop.
pub(super) fn actuator_cells(scene: &Scene) -> [(&'static str, Cell); 2] {
    [
        ("output_period_samples", Cell::Whole(scene.actuator.period.into())),
        ("latency_samples", scene.actuator.latency.into()),
    ]
}

fn peak(walked: &Walked) -> f64 {
    walked.boundaries.stiffness_peak_n_per_m()
}

impl LeverStudy {
    pub(super) fn lever(&self, result: &LeverResult) -> &Lever {
        &self.question.levers[result.lever]
    }

    /// The result of loop number `lever` for this limit and push.
    fn of(&self, lever: usize, limit: Limit, push: PushBy) -> Option<&LeverResult> {
        let same = |r: &&LeverResult| r.lever == lever && r.limit == limit && r.push == push;
        self.results.iter().find(same)
    }

    /// Area divided by the area of the unchanged scene.
    fn times(&self, result: &LeverResult) -> Option<f64> {
        let own = self.of(0, result.limit, result.push)?.area();
        (own > 0.0).then(|| result.area() / own)
    }

    pub fn csv(&self) -> String {
        self.table_of(|Lever { of_loop, between, scene }| {
            let loop_of = ("loop", of_loop.clone().into());
            let between = ("between", between.name().into());
            [loop_of].into_iter().chain(actuator_cells(scene)).chain([between]).collect()
        })
    }

    /// A row for each loop, limit, push and cutoff. Each row begins with the cells of `of_loop`.
    pub(super) fn table_of(&self, of_loop: impl Fn(&Lever) -> Cells) -> String {
        csv_of(self.results.iter().flat_map(|result| {
            let estimated =
                result.cutoffs.iter().map(|(cutoff_hz, walked)| (Some(*cutoff_hz), walked));
            let told = (!result.told.boundaries.is_empty()).then_some((None, &result.told));
            estimated.chain(told).map(|(cutoff_hz, Walked { boundaries, walk })| {
                let mut row = of_loop(self.lever(result));
                row.push(("push", result.push.name().into()));
                row.extend(limit_cells(result.limit, cutoff_hz));
                row.extend(area_cells(boundaries));
                row.extend(reach_cells(boundaries));
                row.extend(walk_cells(boundaries.len() as u64, walk));
                row.extend(ideal_cells(result.sweep.ideal));
                row.push(version());
                row
            })
        }))
    }

    pub fn summary(&self) -> Vec<LeverSummary> {
        let summary = |result: &LeverResult| {
            let Lever { of_loop, between, scene } = self.lever(result);
            let (limit, limit_unit) = result.limit.told();
            let ideal = result.sweep.ideal;
            let best = result.best();
            LeverSummary {
                of_loop: of_loop.clone(),
                output_period_samples: scene.actuator.period,
                latency_samples: scene.actuator.latency,
                between: between.name(),
                push: result.push.name(),
                limit,
                limit_unit,
                ideal_cutoff_hz: ideal.map(|ideal| ideal.cutoff_hz),
                ideal_cutoff_range_hz: ideal.map(|ideal| ideal.range_hz),
                area_at_ideal_n2_s_per_m2: result.area(),
                times_the_scene: self.times(result),
                stiffness_peak_n_per_m: best.map_or(0.0, peak),
                is_capped: best.is_some_and(|walked| walked.boundaries.capped() > 0),
                true_velocity_area_n2_s_per_m2: (!result.told.boundaries.is_empty())
                    .then(|| result.told.boundaries.area()),
            }
        };
        self.results.iter().map(summary).collect()
    }

    /// The tables for people, one for each limit and push. After the tables, a sentence says what limits the scene's
    /// walls first.
    pub fn text(&self) -> String {
        let mut text = format!(
            "when the loop acts: area at the ideal cutoff, {}, and in brackets the ideal range, Hz\n  period: samples per \
             output; >: a cap of the walk cuts the area",
            areas_in(self.question.units()).0
        );
        for &limit in &self.question.limits {
            for &push in &self.question.pushes {
                self.table(&mut text, limit, push);
            }
        }
        text
    }

    fn table(&self, text: &mut String, limit: Limit, push: PushBy) {
        let units = self.question.units();
        let _ = write!(
            text,
            "\n  limit {}, the {} pushes\n  {:<16} {:>6}",
            name_in(limit, units),
            push.name(),
            "loop",
            "period"
        );
        for between in Between::ALL {
            let _ = write!(text, "  {:>24}", between.name());
        }
        let _ = write!(text, "  {:>13}", "true velocity");
        let mut rows: Vec<(&str, u32)> = vec![];
        for lever in &self.question.levers {
            let row = (lever.of_loop.as_str(), lever.scene.actuator.period);
            if !rows.contains(&row) {
                rows.push(row);
            }
        }
        for (of_loop, period) in rows {
            let _ = write!(text, "\n  {of_loop:<16} {period:>6}");
            let of_row = |between: Between| {
                let is_it = |lever: &Lever| {
                    lever.of_loop == of_loop
                        && lever.scene.actuator.period == period
                        && lever.between == between
                };
                self.of(self.question.levers.iter().position(is_it)?, limit, push)
            };
            for between in Between::ALL {
                let cell = of_row(between).map_or(String::new(), |result| cell(result, units));
                let _ = write!(text, "  {cell:>24}");
            }
            let told = of_row(Between::Nothing)
                .map_or(String::new(), |result| walked_area(&result.told.boundaries, units));
            let _ = write!(text, "  {told:>13}");
        }
        if let Some(sentence) = self.sentence(limit, push) {
            let _ = write!(text, "\n  {sentence}");
        }
    }

    /// A sentence that says what limits the scene's walls first.
    pub fn sentence(&self, limit: Limit, push: PushBy) -> Option<String> {
        let own = self.of(0, limit, push)?;
        let scene = &self.question.levers[0].scene;
        let units = scene.units;
        let base = own.best()?;
        let area_of = base.boundaries.area();
        let mut text = format!(
            "as it is: area {} at {} Hz, up to {}. Times this area with a perfect velocity {}",
            walked_area(&base.boundaries, units),
            own.sweep.ideal?.cutoff_hz,
            units.said(peak(base), "N/m"),
            three_digits(own.told.boundaries.area() / area_of)
        );
        let period = scene.actuator.period;
        let first = self
            .question
            .levers
            .iter()
            .find(|lever| lever.of_loop != self.question.levers[0].of_loop);
        for (of_period, what) in [
            (period, "with the latency of"),
            (1, "with the latency and an output for every sample of"),
        ] {
            let of_board = self.question.levers.iter().position(|lever| {
                Some(&lever.of_loop) == first.map(|first| &first.of_loop)
                    && lever.scene.actuator.period == of_period
                    && lever.between == Between::Nothing
            });
            if let Some(result) = of_board.and_then(|place| self.of(place, limit, push)) {
                let of_loop = &self.lever(result).of_loop;
                let _ =
                    write!(text, ", {what} {of_loop} {}", three_digits(result.area() / area_of));
            }
        }
        for (place, lever) in self.question.levers.iter().enumerate() {
            let own_loop = lever.of_loop == self.question.levers[0].of_loop
                && lever.scene.actuator.period == period;
            if own_loop
                && lever.between != Between::Nothing
                && let Some(result) = self.of(place, limit, push)
            {
                let _ = write!(
                    text,
                    ", with {} {}",
                    lever.between.text(),
                    three_digits(result.area() / area_of)
                );
            }
        }
        Some(text)
    }

    pub const CAPTION: &str = "The area at the ideal cutoff where the same device acts sooner and more often, and what an \
                               amplifier and a transmission leave of it.";

    /// The figure. It shows the area at the ideal cutoff over the output period, with one panel for each limit. Only
    /// results with the motor's push are shown.
    pub fn figure(&self, scene: &str) -> Result<Option<Figure>, FigureError> {
        let Some(&push) = self.question.pushes.first() else { return Ok(None) };
        let mut loops: Vec<&str> = vec![];
        for lever in &self.question.levers {
            if !loops.contains(&lever.of_loop.as_str()) {
                loops.push(&lever.of_loop);
            }
        }
        let mut series = vec![];
        // both boards give nearly the same result, so only the scene's own loop and the first board are shown
        for (place, of_loop) in loops.into_iter().take(2).enumerate() {
            for (n, between) in Between::ALL.into_iter().enumerate() {
                let x_of = |lever: &Lever| {
                    let is_it = (lever.of_loop.as_str(), lever.between) == (of_loop, between);
                    is_it.then(|| f64::from(lever.scene.actuator.period))
                };
                let mark = if place == 0 { Mark::Diamond } else { Mark::Circle };
                let name = format!("{of_loop}, {}", between.name());
                series.push(self.line(name, (n, mark), push, x_of));
            }
        }
        let texts = ["When the loop acts", "Loop, and what is between", "Output period [samples]"];
        self.panels(scene, texts, push, series)
    }

    /// A line that shows the area at the ideal cutoff of each loop, with a panel for each limit. `x_of` gives the x of
    /// a loop. Loops for which it returns `None` are not on the line.
    pub(super) fn line(
        &self,
        name: String,
        (colour, mark): (usize, Mark),
        push: PushBy,
        x_of: impl Fn(&Lever) -> Option<f64>,
    ) -> TradeSeries {
        let (_, factor) = self.question.units().written("N² s/m²");
        let points = |&limit: &Limit| -> Vec<[f64; 2]> {
            let of_it = self.results.iter().filter(|r| (r.limit, r.push) == (limit, push));
            let mut points: Vec<[f64; 2]> = of_it
                .filter_map(|r| Some([x_of(self.lever(r))?, factor * r.area()]))
                .filter(|[_, area]| *area > 0.0)
                .collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            points
        };
        let points = self.question.limits.iter().map(points).collect();
        TradeSeries { name, colour, mark, points }
    }

    /// Draws the lines in one panel for each limit, with this title, legend and axis. Returns `None` if there are no
    /// points.
    pub(super) fn panels(
        &self,
        scene: &str,
        [title, legend, x_title]: [&str; 3],
        push: PushBy,
        series: Vec<TradeSeries>,
    ) -> Result<Option<Figure>, FigureError> {
        if series.iter().flat_map(|series| &series.points).all(Vec::is_empty) {
            return Ok(None);
        }
        let units = self.question.units();
        let (unit, factor) = units.written("N² s/m²");
        let panel = |limit: &Limit| {
            let title = format!("Limit {}", name_in(*limit, units));
            TradePanel::new(title, format!("Area [{unit}]"), factor)
        };
        trade(&TradePlot {
            title: format!("{title}, {scene}"),
            subtitle: format!("RMS of motion, the {} pushes", push.name()),
            legend: legend.into(),
            x_title: x_title.into(),
            panels: self.question.limits.iter().map(panel).collect(),
            series,
            lines: true,
        })
        .map(Some)
    }
}

/// Area at the ideal cutoff and the range of this cutoff, as text.
pub(super) fn cell(result: &LeverResult, units: Units) -> String {
    let Some(ideal) = result.sweep.ideal else { return "no stable wall".into() };
    let area = result.best().map_or(String::new(), |best| walked_area(&best.boundaries, units));
    format!("{area} ({})", range(ideal.range_hz))
}
