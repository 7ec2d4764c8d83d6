//! Figures of a sweep, a wall hit, an identification, a board's telemetry and a trade, drawn from plain data.
//!
//! ```text
//! ZwidthPlot    -> zwidth         ┐
//! AreaPlot      -> area           │
//! TracePlot     -> hit_trace      ├─> Figure ─> svg(), png()
//! ResponsePlot  -> pulse_response │
//! TelemetryPlot -> telemetry      │
//! TradePlot     -> trade          ┘
//! ```
//! Each figure is a pure function: the same data gives the same bytes. Coordinates of plotters are integers, so SVG and
//! PNG share one grid with `GRID` steps per unit. The font is bundled, so a figure does not depend on the system.
//! Cutoffs have an order, so their colours are viridis. The ideal cutoff is vermilion.
//!
//! Some parts are missing in plotters and are drawn here:
//! - legends outside the plot;
//! - the numbers at the cutoffs (two rows, two scales, one colour each);
//! - strips of phases;
//! - lines and texts of the PNG ([`sim_bitmap`]).

mod area;
mod axis;
mod colour;
mod page;
mod panel;
mod render;
mod response;
mod telemetry;
mod text;
mod trace;
mod trade;
mod zwidth;

use std::{cell::RefCell, convert::Infallible, mem, rc::Rc};

use plotters::drawing::DrawingAreaErrorKind;
use sim_bitmap::{BitmapError, Shape};

use crate::error::Error;
use page::{Page, Recorder};

pub use area::{AreaPlot, AreaPoint, area};
pub(crate) use axis::{hertz, scaled_unit};
pub use response::{ResponsePlot, pulse_response};
pub use telemetry::{ReplayPlot, TelemetryPlot, TelemetryPoint, replay, telemetry};
pub(crate) use text::escape;
pub use trace::{TracePlot, hit_trace};
pub use trade::{Mark, TradePanel, TradePlot, TradeSeries, trade};
pub use zwidth::{Curve, ZwidthPlot, zwidth};

/// Width of every figure in SVG user units. A font of 12 units is 4.7 pt in a column of 88 mm.
const WIDTH: f64 = 640.0;
const MARGIN: f64 = 12.0;
/// Steps of the drawing grid per unit.
const GRID: f64 = 6.0;
/// Largest number that can be plotted. Larger numbers are mistakes, and the calculation of the axes would lose digits.
const LARGEST_VALUE: f64 = 1e15;
/// Smallest number that does not count as 0 before a logarithm or a division.
const SMALLEST_POSITIVE: f64 = 1e-15;

#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    size: (u32, u32),
    shapes: Vec<Shape>,
    svg: String,
}

impl Figure {
    /// Draws a page with this height, title and subtitle. `draw` adds everything else.
    fn new(
        [title, subtitle]: [&str; 2],
        height: f64,
        draw: &dyn Fn(&Page) -> Result<(), FigureError>,
    ) -> Result<Self, FigureError> {
        let size = (grid(WIDTH).unsigned_abs(), grid(height).unsigned_abs());
        let recorder = Rc::new(RefCell::new(Recorder { size, shapes: vec![] }));
        let page = Page::from(&recorder);
        panel::heading(&page, title, subtitle)?;
        draw(&page)?;
        let shapes = mem::take(&mut recorder.borrow_mut().shapes);
        let svg = render::svg_head(size, title) + &render::svg(&shapes) + "</svg>\n";
        Ok(Self { size, shapes, svg })
    }

    /// One `<svg>` element without ids and without an XML declaration. The element can be a file, or be inserted into a
    /// page.
    #[must_use]
    pub fn svg(&self) -> &str {
        &self.svg
    }

    /// The same figure as PNG, with three pixels for each SVG unit.
    ///
    /// # Errors
    /// The bitmap cannot be made. Data never causes this error.
    pub fn png(&self) -> Result<Vec<u8>, FigureError> {
        sim_bitmap::png(&self.shapes, self.size).map_err(|error| FigureError(error.to_string()))
    }
}

/// Converts a length from units to steps of the grid.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the cast saturates, and pages are a few thousand steps wide"
)]
fn grid(units: f64) -> i32 {
    (units * GRID).round() as i32
}

/// Converts a point from units to the grid.
fn at(x: f64, y: f64) -> (i32, i32) {
    (grid(x), grid(y))
}

/// Reason why there is no figure: an invalid number, or no samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FigureError(String);

const NOT_PLOTTABLE: &str = "is not a number between -1e15 and 1e15";
const NOT_POSITIVE: &str = "is not greater than 0";
const NEGATIVE: &str = "is less than 0";

impl FigureError {
    fn of(quantity: &str, why: &str) -> Self {
        Self(format!("{quantity} {why}"))
    }

    fn no_samples() -> Self {
        Self::of("the trace", "has no samples")
    }
}

impl From<DrawingAreaErrorKind<Infallible>> for FigureError {
    fn from(_: DrawingAreaErrorKind<Infallible>) -> Self {
        Self(BitmapError::Encoding.to_string())
    }
}

impl From<FigureError> for Error {
    fn from(error: FigureError) -> Self {
        Self::Internal(format!("cannot draw: {}", error.0))
    }
}

fn checked(quantity: &str, value: f64, is: bool, why: &str) -> Result<f64, FigureError> {
    if is { Ok(value) } else { Err(FigureError::of(quantity, why)) }
}

fn plottable(quantity: &str, value: f64) -> Result<f64, FigureError> {
    checked(quantity, value, value.abs() <= LARGEST_VALUE, NOT_PLOTTABLE)
}

fn positive(quantity: &str, value: f64) -> Result<f64, FigureError> {
    checked(quantity, plottable(quantity, value)?, value >= SMALLEST_POSITIVE, NOT_POSITIVE)
}

fn not_negative(quantity: &str, value: f64) -> Result<f64, FigureError> {
    checked(quantity, plottable(quantity, value)?, value >= 0.0, NEGATIVE)
}

#[cfg(test)]
mod testing;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_cannot_be_plotted_are_named() {
        for value in [f64::NAN, f64::INFINITY, -1e16] {
            let error = plottable("damping", value).unwrap_err();
            assert_eq!(error.0, "damping is not a number between -1e15 and 1e15");
        }
        assert_eq!(positive("cutoff", 0.0).unwrap_err().0, "cutoff is not greater than 0");
        assert_eq!(not_negative("area", -1.0).unwrap_err().0, "area is less than 0");
    }
}
