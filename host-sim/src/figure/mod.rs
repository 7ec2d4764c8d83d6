//! Figures of a sweep and of a wall hit, drawn from plain data.
//!
//! ```text
//! ZwidthPlot -> zwidth    ┐
//! AreaPlot   -> area      ├─> Figure ─> svg(), png()
//! TracePlot  -> hit_trace ┘
//! ```
//! Each figure is a pure function: the same data gives the same bytes. Both forms are painted from
//! one list of shapes; the font is bundled, so nothing is taken from the system.
//! Colours: viridis for cutoffs, which are ordered, and vermilion for the ideal one.

mod area;
mod axis;
mod colour;
mod drawing;
mod font;
mod panel;
mod raster;
mod trace;
mod zwidth;

use std::fmt;

pub use area::{AreaPlot, AreaPoint, area};
pub(crate) use axis::{hertz, number, scaled_unit};
pub(crate) use drawing::escape;
pub use trace::{TracePlot, hit_trace};
pub use zwidth::{Curve, ZwidthPlot, zwidth};

use drawing::Drawing;

/// Width of every figure in SVG user units; a font of 12 units is 4.7 pt on a column of 88 mm.
const WIDTH: f64 = 640.0;
const TITLE_SIZE: f64 = 16.0;
const SUBTITLE_SIZE: f64 = 12.0;
const AXIS_TITLE_SIZE: f64 = 13.0;
const TICK_SIZE: f64 = 12.0;
const MARGIN: f64 = 12.0;
/// Beyond this a plotted number is a mistake, and the axis arithmetic would lose its digits.
const LARGEST_VALUE: f64 = 1e15;
/// What is smaller counts as 0 where a logarithm or a division follows.
const SMALLEST_POSITIVE: f64 = 1e-15;

/// A finished figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    drawing: Drawing,
    svg: String,
}

impl Figure {
    fn new(drawing: Drawing, label: &str) -> Self {
        let svg = drawing.to_svg(label);
        Self { drawing, svg }
    }

    /// One `<svg>` element without ids and without an XML declaration: a file as it is, or inline in
    /// a page.
    #[must_use]
    pub fn svg(&self) -> &str {
        &self.svg
    }

    /// The same figure as PNG, three pixels per SVG unit.
    ///
    /// # Errors
    /// [`FigureError::Font`] or [`FigureError::Encoding`], neither of which the data can cause.
    pub fn png(&self) -> Result<Vec<u8>, FigureError> {
        raster::png(&self.drawing)
    }
}

/// Why there is no figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureError {
    /// A number is NaN, infinite or larger than 1e15 in magnitude.
    NotPlottable {
        /// Which one.
        quantity: &'static str,
    },
    /// A number must be greater than 0.
    NotPositive {
        /// Which one.
        quantity: &'static str,
    },
    /// A number must not be less than 0.
    Negative {
        /// Which one.
        quantity: &'static str,
    },
    /// A trace has no samples.
    NoSamples,
    /// The bundled font cannot be read.
    Font,
    /// The bitmap could not be made or compressed.
    Encoding,
}

impl fmt::Display for FigureError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotPlottable { quantity } => {
                write!(f, "{quantity} is not a number between -1e15 and 1e15")
            }
            Self::NotPositive { quantity } => write!(f, "{quantity} is not greater than 0"),
            Self::Negative { quantity } => write!(f, "{quantity} is less than 0"),
            Self::NoSamples => f.write_str("the trace has no samples"),
            Self::Font => f.write_str("the bundled font cannot be read"),
            Self::Encoding => f.write_str("the bitmap cannot be encoded"),
        }
    }
}

impl std::error::Error for FigureError {}

fn plottable(quantity: &'static str, value: f64) -> Result<f64, FigureError> {
    if value.abs() <= LARGEST_VALUE {
        Ok(value)
    } else {
        Err(FigureError::NotPlottable { quantity })
    }
}

fn positive(quantity: &'static str, value: f64) -> Result<f64, FigureError> {
    if plottable(quantity, value)? >= SMALLEST_POSITIVE {
        Ok(value)
    } else {
        Err(FigureError::NotPositive { quantity })
    }
}

fn not_negative(quantity: &'static str, value: f64) -> Result<f64, FigureError> {
    if plottable(quantity, value)? >= 0.0 {
        Ok(value)
    } else {
        Err(FigureError::Negative { quantity })
    }
}

#[cfg(test)]
pub(crate) mod testing {
    //! What every figure must pass.

    use std::sync::Arc;

    use resvg::{tiny_skia::Pixmap, usvg};

    use super::{Figure, FigureError, font, raster};

    const PNG_SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
    /// Mean difference of a colour channel between our bitmap and resvg's, of 255. Kerning is off in
    /// both; what remains is rounding to a hundredth of a unit at anti-aliased edges, 0.10 at most so
    /// far.
    const LOOK_TOLERANCE: f64 = 0.2;

    pub(crate) fn parse(svg: &str) -> usvg::Tree {
        let mut options = usvg::Options::default();
        Arc::make_mut(&mut options.fontdb).load_font_data(font::FONT.to_vec());
        usvg::Tree::from_str(svg, &options).unwrap()
    }

    /// The big-endian number at `at`.
    fn number_at(bytes: &[u8], at: usize) -> u32 {
        u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    pub(crate) fn check<P>(draw: fn(&P) -> Result<Figure, FigureError>, plot: &P) -> Figure {
        let figure = draw(plot).unwrap();
        let svg = figure.svg();
        assert!(!svg.contains(" id=") && !svg.contains("url(") && !svg.contains("NaN"));

        let png = figure.png().unwrap();
        assert_eq!(png[..8], PNG_SIGNATURE);
        let [width, height] = figure.drawing.size.map(|side| side * f64::from(raster::SCALE));
        assert_eq!(f64::from(number_at(&png, 16)), width);
        assert_eq!(f64::from(number_at(&png, 20)), height);

        let again = draw(plot).unwrap();
        assert_eq!(again.svg(), svg);
        assert!(again.png().unwrap() == png, "the PNG bytes differ");

        let tree = parse(svg);
        let ours = raster::paint(&figure.drawing).unwrap();
        let mut theirs = Pixmap::new(ours.width(), ours.height()).unwrap();
        let scale = f32::from(raster::SCALE);
        resvg::render(&tree, usvg::Transform::from_scale(scale, scale), &mut theirs.as_mut());
        let pairs = ours.data().iter().zip(theirs.data());
        let sum: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
        let mean = sum / ours.data().len() as f64;
        assert!(mean < LOOK_TOLERANCE, "SVG and PNG differ by {mean}");
        figure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_cannot_be_plotted_are_named() {
        for value in [f64::NAN, f64::INFINITY, -1e16] {
            let error = plottable("damping", value).unwrap_err();
            assert_eq!(error.to_string(), "damping is not a number between -1e15 and 1e15");
        }
        assert_eq!(
            positive("cutoff", 0.0).unwrap_err().to_string(),
            "cutoff is not greater than 0"
        );
        assert_eq!(not_negative("area", -1.0).unwrap_err().to_string(), "area is less than 0");
    }
}
