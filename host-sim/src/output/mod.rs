//! What a person gets: files that are whole or not there, figures, the report of a sweep, manifests.

pub mod agree;
pub mod design;
mod draft;
pub mod estimated;
pub mod explain;
pub mod figure;
pub mod files;
pub mod grid;
pub mod in_units;
pub mod levers;
pub mod limits;
pub mod manifest;
pub mod passive;
pub mod peers;
pub mod probability;
pub mod rates;
pub mod recommended;
pub mod report;
mod signals;
pub mod study;
pub mod sweep;
pub mod table;
pub mod telemetry;
pub mod terminal;
pub mod trace;
pub mod trade_figures;
pub mod usable;

use sim_studies::table::{Cell, Column, Kind, Table};

/// Version of every JSON object that the commands print or write: 2 since areas carry their unit.
pub const SCHEMA_VERSION: u32 = 2;

/// A table whose last column says that version.
fn versioned(mut table: Table) -> Table {
    table.columns.push(Column { name: "schema_version".into(), kind: Kind::Whole });
    table.rows.iter_mut().for_each(|row| row.push(Cell::Whole(SCHEMA_VERSION.into())));
    table
}
