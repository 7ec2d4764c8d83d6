//! A drawing as an anti-aliased PNG.

use tiny_skia::{
    FillRule, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, StrokeDash, Transform,
};
use ttf_parser::{Face, OutlineBuilder};

use super::FigureError;
use super::drawing::{Drawing, Ink, Shape, Stroke, Text};
use super::font;

/// Pixels per SVG unit: 640 units become 1920 pixels, 550 dpi on a journal column of 88 mm.
pub(super) const SCALE: u16 = 3;

/// The drawing at [`SCALE`] as PNG bytes.
pub(super) fn png(drawing: &Drawing) -> Result<Vec<u8>, FigureError> {
    paint(drawing)?.encode_png().map_err(|_| FigureError::Encoding)
}

/// The drawing at [`SCALE`] as pixels.
pub(super) fn paint(drawing: &Drawing) -> Result<Pixmap, FigureError> {
    let face = font::face().ok_or(FigureError::Font)?;
    let [width, height] = drawing.size.map(|side| side * f64::from(SCALE));
    let mut pixmap = Pixmap::new(pixels(width), pixels(height)).ok_or(FigureError::Encoding)?;
    for shape in &drawing.shapes {
        paint_shape(&mut pixmap, face, shape);
    }
    Ok(pixmap)
}

fn paint_shape(pixmap: &mut Pixmap, face: &Face<'_>, shape: &Shape) {
    match shape {
        Shape::Line { points, stroke, .. } => {
            if let Some(path) = polyline(points, false) {
                draw(pixmap, &path, *stroke);
            }
        }
        Shape::Area { points, ink } => {
            if let Some(path) = polyline(points, true) {
                fill(pixmap, &path, *ink);
            }
        }
        Shape::Dot { at, radius, ink } => {
            let corner = [at[0] - radius, at[1] - radius];
            let [x, y] = corner.map(single);
            let side = single(2.0 * radius);
            if let Some(path) = Rect::from_xywh(x, y, side, side).and_then(PathBuilder::from_oval) {
                fill(pixmap, &path, *ink);
            }
        }
        Shape::Text(text) => {
            if let Some(path) = outline(face, text) {
                fill(pixmap, &path, text.ink);
            }
        }
    }
}

fn polyline(points: &[[f64; 2]], closed: bool) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for (index, point) in points.iter().enumerate() {
        let [x, y] = point.map(single);
        if index == 0 {
            builder.move_to(x, y);
        } else {
            builder.line_to(x, y);
        }
    }
    if closed {
        builder.close();
    }
    builder.finish()
}

fn outline(face: &Face<'_>, text: &Text) -> Option<Path> {
    let [x, y] = text.at;
    let scale = text.size / f64::from(face.units_per_em());
    let before = text.anchor.share_before() * font::width(&text.text, text.size);
    let mut glyphs = Glyphs { builder: PathBuilder::new(), origin: [x - before, y], scale };
    for c in text.text.chars() {
        let glyph = face.glyph_index(c).unwrap_or_default();
        face.outline_glyph(glyph, &mut glyphs);
        glyphs.origin[0] += font::advance(face, c) * text.size;
    }
    let path = glyphs.builder.finish()?;
    if text.upward {
        path.transform(Transform::from_rotate_at(-90.0, single(x), single(y)))
    } else {
        Some(path)
    }
}

fn fill(pixmap: &mut Pixmap, path: &Path, ink: Ink) {
    pixmap.fill_path(path, &paint_of(ink), FillRule::Winding, scaling(), None);
}

fn draw(pixmap: &mut Pixmap, path: &Path, stroke: Stroke) {
    let dash = stroke.dash.and_then(|lengths| StrokeDash::new(lengths.map(single).to_vec(), 0.0));
    let shape = tiny_skia::Stroke {
        width: single(stroke.width),
        line_join: LineJoin::Round,
        dash,
        ..tiny_skia::Stroke::default()
    };
    pixmap.stroke_path(path, &paint_of(stroke.ink), &shape, scaling(), None);
}

fn paint_of(ink: Ink) -> Paint<'static> {
    let [red, green, blue] = ink.rgb;
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(red, green, blue, byte(ink.opacity * 255.0));
    paint
}

fn scaling() -> Transform {
    Transform::from_scale(f32::from(SCALE), f32::from(SCALE))
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the rasteriser works in single precision, 1e-4 of a pixel at these sizes"
)]
fn single(value: f64) -> f32 {
    value as f32
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast saturates, and drawings are a few thousand pixels wide"
)]
fn pixels(value: f64) -> u32 {
    value.round() as u32
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast saturates, which is right for a colour"
)]
pub(super) fn byte(value: f64) -> u8 {
    value.round() as u8
}

/// Collects glyph outlines, which are in font units with y upwards.
struct Glyphs {
    builder: PathBuilder,
    origin: [f64; 2],
    scale: f64,
}

impl Glyphs {
    fn place(&self, x: f32, y: f32) -> [f32; 2] {
        [
            single(self.origin[0] + f64::from(x) * self.scale),
            single(self.origin[1] - f64::from(y) * self.scale),
        ]
    }
}

impl OutlineBuilder for Glyphs {
    fn move_to(&mut self, x: f32, y: f32) {
        let [x, y] = self.place(x, y);
        self.builder.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let [x, y] = self.place(x, y);
        self.builder.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let [x1, y1] = self.place(x1, y1);
        let [x, y] = self.place(x, y);
        self.builder.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let [x1, y1] = self.place(x1, y1);
        let [x2, y2] = self.place(x2, y2);
        let [x, y] = self.place(x, y);
        self.builder.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.builder.close();
    }
}
