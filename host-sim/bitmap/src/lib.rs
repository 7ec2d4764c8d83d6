//! Paints the shapes of a figure as PNG. This code is a separate crate, so that it is always optimised: a bitmap has
//! millions of pixels.
#![forbid(unsafe_code)]

mod font;

use std::{fmt, mem};

use ab_glyph::{Font as _, Glyph, point};
use plotters::prelude::*;
use plotters_backend::{BackendCoord, BackendStyle, DrawingErrorKind, rasterizer};

pub use font::width;

/// Grid steps per pixel in each direction. For anti-aliasing, `halved` averages the steps of a pixel.
pub const STEPS_PER_PIXEL: u8 = 2;

type PaintError<'a> = DrawingErrorKind<<BitMapBackend<'a> as DrawingBackend>::ErrorType>;

/// A shape with its style. Its points are in grid steps.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    Line([BackendCoord; 2], ShapeStyle),
    /// Open line through several points.
    Path(Vec<BackendCoord>, ShapeStyle),
    /// Filled rectangle between two corners.
    Rectangle([BackendCoord; 2], ShapeStyle),
    /// Filled circle, given by its centre and radius.
    Circle(BackendCoord, u32, ShapeStyle),
    /// Filled area between these corners.
    Polygon(Vec<BackendCoord>, ShapeStyle),
    Text(Lettering, ShapeStyle),
}

#[derive(Debug, Clone, PartialEq)]
pub struct Lettering {
    pub text: String,
    pub at: BackendCoord,
    /// Font size: the length of one em in grid steps.
    pub em: f64,
    /// Which point of the text is at `at`: the name of this anchor in SVG, and the fraction of the text's width that is
    /// before the anchor.
    pub anchor: (&'static str, f64),
    /// Distance from the point `at` down to the base line, in em.
    pub drop: f64,
    /// Whether the text is turned by 90 degrees and read from below.
    pub turned: bool,
}

/// Reason why there is no bitmap. The shapes are never the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BitmapError {
    /// The bundled font cannot be read.
    Font,
    /// The bitmap could not be made or compressed.
    Encoding,
}

impl fmt::Display for BitmapError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Font => "the bundled font cannot be read",
            Self::Encoding => "the bitmap cannot be encoded",
        })
    }
}

impl std::error::Error for BitmapError {}

/// Paints the shapes as PNG. The size of the page is in grid steps.
///
/// # Errors
/// [`BitmapError`]. The shapes are never the reason.
pub fn png(shapes: &[Shape], (width, height): (u32, u32)) -> Result<Vec<u8>, BitmapError> {
    // The page is enlarged to whole pixels, so that no row or column is lost.
    let pixels = [width, height].map(|side| side.div_ceil(STEPS_PER_PIXEL.into()));
    let [width, height] = pixels.map(|side| side * u32::from(STEPS_PER_PIXEL));
    let mut fine = vec![u8::MAX; 3 * width as usize * height as usize];
    let mut bitmap = BitMapBackend::with_buffer(&mut fine, (width, height));
    for shape in shapes {
        paint(&mut bitmap, shape)?;
    }
    drop(bitmap);
    let coarse = halved(&fine, pixels[0] as usize);
    encode(&coarse, pixels).map_err(|_| BitmapError::Encoding)
}

fn encode(rgb: &[u8], [width, height]: [u32; 2]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()?;
    Ok(bytes)
}

/// Paints a shape on the bitmap of plotters. Lines with round joins, and text as in SVG, are painted here. plotters
/// 0.3.7 converts a zigzag to one polygon that crosses itself, which leaves holes and spikes. The `ab_glyph` text of
/// plotters leaves out the bearing of each glyph, and differs from the SVG text of plotters in size and base line.
fn paint(bitmap: &mut BitMapBackend<'_>, shape: &Shape) -> Result<(), BitmapError> {
    let painted = match shape {
        Shape::Line([from, to], style) => rasterizer::draw_line(bitmap, *from, *to, style),
        Shape::Path(path, style) => paint_path(bitmap, path, style),
        Shape::Rectangle([from, to], style) => bitmap.draw_rect(*from, *to, style, true),
        Shape::Circle(centre, radius, style) => bitmap.draw_circle(*centre, *radius, style, true),
        Shape::Polygon(corners, style) => bitmap.fill_polygon(corners.iter().copied(), style),
        Shape::Text(lettering, style) => return paint_text(bitmap, lettering, style),
    };
    painted.map_err(|_| BitmapError::Encoding)
}

