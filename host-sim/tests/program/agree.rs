//! `cargo sim agree`: compares a measured walk with the predicted walk.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use serde_json::Value;

const SIM: &str = env!("CARGO_BIN_EXE_host-sim");

/// A folder with the scene of the tutorial's handle. A walk of this scene has three values of B.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    fs::copy(examples.join("known.toml"), folder.path().join("known.toml")).unwrap();
    folder
}

fn run(folder: &Path, args: &[&str]) -> Output {
    Command::new(SIM).args(args).current_dir(folder).output().unwrap()
}

fn json(folder: &Path, args: &[&str]) -> Value {
    let output = run(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_walk_of_the_scene_agrees_and_one_of_a_slower_amplifier_names_it() {
    let folder = folder();
    let place = folder.path();
    run(place, &["walk", "known.toml", "--cutoff", "1500", "--csv", "own.csv"]);
    let same = json(place, &["agree", "known.toml", "own.csv", "--json"]);
    assert_eq!((&same["agrees"], &same["cutoff_hz"]), (&Value::from(true), &Value::from(1500.0)));
    assert_eq!(same["suspects"].as_array().unwrap().len(), 0);
    assert_eq!(same["walls"].as_array().unwrap().len(), 3);
    assert!(same["walls"][0]["explained_n_per_m"].is_null());

    let known = fs::read_to_string(place.join("known.toml")).unwrap();
    let slow = known.replace("bandwidth_hz = 1500", "bandwidth_hz = 500");
    fs::write(place.join("slow.toml"), slow).unwrap();
    run(place, &["walk", "slow.toml", "--cutoff", "1500", "--csv", "slow.csv"]);
    let args = ["agree", "known.toml", "slow.csv", "--csv", "both.csv", "--plot", "both.svg"];
    let other = json(place, &[&args[..], &["--json"]].concat());
    assert_eq!(other["agrees"], Value::from(false));
    let suspects = other["suspects"].as_array().unwrap();
    let amplifier = suspects.iter().find(|row| row["key"] == "amplifier.bandwidth_hz").unwrap();
    let [low, high] = ["low", "high"].map(|end| amplifier[end].as_f64().unwrap());
    assert!(amplifier["explains"] == true && low < 560.0 && high > 440.0, "{amplifier}");
    let table = fs::read_to_string(place.join("both.csv")).unwrap();
    let head = "damping_n_s_per_m,predicted_n_per_m,predicted_low_n_per_m,predicted_high_n_per_m,measured_n_per_m,\
                explained_n_per_m,schema_version";
    assert_eq!((table.lines().next(), table.lines().count()), (Some(head), 4));
    let figure = fs::read_to_string(place.join("both.svg")).unwrap();
    assert!(figure.contains("measured") && figure.contains("predicted"));
    // The text for people has the same answer. Existing files are not replaced.
    let output = run(place, &["agree", "known.toml", "slow.csv"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("they differ") && text.contains("amplifier.bandwidth_hz"), "{text}");
    assert_eq!(run(place, &args).status.code(), Some(2));
}

#[test]
fn a_bad_walk_is_one_line() {
    let folder = folder();
    let place = folder.path();
    let head = "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m";
    for (text, why) in [
        (String::new(), "bad.csv: the file is empty"),
        (format!("{head}\n1500,20,x\n"), "bad.csv: line 2: stiffness_n_per_m is `x`, allowed"),
        (
            format!("{head}\n1500,30,100\n"),
            "bad.csv: line 2: damping_n_s_per_m is 30, allowed 20 to 60 in steps of 20",
        ),
        (format!("{head}\n7000,20,100\n"), "bad.csv: cutoff_hz is 7000, allowed"),
    ] {
        fs::write(place.join("bad.csv"), text).unwrap();
        let output = run(place, &["agree", "known.toml", "bad.csv"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{said}");
        assert!(said.contains(why), "{said}");
    }
    let output = run(place, &["agree", "known.toml", "none.csv"]);
    assert_eq!(output.status.code(), Some(2));
}
