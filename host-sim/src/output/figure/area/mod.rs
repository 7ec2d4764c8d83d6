//! The area figure, which shows the Z-width area over the cutoff.

use plotters::{
    coord::{
        combinators::{BindKeyPoints as _, LogCoord, WithKeyPoints},
        ranged1d::Ranged as _,
    },
    prelude::*,
    style::text_anchor::HPos,
};

use serde::Serialize;

use crate::scene::Units;

mod cutoffs;

use cutoffs::{ROW_DROP, ROW_PITCH, cutoff_range, draw_labels, labels, rows};

use super::{
    Figure, FigureError, MARGIN, Page, WIDTH, at,
    axis::{Ticks, hertz, scaled_unit},
    colour::{ACCENT, DATA, QUIET, TEXT},
    grid, not_negative,
    panel::{self, AXIS_TITLE_SIZE, Chart, Grid, Panel, SMALL_SIZE, X_TITLE_DROP},
    positive, text,
};

const LEFT: f64 = 56.0;
/// Top of the plot, if only one row of numbers is above it.
const TOP: f64 = 112.0;
const RIGHT: f64 = WIDTH - MARGIN - 8.0;
const PLOT_HEIGHT: f64 = 220.0;
const MOST_TICKS: usize = 7;
/// Smallest end of the axis, as a multiple of the largest value. So the mark of the largest area is inside the frame.
const HEADROOM: f64 = 1.03;

const KEY_MIDDLE: f64 = 60.0;
const KEY_SWATCH: f64 = 20.0;
const KEY_GAP: f64 = 6.0;
const KEY_SPACE: f64 = 16.0;
/// Height of the upper axis title above the uppermost row of numbers.
const TOP_TITLE_RISE: f64 = 16.0;
const CAPTION_DROP: f64 = 52.0;
const CAPTION_PITCH: f64 = 16.0;

const LINE_WIDTH: f64 = 1.6;
const BAR_WIDTH: f64 = 1.1;
const CAP_HALF: f64 = 3.5;
const DOT_RADIUS: f64 = 2.8;
/// Radius of the ring around the ideal mean. The ring is open, so the error bar inside the ring is visible.
const IDEAL_RADIUS: f64 = 6.0;
const IDEAL_HOLE: f64 = 4.2;
const BAND_OPACITY: f64 = 0.18;
const RANGE_OPACITY: f64 = 0.13;
/// Distance by which the shaded range extends beyond its outermost cutoffs, so that all their points are inside.
const RANGE_MARGIN: f64 = 6.0;

#[derive(Debug, Clone, PartialEq)]
pub struct AreaPlot {
    pub title: String,
    /// The second line: scene, resolution, and other facts that identify the run.
    pub subtitle: String,
    pub units: Units,
    /// One point per cutoff, in ascending order of the cutoff.
    pub points: Vec<AreaPoint>,
    pub ideal_cutoff_hz: Option<f64>,
    /// First and last nominal cutoff of the shaded range.
    pub ideal_range_hz: Option<[f64; 2]>,
    /// Names of the shaded range and of the cutoff that is marked.
    pub names: [&'static str; 2],
    /// What the cutoff means, as a sentence below the axis.
    pub convention: String,
}

impl AreaPlot {
    /// Names for the scene's own criterion.
    pub const IDEAL: [&str; 2] = ["ideal range", "ideal"];
    /// Names for quiet walls.
    pub const DIAL_IN: [&str; 2] = ["as good", "dial in"];
}

/// The result for one cutoff. It summarises the repeats.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AreaPoint {
    /// Nominal cutoff of the filter in Hz.
    pub cutoff_hz: f64,
    /// Frequency at which the discrete filter's gain is -3 dB.
    pub true_cutoff_hz: f64,
    /// Mean area [N² s/m²].
    #[serde(rename = "area_n2_s_per_m2")]
    pub area: f64,
    /// Smallest area of the repeats [N² s/m²].
    #[serde(rename = "area_low_n2_s_per_m2")]
    pub area_low: f64,
    /// Largest area of the repeats [N² s/m²].
    #[serde(rename = "area_high_n2_s_per_m2")]
    pub area_high: f64,
    /// Largest stable stiffness at any damping.
    pub stiffness_peak_n_per_m: f64,
    /// Largest damping at which any wall was stable.
    pub damping_max_n_s_per_m: f64,
}

