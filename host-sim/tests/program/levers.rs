//! Tests `sweep --levers`.

use std::{collections::BTreeSet, fs};

use tempfile::TempDir;

use crate::{
    cli::{refused, sim},
    page,
};

/// A scene with a short hit and low caps, so that the test is fast.
fn scene() -> String {
    let text = include_str!("../../../scenes/paper-1um.toml");
    let changes = [
        ("settle_s = 4.0", "settle_s = 1.5"),
        ("window_s = 2.0", "window_s = 0.2"),
        ("stiffness_max_n_per_m = 1e7", "stiffness_max_n_per_m = 5e4"),
        ("damping_max_n_s_per_m = 4000", "damping_max_n_s_per_m = 200"),
    ];
    changes.iter().fold(text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    })
}

#[test]
#[ignore = "84 boundaries: .ci/long criteria"]
fn a_device_in_other_loops_is_rows_by_what_is_between() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("my.toml"), scene()).unwrap();
    let args = ["sweep", "my.toml", "--cutoffs", "500", "--repeat", "1", "--levers", "--json"];
    let output = sim(folder.path(), &args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let made = folder.path().join("zwidth-out/my");
    let text = fs::read_to_string(made.join("levers.csv")).unwrap();
    page::has_columns_of("levers.csv", &text);
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|row| row.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == head.len()));
    let column = |name: &str| head.iter().position(|column| *column == name).unwrap();
    let [of_loop, period, between, push, limit, estimator, area, step] = [
        "loop",
        "output_period_samples",
        "between",
        "push",
        "limit_unit",
        "estimator",
        "area_n2_s_per_m2",
        "stiffness_step_n_per_m",
    ]
    .map(column);
    // There are seven loops: the scene's own loop, four periods of one board, and two periods of the other board. Each
    // loop has two limits, and for each limit the push by motor and by hand. Each of these has three rows at one cutoff
    // (no added element, an amplifier, a transmission), and one row for the true velocity.
    assert_eq!(rows.len(), 7 * 2 * 2 * (3 + 1));
    let loops: BTreeSet<(&str, &str)> =
        rows.iter().map(|row| (row[of_loop], row[period])).collect();
    let all = [("discovery-f407", "1"), ("discovery-f407", "10"), ("my", "10")];
    assert!(all.iter().all(|one| loops.contains(one)) && loops.len() == 7, "{loops:?}");
    let of = |wanted: [&str; 5]| -> f64 {
        let same = |row: &&Vec<&str>| {
            [of_loop, period, between, push, limit].map(|column| row[column]) == wanted
                && row[estimator] == "scene"
        };
        rows.iter().filter(same).map(|row| row[area].parse().unwrap()).fold(0.0, f64::max)
    };
    let own = of(["my", "10", "as-is", "motor", "N"]);
    let sooner = of(["nucleo-f446re", "10", "as-is", "motor", "N"]);
    let slow = of(["nucleo-f446re", "10", "amplifier-and-mode", "motor", "N"]);
    assert!(own > 0.0 && sooner > 1.1 * own && slow < sooner, "{own} {sooner} {slow}");
    let steps: BTreeSet<&str> = rows.iter().map(|row| row[step]).collect();
    assert_eq!(steps, BTreeSet::from(["125"]), "halved once, for the steps of B");
    let summary = fs::read_to_string(made.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    page::has_keys_of("## `sweep [SCENE..]`", &summary);
    assert_eq!(summary["levers"].as_array().unwrap().len(), 7 * 3 * 2 * 2);
    assert_eq!(summary["levers"][0]["times_the_scene"], 1.0);
    let report = fs::read_to_string(made.join("report.html")).unwrap();
    assert!(report.contains("When the loop acts") && report.contains("a perfect velocity"));
    assert!(made.join("levers.svg").exists());
    let why = refused(folder.path(), &["sweep", "my.toml", "--levers", "--plain"]);
    assert!(why.contains("--plain"), "{why}");
}
