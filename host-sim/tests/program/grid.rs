//! Tests the command `grid`, and how much memory it needs for a million walls.

use std::{fs, path::Path, process::Command};

use crate::page;

fn sim() -> Command {
    Command::new(env!("CARGO_BIN_EXE_host-sim"))
}

/// The paper's device. Settling time and window of a hit are both `ms` milliseconds long.
fn scene(folder: &Path, ms: u32) -> String {
    let text = include_str!("../../../scenes/paper-1um.toml")
        .lines()
        .map(|line| match line.split_whitespace().next() {
            Some("settle_s" | "window_s") => {
                let key = line.split_whitespace().next().unwrap();
                format!("{key} = {}\n", f64::from(ms) * 1e-3)
            }
            Some("start_position_m") => "start_position_m = 0.0695\n".into(),
            _ => format!("{line}\n"),
        })
        .collect::<String>();
    let path = folder.join("short.toml");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().into()
}

#[test]
fn rows_are_what_hit_says_and_do_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path(), 200);
    let mut texts = vec![];
    for threads in ["1", "3"] {
        let csv = folder.path().join(threads);
        let done = sim()
            .args(["grid", &scene, "--cutoffs", "200,1500", "--stiffnesses", "2000:30000:92000"])
            .args(["--dampings", "10,300", "--json", "--threads", threads, "--csv"])
            .arg(&csv)
            .output()
            .unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let json: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
        page::has_keys_of("## `grid SCENE", &json);
        assert_eq!(json["points"], 16);
        let all = ["stable", "unstable", "no_contact", "out_of_range"];
        assert_eq!(all.iter().map(|key| json[key].as_u64().unwrap()).sum::<u64>(), 16);
        texts.push(fs::read_to_string(&csv).unwrap());
    }
    assert_eq!(texts[0], texts[1]);
    let rows: Vec<Vec<&str>> = texts[0].lines().map(|row| row.split(',').collect()).collect();
    assert_eq!(
        rows[0],
        ["cutoff_hz", "damping_n_s_per_m", "stiffness_n_per_m", "verdict", "rms_m"]
    );
    assert_eq!(rows.len(), 17);
    assert_eq!(rows[16][..3], ["1500", "300", "92000"]);
    for row in [&rows[1], &rows[8], &rows[16]] {
        let hit = sim()
            .args(["hit", &scene, "--json", "--cutoff", row[0], "--damping", row[1]])
            .args(["--stiffness", row[2]])
            .output()
            .unwrap();
        let json: serde_json::Value = serde_json::from_slice(&hit.stdout).unwrap();
        assert_eq!(json["verdict"], row[3]);
        assert_eq!(json["rms_m"].as_f64().unwrap(), row[4].parse::<f64>().unwrap());
    }
}

#[test]
fn bad_input_is_one_line_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("map.csv");
    for (list, named) in [
        (["1e9", "2000", "10"], "--cutoffs is 1000000000, allowed 0.35 to 4990"),
        (["1500", "-1", "10"], "--stiffnesses is -1, allowed 0 to"),
        (["1500", "2000", "1e7"], "--dampings is 10000000, allowed 0 to"),
    ] {
        let done = sim()
            .args(["grid", "paper-1um", "--cutoffs", list[0], "--stiffnesses", list[1]])
            .args(["--dampings", list[2], "--csv"])
            .arg(&csv)
            .output()
            .unwrap();
        let text = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(2), "{text}");
        assert!(text.contains(named) && text.lines().count() == 1, "{text}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

/// The engine streams the points, so a million points may use at most 300 MB.
#[cfg(target_os = "linux")]
#[test]
fn a_million_walls_take_less_than_300_mb() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path(), 20);
    let csv = folder.path().join("map.csv");
    let mut child = sim()
        .args(["grid", &scene, "--cutoffs", "50:41:4109", "--stiffnesses", "1000:1000:100000"])
        .args(["--dampings", "5:5:500", "--csv"])
        .arg(&csv)
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak_kb = 0;
    while child.try_wait().unwrap().is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kb = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok());
        peak_kb = peak_kb.max(kb.unwrap_or(0));
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let rows = fs::read_to_string(&csv).unwrap().lines().count();
    println!("{rows} rows, at most {} MB", peak_kb / 1024);
    assert_eq!(rows, 1_000_001);
    assert!(peak_kb > 1000, "it was measured");
    assert!(peak_kb < 300 * 1024, "{peak_kb} kB");
}
