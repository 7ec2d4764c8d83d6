//! The shapes of a page as SVG text and as PNG bytes.

use std::{fmt::Write as _, mem};

use ab_glyph::{Font as _, Glyph, point};
use plotters::prelude::*;
use plotters_backend::{BackendCoord, BackendStyle, DrawingErrorKind, rasterizer};

use super::{
    FigureError, GRID, grid,
    page::{Lettering, Shape},
    text::{self, FONT_FAMILIES, escape},
};

/// Grid steps per pixel of a PNG, each way: what they average is the anti-aliasing.
pub(super) const STEPS_PER_PIXEL: u8 = 2;

type BitmapError<'a> = DrawingErrorKind<<BitMapBackend<'a> as DrawingBackend>::ErrorType>;

/// The opening tag of a page, with what is said once for all of it.
pub(super) fn svg_head((width, height): (u32, u32), title: &str) -> String {
    let [wide, high] = [width, height].map(|steps| f64::from(steps) / GRID);
    let title = escape(title);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{wide}\" height=\"{high}\" \
         viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\" \
         font-family=\"{FONT_FAMILIES}\" fill=\"none\" stroke-linejoin=\"round\">\n"
    )
}

/// The shapes as SVG elements.
pub(super) fn svg(shapes: &[Shape]) -> String {
    let mut out = String::new();
    for shape in shapes {
        let _ = match shape {
            Shape::Line([(x1, y1), (x2, y2)], style) => writeln!(
                out,
                "<line{} x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\"/>",
                stroke(style)
            ),
            Shape::Path(path, style) => {
                writeln!(out, "<polyline{} points=\"{}\"/>", stroke(style), points(path))
            }
            Shape::Rectangle([(left, top), (right, bottom)], style) => {
                let (width, height) = (right - left, bottom - top);
                writeln!(
                    out,
                    "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\"{}/>",
                    ink("fill", style)
                )
            }
            Shape::Circle((x, y), radius, style) => {
                writeln!(
                    out,
                    "<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\"{}/>",
                    ink("fill", style)
                )
            }
            Shape::Polygon(corners, style) => {
                writeln!(out, "<polygon{} points=\"{}\"/>", ink("fill", style), points(corners))
            }
            Shape::Text(
                Lettering { text, at: (x, y), size, anchor: (anchor, _), drop, turned },
                style,
            ) => {
                let turn = if *turned {
                    format!(" transform=\"rotate(270, {x}, {y})\"")
                } else {
                    String::new()
                };
                writeln!(
                    out,
                    "<text x=\"{x}\" y=\"{y}\" dy=\"{drop}em\" text-anchor=\"{anchor}\" \
                     font-size=\"{}\"{}{turn}>\n{}\n</text>",
                    text::em(*size),
                    ink("fill", style),
                    escape(text).replace("&#39;", "&apos;") // as plotters writes it
                )
            }
        };
    }
    out
}

/// Opacity, if there is one to tell, and colour.
fn ink(what: &str, style: &ShapeStyle) -> String {
    let RGBAColor(red, green, blue, alpha) = style.color;
    let opacity = if alpha < 1.0 { format!(" opacity=\"{alpha}\"") } else { String::new() };
    format!("{opacity} {what}=\"#{red:02X}{green:02X}{blue:02X}\"")
}

fn stroke(style: &ShapeStyle) -> String {
    format!("{} stroke-width=\"{}\"", ink("stroke", style), style.stroke_width)
}

fn points(points: &[BackendCoord]) -> String {
    points.iter().map(|(x, y)| format!("{x},{y} ")).collect()
}

/// Gives the first line of a colour and width a name that a browser shows under the pointer.
pub(super) fn name_line(shapes: &mut String, colour: RGBColor, width: u32, name: &str) {
    let style = ShapeStyle { stroke_width: width, ..colour.filled() };
    let Some(start) = shapes.find(&format!("{} points=", stroke(&style))) else {
        return;
    };
    if let Some(length) = shapes[start..].find("/>") {
        let end = start + length;
        let title = format!("><title>{}</title></polyline>", escape(name));
        shapes.replace_range(end..end + 2, &title);
    }
}

