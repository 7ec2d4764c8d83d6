//! Tests `passivity` and `[passivity]` on the command line, with their files, keys and errors.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use tempfile::TempDir;

use super::page;

fn sim(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).current_dir(folder).args(args).output().unwrap()
}

/// A folder with a scene of the paper's device. It has a short hit, coarse walks, and the tables `more`.
fn folder(more: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    let mut text = include_str!("../../../scenes/paper-2um.toml").to_owned();
    for (key, value) in [
        ("settle_s", "1.0"),
        ("window_s", "0.1"),
        ("stiffness_step_n_per_m", "20000"),
        ("damping_step_n_s_per_m", "200"),
        ("damping_max_n_s_per_m", "460"),
    ] {
        let start = text.find(&format!("{key} = ")).unwrap();
        let end = start + text[start..].find('\n').unwrap();
        text.replace_range(start..end, &format!("{key} = {value}"));
    }
    fs::write(folder.path().join("coarse.toml"), text + more).unwrap();
    folder
}

fn json(output: &Output) -> serde_json::Value {
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn its_rows_are_those_of_its_file() {
    let folder = folder("");
    let folder = folder.path();
    let args =
        ["passivity", "coarse.toml", "--cutoffs", "1500", "--limits", "15e-6", "--repeat", "1"];
    let json = json(&sim(folder, &[&args[..], &["--json", "--out", "out"]].concat()));
    page::has_keys_of("## Of `passivity`", &json);
    let rows = json["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2, "without and with");
    let number = |row: usize, key: &str| rows[row][key].as_f64().unwrap();
    let given = |row: usize| rows[row]["at_boundary_without"]["given_j"].as_f64().unwrap();
    let reserve = json["reserve_j"].as_f64().unwrap();
    assert!(given(0) > reserve && given(1) <= reserve, "{json}");
    assert!(number(1, "area_n2_s_per_m2") >= number(0, "area_n2_s_per_m2"));
    let csv = fs::read_to_string(folder.join("out/passivity.csv")).unwrap();
    let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines.len(), 1 + 3, "walls of the boundary without, twice, and of that with");
    let files = include_str!("../../../docs/files.md");
    for column in &lines[0][..lines[0].len() - 1] {
        assert!(files.contains(&format!("`{column}`")), "docs/files.md lacks {column}");
    }
    let area = lines[0].iter().position(|name| *name == "area_n2_s_per_m2").unwrap();
    assert_eq!(lines[1][area].parse::<f64>().unwrap(), number(0, "area_n2_s_per_m2"));
    for file in ["passivity.svg", "passivity.png", "manifest.json"] {
        assert!(folder.join("out").join(file).exists(), "{file}");
    }
}

#[test]
fn a_hit_says_what_the_controller_has_done() {
    let folder = folder("\n[passivity]\n");
    let args =
        ["hit", "coarse.toml", "--cutoff", "1500", "--stiffness", "40000", "--damping", "20"];
    let json = json(&sim(folder.path(), &[&args[..], &["--json"]].concat()));
    page::has_keys_of("## `hit SCENE", &json);
    let share = |key: &str| json[key].as_f64().unwrap();
    assert!(
        share("port_limited_fraction") > 0.0 && share("port_withheld_fraction") > 0.0,
        "{json}"
    );
    let said = String::from_utf8(sim(folder.path(), &args).stdout).unwrap();
    assert!(said.contains("its passivity controller changed"), "{said}");
}

#[test]
fn what_cannot_be_is_one_line() {
    for (table, what) in [
        ("acceleration_m_per_s2 = 0", "passivity.acceleration_m_per_s2 is 0, allowed "),
        ("acceleration_m_per_s2 = nan", "passivity.acceleration_m_per_s2 is NaN, allowed "),
        ("acceleration_m_per_s2 = 1e9", "passivity.acceleration_m_per_s2 is 1000000000, allowed "),
        ("speed = 1", "unknown field `speed`"),
    ] {
        let folder = folder(&format!("\n[passivity]\n{table}\n"));
        let output = sim(folder.path(), &["walk", "coarse.toml", "--cutoff", "500"]);
        let line = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && line.lines().count() == 1, "{line}");
        assert!(line.contains(what), "{line}");
    }
    let folder = folder("");
    for (options, what) in [
        (&["--cutoffs", "0"][..], "cutoff"),
        (&["--acceleration", "-3"], "passivity.acceleration_m_per_s2 is -3, allowed "),
        (&["--limits", "x"], "is no limit"),
        (&["--numeric", "f64"], "--numeric: passivity runs the fixed-point core only"),
    ] {
        let output = sim(folder.path(), &[&["passivity", "coarse.toml"][..], options].concat());
        let line = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && line.contains(what), "{options:?}: {line}");
    }
    let late =
        include_str!("../../../scenes/paper-2um.toml").replace("latency = 10.0", "latency = 12.0");
    fs::write(folder.path().join("late.toml"), late + "\n[passivity]\n").unwrap();
    let output = sim(folder.path(), &["walk", "late.toml", "--cutoff", "500"]);
    let line = String::from_utf8(output.stderr).unwrap();
    assert!(
        line.contains("actuator.latency with [passivity] is 12, allowed 0 to actuator.period, 10"),
        "{line}"
    );
}
