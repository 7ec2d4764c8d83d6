//! Walls that a walk or a hit cannot judge, and the messages about them.

use std::fs;

use tempfile::TempDir;

use crate::cli::{SCENE, hit, refused, scene, sim};

#[test]
fn a_walk_whose_first_point_is_unstable_or_without_contact_says_so() {
    let folder = scene("damping_start_n_s_per_m = 10", "damping_start_n_s_per_m = 3000");
    let line = refused(folder.path(), &["walk", "mine.toml", "--cutoff", "50", "--csv", "w.csv"]);
    assert!(line.contains("first point") && line.contains("unstable"), "{line}");
    // the device's spring stops the handle before the wall
    let folder = scene("push_n = 2.835", "push_n = 0.1");
    let line = refused(folder.path(), &["walk", "mine.toml", "--cutoff", "500"]);
    assert!(line.contains("no_contact"), "{line}");
    let line = refused(folder.path(), &["sweep", "mine.toml"]);
    assert!(line.contains("no_contact"), "{line}");
    let output = sim(
        folder.path(),
        &[
            "hit",
            "mine.toml",
            "--cutoff",
            "500",
            "--stiffness",
            "2000",
            "--damping",
            "10",
            "--json",
        ],
    );
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (json["verdict"].as_str(), json["stable"].as_bool()),
        (Some("no_contact"), Some(false))
    );
    assert_eq!(json["peak_penetration_m"], 0.0);
}

#[test]
fn a_wall_that_still_settles_is_no_unstable_wall() {
    // the device is heavy and slow, so it is not yet at rest after 4 s in a stable wall
    let folder = scene("mass_kg = 0.4160", "mass_kg = 10.0");
    let line = refused(folder.path(), &["walk", "mine.toml", "--cutoff", "500"]);
    assert!(line.contains("still settles") && line.contains("wall_hit.settle_s"), "{line}");
    let enough = line.rsplit("settle_s, ").next().unwrap().split(' ').next().unwrap();
    let args = ["sweep", "mine.toml", "--cutoffs", "500", "--repeat", "1"];
    let output = sim(folder.path(), &args);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("no stable wall") && text.contains("still settles"), "{text}");
    // the suggested remedy works
    let file = folder.path().join("mine.toml");
    let patient = fs::read_to_string(&file).unwrap();
    fs::write(&file, patient.replace("settle_s = 4.0", &format!("settle_s = {enough}.0"))).unwrap();
    let wall = ["hit", "mine.toml", "--cutoff", "500", "--stiffness", "2000", "--damping", "10"];
    let text = String::from_utf8(sim(folder.path(), &wall).stdout).unwrap();
    assert!(text.contains("mine: stable"), "{text}");
}

#[test]
fn a_handle_that_bounces_away_for_the_whole_window_is_told_from_one_that_never_arrives() {
    let folder = scene("settle_s = 4.0", "settle_s = 0.45");
    let file = folder.path().join("mine.toml");
    let text = fs::read_to_string(&file).unwrap();
    let text = text.replace("window_s = 2.0", "window_s = 0.01");
    let text = text.replace("stiffness_start_n_per_m = 2000", "stiffness_start_n_per_m = 20000");
    fs::write(&file, text).unwrap();
    let line = refused(folder.path(), &["walk", "mine.toml", "--cutoff", "500"]);
    assert!(line.contains("no_contact") && line.contains("bounces"), "{line}");
    assert!(line.contains("wall_hit.window_s"), "{line}");
}

#[test]
fn a_start_inside_the_wall_is_refused() {
    let folder = scene("start_position_m = 0.0", "start_position_m = 0.0701");
    let args = hit("mine.toml", &[]);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let line = refused(folder.path(), &args);
    assert!(line.contains("device.start_position_m is 0.0701, allowed -1000 to 0.07"), "{line}");
    let args = hit("paper-1um", &["--start-offset", "70001"]);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let line = refused(folder.path(), &args);
    assert!(line.contains("--start-offset is 70001, allowed -1000000 to 70000"), "{line}");
}

#[test]
fn a_velocity_beyond_its_range_is_refused_or_reported() {
    // at 10 nm and 1 kHz the largest velocity is 0.33 m/s, but the push gives 0.49 m/s
    let text = SCENE
        .replace("resolution_m = 1e-6", "resolution_m = 1e-8")
        .replace("rate_hz = 10000", "rate_hz = 1000")
        .replace("period = 10", "period = 1")
        .replace("latency = 10.0", "latency = 1.0")
        .replace("500, 1000, 1200, 1500, 1700, 2000, 2500, 3000, 4000]", "]");
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("fine.toml"), &text).unwrap();
    let line = refused(folder.path(), &["walk", "fine.toml", "--cutoff", "100"]);
    assert!(
        line.contains("more than 0.328 m/s") && line.contains("encoder.resolution_m"),
        "{line}"
    );
    // the handle is slow enough from the scene's start position, but too fast from a start 10 mm before it
    let slower = text.replace("push_n = 2.835", "push_n = 1.65");
    fs::write(folder.path().join("fine.toml"), slower).unwrap();
    let wall =
        ["--cutoff", "50", "--stiffness", "2000", "--damping", "5", "--start-offset", "-1e6"];
    let output = sim(folder.path(), &[&["hit", "fine.toml", "--json"], &wall[..]].concat());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(json["velocity_clipped_fraction"].as_f64().unwrap() > 0.0, "{json}");
    let output = sim(folder.path(), &[&["hit", "fine.toml"], &wall[..]].concat());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("velocity at the end of its range in"), "{text}");
}
