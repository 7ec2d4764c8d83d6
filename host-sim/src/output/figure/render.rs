//! A drawn page as SVG text and as PNG bytes.

use ab_glyph::{Font as _, Glyph, point};
use plotters::prelude::*;
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingErrorKind,
    text_anchor::{HPos, VPos},
};

use super::{
    FigureError, GRID, Plot, grid,
    text::{self, FONT_FAMILIES, escape},
};

/// Grid steps per pixel of a PNG, each way: what they average is the anti-aliasing.
pub(super) const STEPS_PER_PIXEL: u8 = 2;
fn size(plot: &Plot) -> (u32, u32) {
    let side = |units| grid(units).unsigned_abs();
    (side(super::WIDTH), side(plot.height()))
}

/// The figure as one `<svg>` element.
pub(super) fn svg(plot: &Plot) -> Result<String, FigureError> {
    let size = size(plot);
    let mut drawn = String::new();
    {
        let page = SVGBackend::with_string(&mut drawn, size).into_drawing_area();
        plot.draw(&page)?;
        page.present()?;
    }
    let (_, shapes) = drawn.split_once('\n').ok_or(FigureError::Encoding)?;
    // What is said once for the page, what is the default, and what depends on the browser's font.
    // No text can match: the quotes in it are escaped.
    let mut shapes = shapes
        .replace(&format!(" font-family=\"{FONT_FAMILIES}\""), "")
        .replace(" opacity=\"1\"", "")
        .replace(" stroke=\"none\" stroke-width=\"1\"", "")
        .replace(" stroke=\"none\"", "")
        .replace(" fill=\"none\"", "")
        .replace("dy=\"0.5ex\"", "dy=\"0.36em\"")
        .replace("dy=\"-0.5ex\"", "dy=\"-0.27em\"");
    for (colour, width, name) in plot.names() {
        name_line(&mut shapes, colour, width, &name);
    }
    let (width, height) = size;
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}\" height=\"{}\" \
         viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\" \
         font-family=\"{FONT_FAMILIES}\" fill=\"none\" stroke-linejoin=\"round\">\n{shapes}",
        super::WIDTH,
        plot.height(),
        escape(plot.title()),
    ))
}

/// Gives the first line of a colour and width a name that a browser shows under the pointer.
fn name_line(shapes: &mut String, colour: RGBColor, width: u32, name: &str) {
    let RGBColor(red, green, blue) = colour;
    let style =
        format!("stroke=\"#{red:02X}{green:02X}{blue:02X}\" stroke-width=\"{width}\" points=");
    let Some(start) = shapes.find(&style) else {
        return;
    };
    if let Some(length) = shapes[start..].find("/>") {
        let end = start + length;
        let title = format!("><title>{}</title></polyline>", escape(name));
        shapes.replace_range(end..end + 2, &title);
    }
}

/// The figure as PNG, [`GRID`] / [`STEPS_PER_PIXEL`] pixels per unit.
pub(super) fn png(plot: &Plot) -> Result<Vec<u8>, FigureError> {
    text::font()?;
    let (width, height) = size(plot);
    // A row or column that fills no pixel would be lost: the page is padded.
    let pixels = [width, height].map(|side| side.div_ceil(STEPS_PER_PIXEL.into()));
    let [width, height] = pixels.map(|side| side * u32::from(STEPS_PER_PIXEL));
    let mut fine = vec![u8::MAX; 3 * width as usize * height as usize];
    {
        let bitmap = BitMapBackend::with_buffer(&mut fine, (width, height));
        let page = Bitmap(bitmap).into_drawing_area();
        plot.draw(&page)?;
        page.present()?;
    }
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

/// plotters' bitmap with lines that join roundly and text that stands as it does in SVG.
///
/// Both are drawn here because plotters 0.3.7 turns a zigzag into one polygon that crosses itself,
/// which leaves holes and spikes, and because its `ab_glyph` text drops the bearing of each glyph
/// and has another size and base line than its SVG text.
struct Bitmap<'a>(BitMapBackend<'a>);

type Drawn<'a> = Result<(), DrawingErrorKind<<BitMapBackend<'a> as DrawingBackend>::ErrorType>>;

impl<'a> DrawingBackend for Bitmap<'a> {
    type ErrorType = <BitMapBackend<'a> as DrawingBackend>::ErrorType;

    fn get_size(&self) -> (u32, u32) {
        self.0.get_size()
    }

    fn ensure_prepared(&mut self) -> Drawn<'a> {
        self.0.ensure_prepared()
    }

    fn present(&mut self) -> Drawn<'a> {
        self.0.present()
    }

    fn draw_pixel(&mut self, at: BackendCoord, colour: BackendColor) -> Drawn<'a> {
        self.0.draw_pixel(at, colour)
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
        fill: bool,
    ) -> Drawn<'a> {
        self.0.draw_rect(from, to, style, fill)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn<'a> {
        let mut ends = None;
        for point in path {
            if let Some((before, joint)) = ends {
                self.0.draw_line(before, point, style)?;
                if joint {
                    self.0.draw_circle(before, style.stroke_width() / 2, style, true)?;
                }
            }
            ends = Some((point, ends.is_some()));
        }
        Ok(())
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        (x, y): BackendCoord,
    ) -> Drawn<'a> {
        let Ok(font) = text::font() else {
            return Ok(()); // `png` has refused a damaged font already
        };
        let em = text::em(style.size());
        let before = match style.anchor().h_pos {
            HPos::Left => 0.0,
            HPos::Center => 0.5,
            HPos::Right => 1.0,
        };
        // As the SVG has it.
        let base_line = match style.anchor().v_pos {
            VPos::Top => 0.76,
            VPos::Center => 0.36,
            VPos::Bottom => -0.27,
        };
        let units_per_em = font.units_per_em().unwrap_or(1.0);
        let scale = single(em) * font.height_unscaled() / units_per_em;
        let mut pen = -before * text::width(text, em);
        for c in text.chars() {
            let origin = point(single(pen), single(base_line * em));
            let glyph: Glyph = font.glyph_id(c).with_scale_and_position(scale, origin);
            pen += text::advance(font, c) * em;
            let Some(outline) = font.outline_glyph(glyph) else {
                continue;
            };
            let corner = outline.px_bounds().min;
            let (left, top) = (grid_of(corner.x), grid_of(corner.y));
            let mut drawn = Ok(());
            outline.draw(|column, row, cover| {
                let turned = style
                    .transform()
                    .transform(left + column.cast_signed(), top + row.cast_signed());
                let colour = style.color().mix(f64::from(cover.min(1.0)));
                let painted = self.0.draw_pixel((x + turned.0, y + turned.1), colour);
                if drawn.is_ok() {
                    drawn = painted;
                }
            });
            drawn?;
        }
        Ok(())
    }
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
