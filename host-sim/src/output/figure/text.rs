//! Text on a page: style, width, cutting, wrapping, and escapes for markup.

use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};
pub(super) use sim_bitmap::width;

use super::{FigureError, Page, at, page::NOMINAL_PER_EM};

/// Font families that a browser tries in order. The first is the bundled font. The second has nearly the same widths.
pub(super) const FONT_FAMILIES: &str = "DejaVu Sans, Verdana, sans-serif";
/// Smallest size of a text that is made smaller, as a fraction of its size. A text that is still too wide is cut.
const SMALLEST_SHARE: f64 = 0.8;

/// A text style. The font size is `size` units.
pub(super) fn style(size: f64, colour: RGBColor) -> TextStyle<'static> {
    let nominal = size * super::GRID * NOMINAL_PER_EM;
    (FONT_FAMILIES, nominal).into_font().color(&colour)
}

/// Writes a line of text. `x` is the start, middle or end of the line. `y` is the middle of its digits.
pub(super) fn write(
    page: &Page,
    text: &str,
    [x, y]: [f64; 2],
    anchor: HPos,
    size: f64,
    colour: RGBColor,
) -> Result<(), FigureError> {
    let style = style(size, colour).pos(Pos::new(anchor, VPos::Center));
    page.draw_text(&printable(text), &style, at(x, y))?;
    Ok(())
}

/// Fits a text into a width of at most `limit`. Returns the text and its size. The text is first made smaller. If it is
/// still too wide, it is cut, with an ellipsis.
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

/// Breaks a text at spaces into lines of at most `limit`. Only a line with a single long word may be longer.
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

/// Replaces characters that XML 1.0 does not allow with U+FFFD.
fn printable(text: &str) -> String {
    let allowed = |c| match c {
        '\t' | '\n' | '\r' => c,
        '\u{0}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}' => '\u{fffd}',
        _ => c,
    };
    text.chars().map(allowed).collect()
}

/// Escapes a text for XML and HTML, in elements and in quoted attributes.
pub(crate) fn escape(text: &str) -> String {
    printable(text)
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
        .replace('\'', "&#39;")
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn escape_covers_markup_and_control_characters() {
        assert_eq!(
            escape("<a b=\"c\">'&'\u{1}"),
            "&lt;a b=&quot;c&quot;&gt;&#39;&amp;&#39;\u{fffd}"
        );
    }
}
