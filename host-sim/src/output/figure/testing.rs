//! Tests that every figure must pass.

use roxmltree::{Document, Node};

use super::{Figure, FigureError, GRID, WIDTH, grid, text};

const PNG_SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
/// Smallest fraction of a figure that text, grid and data must cover. `MOST_INK` is the largest fraction.
const LEAST_INK: f64 = 0.01;
const MOST_INK: f64 = 0.6;

pub(super) struct Pixels {
    pub width: usize,
    pub rgb: Vec<u8>,
}

impl Pixels {
    pub(super) fn of(figure: &Figure) -> Self {
        Self::read(figure, &figure.png().unwrap())
    }

    fn read(figure: &Figure, bytes: &[u8]) -> Self {
        assert_eq!(bytes[..8], PNG_SIGNATURE);
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let frame = reader.next_frame(&mut rgb).unwrap();
        let scale = GRID / f64::from(sim_bitmap::STEPS_PER_PIXEL);
        assert_eq!(f64::from(frame.width), WIDTH * scale);
        assert_eq!(f64::from(frame.height), (f64::from(figure.size.1) / GRID * scale).ceil());
        let width = frame.width as usize;
        Self { width, rgb }
    }

    /// Number of pixels with exactly this colour.
    pub(super) fn count(&self, colour: plotters::style::RGBColor) -> usize {
        let colour = [colour.0, colour.1, colour.2];
        self.rgb.chunks(3).filter(|pixel| **pixel == colour).count()
    }

    /// The colour at a point. Coordinates are in units.
    pub(super) fn at(&self, x: f64, y: f64) -> [u8; 3] {
        let pixel = |units| {
            usize::try_from(grid(units)).unwrap() / usize::from(sim_bitmap::STEPS_PER_PIXEL)
        };
        let first = 3 * (pixel(y) * self.width + pixel(x));
        self.rgb[first..first + 3].try_into().unwrap()
    }
}

pub(super) fn check<P>(draw: fn(&P) -> Result<Figure, FigureError>, plot: &P) -> Figure {
    let figure = draw(plot).unwrap();
    let svg = figure.svg();
    for forbidden in [" id=", "url(", "NaN", "inf\"", "ex\""] {
        assert!(!svg.contains(forbidden), "{forbidden} is in the figure");
    }
    let document = Document::parse(svg).unwrap();
    assert_eq!(document.root_element().tag_name().name(), "svg");
    let (width, height) = (grid(WIDTH), figure.size.1);
    for [left, top, right, bottom] in text_boxes(&document) {
        assert!(left >= 0.0 && top >= 0.0, "a text leaves the paper");
        assert!(right <= f64::from(width) && bottom <= f64::from(height));
    }

    let png = figure.png().unwrap();
    let pixels = Pixels::read(&figure, &png);
    let paper = pixels.rgb.chunks(3).filter(|pixel| **pixel == [255; 3]).count();
    let ink = 1.0 - 3.0 * paper as f64 / pixels.rgb.len() as f64;
    assert!((LEAST_INK..MOST_INK).contains(&ink), "{ink} of it is inked");

    let again = draw(plot).unwrap();
    assert_eq!(again.svg(), svg);
    assert!(again.png().unwrap() == png, "the PNG bytes differ");
    figure
}

/// Left, top, right and bottom edge of each horizontal text, in grid steps.
pub(super) fn text_boxes(document: &Document<'_>) -> Vec<[f64; 4]> {
    let number = |node: &Node<'_, '_>, name| -> f64 {
        let value = node.attribute(name).unwrap();
        value.trim_end_matches("em").parse().unwrap()
    };
    let horizontal = document
        .descendants()
        .filter(|node| node.has_tag_name("text") && !node.has_attribute("transform"));
    let bounds = |node: Node<'_, '_>| {
        let size = number(&node, "font-size");
        let width = text::width(node.text().unwrap().trim(), size);
        let before = match node.attribute("text-anchor").unwrap() {
            "start" => 0.0,
            "middle" => 0.5,
            _ => 1.0,
        };
        let left = number(&node, "x") - before * width;
        let base_line = number(&node, "y") + number(&node, "dy") * size;
        [left, base_line - 0.73 * size, left + width, base_line + 0.2 * size]
    };
    horizontal.map(bounds).collect()
}
