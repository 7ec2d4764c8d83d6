//! What every command that runs a scene says of it: which of its numbers nobody has measured.

use serde::Serialize;

use super::{
    in_units::InUnits,
    terminal::{print_result, print_text},
};
use crate::{error::Error, scene::Scene};

/// The result of a scene in its units, with the keys that are estimated; a scene without any adds nothing.
#[derive(Serialize)]
struct Marked<T: Serialize> {
    #[serde(flatten)]
    body: InUnits<T>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    estimated: Vec<String>,
}

/// A result of that scene, for `--json` and for files.
pub fn marked<T: Serialize>(scene: &Scene, body: T) -> impl Serialize {
    Marked { body: InUnits(scene.units, body), estimated: scene.estimated_keys() }
}

/// Prints what a command came to with that scene: with `--json` its one object, else the text, and a note below it.
pub fn print_of(
    json: bool,
    scene: &Scene,
    body: impl Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), Error> {
    print_result(json, marked(scene, body), || {
        let note = scene.estimated_note().map(|note| format!("\nnote: {note}"));
        text() + &note.unwrap_or_default()
    })
}

/// The same for a text that a board's console takes: the note is a comment before it.
pub fn print_console_of(
    json: bool,
    scene: &Scene,
    body: impl Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), Error> {
    if !json && let Some(note) = scene.estimated_note() {
        print_text(&format!("# {note}"))?;
    }
    print_result(json, marked(scene, body), text)
}