/// Draws the area over the logarithm of the cutoff. The area axis starts at 0. The upper axis has the true frequencies.
///
/// # Errors
/// [`FigureError`] if an area is NaN, infinite or negative, or a cutoff is not greater than 0.
pub fn area(plot: &AreaPlot) -> Result<Figure, FigureError> {
    check(plot)?;
    Figure::new([&plot.title, &plot.subtitle], height(plot), &|page| draw(plot, page))
}

pub(super) fn panel_of(rows: usize) -> Panel {
    let top = TOP + (rows.max(1) - 1) as f64 * ROW_PITCH;
    Panel { left: LEFT, top, right: RIGHT, bottom: top + PLOT_HEIGHT }
}

fn caption(plot: &AreaPlot) -> Vec<String> {
    text::wrap(&plot.convention, SMALL_SIZE, RIGHT - LEFT)
}

fn x_title_drop(rows: usize) -> f64 {
    X_TITLE_DROP + (rows.max(1) - 1) as f64 * ROW_PITCH
}

fn height(plot: &AreaPlot) -> f64 {
    let rows = rows(&labels(plot));
    let drop = x_title_drop(rows) - X_TITLE_DROP + CAPTION_DROP;
    (panel_of(rows).bottom + drop + CAPTION_PITCH * caption(plot).len() as f64).ceil()
}

fn draw(plot: &AreaPlot, page: &Page) -> Result<(), FigureError> {
    let (unit, times) = plot.units.written("N² s/m²");
    let largest = check(plot)? * times;
    let (factor, unit) = scaled_unit(largest, unit);
    let factor = factor / times;
    let labels = labels(plot);
    let rows = rows(&labels);
    let panel = panel_of(rows);

    key(page, plot)?;
    let y = if largest > 0.0 {
        Ticks::around(0.0, HEADROOM * largest / times / factor, MOST_TICKS)
    } else {
        Ticks::nothing()
    };
    let cutoffs = cutoff_range(&plot.points).log_scale();
    let cutoffs = cutoffs.with_key_points(vec![]); // cutoffs have their own ticks
    let mut chart = panel.chart(page, cutoffs, y, x_title_drop(rows))?;
    shade_range(page, &panel, plot)?;
    let titles = ["Cutoff, nominal [Hz]", &format!("Z-width area [{unit}]")];
    panel::axes(&mut chart, Grid::Horizontal, titles)?;
    draw_areas(page, &chart, plot, factor)?;
    panel.frame(page)?;
    draw_labels(page, &panel, plot, &labels)?;
    let middle = panel.top - ROW_DROP - (rows.max(1) - 1) as f64 * ROW_PITCH - TOP_TITLE_RISE;
    let title = [panel.centre()[0], middle];
    let name = "True −3 dB frequency [Hz]";
    text::write(page, name, title, HPos::Center, AXIS_TITLE_SIZE, TEXT)?;
    if largest <= 0.0 {
        panel.remark(page, "no stable wall found")?;
    }
    let first = panel.bottom + x_title_drop(rows) - X_TITLE_DROP + CAPTION_DROP;
    for (index, line) in caption(plot).iter().enumerate() {
        let (line, size) = text::fit(line, SMALL_SIZE, RIGHT - LEFT);
        let y = first + CAPTION_PITCH * index as f64;
        text::write(page, &line, [LEFT, y], HPos::Left, size, QUIET)?;
    }
    Ok(())
}

/// Checks the numbers. Returns the largest area.
fn check(plot: &AreaPlot) -> Result<f64, FigureError> {
    let mut largest = 0.0_f64;
    for point in &plot.points {
        positive("cutoff_hz", point.cutoff_hz)?;
        positive("true_cutoff_hz", point.true_cutoff_hz)?;
        for (quantity, value) in
            [("area", point.area), ("area_low", point.area_low), ("area_high", point.area_high)]
        {
            largest = largest.max(not_negative(quantity, value)?);
        }
    }
    if let Some(cutoff_hz) = plot.ideal_cutoff_hz {
        positive("ideal_cutoff_hz", cutoff_hz)?;
    }
    for end_hz in plot.ideal_range_hz.into_iter().flatten() {
        positive("ideal_range_hz", end_hz)?;
    }
    Ok(largest)
}

