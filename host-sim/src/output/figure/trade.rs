//! Figures of a trade. They show an error over the cost, or over the cutoff, with logarithmic axes.

use plotters::{prelude::*, style::text_anchor::HPos};

use super::{
    Figure, FigureError, MARGIN, Page, WIDTH,
    axis::superscript,
    colour::{GRID, QUIET, TEXT},
    panel::{self, AXIS_TITLE_SIZE, Panel, SMALL_SIZE},
    plottable, text,
};

const TOP: f64 = 78.0;
const LEFT: f64 = 58.0;
/// Space between panels. Sideways it has the labels of the right panel. Downwards it has the labels and the title of
/// the upper panel.
const GAP: [f64; 2] = [50.0, 46.0];
const PANEL_HEIGHT: f64 = 190.0;
const BOTTOM: f64 = 52.0;
const TICK_SIZE: f64 = 11.0;
const TITLE_RISE: f64 = 15.0;
const LEGEND_GAP: f64 = 14.0;
const LEGEND_PITCH: f64 = 17.0;
const LEGEND_SWATCH: f64 = 18.0;
const LINE_WIDTH: f64 = 1.4;
const GRID_WIDTH: f64 = 0.7;
const MARK: f64 = 3.4;
/// Space between the frame and the ends of an axis, as a fraction of the axis.
const PAD: f64 = 0.025;
const MOST_TICKS: i32 = 6;
const LIMIT: RGBColor = TEXT;
const LIMIT_WIDTH: f64 = 0.9;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    Circle,
    Square,
    /// Filled triangle that points up.
    Triangle,
    /// Filled square that stands on a corner.
    Diamond,
}

/// Colours of Okabe and Ito, without yellow. The colours can be distinguished with every common colour vision
/// deficiency.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 90, 150),
    RGBColor(213, 94, 0),
    RGBColor(0, 140, 100),
    RGBColor(204, 121, 167),
    RGBColor(86, 170, 220),
    RGBColor(150, 110, 0),
    RGBColor(120, 60, 160),
    RGBColor(150, 30, 30),
];

/// A series: its name in the legend, and its points in each panel.
#[derive(Debug, Clone, PartialEq)]
pub struct TradeSeries {
    pub name: String,
    /// Index in the palette.
    pub colour: usize,
    pub mark: Mark,
    /// The points in each panel, as x and y. A y of 0 is drawn at the lower edge, an infinite y on the frame.
    pub points: Vec<Vec<[f64; 2]>>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct TradePanel {
    /// Title above the panel, in one line.
    pub title: String,
    /// Title of the y axis, with the unit.
    pub y_title: String,
    /// Level at which a line is drawn.
    pub limit: Option<f64>,
    /// Smallest value that is drawn. Smaller values are drawn at this value, because 0 has no logarithm.
    pub floor: f64,
    /// Points of the Pareto front, sorted by x. The front is drawn as a staircase.
    pub front: Vec<[f64; 2]>,
}

impl TradePanel {
    /// A panel without a limit and without a front.
    pub fn new(title: impl Into<String>, y_title: impl Into<String>, floor: f64) -> Self {
        let (title, y_title) = (title.into(), y_title.into());
        Self { title, y_title, limit: None, floor, front: vec![] }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct TradePlot {
    pub title: String,
    pub subtitle: String,
    pub legend: String,
    /// Title below each panel, with the unit.
    pub x_title: String,
    /// The panels, two in a row. All panels have the same x axis.
    pub panels: Vec<TradePanel>,
    pub series: Vec<TradeSeries>,
    /// Whether lines connect the points of a series.
    pub lines: bool,
}

/// Draws a trade.
///
/// # Errors
/// [`FigureError`] if a number is NaN, an x is infinite or not greater than 0, or a y is negatively infinite.
pub fn trade(plot: &TradePlot) -> Result<Figure, FigureError> {
    for point in plot.series.iter().flat_map(|series| series.points.iter().flatten()) {
        super::positive("x", point[0])?;
        if point[1] != f64::INFINITY {
            plottable("y", point[1])?;
        }
    }
    Figure::new([&plot.title, &plot.subtitle], height(plot), &|page| draw(plot, page))
}

fn columns(plot: &TradePlot) -> usize {
    plot.panels.len().clamp(1, 2)
}

fn rows(plot: &TradePlot) -> usize {
    plot.panels.len().div_ceil(columns(plot)).max(1)
}

fn height(plot: &TradePlot) -> f64 {
    let rows = rows(plot) as f64;
    let panels = TOP + rows * PANEL_HEIGHT + (rows - 1.0) * GAP[1] + BOTTOM;
    panels.max(TOP + LEGEND_PITCH * (plot.series.len() as f64 + 2.0) + MARGIN)
}

/// A range of whole decades that contains the values.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Decades {
    low: i32,
    high: i32,
}

impl Decades {
    /// The decades that contain these values. `floor` must be a power of ten, or so small that it has no effect.
    fn around(values: impl Iterator<Item = f64>, floor: f64) -> Self {
        let (low, high) = values
            .filter(|value| value.is_finite())
            .map(|value| value.max(floor).log10())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            return Self { low: 0, high: 1 };
        }
        #[expect(clippy::cast_possible_truncation, reason = "logarithms of plottable numbers")]
        let (low, high) = ((low + 1e-9).floor() as i32, (high + 0.02).ceil() as i32);
        Self { low, high: high.max(low + 1) }
    }

