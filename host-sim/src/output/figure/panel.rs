//! A plot on a page: heading, axes, grid, frame.

use std::ops::Range;

use plotters::{
    coord::{
        cartesian::Cartesian2d,
        ranged1d::{AsRangedCoord, Ranged, ValueFormatter},
    },
    prelude::*,
    style::text_anchor::HPos,
};

use super::{
    FigureError, MARGIN, Page, WIDTH, at,
    axis::Ticks,
    colour::{self, FRAME, QUIET, TEXT},
    grid,
    page::Recorder,
    text,
};

pub(super) const TITLE_SIZE: f64 = 16.0;
pub(super) const SMALL_SIZE: f64 = 12.0;
pub(super) const AXIS_TITLE_SIZE: f64 = 13.0;
pub(super) const TICK_LENGTH: f64 = 4.0;
const TITLE_MIDDLE: f64 = 18.0;
const SUBTITLE_MIDDLE: f64 = 37.5;
const GRID_WIDTH: f64 = 0.7;
const FRAME_WIDTH: f64 = 1.0;
/// Distance between a line in a legend and the name of this line.
pub(super) const LEGEND_GAP: f64 = 6.0;
/// Distance from the frame down to the lower edge of the title below it.
pub(super) const X_TITLE_DROP: f64 = 40.0;

/// The rectangle that contains the data.
#[derive(Debug, Clone, Copy)]
pub(super) struct Panel {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

/// A chart whose y axis is linear: stiffness, area or position.
pub(super) type Chart<'a, X> = ChartContext<'a, Recorder, Cartesian2d<X, Ticks>>;

impl Panel {
    /// The chart in this rectangle. `x_title_drop` is the space below the chart.
    pub(super) fn chart<'a, X: AsRangedCoord>(
        &self,
        page: &'a Page,
        x: X,
        y: Ticks,
        x_title_drop: f64,
    ) -> Result<Chart<'a, X::CoordDescType>, FigureError> {
        let (_, height) = page.dim_in_pixel();
        let chart = ChartBuilder::on(page)
            .margin_left(grid(MARGIN))
            .margin_right(grid(WIDTH - self.right))
            .margin_top(grid(self.top))
            .margin_bottom(height.cast_signed() - grid(self.bottom + x_title_drop))
            .x_label_area_size(grid(x_title_drop))
            .y_label_area_size(grid(self.left - MARGIN))
            .build_cartesian_2d(x, y)?;
        Ok(chart)
    }

    pub(super) fn centre(&self) -> [f64; 2] {
        [f64::midpoint(self.left, self.right), f64::midpoint(self.top, self.bottom)]
    }

    pub(super) fn x_pixels(&self) -> (i32, i32) {
        (grid(self.left), grid(self.right))
    }

    /// Draws the frame. The frame is drawn after the data, so that it covers the ends of lines.
    pub(super) fn frame(&self, page: &Page) -> Result<(), FigureError> {
        let (l, t, r, b) = (self.left, self.top, self.right, self.bottom);
        let corners = [[l, t], [r, t], [r, b], [l, b], [l, t], [r, t]];
        line(page, &corners, FRAME, FRAME_WIDTH)
    }

    /// Writes a remark in the middle of an empty plot.
    pub(super) fn remark(&self, page: &Page, remark: &str) -> Result<(), FigureError> {
        let size = AXIS_TITLE_SIZE;
        text::write(page, remark, self.centre(), HPos::Center, size, QUIET)
    }
}

/// Which grid lines [`axes`] draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Grid {
    Both,
    Horizontal,
}

pub(super) fn axes<X: Ranged<ValueType = f64> + ValueFormatter<f64>>(
    chart: &mut Chart<'_, X>,
    grid_lines: Grid,
    [x_title, y_title]: [&str; 2],
) -> Result<(), FigureError> {
    let mut mesh = chart.configure_mesh();
    mesh.bold_line_style(colour::GRID.stroke_width(stroke(GRID_WIDTH)))
        .axis_style(FRAME.stroke_width(stroke(FRAME_WIDTH)))
        .set_all_tick_mark_size(grid(TICK_LENGTH))
        .label_style(text::style(SMALL_SIZE, TEXT))
        .axis_desc_style(text::style(AXIS_TITLE_SIZE, TEXT))
        .x_desc(x_title)
        .y_desc(y_title);
    if grid_lines == Grid::Horizontal {
        mesh.disable_x_mesh();
    }
    mesh.draw()?;
    Ok(())
}

/// Writes title and subtitle at the top left. Both lines are cut to the width of the page.
pub(super) fn heading(page: &Page, title: &str, subtitle: &str) -> Result<(), FigureError> {
    page.fill(&WHITE)?;
    let room = WIDTH - 2.0 * MARGIN;
    for (line, middle, size, colour) in
        [(title, TITLE_MIDDLE, TITLE_SIZE, TEXT), (subtitle, SUBTITLE_MIDDLE, SMALL_SIZE, QUIET)]
    {
        let (line, size) = text::fit(line, size, room);
        text::write(page, &line, [MARGIN, middle], HPos::Left, size, colour)?;
    }
    Ok(())
}

pub(super) fn stroke(units: f64) -> u32 {
    grid(units).unsigned_abs()
}

pub(super) fn line(
    page: &Page,
    points: &[[f64; 2]],
    colour: impl Color,
    width: f64,
) -> Result<(), FigureError> {
    path(page, points.iter().map(|[x, y]| at(*x, *y)).collect(), colour, width)
}

/// Draws a line through points of the drawing grid.
pub(super) fn path(
    page: &Page,
    points: Vec<(i32, i32)>,
    colour: impl Color,
    width: f64,
) -> Result<(), FigureError> {
    Ok(page.draw(&PathElement::new(points, colour.stroke_width(stroke(width))))?)
}

/// Draws a legend: lines with their names, in a row that begins at `left`.
pub(super) fn legend<'a>(
    page: &Page,
    [mut left, middle]: [f64; 2],
    [sample, pitch]: [f64; 2],
    lines: impl IntoIterator<Item = (&'a str, RGBAColor, f64)>,
) -> Result<(), FigureError> {
    for (name, colour, width) in lines {
        line(page, &[[left, middle], [left + sample, middle]], colour, width)?;
        left += sample + LEGEND_GAP;
        text::write(page, name, [left, middle], HPos::Left, SMALL_SIZE, TEXT)?;
        left += text::width(name, SMALL_SIZE) + pitch;
    }
    Ok(())
}

pub(super) fn rect(
    page: &Page,
    x: Range<f64>,
    y: Range<f64>,
    colour: RGBAColor,
) -> Result<(), FigureError> {
    let corners = [at(x.start, y.start), at(x.end, y.end)];
    Ok(page.draw(&Rectangle::new(corners, colour.filled()))?)
}

pub(super) fn dot(
    page: &Page,
    [x, y]: [f64; 2],
    radius: f64,
    colour: RGBColor,
) -> Result<(), FigureError> {
    Ok(page.draw(&Circle::new(at(x, y), grid(radius), colour.filled()))?)
}
