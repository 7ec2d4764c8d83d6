//! Output for people: files, figures, reports and manifests. A file is complete or absent.

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

use sim_studies::table::{Cell, Column, Kind, Table, csv_line};

use crate::study::{boundary::Boundaries, sweep::Ideal};

/// Version of all JSON objects that the commands print or write. From version 2 on, the names of areas have their unit.
pub const SCHEMA_VERSION: u32 = 2;

/// Adds the version to a table, as the last column.
fn versioned(mut table: Table) -> Table {
    table.columns.push(Column { name: "schema_version".into(), kind: Kind::Whole });
    table.rows.iter_mut().for_each(|row| row.push(Cell::Whole(SCHEMA_VERSION.into())));
    table
}

/// Cells of a row, each with the name of its column.
type Cells = Vec<(&'static str, Cell)>;

/// Writes rows as CSV. All rows must have the columns of the first row.
fn csv_of(rows: impl IntoIterator<Item = Cells>) -> String {
    let mut text = String::new();
    for row in rows {
        let (names, cells): (Vec<_>, Vec<Cell>) = row.into_iter().unzip();
        if text.is_empty() {
            text = names.join(",") + "\n";
        }
        text += &csv_line(&cells);
    }
    text
}

fn version() -> (&'static str, Cell) {
    ("schema_version", Cell::Whole(SCHEMA_VERSION.into()))
}

/// Cells that give the mean, the smallest and the largest area of the walks.
fn area_cells(boundaries: &Boundaries) -> [(&'static str, Cell); 3] {
    let [low, high] = boundaries.area_range();
    [
        ("area_n2_s_per_m2", boundaries.area().into()),
        ("area_low_n2_s_per_m2", low.into()),
        ("area_high_n2_s_per_m2", high.into()),
    ]
}

/// Cells that give the largest stiffness, the largest damping and the number of capped walks.
fn reach_cells(boundaries: &Boundaries) -> [(&'static str, Cell); 3] {
    [
        ("stiffness_peak_n_per_m", boundaries.stiffness_peak_n_per_m().into()),
        ("damping_max_n_s_per_m", boundaries.damping_max_n_s_per_m().into()),
        ("capped_walks", Cell::count(boundaries.capped())),
    ]
}

fn ideal_cells(ideal: Option<Ideal>) -> [(&'static str, Cell); 3] {
    let of = |value: fn(Ideal) -> f64| Cell::number(ideal.map(value));
    [
        ("ideal_cutoff_hz", of(|ideal| ideal.cutoff_hz)),
        ("ideal_low_hz", of(|ideal| ideal.range_hz[0])),
        ("ideal_high_hz", of(|ideal| ideal.range_hz[1])),
    ]
}
