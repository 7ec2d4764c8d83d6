//! `schema`: the JSON schema of scene files.

use clap::Args;

use crate::{error::Error, output::terminal::print_text, scene::schema::schema};

/// Prints the JSON schema of scene files. With the schema, an editor completes keys and shows meaning, unit and range.
#[derive(Debug, Args)]
pub struct SchemaArgs;

pub fn run() -> Result<(), Error> {
    print_text(&format!("{:#}", schema()))
}
