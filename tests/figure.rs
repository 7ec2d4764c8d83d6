//! Figures of the pages that tests measure.

use std::{fmt::Display, fs, path::Path};

/// Folder to which the figures are written. Cargo does not set `CARGO_TARGET_TMPDIR` for unit tests of a crate, so the
/// folder is then named here.
const FOLDER: &str = match option_env!("CARGO_TARGET_TMPDIR") {
    Some(folder) => folder,
    None => concat!(env!("CARGO_MANIFEST_DIR"), "/../../target/tmp"),
};

/// Writes a figure to a file for `.ci/pages`. `key` has the form `test program/module/name`.
pub fn figure(key: &str, value: impl Display) {
    let file = Path::new(FOLDER).join("figures").join(key);
    fs::create_dir_all(file.parent().expect("a key has a room")).expect("target is there");
    fs::write(file, value.to_string()).expect("target can be written");
}
