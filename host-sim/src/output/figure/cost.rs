//! What something costs against how much of it there is: panels side by side with logarithms on both axes.

use plotters::{prelude::*, style::text_anchor::HPos};

use super::{
    Figure, FigureError, Page, WIDTH,
    axis::Ticks,
    colour::{ACCENT, DATA, TEXT},
    grid,
    panel::{self, Chart, Grid, Panel, SMALL_SIZE, X_TITLE_DROP},
    positive, text,
};

const TOP: f64 = 78.0;
const BOTTOM: f64 = TOP + 210.0;
const HEIGHT: f64 = BOTTOM + 50.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = WIDTH - 20.0;
/// Between two panels, for the numbers and the title of the second one.
const GAP: f64 = 66.0;
const LEGEND_MIDDLE: f64 = 46.0;
const LEGEND_SAMPLE: f64 = 22.0;
const LEGEND_PITCH: f64 = 16.0;
const LINE_WIDTH: f64 = 1.6;
const DOT_RADIUS: f64 = 2.6;

/// What [`cost`] draws.
#[derive(Debug, Clone, PartialEq)]
pub struct CostPlot {
    /// First line above the plot.
    pub title: String,
    /// Second line: scene and machine.
    pub subtitle: String,
    /// Names of the lines, the same in all panels; at most three.
    pub names: Vec<String>,
    /// From left to right.
    pub panels: Vec<CostPanel>,
}

/// One panel.
#[derive(Debug, Clone, PartialEq)]
pub struct CostPanel {
    /// Title of the horizontal axis, with its unit.
    pub x_title: String,
    /// Title of the vertical axis, with its unit.
    pub y_title: String,
    /// A line for each name: amount and cost, both above 0, amounts ascending.
    pub lines: Vec<Vec<[f64; 2]>>,
}

/// Draws cost against amount, a decade as long on one axis as it is told by its numbers on the other.
///
/// # Errors
/// [`FigureError`] if a number is not above 0 or not finite, or there is nothing to draw.
pub fn cost(plot: &CostPlot) -> Result<Figure, FigureError> {
    let points = || plot.panels.iter().flat_map(|panel| panel.lines.iter().flatten().flatten());
    if points().next().is_none() {
        return Err(FigureError::NoSamples);
    }
    for value in points() {
        positive("cost", *value)?;
    }
    Figure::new([&plot.title, &plot.subtitle], HEIGHT, &|page| draw(plot, page))
}

fn draw(plot: &CostPlot, page: &Page) -> Result<(), FigureError> {
    let colours = [DATA, ACCENT, TEXT];
    let count = plot.panels.len().max(1) as f64;
    let width = (RIGHT - LEFT - GAP * (count - 1.0)) / count;
    for (index, one) in plot.panels.iter().enumerate() {
        let left = LEFT + index as f64 * (width + GAP);
        let place = Panel { left, top: TOP, right: left + width, bottom: BOTTOM };
        let decades = |axis: usize| {
            let values = one.lines.iter().flatten().map(move |point| point[axis].log10());
            let low = values.clone().fold(f64::INFINITY, f64::min);
            Ticks::decades(low, values.fold(f64::NEG_INFINITY, f64::max))
        };
        // the titles stand by hand: those of plotters would reach into the neighbour
        let mut chart = place.chart(page, decades(0), decades(1), X_TITLE_DROP)?;
        panel::axes(&mut chart, Grid::Both, [&one.x_title, ""])?;
        text::write(page, &one.y_title, [left, TOP - 10.0], HPos::Left, SMALL_SIZE, TEXT)?;
        for (line, colour) in one.lines.iter().zip(colours) {
            curve(page, &chart, line, colour)?;
        }
        place.frame(page)?;
    }
    let lengths = plot.names.iter().map(|name| {
        LEGEND_SAMPLE + panel::LEGEND_GAP + text::width(name, SMALL_SIZE) + LEGEND_PITCH
    });
    let left = RIGHT + LEGEND_PITCH - lengths.sum::<f64>();
    let lines = plot.names.iter().zip(colours);
    let lines = lines.map(|(name, colour)| (name.as_str(), colour.mix(1.0), LINE_WIDTH));
    panel::legend(page, [left, LEGEND_MIDDLE], [LEGEND_SAMPLE, LEGEND_PITCH], lines)
}

fn curve(
    page: &Page,
    chart: &Chart<'_, Ticks>,
    line: &[[f64; 2]],
    colour: RGBColor,
) -> Result<(), FigureError> {
    let at = |point: &[f64; 2]| chart.backend_coord(&(point[0].log10(), point[1].log10()));
    let points: Vec<(i32, i32)> = line.iter().map(at).collect();
    for point in &points {
        page.draw(&Circle::new(*point, grid(DOT_RADIUS), colour.filled()))?;
    }
    panel::path(page, points, colour, LINE_WIDTH)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::testing::{Pixels, check};

    fn plot() -> CostPlot {
        let line = |factor: f64| -> Vec<[f64; 2]> {
            (3..=6).map(|n| [10f64.powi(n), factor * 10f64.powi(n - 5)]).collect()
        };
        let panel = |y: &str| CostPanel {
            x_title: "Points".into(),
            y_title: y.into(),
            lines: vec![line(1.0), line(3.0)],
        };
        CostPlot {
            title: "Cost".into(),
            subtitle: "scene".into(),
            names: vec!["fixed".into(), "f64".into()],
            panels: vec![panel("Time [s]"), panel("Memory [MB]")],
        }
    }

    #[test]
    fn decades_are_labelled_and_lines_drawn() {
        let figure = check(cost, &plot());
        for text in ["10⁵", "10⁻²", "Time [s]", "Memory [MB]", "Points", "fixed", "f64"] {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
        assert!(Pixels::of(&figure).count(ACCENT) > 500, "a line does not show");
    }

    #[test]
    fn nothing_and_no_cost_are_errors() {
        let mut bad = plot();
        bad.panels[0].lines[0][0][1] = 0.0;
        assert!(cost(&bad).is_err());
        bad.panels.clear();
        assert_eq!(cost(&bad), Err(FigureError::NoSamples));
    }
}
