//! Progress on stderr; nothing is shown where stderr is not a terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `walks` walks.
pub fn bar(walks: u64) -> ProgressBar {
    let bar = ProgressBar::new(walks);
    let template = "{msg} {wide_bar} {pos}/{len} walks, {elapsed} (left {eta})";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}