fn shade_range(page: &Page, panel: &Panel, plot: &AreaPlot) -> Result<(), FigureError> {
    let (Some(ends), false) = (plot.ideal_range_hz, plot.points.is_empty()) else {
        return Ok(());
    };
    let x = LogCoord::from(cutoff_range(&plot.points).log_scale());
    let limits = panel.x_pixels();
    let margin = grid(RANGE_MARGIN);
    let [low, high] = ends.map(|end_hz| x.map(&end_hz, limits).clamp(limits.0, limits.1));
    let (low, high) = ((low - margin).max(limits.0), (high + margin).min(limits.1));
    let corners = [(low, grid(panel.top)), (high, grid(panel.bottom))];
    page.draw(&Rectangle::new(corners, ACCENT.mix(RANGE_OPACITY).filled()))?;
    Ok(())
}

fn draw_areas(
    page: &Page,
    chart: &Chart<'_, WithKeyPoints<LogCoord<f64>>>,
    plot: &AreaPlot,
    factor: f64,
) -> Result<(), FigureError> {
    let points = || plot.points.iter();
    let place = |point: &AreaPoint, area| chart.backend_coord(&(point.cutoff_hz, area / factor));
    let highs = points().map(|point| place(point, point.area_high));
    let lows = points().rev().map(|point| place(point, point.area_low));
    let band: Vec<_> = highs.chain(lows).collect();
    page.draw(&Polygon::new(band, DATA.mix(BAND_OPACITY).filled()))?;
    let means: Vec<_> = points().map(|point| place(point, point.area)).collect();
    panel::path(page, means.clone(), DATA, LINE_WIDTH)?;
    for (point, mean) in points().zip(means) {
        let ideal = plot.ideal_cutoff_hz == Some(point.cutoff_hz);
        let colour = if ideal { ACCENT } else { DATA };
        if ideal {
            ring(page, mean)?;
        }
        let (x, low) = place(point, point.area_low);
        let (_, high) = place(point, point.area_high);
        let cap = |y| vec![(x - grid(CAP_HALF), y), (x + grid(CAP_HALF), y)];
        for line in [vec![(x, low), (x, high)], cap(low), cap(high)] {
            panel::path(page, line, colour, BAR_WIDTH)?;
        }
        page.draw(&Circle::new(mean, grid(DOT_RADIUS), colour.filled()))?;
    }
    Ok(())
}

fn ring(page: &Page, at: (i32, i32)) -> Result<(), FigureError> {
    page.draw(&Circle::new(at, grid(IDEAL_RADIUS), ACCENT.filled()))?;
    Ok(page.draw(&Circle::new(at, grid(IDEAL_HOLE), WHITE.filled()))?)
}

