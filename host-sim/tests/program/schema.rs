//! Tests `schema`. A scene that the program can read must be valid by the schema. A scene with wrong types or ranges
//! must be invalid.

use std::{fs, path::Path};

use host_sim::scene::NamedScene;
use serde_json::Value;

use crate::cli::sim;

const STORED: &str = "../scenes/scene.schema.json";

fn printed(words: &[&str]) -> String {
    let ran = sim(Path::new("."), words);
    assert!(ran.status.success());
    String::from_utf8(ran.stdout).unwrap()
}

fn validator() -> jsonschema::Validator {
    let schema: Value = serde_json::from_str(&printed(&["schema"])).unwrap();
    jsonschema::draft7::new(&schema).unwrap()
}

fn is_valid(validator: &jsonschema::Validator, scene: &toml::Table) -> bool {
    validator.is_valid(&serde_json::to_value(scene).unwrap())
}

#[test]
fn the_stored_schema_is_the_programs() {
    let stored = fs::read_to_string(STORED).unwrap();
    assert_eq!(stored, printed(&["schema"]), "cargo sim schema > scenes/scene.schema.json");
}

#[test]
fn scenes_of_this_project_are_valid() {
    let validator = validator();
    let mut tried = 0;
    for folder in ["../scenes", "../examples", "../docs/data"] {
        for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let path = entry.path();
            if path.extension().is_some_and(|ending| ending == "toml") {
                let scene: toml::Table = fs::read_to_string(&path).unwrap().parse().unwrap();
                assert!(is_valid(&validator, &scene), "{}", path.display());
                tried += 1;
            }
        }
    }
    assert!(tried > 15);
}

/// Each case is a scene, a key and a value. Both the reader and the schema must report an error.
#[test]
fn what_the_reader_refuses_is_not_valid() {
    let validator = validator();
    for (scene, path, value) in [
        ("paper-1um", "device.mass_kg", "1000.0"),
        ("paper-1um", "device.mass", "1.0"),
        ("paper-1um", "device.mass_kg", "'heavy'"),
        ("paper-1um", "encoder.resolution_m", "1.0"),
        ("paper-1um", "encoder.rounding", "'up'"),
        ("paper-1um", "actuator.period", "0"),
        ("paper-1um", "actuator.period", "1.5"),
        ("paper-1um", "velocity.estimator", "'best'"),
        ("paper-1um", "velocity.window_samples", "4"),
        ("paper-1um", "wall_hit.criterion", "'loud'"),
        ("paper-1um", "wall.position_rad", "0.1"),
        ("paper-1um", "output", "{ kind = 'dac', steps = 12 }"),
        ("paper-1um", "friction", "{ coulomb_n = 0.1 }"),
        ("paper-1um", "arms", "{ someone = { mass_kg = 1.0 } }"),
        ("hapkit", "rotary.ratio", "0.0"),
        ("hapkit", "device", "{ mass_kg = 1.0 }"),
        ("hapkit", "wall.position_m", "0.1"),
        ("hapkit", "encoder.resolution_m", "1e-6"),
    ] {
        let mut table: toml::Table = NamedScene::load(scene).unwrap().text.parse().unwrap();
        assert!(is_valid(&validator, &table), "{scene}");
        let value = format!("key = {value}").parse::<toml::Table>().unwrap()["key"].clone();
        match path.split_once('.') {
            Some((name, key)) => {
                table.get_mut(name).unwrap().as_table_mut().unwrap().insert(key.into(), value);
            }
            None => drop(table.insert(path.into(), value)),
        }
        assert!(!is_valid(&validator, &table), "{scene}: {path}");
        assert!(NamedScene::of_table("mine".into(), table, "mine").is_err(), "{scene}: {path}");
    }
}

#[test]
fn every_key_has_a_meaning() {
    let table = printed(&["reference", "scene"]);
    let rows: Vec<_> = table.lines().skip(2).collect();
    assert!(rows.len() > 100);
    for row in rows {
        let cells: Vec<_> = row.split(" | ").collect();
        assert!(cells.len() == 5 && cells[2].len() > 8, "{row}");
        let of_drive = ["amplifier_a_per_v", "resistance_ohm", "supply_v"];
        if of_drive.iter().any(|key| cells[0] == format!("| `rotary.{key}`")) {
            assert!(cells[2].starts_with("With `drive = ") && cells[4] == "needed |", "{row}");
        }
    }
}
