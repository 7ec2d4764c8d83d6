//! MCAP: one channel of JSON messages with their schema, in uncompressed chunks. Each row is a message. The manifest is
//! the metadata record `zwidth`.

use std::{collections::BTreeMap, io::Cursor};

use ::mcap::{
    WriteOptions,
    records::{MessageHeader, Metadata},
};
use serde_json::{Map, Value, json};

use super::{About, Cells, Column, Kind, Table};

const TOPIC: &str = "/zwidth";

pub fn bytes(table: &Table, about: &About) -> Result<Vec<u8>, String> {
    let times = times_ns(table, about.kind).ok_or("no column time_s or sample")?;
    write(table, &times, about).map_err(|error| error.to_string())
}

fn write(table: &Table, times: &[u64], about: &About) -> ::mcap::McapResult<Vec<u8>> {
    let options = WriteOptions::new()
        .compression(None)
        .library(concat!("zwidth ", env!("CARGO_PKG_VERSION")));
    let mut file = options.create(Cursor::new(Vec::new()))?;
    let schema = schema(table).to_string();
    let schema = file.add_schema("zwidth.Row", "jsonschema", schema.as_bytes())?;
    let channel_id = file.add_channel(schema, TOPIC, "json", &BTreeMap::new())?;
    file.write_metadata(&Metadata {
        name: "zwidth".into(),
        metadata: BTreeMap::from([("manifest".into(), about.manifest.clone())]),
    })?;
    for ((row, sequence), &time) in (0..table.rows).zip(0u32..).zip(times) {
        let cells = table.columns.iter().map(|column| (column.name.clone(), value(column, row)));
        let message = Value::Object(cells.collect::<Map<_, _>>()).to_string();
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        file.write_to_known_channel(&header, message.as_bytes())?;
    }
    file.finish()?;
    Ok(file.into_inner().into_inner())
}

/// Time of each row, in ns since sample 0.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "no time before sample 0"
)]
fn times_ns(table: &Table, kind: Kind) -> Option<Vec<u64>> {
    let Kind::Moments { rate_hz } = kind else { return None };
    let named = |name: &str| table.columns.iter().find(|column| column.name == name);
    let (cells, per_second) = match (named("time_s"), named("sample")) {
        (Some(Column { cells: Cells::Numbers(seconds), .. }), _) => (seconds.clone(), 1.0),
        (_, Some(Column { cells: Cells::Integers(samples), .. })) => {
            (samples.iter().map(|sample| sample.map(|n| n as f64)).collect(), rate_hz)
        }
        _ => return None,
    };
    cells.into_iter().map(|cell| Some((cell? / per_second * 1e9).round() as u64)).collect()
}

fn schema(table: &Table) -> Value {
    let properties = table.columns.iter().map(|column| {
        let kind = match column.cells {
            Cells::Integers(_) => "integer",
            Cells::Numbers(_) => "number",
            Cells::Words(_) => "string",
        };
        let mut about = json!({ "type": kind });
        if let Some(unit) = &column.unit {
            about["description"] = format!("unit: {unit}").into();
        }
        (column.name.clone(), about)
    });
    json!({ "type": "object", "properties": properties.collect::<Map<_, _>>() })
}

/// A cell as JSON. Numbers that JSON cannot represent are null.
fn value(column: &Column, row: usize) -> Value {
    match &column.cells {
        Cells::Integers(cells) => cells[row].into(),
        Cells::Numbers(cells) => cells[row].into(),
        Cells::Words(cells) => cells[row].clone().into(),
    }
}
