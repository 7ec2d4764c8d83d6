//! The cutoff axes of the area figure. They have a tick at each cutoff, and a number where there is space.

use crate::notation::number;
use std::ops::Range;

use plotters::{
    coord::{combinators::LogCoord, ranged1d::Ranged as _},
    prelude::*,
    style::text_anchor::HPos,
};

use super::{
    super::{
        FigureError, GRID, Page,
        axis::hertz,
        colour::{ACCENT, FRAME, TEXT},
        panel::{self, Panel, TICK_LENGTH},
        text,
    },
    AreaPlot, AreaPoint, panel_of,
};

const CUTOFF_SIZE: f64 = 11.0;
/// Distance from the frame to the middle of the first row of numbers. `ROW_PITCH` is the distance from one row to the
/// next.
pub(super) const ROW_DROP: f64 = 12.5;
pub(super) const ROW_PITCH: f64 = 13.0;
/// Number of rows of numbers. If no row has space for the number of a cutoff, the cutoff has only a tick.
const MOST_ROWS: usize = 2;
/// Smallest space between two numbers in a row.
const LABEL_SPACE: f64 = 4.0;

const TICK_WIDTH: f64 = 1.0;
/// Colour of the line from a tick to its number in the second row. The colour is light, because the line passes close
/// to other numbers.
const LEADER: RGBColor = RGBColor(190, 190, 190);

/// Space left and right of the outermost cutoffs, as a fraction of the axis. The space is at least the factor
/// `LEAST_PAD` of the cutoff.
const PAD_SHARE: f64 = 0.04;
const LEAST_PAD: f64 = 1.06;
const LONE_PAD: f64 = 2.0;

pub(super) fn cutoff_range(points: &[AreaPoint]) -> Range<f64> {
    let cutoffs = || points.iter().map(|point| point.cutoff_hz);
    let low = cutoffs().fold(f64::INFINITY, f64::min);
    let high = cutoffs().fold(0.0, f64::max);
    if points.is_empty() {
        return 1.0..10.0;
    }
    let pad = if low < high { (high / low).powf(PAD_SHARE).max(LEAST_PAD) } else { LONE_PAD };
    low / pad..high * pad
}

/// The two numbers at a cutoff. The nominal cutoff is below the plot, the true cutoff is above the plot.
pub(super) struct Label {
    x: f64,
    cutoff_hz: f64,
    nominal: String,
    true_hz: String,
    /// Row of the number. `None` if no row has space.
    row: Option<usize>,
}

impl Label {
    fn of(plot: &AreaPlot, point: &AreaPoint) -> Self {
        let x = LogCoord::from(cutoff_range(&plot.points).log_scale());
        let true_hz = if point.true_cutoff_hz < 10.0 {
            hertz(point.true_cutoff_hz)
        } else {
            number(point.true_cutoff_hz, 0)
        };
        Self {
            x: f64::from(x.map(&point.cutoff_hz, panel_of(1).x_pixels())) / GRID,
            cutoff_hz: point.cutoff_hz,
            nominal: hertz(point.cutoff_hz),
            true_hz,
            row: None,
        }
    }

    fn clashes(&self, other: &Self) -> bool {
        let width = |text: &str| text::width(text, CUTOFF_SIZE);
        let half = |label: &Self| width(&label.nominal).max(width(&label.true_hz)) / 2.0;
        (self.x - other.x).abs() < half(self) + half(other) + LABEL_SPACE
    }
}

/// Gives each label a row without overlap. The labels are placed in this order: ideal cutoff, ends of the axis, ends of
/// the ideal range, round numbers.
pub(super) fn labels(plot: &AreaPlot) -> Vec<Label> {
    let ends = [plot.points.first(), plot.points.last()];
    let rank = |label: &Label| {
        let cutoff_hz = label.cutoff_hz;
        let is_end = |end: &Option<&AreaPoint>| end.is_some_and(|end| end.cutoff_hz == cutoff_hz);
        let bounds = |range: [f64; 2]| range.contains(&cutoff_hz);
        if plot.ideal_cutoff_hz == Some(cutoff_hz) {
            0
        } else if ends.iter().any(is_end) {
            1
        } else if plot.ideal_range_hz.is_some_and(bounds) {
            2
        } else {
            2 + label.nominal.replace('.', "").trim_matches('0').len()
        }
    };
    let mut labels: Vec<Label> = plot.points.iter().map(|point| Label::of(plot, point)).collect();
    labels.sort_by_key(rank);
    for index in 0..labels.len() {
        let (placed, rest) = labels.split_at_mut(index);
        let free = |row: &usize| {
            let mut in_row = placed.iter().filter(|label| label.row == Some(*row));
            in_row.all(|label| !rest[0].clashes(label))
        };
        rest[0].row = (0..MOST_ROWS).find(free);
    }
    labels
}

pub(super) fn rows(labels: &[Label]) -> usize {
    let filled = labels.iter().filter_map(|label| label.row);
    filled.max().map_or(0, |row| row + 1)
}

/// Draws the ticks of all cutoffs. Ticks end at their numbers.
pub(super) fn draw_labels(
    page: &Page,
    panel: &Panel,
    plot: &AreaPlot,
    labels: &[Label],
) -> Result<(), FigureError> {
    for label in labels {
        let ideal = plot.ideal_cutoff_hz == Some(label.cutoff_hz);
        let colour = if ideal { ACCENT } else { TEXT };
        let drop = label.row.unwrap_or(0) as f64 * ROW_PITCH;
        let sides = [(panel.top, -1.0, &label.true_hz), (panel.bottom, 1.0, &label.nominal)];
        for (frame, side, text) in sides {
            let tick = frame + side * TICK_LENGTH;
            panel::line(
                page,
                &[[label.x, tick], [label.x, tick + side * drop]],
                LEADER,
                TICK_WIDTH,
            )?;
            panel::line(page, &[[label.x, frame], [label.x, tick]], FRAME, TICK_WIDTH)?;
            if label.row.is_some() {
                let middle = [label.x, frame + side * (ROW_DROP + drop)];
                text::write(page, text, middle, HPos::Center, CUTOFF_SIZE, colour)?;
            }
        }
    }
    Ok(())
}
