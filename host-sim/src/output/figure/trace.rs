//! The trace of one wall hit. It shows the whole hit and the window.

use crate::{notation::number, scene::Units};
use plotters::{element::DashedPathElement, prelude::*, style::text_anchor::HPos};

use super::{
    Figure, FigureError, MARGIN, Page, WIDTH,
    axis::{Ticks, hertz},
    colour::{ACCENT, DATA, FRAME, TEXT},
    grid, not_negative,
    panel::{self, AXIS_TITLE_SIZE, Chart, Grid, Panel, SMALL_SIZE, X_TITLE_DROP, stroke},
    plottable, positive, text,
};

const STRIP_TOP: f64 = 54.0;
const HIT: Panel = Panel { left: 76.0, top: 72.0, right: WIDTH - 56.0, bottom: 208.0 };
const VERDICT_MIDDLE: f64 = HIT.bottom + 64.5;
const ZOOM: Panel = Panel { top: HIT.bottom + 79.0, bottom: HIT.bottom + 209.0, ..HIT };
const HEIGHT: f64 = ZOOM.bottom + 50.0;
const MOST_X_TICKS: usize = 9;
const MOST_Y_TICKS: usize = 6;

pub(super) const LINE_WIDTH: f64 = 0.9;
const WALL_WIDTH: f64 = 1.2;
const DASH: [f64; 2] = [6.0, 4.0];
/// Opacity of a phase. The first value is for the area behind the trace, the second for the strip above the plot.
const SETTLE_OPACITY: [f64; 2] = [0.08, 0.2];
const WINDOW_OPACITY: [f64; 2] = [0.08, 0.25];
const BAND_OPACITY: f64 = 0.13;
/// Distance from the frame to remarks on its right.
const REMARK_GAP: f64 = 6.0;
const REMARK_HALF_PITCH: f64 = 7.0;
/// Width of a column of a reduced trace, in grid steps. A column is narrower than a line.
const COLUMN_STEPS: i32 = 4;

pub(super) const MM_PER_M: f64 = 1e3;
const UM_PER_M: f64 = 1e6;
/// Length from which on small lengths are in millimetres, not in micrometres.
const MM_FROM_M: f64 = 2e-3;

#[derive(Debug, Clone, PartialEq)]
pub struct TracePlot {
    pub title: String,
    /// The second line: scene, resolution, and other facts that identify the run.
    pub subtitle: String,
    pub units: Units,
    pub rate_hz: f64,
    /// Position at every sample, from t = 0. The positions may end before the end of the window.
    pub positions_m: Vec<f64>,
    pub wall_m: f64,
    /// Time from the start of the hit to the window.
    pub settle_s: f64,
    pub window_s: f64,
    pub rms_limit_m: f64,
    /// `stable`, `unstable` or `no contact`, printed unchanged.
    pub verdict: String,
    /// RMS of the position about its mean in the window.
    pub rms_m: f64,
}

/// Draws the position over time. A second plot below shows only the window. Its 0 is the mean.
///
/// A long trace is reduced. Each pixel column keeps its first, lowest, highest and last sample.
///
/// # Errors
/// [`FigureError`] if a number is NaN or infinite, rate or window is not greater than 0, or there are no samples.
pub fn hit_trace(plot: &TracePlot) -> Result<Figure, FigureError> {
    check(plot)?;
    Figure::new([&plot.title, &plot.subtitle], HEIGHT, &|page| draw(plot, page))
}

fn draw(plot: &TracePlot, page: &Page) -> Result<(), FigureError> {
    draw_hit(page, plot)?;
    let small = plot.units.written("µm");
    let verdict = format!(
        "Measuring window: {}, RMS of the counts {} {} (limit {} {})",
        plot.verdict,
        micrometres(plot.rms_m * small.1),
        small.0,
        micrometres(plot.rms_limit_m * small.1),
        small.0
    );
    let (verdict, size) = text::fit(&verdict, AXIS_TITLE_SIZE, WIDTH - ZOOM.left - MARGIN);
    let middle = [ZOOM.left, VERDICT_MIDDLE];
    text::write(page, &verdict, middle, HPos::Left, size, TEXT)?;
    draw_window(page, plot)
}

