//! The bundled font, and the width of a text in this font.

use std::sync::LazyLock;

use ab_glyph::{Font as _, FontRef};

use crate::BitmapError;

/// DejaVu Sans. Its licence is in the same folder.
static FONT: LazyLock<Option<FontRef<'static>>> =
    LazyLock::new(|| FontRef::try_from_slice(include_bytes!("../../fonts/DejaVuSans.ttf")).ok());

pub(crate) fn font() -> Result<&'static FontRef<'static>, BitmapError> {
    FONT.as_ref().ok_or(BitmapError::Font)
}

/// Advance width of one character, as a fraction of the font size.
pub(crate) fn advance(font: &FontRef<'_>, c: char) -> f64 {
    let units_per_em = font.units_per_em().unwrap_or(1.0);
    f64::from(font.h_advance_unscaled(font.glyph_id(c)) / units_per_em)
}

/// Width of a line of text in the unit of `size`. Kerning is not included.
pub fn width(text: &str, size: f64) -> f64 {
    font().map_or(0.0, |font| text.chars().map(|c| advance(font, c)).sum::<f64>() * size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bundled_font_has_what_the_figures_need() {
        let font = font().unwrap();
        for c in "0123456789 AZaz [](),.;:/=%×·µ²³⁰¹⁴⁵⁶⁷⁸⁹⁻−–±…\u{2009}".chars()
        {
            assert!(font.glyph_id(c).0 != 0, "no glyph for {c:?}");
        }
    }
}
