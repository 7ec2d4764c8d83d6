//! `--engine core` and `--engine lanes` must give the same bytes for all commands that run hits.

use std::{fs, path::Path, process::Command};

use tempfile::TempDir;

/// The paper's device with short hits, and with few walls in a walk.
fn scene(folder: &Path) {
    let text = include_str!("../../../scenes/paper-2um.toml")
        .replace("settle_s = 4.0", "settle_s = 1.5")
        .replace("window_s = 2.0", "window_s = 0.5")
        .replace("stiffness_step_n_per_m = 2000", "stiffness_step_n_per_m = 8000")
        .replace("damping_step_n_s_per_m = 10", "damping_step_n_s_per_m = 60");
    fs::write(folder.join("short.toml"), text).unwrap();
}

/// Runs a command with both engines, and compares the bytes of output and files. The word `FILE` in the arguments
/// becomes a separate file or folder for each engine.
fn both(folder: &Path, command: &str, files: &[&str]) {
    let [core, lanes] = ["core", "lanes"].map(|engine| {
        let output = Command::new(env!("CARGO_BIN_EXE_host-sim"))
            .current_dir(folder)
            .args(command.split_whitespace().map(|word| word.replace("FILE", engine)))
            .args(["--json", "--engine", engine])
            .output()
            .unwrap();
        assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
        let of = |name: &str| {
            let bytes = fs::read(folder.join(name.replace("FILE", engine))).unwrap();
            assert!(bytes.len() > 100, "{command}: {name} is empty");
            bytes
        };
        (
            String::from_utf8(output.stdout).unwrap(),
            files.iter().map(|name| of(name)).collect::<Vec<_>>(),
        )
    });
    assert!(core.1 == lanes.1, "{command}: the files differ");
    assert_eq!(core.0, lanes.0, "{command}");
}

#[test]
fn both_engines_give_the_same_bytes() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    scene(folder);
    both(folder, "walk short.toml --cutoff 1500 --csv FILE.walk", &["FILE.walk"]);
    both(folder, "walk short.toml --cutoff 400 --numeric f64 --csv FILE.twin", &["FILE.twin"]);
    let grid =
        "grid short.toml --cutoffs 200,1500 --stiffnesses 2000:30000:92000 --dampings 10,300";
    both(folder, &format!("{grid} --csv FILE.grid"), &["FILE.grid"]);
    let csv = ["FILE/boundary.csv", "FILE/areas.csv", "FILE/envelope.csv"];
    both(folder, "sweep short.toml --cutoffs 200,1500 --repeat 2 --out FILE", &csv);
    let csv = ["FILE.c/compare.csv", "FILE.c/tuning.csv", "FILE.c/boundary.csv"];
    let compare = "compare short.toml --estimators butterworth,difference --budget 3 --repeat 1";
    both(folder, &format!("{compare} --out FILE.c"), &csv);
}

#[test]
fn an_engine_that_there_is_not_is_refused() {
    let output = Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .args(["walk", "paper-1um", "--cutoff", "1500", "--engine", "scalar"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let line = String::from_utf8(output.stderr).unwrap();
    assert!(line.contains("core, lanes") && line.trim().lines().count() == 1, "{line}");
}
