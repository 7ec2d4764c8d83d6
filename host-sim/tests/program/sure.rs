//! Tests the accuracy and the probability of walls: `compare --usable`, `grid --impedance` and `--probability`.

use std::{fs, path::Path};

use serde_json::Value;
use tempfile::TempDir;

use crate::{
    cli::{refused, sim},
    page,
};

/// Writes a scene with a short hit and a coarse grid, so that the test is fast. The uncertainty of its mass is 10 %.
fn write(folder: &Path, more: &str) {
    let text = include_str!("../../../scenes/paper-2um.toml");
    let changes = [
        ("settle_s = 4.0", "settle_s = 0.5"),
        ("window_s = 2.0", "window_s = 0.2"),
        ("start_position_m = 0.0", "start_position_m = 0.0695"),
        ("stiffness_step_n_per_m = 2000", "stiffness_step_n_per_m = 16000"),
        ("damping_step_n_s_per_m = 10", "damping_step_n_s_per_m = 160"),
    ];
    let text = changes.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    });
    fs::write(folder.join("my.toml"), format!("{text}\n{more}")).unwrap();
}

fn json(folder: &Path, args: &[&str]) -> Value {
    let output = sim(folder, args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn rows(path: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(path).unwrap();
    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

const WALLS: [&str; 6] =
    ["--cutoffs", "100,1500", "--stiffnesses", "4000:8000:60000", "--dampings", "20,100,400"];

#[test]
fn a_map_says_how_far_the_impedance_is_off() {
    let folder = TempDir::new().unwrap();
    write(folder.path(), "");
    let args = [&["grid", "my.toml", "--impedance", "--csv", "a.csv", "--json"], &WALLS[..]];
    let said = json(folder.path(), &args.concat());
    page::has_keys_of("## `grid SCENE", &said);
    let rows = rows(&folder.path().join("a.csv"));
    assert_eq!(rows[0][5], "impedance_error");
    let usable = |limit: f64| {
        let within =
            |row: &&Vec<String>| row[3] == "stable" && row[5].parse::<f64>().unwrap() <= limit;
        rows[1..].iter().filter(within).count() as u64
    };
    let counts = [0.05, 0.1, 0.2].map(usable);
    assert_eq!(said["usable"], serde_json::json!(counts));
    assert!(counts[0] < counts[2] && counts[0] > 0, "{counts:?}");
    // a filter of 100 Hz delays the velocity a lot, a filter of 1500 Hz only a little
    let worst = |cutoff: &str| {
        let errors = rows[1..].iter().filter(|row| row[0] == cutoff);
        errors.map(|row| row[5].parse::<f64>().unwrap()).fold(0.0, f64::max)
    };
    assert!(worst("100") > 0.15 && worst("1500") < 0.03, "{} {}", worst("100"), worst("1500"));
}

#[test]
fn usable_areas_are_ranked_within_each_limit() {
    let folder = TempDir::new().unwrap();
    write(folder.path(), "");
    let args = [
        "compare",
        "my.toml",
        "--usable",
        "3,10",
        "--estimators",
        "butterworth,kalman-3",
        "--budget",
        "4",
        "--repeat",
        "2",
        "--json",
    ];
    let said = json(folder.path(), &args);
    page::has_keys_of("### Of `compare --usable`", &said);
    let csv = folder.path().join("zwidth-out/my/usable/usable.csv");
    page::has_columns_of("usable.csv", &fs::read_to_string(&csv).unwrap());
    let areas = said["areas"].as_array().unwrap();
    assert_eq!((areas.len(), rows(&csv).len()), (6, 7));
    for limit in areas.chunks(2) {
        assert_eq!([&limit[0]["place"], &limit[1]["place"]], [1, 2]);
        let area = |n: usize| limit[n]["area_n2_s_per_m2"].as_f64().unwrap();
        assert!(area(0) >= area(1) && area(1) > 0.0);
        for one in limit {
            let stable = one["stable_area_n2_s_per_m2"].as_f64().unwrap();
            assert!(one["area_n2_s_per_m2"].as_f64().unwrap() <= stable * (1.0 + 1e-12));
        }
    }
    assert!(areas[4]["within_percent"].is_null() && areas[0]["within_percent"] == 3.0);
    let line = refused(folder.path(), &["compare", "my.toml", "--usable", "0"]);
    assert!(line.contains("--usable is 0"), "{line}");
}

#[test]
fn a_sweep_says_how_sure_its_walls_are() {
    let folder = TempDir::new().unwrap();
    write(folder.path(), "[uncertainty]\nmass_kg = 0.0416\n");
    let sweep = ["sweep", "my.toml", "--cutoffs", "500,1500", "--repeat", "1", "--plain", "--json"];
    let draws = ["--probability", "--uncertain", "3"];
    let said = json(folder.path(), &[&sweep[..], &draws].concat());
    page::has_keys_of("## `sweep [SCENE..]`", &said["scenes"][0]);
    let folder_of = folder.path().join("zwidth-out/my");
    let text = fs::read_to_string(folder_of.join("probability.csv")).unwrap();
    page::has_columns_of("probability.csv", &text);
    // the printed integral is the integral of the rows
    let map = rows(&folder_of.join("probability.csv"));
    let of = |cutoff: &str| -> f64 {
        let cells: Vec<&Vec<String>> = map[1..].iter().filter(|row| row[0] == cutoff).collect();
        let number = |row: &[String], n: usize| row[n].parse::<f64>().unwrap();
        let cell = 4.0 * number(cells[0], 1) * number(cells[0], 2);
        cells.iter().map(|row| number(row, 5)).sum::<f64>() * cell
    };
    let probability = &said["scenes"][0]["probability"];
    assert_eq!(probability["draws"], 3);
    for (n, cutoff) in ["500", "1500"].into_iter().enumerate() {
        let area = probability["cutoffs"][n]["area_n2_s_per_m2"].as_f64().unwrap();
        assert!((of(cutoff) / area - 1.0).abs() < 1e-6, "{} {area}", of(cutoff));
    }
    let contours = rows(&folder_of.join("contours.csv"));
    let envelope = rows(&folder_of.join("envelope95.csv"));
    let fitted = contours.iter().filter(|row| row[2] == "true").count();
    assert!(fitted > 5 && envelope.len() == fitted + 1, "{fitted} {}", envelope.len());
    let share = |key: &str| probability["contour"][key].as_f64().unwrap();
    assert!(share("share_low") < share("share") && share("share") < share("share_high"));
    assert!(folder_of.join("probability.svg").exists());
}

#[test]
fn a_grid_counts_the_draws_that_hold() {
    let folder = TempDir::new().unwrap();
    write(folder.path(), "");
    let args = [
        &["grid", "my.toml", "--probability", "--starts-each", "4", "--csv", "a.csv", "--json"],
        &WALLS[..],
    ];
    let said = json(folder.path(), &args.concat());
    page::has_keys_of("## `grid SCENE", &said);
    let rows = rows(&folder.path().join("a.csv"));
    assert_eq!((rows.len(), &rows[1][4][..]), (49, "4"));
    let sum: f64 = rows[1..].iter().map(|row| row[5].parse::<f64>().unwrap()).sum();
    assert!((sum / 48.0 - said["share"].as_f64().unwrap()).abs() < 1e-12 && sum > 1.0);
    let draws = ["sweep", "my.toml", "--probability", "--uncertain", "3"];
    assert!(refused(folder.path(), &draws).contains("[uncertainty]"));
    let line = refused(folder.path(), &["sweep", "my.toml", "--starts-each", "3"]);
    assert!(line.contains("--probability"), "{line}");
}
