//! Parquet: one row group, compressed with Snappy. Units and manifest are key-value pairs of the file.

use std::{collections::BTreeMap, sync::Arc};

use ::parquet::{
    basic::{Compression, LogicalType, Repetition, Type as Physical},
    data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type},
    errors::ParquetError,
    file::{metadata::KeyValue, properties::WriterProperties, writer::SerializedFileWriter},
    schema::types::Type,
};

use super::{Cells, Column, Table};

/// Key of the pair whose value is the units: the columns with their units, as JSON. `MANIFEST` is the key of the
/// manifest.
const UNITS: &str = "zwidth.units";
const MANIFEST: &str = "zwidth.manifest";

pub fn bytes(table: &Table, manifest: &str) -> Result<Vec<u8>, ParquetError> {
    let fields = table.columns.iter().map(|column| Ok(Arc::new(field(column)?)));
    let fields = fields.collect::<Result<_, ParquetError>>()?;
    let schema = Arc::new(Type::group_type_builder("zwidth").with_fields(fields).build()?);
    let units: BTreeMap<&str, &str> =
        table.columns.iter().filter_map(|c| Some((c.name.as_str(), c.unit.as_deref()?))).collect();
    let units =
        serde_json::to_string(&units).map_err(|error| ParquetError::External(error.into()))?;
    let pairs = [(UNITS, units.as_str()), (MANIFEST, manifest)]
        .map(|(key, value)| KeyValue::new(key.to_owned(), value.to_owned()));
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(concat!("zwidth ", env!("CARGO_PKG_VERSION")).to_owned())
        .set_key_value_metadata(Some(pairs.to_vec()))
        .build();
    let mut file = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
    let mut group = file.next_row_group()?;
    for column in &table.columns {
        let Some(mut writer) = group.next_column()? else { break };
        match &column.cells {
            Cells::Integers(cells) => {
                let (values, there) = split(cells, |&cell| cell);
                writer.typed::<Int64Type>().write_batch(&values, Some(&there), None)?;
            }
            Cells::Numbers(cells) => {
                let (values, there) = split(cells, |&cell| cell);
                writer.typed::<DoubleType>().write_batch(&values, Some(&there), None)?;
            }
            Cells::Words(cells) => {
                let (values, there) = split(cells, |cell| ByteArray::from(cell.as_str()));
                writer.typed::<ByteArrayType>().write_batch(&values, Some(&there), None)?;
            }
        }
        writer.close()?;
    }
    group.close()?;
    file.into_inner()
}

fn field(column: &Column) -> Result<Type, ParquetError> {
    let (physical, logical) = match column.cells {
        Cells::Integers(_) => (Physical::INT64, None),
        Cells::Numbers(_) => (Physical::DOUBLE, None),
        Cells::Words(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
    };
    Type::primitive_type_builder(&column.name, physical)
        .with_logical_type(logical)
        .with_repetition(Repetition::OPTIONAL)
        .build()
}

/// Separates the values that are not null. For each cell, the second list says whether the cell has a value (the
/// definition level).
fn split<T, V>(cells: &[Option<T>], value: impl Fn(&T) -> V) -> (Vec<V>, Vec<i16>) {
    let there = cells.iter().map(|cell| i16::from(cell.is_some())).collect();
    (cells.iter().flatten().map(value).collect(), there)
}
