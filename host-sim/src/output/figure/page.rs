//! The page of a figure, which records the shapes that plotters draws.
//!
//! plotters is generic over its backend. Because there is only one recorder, plotters is compiled once, and each figure
//! is drawn once.

use std::convert::Infallible;

use plotters::{coord::Shift, prelude::*};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingErrorKind,
    text_anchor::{HPos, VPos},
};
use sim_bitmap::{Lettering, Shape};

/// Ratio of the nominal font size to the font size in the SVG of plotters.
pub(super) const NOMINAL_PER_EM: f64 = 1.24;

/// The drawing area of a figure. Points are in grid steps from its top left corner.
pub(super) type Page = DrawingArea<Recorder, Shift>;

/// Records the shapes that plotters draws. Figures only have filled shapes, lines and texts.
pub(super) struct Recorder {
    pub size: (u32, u32),
    pub shapes: Vec<Shape>,
}

type Drawn = Result<(), DrawingErrorKind<Infallible>>;

impl Recorder {
    fn keep(
        &mut self,
        style: &impl BackendStyle,
        shape: impl FnOnce(ShapeStyle) -> Shape,
    ) -> Drawn {
        let BackendColor { alpha, rgb: (red, green, blue) } = style.color();
        let color = RGBAColor(red, green, blue, alpha);
        if alpha > 0.0 {
            let stroke_width = style.stroke_width();
            self.shapes.push(shape(ShapeStyle { color, filled: true, stroke_width }));
        }
        Ok(())
    }
}

impl DrawingBackend for Recorder {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        self.size
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, (x, y): BackendCoord, colour: BackendColor) -> Drawn {
        self.keep(&colour, |style| Shape::Rectangle([(x, y), (x + 1, y + 1)], style))
    }

    fn draw_line<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
    ) -> Drawn {
        self.keep(style, |style| Shape::Line([from, to], style))
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
        _: bool,
    ) -> Drawn {
        self.keep(style, |style| Shape::Rectangle([from, to], style))
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn {
        self.keep(style, |style| Shape::Path(path.into_iter().collect(), style))
    }

    fn draw_circle<S: BackendStyle>(
        &mut self,
        centre: BackendCoord,
        radius: u32,
        style: &S,
        _: bool,
    ) -> Drawn {
        self.keep(style, |style| Shape::Circle(centre, radius, style))
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        corners: I,
        style: &S,
    ) -> Drawn {
        self.keep(style, |style| Shape::Polygon(corners.into_iter().collect(), style))
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, at: BackendCoord) -> Drawn {
        let lettering = Lettering {
            text: text.to_owned(),
            at,
            em: style.size() / NOMINAL_PER_EM,
            anchor: match style.anchor().h_pos {
                HPos::Left => ("start", 0.0),
                HPos::Center => ("middle", 0.5),
                HPos::Right => ("end", 1.0),
            },
            drop: match style.anchor().v_pos {
                VPos::Top => 0.76,
                VPos::Center => 0.36,
                VPos::Bottom => -0.27,
            },
            turned: matches!(style.transform(), FontTransform::Rotate270),
        };
        self.keep(&style.color(), |style| Shape::Text(lettering, style))
    }
}