/// The shapes as PNG, [`GRID`] / [`STEPS_PER_PIXEL`] pixels per unit.
pub(super) fn png(shapes: &[Shape], (width, height): (u32, u32)) -> Result<Vec<u8>, FigureError> {
    // A row or column that fills no pixel would be lost: the page is padded.
    let pixels = [width, height].map(|side| side.div_ceil(STEPS_PER_PIXEL.into()));
    let [width, height] = pixels.map(|side| side * u32::from(STEPS_PER_PIXEL));
    let mut fine = vec![u8::MAX; 3 * width as usize * height as usize];
    let mut bitmap = BitMapBackend::with_buffer(&mut fine, (width, height));
    for shape in shapes {
        paint(&mut bitmap, shape)?;
    }
    drop(bitmap);
    let coarse = average(&fine, pixels[0] as usize, STEPS_PER_PIXEL.into());
    encode(&coarse, pixels).map_err(|_| FigureError::Encoding)
}

/// Means of `steps` times `steps` samples, rows of `columns` pixels.
fn average(fine: &[u8], columns: usize, steps: usize) -> Vec<u8> {
    let samples = u32::try_from(steps * steps).unwrap_or(1);
    let row_bytes = 3 * columns * steps;
    let mut coarse = Vec::with_capacity(fine.len() / (steps * steps));
    for rows in fine.chunks_exact(row_bytes * steps) {
        for column in 0..columns {
            for channel in 0..3 {
                let first = 3 * column * steps + channel;
                let sum: u32 = (0..steps * steps)
                    .map(|n| first + n / steps * row_bytes + 3 * (n % steps))
                    .map(|index| u32::from(rows[index]))
                    .sum();
                coarse.push(u8::try_from((sum + samples / 2) / samples).unwrap_or(u8::MAX));
            }
        }
    }
    coarse
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

/// A shape on plotters' bitmap. Lines that join roundly and text that stands as it does in SVG are made here:
/// plotters 0.3.7 turns a zigzag into one polygon that crosses itself, which leaves holes and spikes, and its
/// `ab_glyph` text drops the bearing of each glyph and has another size and base line than its SVG text.
fn paint(bitmap: &mut BitMapBackend<'_>, shape: &Shape) -> Result<(), FigureError> {
    let painted = match shape {
        Shape::Line([from, to], style) => rasterizer::draw_line(bitmap, *from, *to, style),
        Shape::Path(path, style) => paint_path(bitmap, path, style),
        Shape::Rectangle([from, to], style) => bitmap.draw_rect(*from, *to, style, true),
        Shape::Circle(centre, radius, style) => bitmap.draw_circle(*centre, *radius, style, true),
        Shape::Polygon(corners, style) => bitmap.fill_polygon(corners.iter().copied(), style),
        Shape::Text(lettering, style) => return paint_text(bitmap, lettering, style),
    };
    painted.map_err(|_| FigureError::Encoding)
}

fn paint_path<'a>(
    bitmap: &mut BitMapBackend<'a>,
    path: &[BackendCoord],
    style: &ShapeStyle,
) -> Result<(), BitmapError<'a>> {
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
) -> Result<(), FigureError> {
    let Lettering { text, at: (x, y), size, anchor: (_, before), drop, turned } = lettering;
    let (font, size) = (text::font()?, text::em(*size));
    let units_per_em = font.units_per_em().unwrap_or(1.0);
    let scale = single(size) * font.height_unscaled() / units_per_em;
    let mut pen = -before * text::width(text, size);
    for c in text.chars() {
        let origin = point(single(pen), single(drop * size));
        let glyph: Glyph = font.glyph_id(c).with_scale_and_position(scale, origin);
        pen += text::advance(font, c) * size;
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
        painted.map_err(|_| FigureError::Encoding)?;
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

fn grid_of(step: f32) -> i32 {
    grid(f64::from(step) / GRID)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_average_takes_every_sample_once() {
        let mut fine = vec![0; 3 * 4 * 2];
        fine[..6].fill(200); // upper half of the left pixel, of two
        assert_eq!(average(&fine, 2, 2), [100, 100, 100, 0, 0, 0]);
    }

    #[test]
    fn the_named_line_is_the_one_of_its_colour_and_width() {
        let mut shapes = "<polyline stroke=\"#0000FF\" stroke-width=\"2\" points=\"\"/>\n\
                          <polyline stroke=\"#FF0000\" stroke-width=\"2\" points=\"1,2 \"/>"
            .to_owned();
        name_line(&mut shapes, RGBColor(255, 0, 0), 2, "a < b");
        assert!(shapes.ends_with("points=\"1,2 \"><title>a &lt; b</title></polyline>"));
        name_line(&mut shapes, RGBColor(1, 1, 1), 2, "absent");
        assert_eq!(shapes.matches("<title>").count(), 1);
    }
}