fn check(plot: &TracePlot) -> Result<(), FigureError> {
    positive("rate_hz", plot.rate_hz)?;
    positive("window_s", plot.window_s)?;
    not_negative("settle_s", plot.settle_s)?;
    not_negative("rms_limit_m", plot.rms_limit_m)?;
    not_negative("rms_m", plot.rms_m)?;
    plottable("wall_m", plot.wall_m)?;
    if plot.positions_m.is_empty() {
        return Err(FigureError::no_samples());
    }
    for position_m in &plot.positions_m {
        plottable("positions_m", *position_m)?;
    }
    Ok(())
}

fn draw_hit(page: &Page, plot: &TracePlot) -> Result<(), FigureError> {
    let window_end_s = plot.settle_s + plot.window_s;
    let end_s = window_end_s.max(plot.positions_m.len() as f64 / plot.rate_hz);
    let [low, high] = range(plot.positions_m.iter().copied().chain([plot.wall_m]));
    let x = Ticks::within(0.0, end_s, MOST_X_TICKS);
    let (unit, times) = plot.units.written("mm");
    let per_m = MM_PER_M * times;
    let y = Ticks::around(low * per_m, high * per_m, MOST_Y_TICKS);
    let mut chart = HIT.chart(page, x, y, X_TITLE_DROP)?;
    let wall = plot.wall_m * per_m;
    let place = |time_s, position_mm| chart.backend_coord(&(time_s, position_mm));
    for (from_s, to_s, name, colour, [behind, strip]) in [
        (0.0, plot.settle_s, "settle", FRAME, SETTLE_OPACITY),
        (plot.settle_s, window_end_s, "measuring window", DATA, WINDOW_OPACITY),
    ] {
        let unit = |time_s| f64::from(place(time_s, wall).0) / super::GRID;
        let (left, right) = (unit(from_s), unit(to_s));
        panel::rect(page, left..right, HIT.top..HIT.bottom, colour.mix(behind))?;
        panel::rect(page, left..right, STRIP_TOP..HIT.top, colour.mix(strip))?;
        let long = format!("{name} {} s", hertz(to_s - from_s));
        let fits = |text: &&str| text::width(text, SMALL_SIZE) < right - left;
        if let Some(text) = [long.as_str(), name].into_iter().find(fits) {
            let middle = [f64::midpoint(left, right), f64::midpoint(STRIP_TOP, HIT.top)];
            text::write(page, text, middle, HPos::Center, SMALL_SIZE, TEXT)?;
        }
    }
    let position = if plot.units.is_rotary() { "True angle" } else { "True position x" };
    let titles = ["Time t [s]", &format!("{position} [{unit}]")];
    panel::axes(&mut chart, Grid::Horizontal, titles)?;
    HIT.frame(page)?;
    let samples = plot.positions_m.iter().enumerate();
    let trace = samples.map(|(n, position_m)| (n as f64 / plot.rate_hz, position_m * per_m));
    draw_trace(page, &chart, trace, DATA.mix(1.0), LINE_WIDTH)?;
    draw_level(page, &chart, wall)?;
    let height = f64::from(chart.backend_coord(&(0.0, wall)).1) / super::GRID;
    let beside = [HIT.right + REMARK_GAP, height];
    text::write(page, "wall", beside, HPos::Left, SMALL_SIZE, ACCENT)
}

/// Draws the line through the samples, reduced to columns.
pub(super) fn draw_trace(
    page: &Page,
    chart: &Chart<'_, Ticks>,
    samples: impl Iterator<Item = (f64, f64)>,
    colour: RGBAColor,
    width: f64,
) -> Result<(), FigureError> {
    let points = reduce(samples.map(|sample| chart.backend_coord(&sample)));
    panel::path(page, points, colour, width)
}

/// The unit for small lengths in this range, and how many of this unit are a metre.
pub(super) fn small_unit([low_m, high_m]: [f64; 2]) -> (&'static str, f64) {
    if low_m.abs().max(high_m.abs()) >= MM_FROM_M { ("mm", MM_PER_M) } else { ("µm", UM_PER_M) }
}

