//! A flat list of shapes that becomes SVG text here and a bitmap in `raster`.
//!
//! Coordinates are SVG user units from the top left corner. Neither form uses ids, style sheets or
//! clipping, so that several drawings can stand in one HTML page.

use std::fmt::Write as _;

/// Families tried by a browser; the first is the bundled one, the second has nearly its widths.
const FONT_FAMILIES: &str = "DejaVu Sans, Verdana, sans-serif";

/// A colour with an opacity of 0..=1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ink {
    pub rgb: [u8; 3],
    pub opacity: f64,
}

impl Ink {
    pub(super) const fn new(red: u8, green: u8, blue: u8) -> Self {
        Self { rgb: [red, green, blue], opacity: 1.0 }
    }

    pub(super) const fn with_opacity(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    fn attributes(self, role: &str) -> String {
        let [red, green, blue] = self.rgb;
        let mut out = format!(" {role}=\"#{red:02x}{green:02x}{blue:02x}\"");
        if self.opacity < 1.0 {
            let _ = write!(out, " {role}-opacity=\"{}\"", self.opacity);
        }
        out
    }
}

/// How a line is drawn; `dash` is the length of a dash and of the gap after it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stroke {
    pub ink: Ink,
    pub width: f64,
    pub dash: Option<[f64; 2]>,
}

impl Stroke {
    pub(super) const fn solid(ink: Ink, width: f64) -> Self {
        Self { ink, width, dash: None }
    }

    fn attributes(self) -> String {
        let mut out = self.ink.attributes("stroke");
        let _ = write!(out, " stroke-width=\"{}\"", self.width);
        if let Some([on, off]) = self.dash {
            let _ = write!(out, " stroke-dasharray=\"{on} {off}\"");
        }
        out
    }
}

/// Which end of a text stands at its position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    /// Part of the width that lies before the position.
    pub(super) const fn share_before(self) -> f64 {
        match self {
            Self::Start => 0.0,
            Self::Middle => 0.5,
            Self::End => 1.0,
        }
    }
}

/// A line of text; `y` is its base line, `upward` turns it a quarter to the left.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Text {
    pub at: [f64; 2],
    pub size: f64,
    pub anchor: Anchor,
    pub ink: Ink,
    pub upward: bool,
    pub text: String,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    Line {
        points: Vec<[f64; 2]>,
        stroke: Stroke,
        /// Shown by a browser under the pointer.
        name: Option<String>,
    },
    Area {
        points: Vec<[f64; 2]>,
        ink: Ink,
    },
    Dot {
        at: [f64; 2],
        radius: f64,
        ink: Ink,
    },
    Text(Text),
}

/// Shapes in the order in which they are painted, on white.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drawing {
    pub size: [f64; 2],
    pub shapes: Vec<Shape>,
}

impl Drawing {
    pub(super) fn new(width: f64, height: f64) -> Self {
        let mut drawing = Self { size: [width, height], shapes: Vec::new() };
        drawing.rect([0.0, 0.0], [width, height], super::colour::PAPER);
        drawing
    }

    pub(super) fn line(&mut self, points: Vec<[f64; 2]>, stroke: Stroke) {
        self.shapes.push(Shape::Line { points, stroke, name: None });
    }

    pub(super) fn named_line(&mut self, points: Vec<[f64; 2]>, stroke: Stroke, name: String) {
        self.shapes.push(Shape::Line { points, stroke, name: Some(name) });
    }

    pub(super) fn area(&mut self, points: Vec<[f64; 2]>, ink: Ink) {
        self.shapes.push(Shape::Area { points, ink });
    }

    /// A filled rectangle between two opposite corners.
    pub(super) fn rect(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], ink: Ink) {
        self.area(vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]], ink);
    }

    pub(super) fn dot(&mut self, at: [f64; 2], radius: f64, ink: Ink) {
        self.shapes.push(Shape::Dot { at, radius, ink });
    }

    pub(super) fn text(&mut self, at: [f64; 2], size: f64, anchor: Anchor, ink: Ink, text: &str) {
        self.shapes.push(Shape::Text(Text {
            at,
            size,
            anchor,
            ink,
            upward: false,
            text: text.to_owned(),
        }));
    }

    /// The drawing as one `<svg>` element; `label` is read out by a screen reader.
    pub(super) fn to_svg(&self, label: &str) -> String {
        let [width, height] = self.size;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\" \
             font-family=\"{FONT_FAMILIES}\" fill=\"none\" stroke-linejoin=\"round\" \
             stroke-linecap=\"butt\" style=\"font-kerning:none;font-variant-ligatures:none\">\n",
            escape(label)
        );
        for shape in &self.shapes {
            write_shape(&mut out, shape);
        }
        out.push_str("</svg>\n");
        out
    }
}

fn write_shape(out: &mut String, shape: &Shape) {
    // Writing to a String cannot fail.
    let _ = match shape {
        Shape::Line { points, stroke, name } => {
            let head =
                format!("<polyline points=\"{}\"{}", coordinates(points), stroke.attributes());
            match name {
                Some(name) => writeln!(out, "{head}><title>{}</title></polyline>", escape(name)),
                None => writeln!(out, "{head}/>"),
            }
        }
        Shape::Area { points, ink } => {
            writeln!(out, "<polygon points=\"{}\"{}/>", coordinates(points), ink.attributes("fill"))
        }
        Shape::Dot { at, radius, ink } => writeln!(
            out,
            "<circle cx=\"{}\" cy=\"{}\" r=\"{radius}\"{}/>",
            coordinate(at[0]),
            coordinate(at[1]),
            ink.attributes("fill")
        ),
        Shape::Text(text) => write_text(out, text),
    };
}

fn write_text(out: &mut String, text: &Text) -> std::fmt::Result {
    let (x, y) = (coordinate(text.at[0]), coordinate(text.at[1]));
    write!(out, "<text x=\"{x}\" y=\"{y}\" font-size=\"{}\"", coordinate(text.size))?;
    match text.anchor {
        Anchor::Start => {}
        Anchor::Middle => out.push_str(" text-anchor=\"middle\""),
        Anchor::End => out.push_str(" text-anchor=\"end\""),
    }
    if text.upward {
        write!(out, " transform=\"rotate(-90 {x} {y})\"")?;
    }
    writeln!(out, "{}>{}</text>", text.ink.attributes("fill"), escape(&text.text))
}

fn coordinates(points: &[[f64; 2]]) -> String {
    let pairs: Vec<String> =
        points.iter().map(|[x, y]| format!("{},{}", coordinate(*x), coordinate(*y))).collect();
    pairs.join(" ")
}

/// A hundredth of a unit is far below what print can show.
fn coordinate(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Text made safe for XML and HTML, in elements and in quoted attributes.
///
/// Characters that XML 1.0 does not allow at all are replaced by U+FFFD.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' | '\r' => out.push(c),
            '\u{0}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_short() {
        assert_eq!(coordinate(12.0), "12");
        assert_eq!(coordinate(-0.001), "0");
        assert_eq!(coordinate(1.256), "1.26");
        assert_eq!(coordinate(100.0), "100");
    }

    #[test]
    fn escape_covers_markup_and_control_characters() {
        assert_eq!(
            escape("<a b=\"c\">'&'\u{1}"),
            "&lt;a b=&quot;c&quot;&gt;&#39;&amp;&#39;\u{fffd}"
        );
    }
}