/// Draws the legend in one line above the plot, so that no text covers data.
fn key(page: &Page, plot: &AreaPlot) -> Result<(), FigureError> {
    let y = KEY_MIDDLE;
    let mut x = LEFT;
    let label = |x: &mut f64, text: &str| {
        let left = *x + KEY_SWATCH + KEY_GAP;
        *x = left + text::width(text, SMALL_SIZE) + KEY_SPACE;
        text::write(page, text, [left, y], HPos::Left, SMALL_SIZE, TEXT)
    };

    let (end, middle) = (x + KEY_SWATCH, x + KEY_SWATCH / 2.0);
    panel::rect(page, x..end, y - 4.0..y + 4.0, DATA.mix(BAND_OPACITY))?;
    panel::line(page, &[[x, y], [end, y]], DATA, LINE_WIDTH)?;
    panel::line(page, &[[middle, y - 4.0], [middle, y + 4.0]], DATA, BAR_WIDTH)?;
    panel::dot(page, [middle, y], DOT_RADIUS, DATA)?;
    label(&mut x, "mean, lowest to highest")?;

    if let Some([low, high]) = plot.ideal_range_hz {
        let colour = ACCENT.mix(2.0 * RANGE_OPACITY);
        panel::rect(page, x..x + KEY_SWATCH, y - 6.0..y + 6.0, colour)?;
        let text = if low < high {
            format!("{} {} to {} Hz", plot.names[0], hertz(low), hertz(high))
        } else {
            plot.names[0].to_owned()
        };
        label(&mut x, &text)?;
    }
    if let Some(ideal_hz) = plot.ideal_cutoff_hz {
        let middle = x + KEY_SWATCH / 2.0;
        ring(page, at(middle, y))?;
        panel::dot(page, [middle, y], DOT_RADIUS, ACCENT)?;
        label(&mut x, &format!("{} {} Hz", plot.names[1], hertz(ideal_hz)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::testing::{check as look, text_boxes};

    /// Areas of a run with a resolution of 1 µm.
    const AREAS: [(f64, f64, f64); 6] = [
        (50.0, 50.0, 6.8e5),
        (500.0, 496.0, 2.65e7),
        (1000.0, 968.9, 3.9e7),
        (1500.0, 1401.8, 4.4e7),
        (2000.0, 1785.7, 4.69e7),
        (4000.0, 2860.5, 4.55e7),
    ];

    fn plot(points: Vec<AreaPoint>) -> AreaPlot {
        AreaPlot {
            units: Units::Linear,
            title: "Areas <1 µm>".to_owned(),
            subtitle: "resolution 1 µm".to_owned(),
            points,
            ideal_cutoff_hz: Some(2000.0),
            ideal_range_hz: Some([1500.0, 2000.0]),
            names: AreaPlot::IDEAL,
            convention: "bilinear, not pre-warped: nominal 2000 Hz is −3 dB at 1785.7 Hz"
                .to_owned(),
        }
    }

    fn point(cutoff_hz: f64, true_cutoff_hz: f64, area: f64) -> AreaPoint {
        let [stiffness_peak_n_per_m, damping_max_n_s_per_m] = [5e4, 700.0];
        let [area_low, area_high] = [0.99 * area, 1.01 * area];
        AreaPoint {
            cutoff_hz,
            true_cutoff_hz,
            area,
            area_low,
            area_high,
            stiffness_peak_n_per_m,
            damping_max_n_s_per_m,
        }
    }

    fn run() -> Vec<AreaPoint> {
        AREAS.iter().map(|(fc, ft, area)| point(*fc, *ft, *area)).collect()
    }

    #[test]
    fn it_names_axes_ideal_range_and_convention() {
        let figure = look(area, &plot(run()));
        for text in [
            "Z-width area [10⁷ N² s/m²]",
            "Cutoff, nominal [Hz]",
            "True −3 dB frequency [Hz]",
            "ideal range 1500 to 2000 Hz",
            "ideal 2000 Hz",
            ">\n1786\n<",
            "bilinear, not pre-warped: nominal 2000 Hz is −3 dB at 1785.7 Hz",
            "Areas &lt;1 µm&gt;",
        ] {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
    }

    #[test]
    fn labels_of_crowded_cutoffs_keep_apart() {
        let points = (1..=30).map(|n| 150.0 * f64::from(n));
        let points: Vec<AreaPoint> = points.map(|fc| point(fc, 0.9 * fc, 1e4 * fc)).collect();
        let figure = look(area, &plot(points));
        let document = roxmltree::Document::parse(figure.svg()).unwrap();
        let boxes = text_boxes(&document);
        assert!(boxes.len() > 20);
        for (index, one) in boxes.iter().enumerate() {
            for other in &boxes[index + 1..] {
                assert!(
                    (0..2).any(|n| one[n + 2] <= other[n] || other[n + 2] <= one[n]),
                    "texts overlap: {one:?} {other:?}"
                );
            }
        }
    }

    #[test]
    fn one_cutoff_no_cutoff_and_no_area_have_figures() {
        look(area, &plot(vec![point(2000.0, 1785.7, 4.69e7)]));
        for points in [vec![], vec![point(50.0, 50.0, 0.0), point(100.0, 99.97, 0.0)]] {
            let figure = look(area, &plot(points));
            assert!(figure.svg().contains("no stable wall found"));
        }
    }

    #[test]
    fn what_is_no_number_is_an_error() {
        let quantity = "area";
        let bad = plot(vec![point(50.0, 50.0, f64::NAN)]);
        assert_eq!(
            area(&bad),
            Err(FigureError::of(quantity, crate::output::figure::NOT_PLOTTABLE))
        );
        let bad = plot(vec![point(50.0, 50.0, -1.0)]);
        assert_eq!(area(&bad), Err(FigureError::of(quantity, crate::output::figure::NEGATIVE)));
        let quantity = "cutoff_hz";
        let bad = plot(vec![point(0.0, 50.0, 1.0)]);
        assert_eq!(area(&bad), Err(FigureError::of(quantity, crate::output::figure::NOT_POSITIVE)));
    }
}
