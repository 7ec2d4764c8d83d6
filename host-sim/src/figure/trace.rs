//! The trace of one wall hit, whole and in its measuring window.

use super::axis::{Scale, Ticks, hertz, number};
use super::colour::{ACCENT, DATA, TEXT};
use super::drawing::{Anchor, Drawing, Ink, Stroke};
use super::panel::{self, Panel, X_TITLE_DROP};
use super::{
    AXIS_TITLE_SIZE, Figure, FigureError, MARGIN, SUBTITLE_SIZE, WIDTH, font, not_negative,
    plottable, positive,
};

const LEFT: f64 = 76.0;
const RIGHT: f64 = WIDTH - 56.0;
const STRIP_TOP: f64 = 54.0;
const STRIP_BOTTOM: f64 = 72.0;
const HIT_BOTTOM: f64 = 208.0;
const VERDICT_BASELINE: f64 = HIT_BOTTOM + X_TITLE_DROP + 32.0;
const ZOOM_TOP: f64 = VERDICT_BASELINE + 10.0;
const ZOOM_BOTTOM: f64 = ZOOM_TOP + 130.0;
const HEIGHT: f64 = ZOOM_BOTTOM + X_TITLE_DROP + 13.0;
const MOST_X_TICKS: usize = 8;
const MOST_Y_TICKS: usize = 5;

const LINE_WIDTH: f64 = 0.9;
const WALL_WIDTH: f64 = 1.2;
const DASH: [f64; 2] = [6.0, 4.0];
const SETTLE: Ink = Ink::new(120, 120, 120).with_opacity(0.10);
const SETTLE_STRIP: Ink = Ink::new(120, 120, 120).with_opacity(0.25);
const WINDOW: Ink = DATA.with_opacity(0.08);
const WINDOW_STRIP: Ink = DATA.with_opacity(0.25);
const BAND: Ink = ACCENT.with_opacity(0.13);
/// Columns per SVG unit that a long trace is reduced to: finer than a pen line is wide.
const COLUMNS_PER_UNIT: f64 = 1.5;

const MM_PER_M: f64 = 1e3;
const UM_PER_M: f64 = 1e6;

/// What [`hit_trace`] draws.
#[derive(Debug, Clone, PartialEq)]
pub struct TracePlot {
    /// First line above the plot.
    pub title: String,
    /// Second line: scene, resolution, and what else identifies the run.
    pub subtitle: String,
    /// Samples per second.
    pub rate_hz: f64,
    /// Position at every sample, from t = 0; may end early.
    pub positions_m: Vec<f64>,
    /// Position of the wall.
    pub wall_m: f64,
    /// From the start to the measuring window.
    pub settle_s: f64,
    /// Length of the measuring window.
    pub window_s: f64,
    /// Largest RMS that counts as stable.
    pub rms_limit_m: f64,
    /// `stable`, `unstable`, `no contact`: printed as it is.
    pub verdict: String,
    /// RMS of the position about its mean in the window.
    pub rms_m: f64,
}

/// Draws position over time, and below it the measuring window about its mean.
///
/// A long trace is reduced to the first, lowest, highest and last sample of each pixel column.
///
/// # Errors
/// [`FigureError`] if a number is NaN or infinite, the rate or the window is not greater than 0, or
/// there are no samples.
pub fn hit_trace(plot: &TracePlot) -> Result<Figure, FigureError> {
    check(plot)?;
    let mut drawing = Drawing::new(WIDTH, HEIGHT);
    panel::heading(&mut drawing, &plot.title, &plot.subtitle);
    draw_hit(&mut drawing, plot);

    let verdict = format!(
        "Measuring window: {}, RMS {} µm (limit {} µm)",
        plot.verdict,
        micrometres(plot.rms_m),
        micrometres(plot.rms_limit_m)
    );
    let (text, size) = font::fit(&verdict, AXIS_TITLE_SIZE, WIDTH - LEFT - MARGIN);
    drawing.text([LEFT, VERDICT_BASELINE], size, Anchor::Start, TEXT, &text);
    draw_window(&mut drawing, plot);
    Ok(Figure::new(drawing, &plot.title))
}

fn check(plot: &TracePlot) -> Result<(), FigureError> {
    positive("rate_hz", plot.rate_hz)?;
    positive("window_s", plot.window_s)?;
    not_negative("settle_s", plot.settle_s)?;
    not_negative("rms_limit_m", plot.rms_limit_m)?;
    not_negative("rms_m", plot.rms_m)?;
    plottable("wall_m", plot.wall_m)?;
    if plot.positions_m.is_empty() {
        return Err(FigureError::NoSamples);
    }
    for position_m in &plot.positions_m {
        plottable("positions_m", *position_m)?;
    }
    Ok(())
}

