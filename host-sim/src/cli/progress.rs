//! Progress bars on stderr, which appear only on a terminal.

use indicatif::{ProgressBar, ProgressStyle};

pub fn bar(walks: u64) -> ProgressBar {
    bar_of(walks, "walks")
}

/// A bar that counts `things`.
pub fn bar_of(number: u64, things: &str) -> ProgressBar {
    let bar = ProgressBar::new(number);
    let template =
        format!("{{msg}} {{wide_bar}} {{pos}}/{{len}} {things}, {{elapsed}} (left {{eta}})");
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style);
    }
    bar
}
