//! Compares `docs/files.md` with the files and the JSON of the program. Tests of the commands call these functions.

use std::collections::BTreeSet;

use serde_json::Value;

const PAGE: &str = include_str!("../../../docs/files.md");

/// The names that stand between backticks in a text.
fn names(text: &str) -> BTreeSet<&str> {
    let code = text.split('`').skip(1).step_by(2);
    code.flat_map(|code| code.split(|c: char| !c.is_ascii_alphanumeric() && c != '_')).collect()
}

/// Asserts that the table with the head ``column of `FILE` `` names exactly the columns of this file.
pub fn has_columns_of(file: &str, csv: &str) {
    let head = format!("| column of `{file}` |");
    let table = PAGE.split_once(&head).unwrap_or_else(|| panic!("no table {head}")).1;
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
    let written: BTreeSet<&str> =
        csv.lines().next().unwrap().split(',').filter(|name| *name != "schema_version").collect();
    // a design with one section has no columns for a second section
    let is_left_out = |name: &&str| {
        file == "design.csv" && name.starts_with("second_") && !written.contains(name)
    };
    let told: BTreeSet<&str> = rows
        .flat_map(|row| names(row.split(" | ").next().unwrap()))
        .filter(|name| !is_left_out(name))
        .collect();
    assert_eq!(told, written, "docs/files.md (left), {file} (right)");
}

/// Asserts that the text below this heading names all keys of the object. Keys that every object has need not be named.
pub fn has_keys_of(heading: &str, object: &Value) {
    let at = format!("\n{heading}");
    let level = heading.split(' ').next().unwrap();
    let part = PAGE.split_once(&at).unwrap_or_else(|| panic!("no heading {heading}")).1;
    let part = &part[part.find('\n').unwrap()..];
    let next = part.match_indices("\n#").find(|(place, _)| {
        let marks = part[place + 1..].split(' ').next().unwrap();
        marks.len() <= level.len()
    });
    let told = names(&part[..next.map_or(part.len(), |(place, _)| place)]);
    let mut keys = BTreeSet::new();
    collect(object, &mut keys);
    let missing: Vec<&str> = keys
        .into_iter()
        .filter(|key| !told.contains(key) && !["schema_version", "command"].contains(key))
        .collect();
    assert!(missing.is_empty(), "docs/files.md, {heading}: does not name {missing:?}");
}

fn collect<'a>(value: &'a Value, keys: &mut BTreeSet<&'a str>) {
    match value {
        Value::Object(map) => map.iter().for_each(|(key, value)| {
            keys.insert(key);
            collect(value, keys);
        }),
        Value::Array(values) => values.iter().for_each(|value| collect(value, keys)),
        _ => {}
    }
}
