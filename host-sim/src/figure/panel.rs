//! The frame of a plot: grid, ticks, axis titles, and the heading above it.

use super::axis::Scale;
use super::colour::{FRAME, GRID, QUIET, TEXT};
use super::drawing::{Anchor, Drawing, Shape, Stroke, Text};
use super::{AXIS_TITLE_SIZE, MARGIN, SUBTITLE_SIZE, TICK_SIZE, TITLE_SIZE, font};

const TITLE_BASELINE: f64 = 24.0;
const SUBTITLE_BASELINE: f64 = 42.0;
const TICK_LENGTH: f64 = 4.0;
const GRID_WIDTH: f64 = 0.7;
const FRAME_WIDTH: f64 = 1.0;
/// From the frame to the base line of the numbers below it.
const X_LABEL_DROP: f64 = 17.0;
/// From the frame to the base line of the title below it.
pub(super) const X_TITLE_DROP: f64 = 37.0;
/// From the frame to the end of the numbers left of it.
const Y_LABEL_GAP: f64 = 8.0;
/// From the left edge to the base line of the turned title.
const Y_TITLE_BASELINE: f64 = 21.0;

/// The rectangle that data is drawn in, with its two scales.
#[derive(Debug, Clone, Copy)]
pub(super) struct Panel {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
    x: Scale,
    y: Scale,
}

impl Panel {
    /// A panel between two corners.
    pub(super) fn new(
        [left, top]: [f64; 2],
        [right, bottom]: [f64; 2],
        x: Scale,
        y: Scale,
    ) -> Self {
        Self { left, top, right, bottom, x: x.across(left, right), y: y.across(bottom, top) }
    }

    pub(super) fn x(&self, value: f64) -> f64 {
        self.x.at(value)
    }

    pub(super) fn y(&self, value: f64) -> f64 {
        self.y.at(value)
    }

    pub(super) fn at(&self, x: f64, y: f64) -> [f64; 2] {
        [self.x(x), self.y(y)]
    }

    pub(super) fn centre(&self) -> [f64; 2] {
        [f64::midpoint(self.left, self.right), f64::midpoint(self.top, self.bottom)]
    }

    pub(super) fn x_grid(&self, drawing: &mut Drawing, values: &[f64]) {
        for value in values {
            let x = self.x(*value);
            drawing.line(vec![[x, self.top], [x, self.bottom]], Stroke::solid(GRID, GRID_WIDTH));
        }
    }

    pub(super) fn y_grid(&self, drawing: &mut Drawing, values: &[f64]) {
        for value in values {
            let y = self.y(*value);
            drawing.line(vec![[self.left, y], [self.right, y]], Stroke::solid(GRID, GRID_WIDTH));
        }
    }

    /// The frame, painted after the data so that lines end under it.
    pub(super) fn frame(&self, drawing: &mut Drawing) {
        let (l, t, r, b) = (self.left, self.top, self.right, self.bottom);
        drawing.line(
            vec![[l, t], [r, t], [r, b], [l, b], [l, t], [r, t]],
            Stroke::solid(FRAME, FRAME_WIDTH),
        );
    }

    pub(super) fn x_ticks(&self, drawing: &mut Drawing, values: &[f64]) {
        for value in values {
            let x = self.x(*value);
            drawing.line(
                vec![[x, self.bottom], [x, self.bottom + TICK_LENGTH]],
                Stroke::solid(FRAME, FRAME_WIDTH),
            );
        }
    }

    pub(super) fn x_labels(&self, drawing: &mut Drawing, values: &[f64], labels: &[String]) {
        for (value, label) in values.iter().zip(labels) {
            let at = [self.x(*value), self.bottom + X_LABEL_DROP];
            drawing.text(at, TICK_SIZE, Anchor::Middle, TEXT, label);
        }
    }

    pub(super) fn y_axis(&self, drawing: &mut Drawing, values: &[f64], labels: &[String]) {
        for (value, label) in values.iter().zip(labels) {
            let y = self.y(*value);
            drawing.line(
                vec![[self.left - TICK_LENGTH, y], [self.left, y]],
                Stroke::solid(FRAME, FRAME_WIDTH),
            );
            // Digits are 0.73 of the font size high.
            let at = [self.left - Y_LABEL_GAP, y + 0.365 * TICK_SIZE];
            drawing.text(at, TICK_SIZE, Anchor::End, TEXT, label);
        }
    }

    pub(super) fn x_title(&self, drawing: &mut Drawing, title: &str) {
        let at = [self.centre()[0], self.bottom + X_TITLE_DROP];
        drawing.text(at, AXIS_TITLE_SIZE, Anchor::Middle, TEXT, title);
    }

    pub(super) fn y_title(&self, drawing: &mut Drawing, title: &str) {
        let (text, size) = font::fit(title, AXIS_TITLE_SIZE, self.bottom - self.top);
        drawing.shapes.push(Shape::Text(Text {
            at: [Y_TITLE_BASELINE, self.centre()[1]],
            size,
            anchor: Anchor::Middle,
            ink: TEXT,
            upward: true,
            text,
        }));
    }

    /// A remark in the middle of an empty plot.
    pub(super) fn remark(&self, drawing: &mut Drawing, text: &str) {
        drawing.text(self.centre(), AXIS_TITLE_SIZE, Anchor::Middle, QUIET, text);
    }
}

/// Title and subtitle at the top left, cut to the width of the drawing.
pub(super) fn heading(drawing: &mut Drawing, title: &str, subtitle: &str) {
    let room = drawing.size[0] - 2.0 * MARGIN;
    let (title, size) = font::fit(title, TITLE_SIZE, room);
    drawing.text([MARGIN, TITLE_BASELINE], size, Anchor::Start, TEXT, &title);
    let (subtitle, size) = font::fit(subtitle, SUBTITLE_SIZE, room);
    drawing.text([MARGIN, SUBTITLE_BASELINE], size, Anchor::Start, QUIET, &subtitle);
}
