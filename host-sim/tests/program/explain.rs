//! `explain` on the command line: its files and its errors.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use tempfile::TempDir;

fn sim(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).current_dir(folder).args(args).output().unwrap()
}

/// A folder with a scene of the paper's device. It has a short hit and a grid of few walls.
fn folder() -> TempDir {
    let folder = TempDir::new().unwrap();
    let mut text = include_str!("../../../scenes/paper-2um.toml").to_owned();
    for (key, value) in [
        ("settle_s", "1.0"),
        ("window_s", "0.1"),
        ("stiffness_start_n_per_m", "20000"),
        ("stiffness_step_n_per_m", "20000"),
        ("stiffness_max_n_per_m", "1e5"),
        ("damping_start_n_s_per_m", "60"),
        ("damping_step_n_s_per_m", "200"),
        ("damping_max_n_s_per_m", "460"),
    ] {
        let start = text.find(&format!("{key} = ")).unwrap();
        let end = start + text[start..].find('\n').unwrap();
        text.replace_range(start..end, &format!("{key} = {value}"));
    }
    fs::write(folder.path().join("coarse.toml"), text).unwrap();
    folder
}

#[test]
fn its_files_say_what_its_json_says() {
    let folder = folder();
    let folder = folder.path();
    let args = ["explain", "coarse.toml", "--budget", "3", "--repeat", "2", "--damping", "60"];
    let output = sim(folder, &[&args[..], &["--json", "--out", "out"]].concat());
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{error}");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let changes = json["changes"].as_array().unwrap();
    assert!(changes.len() >= 12 && changes[0]["change"] == "none" && changes[0]["rank"] == 0);
    assert_eq!(json["answers"].as_array().unwrap().len(), 3, "{}", json["answers"]);
    let csv = fs::read_to_string(folder.join("out/explain.csv")).unwrap();
    let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines.len(), changes.len() + 1);
    let files = include_str!("../../../docs/files.md");
    for column in &lines[0][..lines[0].len() - 1] {
        assert!(files.contains(&format!("`{column}`")), "docs/files.md lacks {column}");
    }
    for (line, change) in lines[1..].iter().zip(changes) {
        assert_eq!(line.len(), lines[0].len());
        for (name, cell) in lines[0].iter().zip(line) {
            match &change[*name] {
                serde_json::Value::Number(number) => {
                    assert_eq!(number.as_f64().unwrap(), cell.parse::<f64>().unwrap(), "{name}");
                }
                serde_json::Value::String(text) => assert_eq!(text.replace(',', ";"), **cell),
                serde_json::Value::Null if *name != "schema_version" => assert_eq!(**cell, *""),
                _ => {}
            }
        }
    }
    for file in ["boundary.csv", "explain.svg", "explain.png", "report.html", "manifest.json"] {
        assert!(folder.join("out").join(file).exists(), "{file}");
    }
}

#[test]
fn what_it_cannot_do_is_refused_in_one_line() {
    let folder = folder();
    for (args, wanted) in [
        (&["--damping", "1e9"][..], "--damping is 1000000000, allowed 60 to 460"),
        (&["--numeric", "f64"], "explain runs the fixed-point core only"),
        (&["--repeat", "1"], "--repeat"),
    ] {
        let output = sim(folder.path(), &[&["explain", "coarse.toml"][..], args].concat());
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), line.trim_end().lines().count()), (Some(2), 1), "{line}");
        assert!(line.contains(wanted), "{line}");
    }
}