fn draw_hit(drawing: &mut Drawing, plot: &TracePlot) {
    let window_end_s = plot.settle_s + plot.window_s;
    let end_s = window_end_s.max(plot.positions_m.len() as f64 / plot.rate_hz);
    let [low, high] = range(plot.positions_m.iter().copied().chain([plot.wall_m]));
    let x = Ticks::within(0.0, end_s, MOST_X_TICKS);
    let y = Ticks::around(low * MM_PER_M, high * MM_PER_M, MOST_Y_TICKS);
    let panel = Panel::new(
        [LEFT, STRIP_BOTTOM],
        [RIGHT, HIT_BOTTOM],
        Scale::linear(0.0, end_s),
        Scale::linear(y.low, y.high),
    );
    let phases = [
        (0.0, plot.settle_s, "settle", SETTLE, SETTLE_STRIP),
        (plot.settle_s, window_end_s, "measuring window", WINDOW, WINDOW_STRIP),
    ];
    for (from_s, to_s, name, ink, strip) in phases {
        let (left, right) = (panel.x(from_s), panel.x(to_s));
        drawing.rect([left, panel.top], [right, panel.bottom], ink);
        drawing.rect([left, STRIP_TOP], [right, panel.top], strip);
        let length_s = hertz(to_s - from_s);
        let long = format!("{name} {length_s} s");
        for text in [long.as_str(), name] {
            if font::width(text, SUBTITLE_SIZE) < right - left {
                let at = [f64::midpoint(left, right), STRIP_BOTTOM - 5.0];
                drawing.text(at, SUBTITLE_SIZE, Anchor::Middle, TEXT, text);
                break;
            }
        }
    }
    panel.y_grid(drawing, &y.values);
    panel.frame(drawing);
    let samples = plot.positions_m.iter().enumerate();
    let line = reduce(
        &panel,
        samples.map(|(n, position_m)| (n as f64 / plot.rate_hz, position_m * MM_PER_M)),
    );
    drawing.line(line, Stroke::solid(DATA, LINE_WIDTH));
    let wall = panel.y(plot.wall_m * MM_PER_M);
    drawing.line(
        vec![[panel.left, wall], [panel.right, wall]],
        Stroke { dash: Some(DASH), ..Stroke::solid(ACCENT, WALL_WIDTH) },
    );
    let beside = [panel.right + 6.0, wall + 4.0];
    drawing.text(beside, SUBTITLE_SIZE, Anchor::Start, ACCENT, "wall");
    panel.x_ticks(drawing, &x.values);
    panel.x_labels(drawing, &x.values, &x.labels());
    panel.y_axis(drawing, &y.values, &y.labels());
    panel.x_title(drawing, "Time t [s]");
    panel.y_title(drawing, "Position x [mm]");
}

fn draw_window(drawing: &mut Drawing, plot: &TracePlot) {
    let times = |n: usize| n as f64 / plot.rate_hz;
    // Half a sample of slack: n / rate need not be exact.
    let half_s = 0.5 / plot.rate_hz;
    let from_s = plot.settle_s;
    let to_s = plot.settle_s + plot.window_s;
    let inside: Vec<(f64, f64)> = plot
        .positions_m
        .iter()
        .enumerate()
        .map(|(n, position_m)| (times(n), *position_m))
        .filter(|(t, _)| *t >= from_s - half_s && *t < to_s - half_s)
        .map(|(t, position_m)| (t.clamp(from_s, to_s), position_m))
        .collect();
    let mean_m = inside.iter().map(|(_, x)| x).sum::<f64>() / inside.len().max(1) as f64;
    let limit = plot.rms_limit_m * UM_PER_M;
    let deviations: Vec<(f64, f64)> =
        inside.into_iter().map(|(t, x)| (t, (x - mean_m) * UM_PER_M)).collect();
    let [low, high] =
        range(deviations.iter().map(|(_, deviation)| *deviation).chain([-limit, limit]));
    let x = Ticks::within(from_s, to_s, MOST_X_TICKS);
    let y = Ticks::around(low, high, MOST_Y_TICKS);
    let panel = Panel::new(
        [LEFT, ZOOM_TOP],
        [RIGHT, ZOOM_BOTTOM],
        Scale::linear(from_s, to_s),
        Scale::linear(y.low, y.high),
    );
    drawing.rect([panel.left, panel.y(limit)], [panel.right, panel.y(-limit)], BAND);
    panel.y_grid(drawing, &y.values);
    let beside = panel.right + 6.0;
    for (text, drop) in [("RMS", -3.0), ("limit", 11.0)] {
        let at = [beside, panel.y(0.0) + drop];
        drawing.text(at, SUBTITLE_SIZE, Anchor::Start, ACCENT, text);
    }
    if deviations.is_empty() {
        panel.remark(drawing, "the trace ends before the window");
    } else {
        let line = reduce(&panel, deviations.into_iter());
        drawing.line(line, Stroke::solid(DATA, LINE_WIDTH));
    }
    for level in [-limit, limit] {
        drawing.line(
            vec![[panel.left, panel.y(level)], [panel.right, panel.y(level)]],
            Stroke { dash: Some(DASH), ..Stroke::solid(ACCENT, WALL_WIDTH) },
        );
    }
    panel.frame(drawing);
    panel.x_ticks(drawing, &x.values);
    panel.x_labels(drawing, &x.values, &x.labels());
    panel.y_axis(drawing, &y.values, &y.labels());
    panel.x_title(drawing, "Time t [s]");
    panel.y_title(drawing, "x − mean [µm]");
}

