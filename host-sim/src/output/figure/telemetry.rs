//! Telemetry of a board: position, velocity, force and flags over time.

use plotters::{prelude::*, style::text_anchor::HPos};

use super::{
    Figure, FigureError, Page, WIDTH,
    axis::Ticks,
    colour::{ACCENT, DATA, FRAME, TEXT},
    panel::{self, AXIS_TITLE_SIZE, Grid, Panel, SMALL_SIZE, X_TITLE_DROP},
    plottable, text,
    trace::{LINE_WIDTH, draw_trace, range},
};

const TOP: f64 = 56.0;
const PANEL_HEIGHT: f64 = 104.0;
/// Distance between panels, with space for the labels of the time axis.
const GAP: f64 = 26.0;
const PANELS: usize = 3;
/// Height of a row of flags.
const ROW: f64 = 16.0;
const BAR: f64 = 9.0;
const LEFT: f64 = 84.0;
const RIGHT: f64 = WIDTH - 20.0;
const MOST_X_TICKS: usize = 9;
const MOST_Y_TICKS: usize = 5;
/// Shortest time axis. On a shorter axis, labels would need too many digits.
const SHORTEST: f64 = 1e-3;
const NAME_GAP: f64 = 8.0;
const BAR_OPACITY: f64 = 0.75;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TelemetryPoint {
    /// Time. The time must increase from record to record.
    pub time: f64,
    /// Position, velocity and force, in this order.
    pub values: [f64; PANELS],
    /// Whether records are missing before this record. If so, the line has a gap here.
    pub after_gap: bool,
    /// The flags that are set. Each flag is a bit from `TelemetryPlot::facts`.
    pub facts: u32,
}

#[derive(Debug, Clone, PartialEq)]
pub struct TelemetryPlot {
    pub title: String,
    /// The second line: a text that identifies the capture.
    pub subtitle: String,
    /// Title of the time axis, with its unit.
    pub time_title: String,
    /// Titles of the three panels, with their units.
    pub titles: [String; PANELS],
    /// For each flag: its name, its bit, and whether it is a problem.
    pub facts: Vec<(String, u32, bool)>,
    pub points: Vec<TelemetryPoint>,
}

/// Draws three panels one below the other. Below the panels, each flag has a row. The bars in the row show when the
/// flag is set.
///
/// # Errors
/// [`FigureError`] if a number is NaN or infinite, or there are no records.
pub fn telemetry(plot: &TelemetryPlot) -> Result<Figure, FigureError> {
    if plot.points.is_empty() {
        return Err(FigureError::no_samples());
    }
    for point in &plot.points {
        plottable("time", point.time)?;
        for value in point.values {
            plottable("telemetry", value)?;
        }
    }
    Figure::new([&plot.title, &plot.subtitle], height(plot), &|page| draw(plot, page))
}

fn height(plot: &TelemetryPlot) -> f64 {
    panel_top(PANELS) + ROW * plot.facts.len() as f64 + X_TITLE_DROP + 12.0
}

fn panel_top(index: usize) -> f64 {
    TOP + index as f64 * (PANEL_HEIGHT + GAP)
}

fn draw(plot: &TelemetryPlot, page: &Page) -> Result<(), FigureError> {
    let [from, to] = range(plot.points.iter().map(|point| point.time));
    let to = to.max(from + SHORTEST);
    for (index, title) in plot.titles.iter().enumerate() {
        let line = |run: &[TelemetryPoint]| {
            (run.iter().map(|point| (point.time, point.values[index])).collect(), DATA)
        };
        let lines = plot.points.chunk_by(|_, next| !next.after_gap).map(line).collect();
        draw_lines(page, [from, to], [panel_top(index), PANEL_HEIGHT], title, lines)?;
    }
    draw_facts(page, plot, [from, to])
}

/// Draws the lines of a panel over time. `top` and `height` are the panel's.
fn draw_lines(
    page: &Page,
    [from, to]: [f64; 2],
    [top, height]: [f64; 2],
    title: &str,
    lines: Vec<(Vec<(f64, f64)>, RGBColor)>,
) -> Result<(), FigureError> {
    let panel = Panel { left: LEFT, top, right: RIGHT, bottom: top + height };
    let [low, high] = range(lines.iter().flat_map(|(points, _)| points).map(|(_, value)| *value));
    let x = Ticks::within(from, to, MOST_X_TICKS);
    let y = Ticks::around(low, high, MOST_Y_TICKS);
    let mut chart = panel.chart(page, x, y, GAP - 4.0)?;
    panel::axes(&mut chart, Grid::Both, ["", title])?;
    for (points, colour) in lines {
        draw_trace(page, &chart, points.into_iter(), colour.mix(1.0), LINE_WIDTH)?;
    }
    panel.frame(page)
}

