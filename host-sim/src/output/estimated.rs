//! Adds the list of estimated values to the output of commands. Estimated values were neither measured nor published.

use serde::Serialize;

use super::{
    in_units::InUnits,
    terminal::{print_result, print_text},
};
use crate::{error::Error, scene::Scene};

/// A result in the units of its scene, together with the keys of the scene's estimated values.
#[derive(Serialize)]
struct Marked<T: Serialize> {
    #[serde(flatten)]
    body: InUnits<T>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    estimated: Vec<String>,
}

/// A result of this scene as JSON, for `--json` and for files.
pub fn marked<T: Serialize>(scene: &Scene, body: T) -> impl Serialize {
    Marked { body: InUnits(scene.units, body), estimated: scene.estimated_keys() }
}

/// Prints the result of a command. With `--json`, one object is printed. Otherwise the text is printed, with a note
/// below it.
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

/// The same as [`print_of`], for a text that is sent to a board's console. The note is a comment before the text.
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