/// Lowest and highest value; a range of one value grows, so that an axis has a length.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
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

/// The line through the samples, reduced to four points per column: peaks survive.
fn reduce(panel: &Panel, samples: impl Iterator<Item = (f64, f64)>) -> Vec<[f64; 2]> {
    let mut line = Vec::new();
    let mut column: Vec<[f64; 2]> = Vec::new();
    let mut current = f64::NAN;
    for (time, value) in samples {
        let point = panel.at(time, value);
        let index = ((point[0] - panel.left) * COLUMNS_PER_UNIT).floor();
        if index != current {
            flush(&mut column, &mut line);
            current = index;
        }
        column.push(point);
    }
    flush(&mut column, &mut line);
    line
}

/// First, lowest, highest and last point of a column, in the order of time.
fn flush(column: &mut Vec<[f64; 2]>, line: &mut Vec<[f64; 2]>) {
    let heights = || column.iter().enumerate().map(|(index, point)| (point[1], index));
    let lowest = heights().min_by(|a, b| a.0.total_cmp(&b.0));
    let highest = heights().max_by(|a, b| a.0.total_cmp(&b.0));
    if let (Some((_, lowest)), Some((_, highest))) = (lowest, highest) {
        let mut kept = [0, lowest, highest, column.len() - 1];
        kept.sort_unstable();
        let mut previous = None;
        for index in kept {
            if previous != Some(index) {
                line.push(column[index]);
            }
            previous = Some(index);
        }
    }
    column.clear();
}

/// A length in micrometres to about three digits.
fn micrometres(length_m: f64) -> String {
    let length_um = length_m * UM_PER_M;
    let decimals = match length_um {
        v if v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        _ => 2,
    };
    let text = number(length_um, decimals);
    match text.split_once('.') {
        Some((whole, fraction)) if fraction.bytes().all(|b| b == b'0') => whole.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::testing::check as look;

    const LARGEST_SVG_BYTES: usize = 300_000;
    const RATE_HZ: f64 = 1e4;

    fn plot(positions_m: Vec<f64>) -> TracePlot {
        TracePlot {
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

    /// Alternates by ±2 µm about 0.0702 m from 0.3 s on.
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
            "Position x [mm]",
            "x − mean [µm]",
            "Time t [s]",
            "settle 4 s",
            "measuring window 2 s",
            ">wall<",
            "Measuring window: stable, RMS 2.20 µm (limit 15 µm)",
        ] {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
    }

    #[test]
    fn a_peak_of_one_sample_survives() {
        let panel = Panel::new(
            [0.0, 0.0],
            [100.0, 100.0],
            Scale::linear(0.0, 60_000.0),
            Scale::linear(0.0, 1.0),
        );
        let value = |n: u32| if n == 31_234 { 1.0 } else { 0.5 };
        let line = reduce(&panel, (0..60_000).map(|n| (f64::from(n), value(n))));
        assert!(line.len() < 1000);
        assert_eq!(line.iter().filter(|point| point[1] == 0.0).count(), 1);
        assert!(line.windows(2).all(|pair| pair[0][0] <= pair[1][0]));
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
        assert_eq!(hit_trace(&plot(vec![])), Err(FigureError::NoSamples));
        let quantity = "positions_m";
        assert_eq!(
            hit_trace(&plot(vec![0.0, f64::NAN])),
            Err(FigureError::NotPlottable { quantity })
        );
        let quantity = "rate_hz";
        let mut bad = plot(vec![0.0]);
        bad.rate_hz = 0.0;
        assert_eq!(hit_trace(&bad), Err(FigureError::NotPositive { quantity }));
    }
}