    /// Position of a value on the axis, from 0 to 1.
    fn place(self, value: f64) -> f64 {
        let (low, high) = (f64::from(self.low), f64::from(self.high));
        ((value.max(f64::MIN_POSITIVE).log10() - low) / (high - low)).clamp(0.0, 1.0)
    }

    fn ticks(self) -> impl Iterator<Item = i32> {
        let every = (self.high - self.low + MOST_TICKS - 1) / MOST_TICKS;
        (self.low..=self.high).filter(move |exponent| exponent.rem_euclid(every.max(1)) == 0)
    }
}

/// A power of ten as text. From 0.1 to 1000 it is a plain number, otherwise it has the form `10⁻³`.
fn decade(exponent: i32) -> String {
    match exponent {
        -1 => "0.1".into(),
        0 => "1".into(),
        1 => "10".into(),
        2 => "100".into(),
        3 => "1000".into(),
        other => {
            let raised: String = other.to_string().chars().map(superscript).collect();
            format!("10{raised}")
        }
    }
}

fn draw(plot: &TradePlot, page: &Page) -> Result<(), FigureError> {
    let names = plot.series.iter().map(|series| text::width(&series.name, SMALL_SIZE));
    let widest = names.fold(text::width(&plot.legend, AXIS_TITLE_SIZE) - LEGEND_SWATCH, f64::max);
    let right = WIDTH - MARGIN - LEGEND_GAP - LEGEND_SWATCH - widest - 6.0;
    let columns = columns(plot);
    let width = (right - LEFT - GAP[0] * (columns as f64 - 1.0)) / columns as f64;
    let points = |n: usize| plot.series.iter().filter_map(move |series| series.points.get(n));
    let all = (0..plot.panels.len()).flat_map(points).flatten();
    let x = Decades::around(all.map(|point| point[0]), f64::MIN_POSITIVE);
    for (n, part) in plot.panels.iter().enumerate() {
        let left = LEFT + (n % columns) as f64 * (width + GAP[0]);
        let top = TOP + (n / columns) as f64 * (PANEL_HEIGHT + GAP[1]);
        let panel = Panel { left, top, right: left + width, bottom: top + PANEL_HEIGHT };
        let heights = points(n).flatten().map(|point| point[1]);
        let y = Decades::around(heights.chain(part.limit), part.floor);
        let below = n + columns >= plot.panels.len();
        draw_panel(page, plot, n, part, &panel, [x, y], below)?;
    }
    draw_legend(page, plot, right + LEGEND_GAP)
}

fn draw_panel(
    page: &Page,
    plot: &TradePlot,
    n: usize,
    part: &TradePanel,
    panel: &Panel,
    [x, y]: [Decades; 2],
    below: bool,
) -> Result<(), FigureError> {
    // marks at the ends of the axes must not touch the frame
    let inside = |place: f64| PAD + place * (1.0 - 2.0 * PAD);
    let at = |[u, v]: [f64; 2]| {
        let across = panel.left + inside(x.place(u)) * (panel.right - panel.left);
        // an infinite value is drawn on the frame, above all ticks
        let up = if v == f64::INFINITY { 1.0 } else { inside(y.place(v)) };
        [across, panel.bottom - up * (panel.bottom - panel.top)]
    };
    for exponent in x.ticks() {
        let [place, _] = at([10f64.powi(exponent), 1.0]);
        panel::line(page, &[[place, panel.top], [place, panel.bottom]], GRID, GRID_WIDTH)?;
        let middle = [place, panel.bottom + 12.0];
        text::write(page, &decade(exponent), middle, HPos::Center, TICK_SIZE, TEXT)?;
    }
    for exponent in y.ticks() {
        let [_, place] = at([1.0, 10f64.powi(exponent)]);
        panel::line(page, &[[panel.left, place], [panel.right, place]], GRID, GRID_WIDTH)?;
        let end = [panel.left - 5.0, place];
        text::write(page, &decade(exponent), end, HPos::Right, TICK_SIZE, TEXT)?;
    }
    if let Some(limit) = part.limit {
        let [_, place] = at([1.0, limit]);
        panel::line(page, &[[panel.left, place], [panel.right, place]], LIMIT, LIMIT_WIDTH)?;
    }
    let steps: Vec<[f64; 2]> = part
        .front
        .iter()
        .enumerate()
        .flat_map(|(place, &point)| {
            let corner = place.checked_sub(1).map(|before| [point[0], part.front[before][1]]);
            corner.into_iter().chain([point])
        })
        .map(at)
        .collect();
    if steps.len() > 1 {
        panel::line(page, &steps, QUIET, LINE_WIDTH)?;
    }
    for series in &plot.series {
        let places: Vec<[f64; 2]> =
            series.points.get(n).into_iter().flatten().map(|point| at(*point)).collect();
        let colour = COLOURS[series.colour % COLOURS.len()];
        if plot.lines && places.len() > 1 {
            panel::line(page, &places, colour, LINE_WIDTH)?;
        }
        for place in places {
            draw_mark(page, place, series.mark, colour)?;
        }
    }
    panel.frame(page)?;
    let rise = panel.top - TITLE_RISE;
    // the name of the y axis is above the upper end of the axis, so that panels can be close together
    let name =
        format!("{}{}{}", part.y_title, if part.title.is_empty() { "" } else { ", " }, part.title);
    let room = panel.right - panel.left + 44.0;
    let (name, size) = text::fit(&name, SMALL_SIZE, room);
    text::write(page, &name, [panel.left - 44.0, rise], HPos::Left, size, TEXT)?;
    if below {
        let middle = [panel.centre()[0], panel.bottom + 32.0];
        let (title, size) =
            text::fit(&plot.x_title, AXIS_TITLE_SIZE, panel.right - panel.left + 24.0);
        text::write(page, &title, middle, HPos::Center, size, TEXT)?;
    }
    Ok(())
}

fn draw_mark(
    page: &Page,
    [x, y]: [f64; 2],
    mark: Mark,
    colour: RGBColor,
) -> Result<(), FigureError> {
    let corners: &[[f64; 2]] = match mark {
        Mark::Circle => return panel::dot(page, [x, y], MARK, colour),
        Mark::Square => &[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
        Mark::Triangle => &[[0.0, -1.2], [1.1, 0.8], [-1.1, 0.8]],
        Mark::Diamond => &[[0.0, -1.3], [1.3, 0.0], [0.0, 1.3], [-1.3, 0.0]],
    };
    let corners: Vec<_> =
        corners.iter().map(|[u, v]| super::at(x + MARK * u, y + MARK * v)).collect();
    page.draw(&Polygon::new(corners, colour.filled()))?;
    Ok(())
}

fn draw_legend(page: &Page, plot: &TradePlot, left: f64) -> Result<(), FigureError> {
    text::write(page, &plot.legend, [left, TOP + 4.0], HPos::Left, AXIS_TITLE_SIZE, TEXT)?;
    let mut y = TOP + 24.0;
    for series in &plot.series {
        let colour = COLOURS[series.colour % COLOURS.len()];
        let middle = [left + LEGEND_SWATCH / 2.0, y];
        if plot.lines {
            panel::line(page, &[[left, y], [left + LEGEND_SWATCH, y]], colour, LINE_WIDTH)?;
        }
        draw_mark(page, middle, series.mark, colour)?;
        let beside = [left + LEGEND_SWATCH + 6.0, y];
        text::write(page, &series.name, beside, HPos::Left, SMALL_SIZE, TEXT)?;
        y += LEGEND_PITCH;
    }
    let mut extra = vec![];
    if plot.panels.iter().any(|part| part.front.len() > 1) {
        extra.push((QUIET, "not beaten"));
    }
    if plot.panels.iter().any(|part| part.limit.is_some()) {
        extra.push((LIMIT, "limit"));
    }
    for (colour, name) in extra {
        panel::line(page, &[[left, y], [left + LEGEND_SWATCH, y]], colour, LINE_WIDTH)?;
        text::write(page, name, [left + LEGEND_SWATCH + 6.0, y], HPos::Left, SMALL_SIZE, TEXT)?;
        y += LEGEND_PITCH;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::testing::{Pixels, check as look};

    fn plot() -> TradePlot {
        let panel = |title: &str| TradePanel {
            title: title.to_owned(),
            y_title: "error [mm/s]".to_owned(),
            limit: Some(1e-4),
            floor: 1e-12,
            front: vec![[30.0, 1e-2], [100.0, 1e-9]],
        };
        let series = |name: &str, mark, colour| TradeSeries {
            name: name.to_owned(),
            colour,
            mark,
            points: vec![vec![[30.0, 1e-2], [100.0, 1e-9], [2000.0, 0.0]]; 2],
        };
        TradePlot {
            title: "Error over cost <1 µm>".to_owned(),
            subtitle: "cycles of a Cortex-M4".to_owned(),
            legend: "Format, form".to_owned(),
            x_title: "Cost [cycles]".to_owned(),
            panels: vec![panel("20 Hz"), panel("2000 Hz")],
            series: vec![
                series("f32, direct form 1", Mark::Circle, 0),
                series("q15", Mark::Square, 1),
                series("i32", Mark::Triangle, 2),
                series("f64", Mark::Diamond, 3),
            ],
            lines: true,
        }
    }

    #[test]
    fn it_names_axes_panels_and_series() {
        let figure = look(trade, &plot());
        for text in
            ["error [mm/s], 20 Hz", "Cost [cycles]", "f32, direct form 1", "10⁻⁸", "not beaten"]
        {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
    }

    #[test]
    fn costs_are_lines_between_decades() {
        let line = |factor: f64| -> Vec<[f64; 2]> {
            (3..=6).map(|n| [10f64.powi(n), factor * 10f64.powi(n - 5)]).collect()
        };
        let mut costs = plot();
        costs.series.truncate(2);
        costs.panels.iter_mut().for_each(|panel| panel.front.clear());
        for (series, factor) in costs.series.iter_mut().zip([1.0, 3.0]) {
            series.points = vec![line(factor); 2];
        }
        let figure = look(trade, &costs);
        for text in ["10⁵", "10⁻²", "Cost [cycles]", "q15"] {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
        assert!(!figure.svg().contains("not beaten"));
        assert!(Pixels::of(&figure).count(COLOURS[1]) > 500, "a line does not show");
        costs.series[0].points[0][0][0] = 0.0;
        assert_eq!(trade(&costs), Err(FigureError::of("x", crate::output::figure::NOT_POSITIVE)));
    }

    #[test]
    fn decades_hold_their_values() {
        let decades = Decades::around([0.3, 20.0].into_iter(), 1e-9);
        assert_eq!(decades, Decades { low: -1, high: 2 });
        let floored = Decades::around([0.0, 1.0].into_iter(), 1e-3);
        assert_eq!((floored.low, floored.place(0.0)), (-3, 0.0));
        assert!((decades.place(1.0) - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(Decades::around(std::iter::empty(), 1.0).high, 1);
        assert_eq!(
            Decades { low: -17, high: 1 }.ticks().collect::<Vec<_>>(),
            [-15, -12, -9, -6, -3, 0]
        );
    }

    #[test]
    fn what_is_infinite_is_on_the_frame_and_moves_no_axis() {
        let mut infinite = plot();
        infinite.series[0].points[0][1][1] = f64::INFINITY;
        let figure = look(trade, &infinite);
        let values = [f64::INFINITY, 0.3, 20.0].into_iter();
        assert_eq!(Decades::around(values, 1e-9), Decades { low: -1, high: 2 });
        let on_top = format!("cy=\"{}\"", TOP * super::super::GRID);
        assert!(figure.svg().contains(&on_top) && !trade(&plot()).unwrap().svg().contains(&on_top));
        infinite.series[0].points[0][1][1] = f64::NEG_INFINITY;
        assert_eq!(
            trade(&infinite),
            Err(FigureError::of("y", crate::output::figure::NOT_PLOTTABLE))
        );
    }

    #[test]
    fn what_is_no_number_is_an_error() {
        let mut bad = plot();
        bad.series[0].points[0][0] = [0.0, 1.0];
        assert_eq!(trade(&bad), Err(FigureError::of("x", crate::output::figure::NOT_POSITIVE)));
        bad.series[0].points[0][0] = [1.0, f64::NAN];
        assert_eq!(trade(&bad), Err(FigureError::of("y", crate::output::figure::NOT_PLOTTABLE)));
    }
}