fn draw_level(page: &Page, chart: &Chart<'_, Ticks>, level: f64) -> Result<(), FigureError> {
    let (_, y) = chart.backend_coord(&(0.0, level));
    let ends = [(grid(ZOOM.left), y), (grid(ZOOM.right), y)];
    let [dash, gap] = DASH.map(grid);
    let style = ACCENT.stroke_width(stroke(WALL_WIDTH));
    page.draw(&DashedPathElement::new(ends, dash, gap, style))?;
    Ok(())
}

fn draw_window(page: &Page, plot: &TracePlot) -> Result<(), FigureError> {
    // The tolerance is half a sample, because n / rate may be rounded.
    let half_s = 0.5 / plot.rate_hz;
    let (from_s, to_s) = (plot.settle_s, plot.settle_s + plot.window_s);
    let samples = plot.positions_m.iter().enumerate();
    let inside: Vec<(f64, f64)> = samples
        .map(|(n, position_m)| (n as f64 / plot.rate_hz, *position_m))
        .filter(|(t, _)| *t >= from_s - half_s && *t < to_s - half_s)
        .map(|(t, position_m)| (t.clamp(from_s, to_s), position_m))
        .collect();
    let mean_m = inside.iter().map(|(_, x)| x).sum::<f64>() / inside.len().max(1) as f64;
    let deviations_m = || inside.iter().map(|(_, x)| x - mean_m);
    let limit_m = plot.rms_limit_m;
    let ends_m = range(deviations_m().chain([-limit_m, limit_m]));
    let (unit, factor) = small_unit(ends_m);
    let (unit, times) = plot.units.written(unit);
    let factor = factor * times;
    let limit = limit_m * factor;
    let [low, high] = ends_m.map(|end_m| end_m * factor);
    let x = Ticks::within(from_s, to_s, MOST_X_TICKS);
    let y = Ticks::around(low, high, MOST_Y_TICKS);
    let mut chart = ZOOM.chart(page, x, y, X_TITLE_DROP)?;
    let [top, bottom] = [limit, -limit].map(|level| chart.backend_coord(&(from_s, level)).1);
    let band = [(grid(ZOOM.left), top), (grid(ZOOM.right), bottom)];
    page.draw(&Rectangle::new(band, ACCENT.mix(BAND_OPACITY).filled()))?;
    panel::axes(&mut chart, Grid::Horizontal, ["Time t [s]", &format!("x − mean [{unit}]")])?;
    if inside.is_empty() {
        ZOOM.remark(page, "the trace ends before the window")?;
    }
    let deviations = inside.iter().map(|(t, x)| (*t, (x - mean_m) * factor));
    draw_trace(page, &chart, deviations, DATA.mix(1.0), LINE_WIDTH)?;
    for level in [-limit, limit] {
        draw_level(page, &chart, level)?;
    }
    ZOOM.frame(page)?;
    let zero = f64::from(i32::midpoint(top, bottom)) / super::GRID;
    for (text, drop) in [("RMS", -REMARK_HALF_PITCH), ("limit", REMARK_HALF_PITCH)] {
        let beside = [ZOOM.right + REMARK_GAP, zero + drop];
        text::write(page, text, beside, HPos::Left, SMALL_SIZE, ACCENT)?;
    }
    Ok(())
}

/// Lowest and highest value. If the two values are equal, the range is extended, so that the axis has a length.
pub(super) fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        [low.min(value), high.max(value)]
    });
    if low < high {
        [low, high]
    } else {
        let pad = low.abs().max(1e-6);
        [low - pad, high + pad]
    }
}

/// Keeps the first, lowest, highest and last point of each column, so that peaks stay visible.
fn reduce(points: impl Iterator<Item = (i32, i32)>) -> Vec<(i32, i32)> {
    let points: Vec<(i32, i32)> = points.collect();
    let columns = points.chunk_by(|a, b| a.0 / COLUMN_STEPS == b.0 / COLUMN_STEPS);
    let mut line: Vec<(i32, i32)> = columns
        .flat_map(|column| {
            let height = |index: &usize| column[*index].1;
            let highest = (0..column.len()).min_by_key(height).unwrap_or(0);
            let lowest = (0..column.len()).max_by_key(height).unwrap_or(0);
            let mut kept = [0, lowest, highest, column.len() - 1];
            kept.sort_unstable();
            kept.map(|index| column[index])
        })
        .collect();
    line.dedup();
    line
}

