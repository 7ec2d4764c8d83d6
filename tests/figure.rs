//! Figures of the pages, as the tests measure them.

use std::{fmt::Display, fs, path::Path};

/// Unit tests of a crate of the simulator are not told where that is.
const FOLDER: &str = match option_env!("CARGO_TARGET_TMPDIR") {
    Some(folder) => folder,
    None => concat!(env!("CARGO_MANIFEST_DIR"), "/../../target/tmp"),
};

/// Leaves a figure where `.ci/pages` finds it: `key` is the test program, the room and what it is.
pub fn figure(key: &str, value: impl Display) {
    let file = Path::new(FOLDER).join("figures").join(key);
    fs::create_dir_all(file.parent().expect("a key has a room")).expect("target is there");
    fs::write(file, value.to_string()).expect("target can be written");
}
