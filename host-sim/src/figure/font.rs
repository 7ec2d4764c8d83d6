//! The bundled font: how wide a text is, and how it is cut to a width.

use std::sync::LazyLock;

use ttf_parser::Face;

/// DejaVu Sans; its licence stands beside it.
pub(super) static FONT: &[u8] = include_bytes!("../../fonts/DejaVuSans.ttf");

static FACE: LazyLock<Option<Face<'static>>> = LazyLock::new(|| Face::parse(FONT, 0).ok());

/// A text may shrink to this part of its size before it is cut.
const SMALLEST_SHARE: f64 = 0.8;

/// The parsed font, `None` when the bundled file is damaged.
pub(super) fn face() -> Option<&'static Face<'static>> {
    FACE.as_ref()
}

/// Advance of one character in units of the font size.
pub(super) fn advance(face: &Face<'_>, c: char) -> f64 {
    let glyph = face.glyph_index(c).unwrap_or_default();
    let units = face.glyph_hor_advance(glyph).unwrap_or_default();
    f64::from(units) / f64::from(face.units_per_em())
}

/// Width of a line of text, without kerning.
pub(super) fn width(text: &str, size: f64) -> f64 {
    face().map_or(0.0, |face| text.chars().map(|c| advance(face, c)).sum::<f64>() * size)
}

/// The text and its size so that it is at most `limit` wide: first shrunk, then cut with an ellipsis.
pub(super) fn fit(text: &str, size: f64, limit: f64) -> (String, f64) {
    let natural = width(text, size);
    if natural <= limit {
        return (text.to_owned(), size);
    }
    let size = size * (limit / natural).max(SMALLEST_SHARE);
    let mut kept: Vec<char> = text.chars().collect();
    loop {
        let shown: String = kept.iter().collect();
        if width(&shown, size) <= limit {
            return (shown, size);
        }
        if kept.pop() == Some('…') {
            kept.pop();
        }
        if kept.is_empty() {
            return (String::new(), size);
        }
        kept.push('…');
    }
}

/// The text broken at spaces into lines of at most `limit`, each of them fitted.
pub(super) fn wrap(text: &str, size: f64, limit: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width(&format!("{line} {word}"), size) <= limit => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bundled_font_has_what_the_figures_need() {
        let face = face().unwrap();
        for c in "0123456789 AZaz [](),.;:/=%×·µ²³⁰¹⁴⁵⁶⁷⁸⁹⁻−–±…\u{2009}".chars()
        {
            assert!(face.glyph_index(c).is_some(), "no glyph for {c:?}");
        }
    }

    #[test]
    fn a_fitted_text_keeps_the_limit() {
        const LIMIT: f64 = 100.0;
        let (same, size) = fit("short", 10.0, LIMIT);
        assert_eq!((same.as_str(), size), ("short", 10.0));
        let (cut, size) = fit(&"wide ".repeat(40), 10.0, LIMIT);
        assert!(cut.ends_with('…'));
        assert!(width(&cut, size) <= LIMIT);
        assert_eq!(fit("word", 10.0, 0.0).0, "");
    }

    #[test]
    fn wrapped_lines_keep_every_word() {
        let text = "one two three four five six seven";
        let lines = wrap(text, 10.0, 60.0);
        assert!(lines.len() > 1);
        assert_eq!(lines.join(" "), text);
    }
}