/// A length in micrometres with about three digits.
fn micrometres(length_m: f64) -> String {
    let length_um = length_m * UM_PER_M;
    let decimals = if length_um >= 100.0 { 0 } else { 2 };
    let text = number(length_um, decimals);
    match text.split_once('.') {
        Some((whole, fraction)) if fraction.bytes().all(|b| b == b'0') => whole.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::testing::check as look;

    const LARGEST_SVG_BYTES: usize = 300_000;
    const RATE_HZ: f64 = 1e4;

    fn plot(positions_m: Vec<f64>) -> TracePlot {
        TracePlot {
            units: Units::Linear,
            title: "Wall hit".to_owned(),
            subtitle: "K = 50 kN/m".to_owned(),
            rate_hz: RATE_HZ,
            positions_m,
            wall_m: 0.07,
            settle_s: 4.0,
            window_s: 2.0,
            rms_limit_m: 1.5e-5,
            verdict: "stable".to_owned(),
            rms_m: 2.2e-6,
        }
    }

    /// Positions that alternate by ±2 µm about 0.0702 m. They begin at 0.3 s.
    fn contact() -> Vec<f64> {
        (0..60_000_u32)
            .map(|n| match n {
                0..3000 => 0.07 * (f64::from(n) / 3000.0).powi(2),
                n if n.is_multiple_of(2) => 0.070_202,
                _ => 0.070_198,
            })
            .collect()
    }

    #[test]
    fn a_long_trace_stays_small_and_labelled() {
        let figure = look(hit_trace, &plot(contact()));
        assert!(figure.svg().len() < LARGEST_SVG_BYTES);
        for text in [
            "True position x [mm]",
            "x − mean [µm]",
            "Time t [s]",
            "settle 4 s",
            "measuring window 2 s",
            ">\nwall\n<",
            "Measuring window: stable, RMS of the counts 2.20 µm (limit 15 µm)",
        ] {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
    }

    #[test]
    fn a_peak_of_one_sample_survives() {
        let height = |n| if n == 31_234 { 0 } else { 500 };
        let line = reduce((0..60_000).map(|n| (n / 100, height(n))));
        assert!(line.len() < 1000);
        assert_eq!(line.iter().filter(|point| point.1 == 0).count(), 1);
        assert!(line.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    }

    #[test]
    fn short_and_motionless_traces_have_figures() {
        look(hit_trace, &plot(vec![0.0; 60_000]));
        let early = look(hit_trace, &plot(contact()[..30_000].to_vec()));
        assert!(early.svg().contains("the trace ends before the window"));
        let mut still = plot(vec![0.07]);
        still.settle_s = 0.0;
        still.rms_limit_m = 0.0;
        look(hit_trace, &still);
    }

    #[test]
    fn absurd_numbers_neither_hang_nor_leak_into_the_figure() {
        let mut far = plot(vec![1e15, 1e15 - 0.125]);
        far.wall_m = 1e15;
        far.settle_s = 1e15;
        far.window_s = 1e-3;
        far.verdict = "long ".repeat(100);
        let figure = hit_trace(&far).unwrap();
        assert!(!figure.svg().contains("NaN") && !figure.svg().contains("inf"));
        assert!(figure.png().is_ok());
    }

    #[test]
    fn impossible_traces_are_errors() {
        assert_eq!(hit_trace(&plot(vec![])), Err(FigureError::no_samples()));
        let quantity = "positions_m";
        assert_eq!(
            hit_trace(&plot(vec![0.0, f64::NAN])),
            Err(FigureError::of(quantity, crate::output::figure::NOT_PLOTTABLE))
        );
        let quantity = "rate_hz";
        let mut bad = plot(vec![0.0]);
        bad.rate_hz = 0.0;
        assert_eq!(
            hit_trace(&bad),
            Err(FigureError::of(quantity, crate::output::figure::NOT_POSITIVE))
        );
    }
}
