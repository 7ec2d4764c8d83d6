//! Tests the ready devices in `scenes/`: each has stable walls, a record, and a list of its estimated values.

use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::cli::sim;

/// A wall far inside the stable range for each scene. After the scene's name come cutoff, K and B, in the scene's
/// units.
const WALLS: [(&str, [&str; 3]); 6] = [
    ("epfl-paddle", ["500", "20", "0.1"]),
    ("rice-paddle", ["500", "20", "0.1"]),
    ("hapkit", ["500", "10", "0.05"]),
    ("smartknob", ["500", "0.2", "0.001"]),
    ("nucleo-f446re", ["1500", "8000", "30"]),
    ("discovery-f407", ["1500", "8000", "30"]),
];

fn run(folder: &Path, args: &[&str]) -> Value {
    let output = sim(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn every_ready_device_holds_a_wall() {
    let folder = TempDir::new().unwrap();
    for (scene, [cutoff, k, b]) in WALLS {
        let wall = ["--cutoff", cutoff, "--stiffness", k, "--damping", b, "--json"];
        let json = run(folder.path(), &[&["hit", scene], &wall[..]].concat());
        assert_eq!(json["verdict"], "stable", "{scene}: {json}");
        assert_eq!(json["window_at_limit_fraction"], 0.0, "{scene}: {json}");
    }
}

/// The dry friction of this device needs short steps of integration.
const SLOW: &str = "epfl-paddle";

#[test]
fn every_ready_device_has_a_record() {
    have_records(WALLS.map(|(scene, _)| scene).into_iter().filter(|scene| *scene != SLOW));
}

#[test]
#[ignore = "half a minute; .ci/long runs it"]
fn the_slow_ready_device_has_a_record() {
    have_records([SLOW]);
}

/// Guessed values are in the scene's units, as are the other values of the output.
fn have_records(scenes: impl IntoIterator<Item = &'static str>) {
    let folder = TempDir::new().unwrap();
    for scene in scenes {
        let output = sim(folder.path(), &["prepare", scene, "--out", &format!("{scene}.device")]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{scene}: {}", String::from_utf8_lossy(&output.stderr));
        let after = |what: &str| {
            let found = text.split_once(what).unwrap_or_else(|| panic!("{scene}, {what}: {text}"));
            found.1.split([' ', ',']).next().unwrap().parse::<f64>().unwrap()
        };
        if scene.contains("-f4") {
            assert!(!text.contains("guessed"), "{text}");
            continue;
        }
        let heaviest = after("safety.heaviest_inertia_kg_m2 ");
        assert!((heaviest / after("as it would ") - 1.0).abs() < 1e-3, "{text}");
        let all = after("force      ");
        assert!(after("return.force_n_m ") < all, "{text}");
        let known = run(folder.path(), &["sweep", scene, "--plain", "--repeat", "1", "--json"]);
        for key in known["scenes"][0]["estimated"].as_array().unwrap() {
            assert!(text.contains(key.as_str().unwrap()), "{key}: {text}");
        }
    }
}

/// Every command lists the estimated values, in its text and in its JSON.
#[test]
fn every_command_names_what_is_estimated() {
    let folder = TempDir::new().unwrap();
    let wall = ["--stiffness", "20", "--damping", "0.1"];
    let walls = ["--stiffnesses", "20", "--dampings", "0.1"];
    for (command, args) in [
        ("hit", [&["--cutoff", "500"], &wall[..]].concat()),
        ("walk", vec!["--cutoff", "500"]),
        ("grid", [&["--cutoffs", "500"], &walls[..]].concat()),
        ("linear", vec!["--cutoffs", "500", "--dampings", "0.1"]),
    ] {
        let args = [&[command, "rice-paddle"][..], &args].concat();
        is_marked(folder.path(), &args, "note: ");
        let plain: Vec<&str> =
            args.iter().map(|arg| if *arg == "rice-paddle" { "paper-1um" } else { arg }).collect();
        let plain: Vec<&str> =
            plain.iter().map(|arg| if *arg == "0.1" { "10" } else { arg }).collect();
        let plain = run(folder.path(), &[&plain[..], &["--json"]].concat());
        assert_eq!(plain.get("estimated"), None, "{command}");
    }
    is_marked(folder.path(), &["identify", "--plan", "--base", "rice-paddle"], "# ");
}

fn is_marked(folder: &Path, args: &[&str], before: &str) {
    let json = run(folder, &[args, &["--json"]].concat());
    let keys = json["estimated"].as_array().unwrap_or_else(|| panic!("{args:?}: {json}"));
    assert!(keys.contains(&"rotary.handle_inertia_kg_m2".into()), "{args:?}: {keys:?}");
    let text = String::from_utf8(sim(folder, args).stdout).unwrap();
    let note =
        format!("{before}estimated, neither measured nor published: rotary.handle_radius_m, ");
    assert_eq!(text.lines().filter(|line| line.starts_with(&note)).count(), 1, "{args:?}: {text}");
}

/// `explain` finds the best estimator of a longer search, or an estimator whose area is in the range of the best
/// estimator's area.
#[test]
#[ignore = "an explanation and a comparison of each ready device; .ci/long runs it"]
fn the_best_estimator_of_an_explanation_is_that_of_a_comparison() {
    for (scene, _) in WALLS {
        let folder = TempDir::new().unwrap();
        let area = |row: &Value, key: &str| {
            let found = row.as_object().unwrap().iter().find(|(name, _)| name.starts_with(key));
            found.unwrap().1.as_f64().unwrap()
        };
        let explained = run(folder.path(), &["explain", scene, "--json"]);
        let rows = explained["changes"].as_array().unwrap();
        let of = |change: &str| rows.iter().find(|row| row["change"] == change).unwrap();
        let (row, own) = (of("estimator"), of("none")["estimator"].as_str().unwrap());
        let compared = run(folder.path(), &["compare", scene, "--budget", "16", "--json"]);
        let others = compared["estimators"].as_array().unwrap().iter();
        let others =
            others.filter(|one| one["class"] == "position_only" && one["estimator"] != own);
        let others = others.map(|one| (area(one, "area_n2"), one["estimator"].as_str().unwrap()));
        let (best, name) = others.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        let [mean, high] = ["area_n2", "area_high_n2"].map(|key| area(row, key));
        let found = row["estimator"].as_str().unwrap();
        println!("{scene}: {found} {mean:.4e}, up to {high:.4e}; compared {name} {best:.4e}");
        assert!(mean >= 0.95 * best || high >= best, "{scene}: {found} {mean}, {name} {best}");
        let estimated = explained["estimated"].as_array().map_or(0, Vec::len);
        assert!(estimated > 0, "{scene}");
    }
}

#[test]
#[ignore = "sweeps and comparisons of six devices; .ci/long runs it"]
fn sweep_and_comparison_of_a_ready_device_find_a_cutoff() {
    for (scene, _) in WALLS {
        let folder = TempDir::new().unwrap();
        let sweep = ["sweep", scene, "--plain", "--repeat", "1", "--json"];
        let swept = run(folder.path(), &sweep);
        let swept = &swept["scenes"][0];
        assert!(swept["ideal_cutoff_hz"].is_number(), "{scene}: {swept}");
        let estimated = swept["estimated"].as_array().map_or(0, Vec::len);
        assert!(estimated > 0, "{scene}");
        let five = "butterworth,first-order,tracking-loop,kalman-3,levant-explicit";
        let compare =
            ["compare", scene, "--estimators", five, "--budget", "3", "--repeat", "2", "--json"];
        let compared = run(folder.path(), &compare);
        for row in compared["estimators"].as_array().unwrap() {
            let area = row.as_object().unwrap().iter().find(|(key, _)| key.starts_with("area_n2"));
            assert!(area.unwrap().1.as_f64().unwrap() > 0.0, "{scene}: {row}");
        }
    }
}