fn draw_facts(page: &Page, plot: &TelemetryPlot, [from, to]: [f64; 2]) -> Result<(), FigureError> {
    let x = |time: f64| LEFT + (time - from) / (to - from) * (RIGHT - LEFT);
    let top = panel_top(PANELS); // below the last panel
    for (row, (name, bit, bad)) in plot.facts.iter().enumerate() {
        let middle = top + ROW * (row as f64 + 0.5);
        let beside = [LEFT - NAME_GAP, middle];
        text::write(page, name, beside, HPos::Right, SMALL_SIZE, TEXT)?;
        let colour = if *bad { ACCENT } else { DATA };
        let runs = plot.points.chunk_by(|a, b| (a.facts & bit == b.facts & bit) && !b.after_gap);
        let mut runs = runs.peekable();
        while let Some(run) = runs.next() {
            let (first, last) = (run[0], run[run.len() - 1]);
            // The bar of a single record ends at the next record.
            let alone = run.len() == 1;
            let until = match runs.peek().map(|next| next[0]) {
                Some(next) if alone || !next.after_gap => next.time,
                None if alone => to,
                _ => last.time,
            };
            if first.facts & bit != 0 {
                bar(page, [x(first.time), x(until)], middle, colour)?;
            }
        }
    }
    let bottom = top + ROW * plot.facts.len() as f64;
    panel::line(page, &[[LEFT, bottom + 4.0], [RIGHT, bottom + 4.0]], FRAME, 1.0)?;
    let title = [f64::midpoint(LEFT, RIGHT), bottom + X_TITLE_DROP - 14.0];
    text::write(page, &plot.time_title, title, HPos::Center, AXIS_TITLE_SIZE, TEXT)
}

fn bar(
    page: &Page,
    [from, to]: [f64; 2],
    middle: f64,
    colour: RGBColor,
) -> Result<(), FigureError> {
    // The bar must be wide enough to be visible.
    let to = to.max(from + 1.0).min(RIGHT);
    panel::rect(page, from..to, middle - BAR / 2.0..middle + BAR / 2.0, colour.mix(BAR_OPACITY))
}

#[derive(Debug, Clone, PartialEq)]
pub struct ReplayPlot {
    pub title: String,
    /// The second line: a text that identifies the capture.
    pub subtitle: String,
    /// Title of the time axis, with its unit.
    pub time_title: String,
    /// Titles of the two panels, with their units.
    pub titles: [String; 2],
    /// Names of the board's velocity and of the other velocity.
    pub names: [String; 2],
    /// Time, position, the board's velocity and the other velocity.
    pub points: Vec<[f64; 4]>,
}

/// Draws the position over time, and both velocities below the position.
///
/// # Errors
/// [`FigureError`] if a number is NaN or infinite, or there are no samples.
pub fn replay(plot: &ReplayPlot) -> Result<Figure, FigureError> {
    if plot.points.is_empty() {
        return Err(FigureError::no_samples());
    }
    for value in plot.points.iter().flatten() {
        plottable("velocity", *value)?;
    }
    let height = panel_top(2) + PANEL_HEIGHT + X_TITLE_DROP + 12.0;
    Figure::new([&plot.title, &plot.subtitle], height, &|page| draw_replay(plot, page))
}

fn draw_replay(plot: &ReplayPlot, page: &Page) -> Result<(), FigureError> {
    let [from, to] = range(plot.points.iter().map(|point| point[0]));
    let to = to.max(from + SHORTEST);
    let curves = [&[(1, DATA)][..], &[(2, DATA), (3, ACCENT)]];
    for ((index, curves), title) in curves.into_iter().enumerate().zip(&plot.titles) {
        let line = |&(place, colour): &(usize, RGBColor)| {
            (plot.points.iter().map(|point| (point[0], point[place])).collect(), colour)
        };
        // The second panel is twice as high.
        let height = (index as f64 + 1.0) * PANEL_HEIGHT;
        let lines = curves.iter().map(line).collect();
        draw_lines(page, [from, to], [panel_top(index), height], title, lines)?;
    }
    let bottom = panel_top(1) + 2.0 * PANEL_HEIGHT + GAP;
    let middle = f64::midpoint(LEFT, RIGHT);
    text::write(
        page,
        &plot.time_title,
        [middle, bottom + 8.0],
        HPos::Center,
        AXIS_TITLE_SIZE,
        TEXT,
    )?;
    let rows = [(LEFT, HPos::Left, DATA), (RIGHT, HPos::Right, ACCENT)];
    for (name, (x, side, colour)) in plot.names.iter().zip(rows) {
        text::write(page, name, [x, bottom + 8.0], side, SMALL_SIZE, colour)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::testing::check as look;

    fn plot(points: Vec<TelemetryPoint>) -> TelemetryPlot {
        TelemetryPlot {
            title: "Telemetry".to_owned(),
            subtitle: "capture.bin".to_owned(),
            time_title: "Time t [s]".to_owned(),
            titles: ["x [mm]", "v [m/s]", "F [N]"].map(str::to_owned),
            facts: vec![("contact".to_owned(), 1, false), ("fault".to_owned(), 2, true)],
            points,
        }
    }

    fn points() -> Vec<TelemetryPoint> {
        (0..2_000u32)
            .map(|n| TelemetryPoint {
                time: f64::from(n) * 1e-3,
                values: [f64::from(n), (f64::from(n) / 100.0).sin(), 0.0],
                after_gap: n == 700,
                facts: u32::from(n > 1_000) | u32::from(n == 1_999) << 1,
            })
            .collect()
    }

    #[test]
    fn panels_and_facts_are_named() {
        let figure = look(telemetry, &plot(points()));
        for text in ["Time t [s]", "x [mm]", "v [m/s]", "F [N]", "contact", "fault"] {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
        assert!(figure.svg().len() < 300_000);
    }

    #[test]
    fn one_record_and_standstill_have_figures_and_nothing_has_none() {
        look(telemetry, &plot(points()[..1].to_vec()));
        assert_eq!(telemetry(&plot(vec![])), Err(FigureError::no_samples()));
        let bad = TelemetryPoint { time: f64::NAN, ..points()[0] };
        assert_eq!(
            telemetry(&plot(vec![bad])),
            Err(FigureError::of("time", crate::output::figure::NOT_PLOTTABLE))
        );
    }
}