fn paint_path<'a>(
    bitmap: &mut BitMapBackend<'a>,
    path: &[BackendCoord],
    style: &ShapeStyle,
) -> Result<(), PaintError<'a>> {
    for (index, ends) in path.windows(2).enumerate() {
        bitmap.draw_line(ends[0], ends[1], style)?;
        if index > 0 {
            bitmap.draw_circle(ends[0], style.stroke_width / 2, style, true)?;
        }
    }
    Ok(())
}

fn paint_text(
    bitmap: &mut BitMapBackend<'_>,
    lettering: &Lettering,
    style: &ShapeStyle,
) -> Result<(), BitmapError> {
    let Lettering { text, at: (x, y), em: size, anchor: (_, before), drop, turned } = lettering;
    let font = font::font()?;
    let units_per_em = font.units_per_em().unwrap_or(1.0);
    let scale = single(*size) * font.height_unscaled() / units_per_em;
    let mut pen = -before * width(text, *size);
    for c in text.chars() {
        let origin = point(single(pen), single(drop * size));
        let glyph: Glyph = font.glyph_id(c).with_scale_and_position(scale, origin);
        pen += font::advance(font, c) * size;
        let Some(outline) = font.outline_glyph(glyph) else {
            continue;
        };
        let corner = outline.px_bounds().min;
        let (left, top) = (grid_of(corner.x), grid_of(corner.y));
        let mut painted = Ok(());
        outline.draw(|column, row, cover| {
            let (right, down) = (left + column.cast_signed(), top + row.cast_signed());
            let place = if *turned { (x + down, y - right) } else { (x + right, y + down) };
            let colour = style.color().mix(f64::from(cover.min(1.0)));
            let pixel = bitmap.draw_pixel(place, colour);
            painted = mem::replace(&mut painted, Ok(())).and(pixel);
        });
        painted.map_err(|_| BitmapError::Encoding)?;
    }
    Ok(())
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "glyphs are painted in single precision, 1e-3 of a step at these sizes"
)]
fn single(value: f64) -> f32 {
    value as f32
}

#[expect(clippy::cast_possible_truncation, reason = "pages are a few thousand steps wide")]
fn grid_of(step: f32) -> i32 {
    step.round() as i32
}

/// Halves width and height. A pixel of the result is the rounded mean of two times two pixels. A row of the result has
/// `columns` pixels.
fn halved(fine: &[u8], columns: usize) -> Vec<u8> {
    let mut coarse = Vec::with_capacity(fine.len() / 4);
    for rows in fine.chunks_exact(12 * columns) {
        let (upper, lower) = rows.split_at(6 * columns);
        let pairs = upper.as_chunks::<6>().0.iter().zip(lower.as_chunks::<6>().0);
        coarse.extend(pairs.flat_map(|([a, b, c, d, e, f], [g, h, i, j, k, l])| {
            [mean([*a, *d, *g, *j]), mean([*b, *e, *h, *k]), mean([*c, *f, *i, *l])]
        }));
    }
    coarse
}

fn mean(samples: [u8; 4]) -> u8 {
    let sum: u16 = samples.map(u16::from).iter().sum();
    u8::try_from((sum + 2) / 4).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_takes_every_sample_once() {
        let mut fine = vec![0; 3 * 4 * 2];
        fine[..6].fill(200); // upper half of the left one of two pixels
        assert_eq!(halved(&fine, 2), [100, 100, 100, 0, 0, 0]);
        // squares of n: 0 9 36 81, 1 16 49 100 and 4 25 64 121
        let fine: Vec<u8> = (0..12).map(|n| n * n).collect();
        assert_eq!(halved(&fine, 1), [32, 42, 54]);
    }
}
