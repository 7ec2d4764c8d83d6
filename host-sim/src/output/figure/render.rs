//! The shapes of a page as SVG text.

use std::fmt::Write as _;

use plotters::prelude::*;
use plotters_backend::BackendCoord;
use sim_bitmap::{Lettering, Shape};

use super::{
    GRID,
    text::{FONT_FAMILIES, escape},
};

/// The opening tag of a page. The attributes of the tag apply to the whole page.
pub(super) fn svg_head((width, height): (u32, u32), title: &str) -> String {
    let [wide, high] = [width, height].map(|steps| f64::from(steps) / GRID);
    let title = escape(title);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{wide}\" height=\"{high}\" \
         viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\" \
         font-family=\"{FONT_FAMILIES}\" fill=\"none\" stroke-linejoin=\"round\">\n"
    )
}

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
                Lettering { text, at: (x, y), em, anchor: (anchor, _), drop, turned },
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
                     font-size=\"{em}\"{}{turn}>\n{}\n</text>",
                    ink("fill", style),
                    escape(text).replace("&#39;", "&apos;") // in the form that plotters writes
                )
            }
        };
    }
    out
}

/// A colour as an attribute. An opacity below 1 becomes a second attribute.
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

/// Gives a name to the first line with this colour and width. A browser shows the name under the pointer.
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

#[cfg(test)]
mod tests {
    use super::*;

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
