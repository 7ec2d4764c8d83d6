//! Tests `identify` on the command line: how a log becomes a scene for the other commands, and which errors occur.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
    time::Instant,
};

use host_sim::{
    analysis::identify::Record,
    plant::{Plant as _, PlantStep},
    scene::{Device, NamedScene},
};
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use tempfile::TempDir;

use crate::page;

/// Longest time that may pass from a log to a scene, in s. 0.2 s were measured.
const LONGEST_S: f64 = 2.0;

fn sim(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).current_dir(folder).args(args).output().unwrap()
}

#[track_caller]
fn done(folder: &Path, args: &[&str]) -> String {
    let output = sim(folder, args);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{args:?}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

#[track_caller]
fn refused(folder: &Path, args: &[&str], wanted: &str) {
    let before = fs::read_dir(folder).unwrap().count();
    let output = sim(folder, args);
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {line}");
    assert_eq!(line.trim_end().lines().count(), 1, "{args:?}: {line}");
    assert!(line.starts_with("error: ") && line.contains(wanted), "{args:?}: {line}");
    assert!(output.stdout.is_empty());
    assert_eq!(fs::read_dir(folder).unwrap().count(), before, "{args:?} left something behind");
}

fn log(added_kg: f64) -> String {
    log_of(added_kg, 20_000)
}

/// A log of two pulses on the paper's device, whose mass is larger by `added_kg`. The noise is about half a count.
pub fn log_of(added_kg: f64, rows: usize) -> String {
    let device = NamedScene::load("paper-1um").unwrap().scene.device;
    let device = Device { mass_kg: device.mass_kg + added_kg, ..device };
    let plant = PlantStep::new(&device, 1e-4, 0.0);
    let mut state = plant.at_rest(0.3e-6);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    let command: Vec<f64> = (0..rows)
        .map(|row| match row {
            1000..3000 => 4.0,
            3000..5000 => -4.0,
            _ => 0.0,
        })
        .collect();
    let positions = (0..rows).map(|row| {
        let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let count = (plant.position_m(&state) / 1e-6 + 0.5 * normal).floor();
        let late = row.checked_sub(10).map_or(0.0, |row| command[row]);
        state = plant.advance(&state, 0.5906 * late);
        count * 1e-6
    });
    let position_m = positions.collect();
    let (name, start_s, step_s) = ("log".into(), 0.0, 1e-4);
    Record { name, start_s, step_s, command, position_m, drive: Default::default(), may_clip: true }
        .csv()
}

fn folder() -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("log.csv"), log(0.0)).unwrap();
    folder
}

#[test]
fn positions_in_mm_are_named_as_the_likely_cause() {
    let folder = folder();
    let folder = folder.path();
    let in_mm = |factor: f64, name: &str| {
        let text = fs::read_to_string(folder.join("log.csv")).unwrap();
        let mut lines = text.lines();
        let header = lines.next().unwrap().to_owned();
        let place = header.split(',').position(|column| column == "position_m").unwrap();
        let rows = lines.map(|line| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            cells[place] = format!("{:.6}", cells[place].parse::<f64>().unwrap() * factor);
            cells.join(",")
        });
        let rows: Vec<String> = [header].into_iter().chain(rows).collect();
        fs::write(folder.join(name), rows.join("\n")).unwrap();
    };
    in_mm(1000.0, "mm.csv");
    let args = ["identify", "--base", "paper-1um", "mm.csv", "--gain", "0.5906"];
    refused(folder, &args, "are these mm?");
    // without counts, only an implausible travel or mass shows that a unit is wrong
    refused(
        folder,
        &[&args[..], &["--resolution", "0"]].concat(),
        "allowed 5 m; position_m is in m",
    );
    in_mm(600.0, "small.csv");
    let args = [
        "identify",
        "--base",
        "paper-1um",
        "small.csv",
        "--gain",
        "0.0005906",
        "--resolution",
        "0",
    ];
    refused(folder, &args, "are these mm?");
}

/// Writes the log again with another header and in other units.
fn with_header(folder: &Path, header: &str, [time, command, position]: [f64; 3]) {
    let text = fs::read_to_string(folder.join("log.csv")).unwrap();
    let rows = text.lines().skip(1).map(|line| {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        format!("{},{},{:.4}", cells[0] * time, cells[1] * command, cells[2] * position)
    });
    let lines: Vec<String> = [header.to_owned()].into_iter().chain(rows).collect();
    fs::write(folder.join("other.csv"), lines.join("\n")).unwrap();
}

#[test]
fn a_force_or_a_current_identifies_as_the_voltage_does() {
    let folder = folder();
    let folder = folder.path();
    let found = |args: &[&str]| -> serde_json::Value {
        let args = [args, &["--json", "--latency", "10"]].concat();
        serde_json::from_str(&done(folder, &args)).unwrap()
    };
    let voltage = found(&["identify", "--base", "paper-1um", "log.csv", "--gain", "0.5906"]);
    let gain = NamedScene::load("paper-1um").unwrap().scene.actuator.gain_n_per_v;
    let same = |json: &serde_json::Value| {
        for key in ["mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "rest_position_m"] {
            let [is, wanted] = [json, &voltage].map(|json| json[key]["value"].as_f64().unwrap());
            assert!((is / wanted - 1.0).abs() < 1e-6, "{key}: {is}, with a voltage {wanted}");
        }
        assert_eq!(json["scene"]["actuator"]["gain_n_per_v"], gain, "the base scene's");
    };
    with_header(folder, "Time (ms);Force (mN);Position (mm)", [1e3, 590.6, 1e3]);
    let text = fs::read_to_string(folder.join("other.csv")).unwrap();
    fs::write(folder.join("other.csv"), text.replace(',', ";")).unwrap();
    let force = found(&["identify", "--base", "paper-1um", "other.csv"]);
    same(&force);
    assert_eq!((&force["drive"], &force["gain_source"]), (&"force".into(), &"force".into()));
    assert!(force["gain_n_per_v"].is_null() && force.get("gain_n_per_a").is_none());
    refused(
        folder,
        &["identify", "--base", "paper-1um", "other.csv", "--gain", "1"],
        "the log has the force itself",
    );
    with_header(folder, "t/s,current_mA,encoder_ticks", [1.0, 1e3, 1e6]);
    let current = found(&["identify", "--base", "paper-1um", "other.csv", "--gain", "0.5906"]);
    same(&current);
    assert_eq!(current["gain_n_per_a"]["value"], 0.5906);
    let by_motor = ["--torque-constant", "0.01", "--drum-radius", "0.02"];
    let by_motor =
        found(&[&["identify", "--base", "paper-1um", "other.csv"], &by_motor[..]].concat());
    assert_eq!(by_motor["gain_n_per_a"]["value"], 0.5);
    refused(
        folder,
        &["identify", "--base", "paper-1um", "other.csv"],
        "the force per ampere is not given",
    );
    let both = ["identify", "--base", "paper-1um", "log.csv", "other.csv", "--gain", "1"];
    refused(folder, &both, "log.csv has a voltage and other.csv a current");
}

#[test]
fn a_latency_is_in_rows_of_the_log() {
    let folder = folder();
    let folder = folder.path();
    let text = fs::read_to_string(folder.join("log.csv")).unwrap();
    let tenth = text.lines().enumerate().filter(|(row, _)| *row == 0 || row % 10 == 1);
    let tenth: Vec<&str> = tenth.map(|(_, line)| line).collect();
    fs::write(folder.join("tenth.csv"), tenth.join("\n")).unwrap();
    let args = [
        "identify",
        "--base",
        "paper-1um",
        "tenth.csv",
        "--gain",
        "0.5906",
        "--latency",
        "1",
        "--json",
    ];
    let json: serde_json::Value = serde_json::from_str(&done(folder, &args)).unwrap();
    assert_eq!(json["latency_s"]["value"], json["step_s"]);
}

#[test]
fn a_log_becomes_a_scene_that_the_other_commands_take() {
    let folder = folder();
    let folder = folder.path();
    let start = Instant::now();
    let args = [
        "identify",
        "--base",
        "paper-1um",
        "log.csv",
        "--gain",
        "0.5906",
        "--out",
        "mine.toml",
        "--json",
    ];
    let mut json: serde_json::Value = serde_json::from_str(&done(folder, &args)).unwrap();
    let took_s = start.elapsed().as_secs_f64();
    println!("from CSV to scene in {took_s:.2} s");
    assert!(took_s < LONGEST_S);
    let scene = json["scene"].take(); // docs/scenes.md has these keys
    page::has_keys_of("## `identify LOG", &json);
    json["scene"] = scene;
    assert_eq!((&json["schema_version"], &json["command"]), (&2.into(), &"identify".into()));
    let paper = NamedScene::load("paper-1um").unwrap().scene;
    for (key, truth) in [
        ("mass_kg", paper.device.mass_kg),
        ("damping_n_s_per_m", paper.device.damping_n_s_per_m),
        ("stiffness_n_per_m", paper.device.stiffness_n_per_m),
        ("rest_position_m", paper.device.rest_position_m),
    ] {
        let [value, low, high] =
            ["value", "low", "high"].map(|part| json[key][part].as_f64().unwrap());
        assert!(low < value && value < high && (value / truth - 1.0).abs() < 1e-4, "{key}");
    }
    let text = fs::read_to_string(folder.join("mine.toml")).unwrap();
    let scene = NamedScene::parse("mine".into(), text.clone(), "mine.toml").unwrap().scene;
    assert_eq!(scene.device.mass_kg, json["mass_kg"]["value"].as_f64().unwrap());
    let mut same = scene.clone();
    let sure = same.uncertainty.take().unwrap();
    // the half width of a 95 % interval is 1.96 standard deviations
    let half = json["mass_kg"]["high"].as_f64().unwrap() - scene.device.mass_kg;
    assert!((half / sure.mass_kg / 1.959_964 - 1.0).abs() < 1e-4, "{half} {}", sure.mass_kg);
    assert!(sure.gain_n_per_v == 0.0 && sure.latency == 0.0, "they were given");
    assert_eq!(sure.correlations.len(), 6);
    same.device = paper.device;
    assert_eq!(same, paper, "something else than the device changed");
    assert!(
        text.starts_with("# Identified by `cargo sim identify` from log.csv.\n# mass "),
        "{text}"
    );
    let wall = ["--cutoff", "500", "--stiffness", "4000", "--damping", "20"];
    assert!(done(folder, &[&["hit", "mine.toml"], &wall[..]].concat()).contains("stable"));
}

#[test]
fn figure_and_table_of_the_fit_are_written() {
    let folder = folder();
    let args = [
        "identify",
        "--base",
        "paper-1um",
        "log.csv",
        "--gain",
        "0.5906",
        "--plot",
        "fit.png",
        "--csv",
        "fit.csv",
    ];
    let text = done(folder.path(), &args);
    assert!(text.contains("mass           0.4160") && text.contains("; white"), "{text}");
    assert!(fs::read(folder.path().join("fit.png")).unwrap().len() > 10_000);
    let csv = fs::read_to_string(folder.path().join("fit.csv")).unwrap();
    assert!(csv.starts_with("time_s,voltage_v,position_m,model_m,residual_m\n0.0010000,0,"));
    assert_eq!(csv.lines().count(), 1 + 20_000 - 10);
    let row: Vec<f64> =
        csv.lines().nth(7000).unwrap().split(',').map(|v| v.parse().unwrap()).collect();
    assert!((row[2] + 0.5e-6 - row[3] - row[4]).abs() < 2e-9, "{row:?}");
    refused(folder.path(), &args, "is there already; --force replaces it");
}

#[test]
fn the_gain_comes_from_motor_weight_or_added_mass() {
    let folder = folder();
    let folder = folder.path();
    fs::write(folder.join("heavy.csv"), log(0.15)).unwrap();
    let gain = |args: &[&str]| -> f64 {
        let args = [&["identify", "--base", "paper-1um", "log.csv", "--json"], args].concat();
        let json: serde_json::Value = serde_json::from_str(&done(folder, &args)).unwrap();
        let (gain, mass) = (&json["gain_n_per_v"]["value"], &json["mass_kg"]["value"]);
        let ratio = mass.as_f64().unwrap() / gain.as_f64().unwrap();
        assert!((ratio / (0.4160 / 0.5906) - 1.0).abs() < 1e-4, "{ratio}");
        gain.as_f64().unwrap()
    };
    let motor = ["--torque-constant", "0.0196", "--amplifier-gain", "0.3", "--drum-radius", "0.01"];
    assert!((gain(&motor) - 0.588).abs() < 1e-12);
    let weight = ["--calibration-mass", "0.2", "--calibration-voltage", "-3.32"];
    assert!((gain(&weight) - 0.2 * 9.80665 / 3.32).abs() < 1e-12);
    assert!((gain(&["heavy.csv", "--added-mass", "0.15"]) - 0.5906).abs() < 1e-4);
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let folder = folder();
    let folder = folder.path();
    fs::write(folder.join("broken.csv"), log(0.0).replace("0.5000000,", "x,")).unwrap();
    fs::write(folder.join("binary"), [0xff, 0, 1, 2]).unwrap();
    fs::write(folder.join("empty.csv"), "").unwrap();
    let gain = ["--gain", "0.5906"];
    let with = |log: &'static str, more: &[&'static str]| {
        [&["identify", "--base", "paper-1um", log], more].concat()
    };
    for (args, wanted) in [
        (with("log.csv", &[]), "the force per volt is not given"),
        (with("none.csv", &gain), "none.csv cannot be read"),
        (
            with("broken.csv", &gain),
            "broken.csv: line 5002: time_s is `x`, allowed any finite number",
        ),
        (
            with("binary", &gain),
            "binary: not UTF-8, byte 1: UTF-16?; no telemetry: no frame of layout",
        ),
        (with("empty.csv", &gain), "empty.csv: the file is empty"),
        (with("log.csv", &["--gain", "nan"]), "--gain is NaN, allowed 0.000001 to 1000000"),
        (with("log.csv", &["--gain", "0"]), "--gain is 0, allowed"),
        (with("log.csv", &["--gain", "1", "--added-mass", "1"]), "cannot be used with"),
        (with("log.csv", &["--torque-constant", "1"]), "--drum-radius <M>"),
        (with("log.csv", &["--drum-radius", "1"]), "--torque-constant"),
        (with("log.csv", &["--calibration-mass", "1"]), "--calibration-voltage <V>"),
        (with("log.csv", &["--added-mass", "0.1"]), "--added-mass needs two records, not 1"),
        (with("log.csv", &["log.csv", "--added-mass", "0.1"]), "does not show more mass"),
        (
            with("log.csv", &["--gain", "1", "--latency", "-1"]),
            "--latency is -1, allowed 0 to 1000 rows",
        ),
        (with("log.csv", &["--gain", "1", "--resolution", "1"]), "--resolution is 1, allowed"),
        (
            with("log.csv", &["--gain", "0.5N/V"]),
            "'0.5N/V' for '--gain <N_PER_V>': it has to be a number, without a unit",
        ),
        (
            with("log.csv", &["--gain", "1", "--from", "0.9", "--to", "0.1"]),
            "no row of data between --from and --to, allowed 0 to ",
        ),
        (with("log.csv", &["--gain", "1", "--from", "1.7e9"]), "no row of data between --from and"),
        (
            with("log.csv", &["--gain", "1", "--from", "nan"]),
            "--from is NaN, allowed any finite number of s",
        ),
        (with("log.csv", &["--gain", "1", "--from", "1.0"]), "no excitation"),
        (vec!["identify", "log.csv", "--gain", "1", "--base", "none"], "none cannot be read: "),
        (
            with("log.csv", &["--gain", "1", "--plot", "fit.pdf"]),
            "allowed endings are .svg and .png",
        ),
        (
            with("log.csv", &["--gain", "0.1", "--out", "s.toml"]),
            "wall_hit.push_n is 2.835, allowed -1 to 1",
        ),
        (vec!["identify"], "required arguments"),
    ] {
        refused(folder, &args, wanted);
    }
}

#[test]
fn terms_are_asked_for_by_name_and_become_elements() {
    let folder = folder();
    let folder = folder.path();
    let plain = ["identify", "--base", "paper-1um", "log.csv", "--gain", "0.5906", "--json"];
    let automatic = done(folder, &plain);
    assert_eq!(done(folder, &[&plain[..], &["--terms", "none"]].concat()), automatic);
    assert!(!automatic.contains("\"terms\""));
    refused(folder, &[&plain[..6], &["--offset"]].concat(), "give --rest-position");
    refused(folder, &[&plain[..6], &["--friction", "--terms", "none"]].concat(), "--terms");
    refused(folder, &[&plain[..6], &["--encoder-cycle", "2"]].concat(), "--encoder-cycle is 2");
    // the option moves the spring's rest position by 1 mm, so the fit must find a constant force that balances the
    // spring
    let asked = [&plain[..], &["--rest-position", "0.0507", "--out", "pushed.toml"]].concat();
    let json: serde_json::Value = serde_json::from_str(&done(folder, &asked)).unwrap();
    let force_n = json["terms"]["offset_n"]["value"].as_f64().unwrap();
    assert!((force_n - 11.0626e-3).abs() < 1e-4, "{force_n}");
    assert_eq!(json["terms"]["tests"][0]["term"], "offset");
    assert_eq!(json["scene"]["offset"]["force_n"], force_n);
    assert_eq!(json["scene"]["device"]["rest_position_m"], 0.0507);
    done(
        folder,
        &["hit", "pushed.toml", "--cutoff", "1500", "--stiffness", "2e4", "--damping", "50"],
    );
}

#[test]
fn a_plan_is_what_the_console_takes() {
    let folder = TempDir::new().unwrap();
    let args = ["identify", "--plan", "--base", "nucleo-f446re", "--json"];
    let json: serde_json::Value = serde_json::from_str(&done(folder.path(), &args)).unwrap();
    let lines: Vec<&str> =
        json["console"].as_array().unwrap().iter().map(|line| line.as_str().unwrap()).collect();
    assert_eq!(lines.iter().filter(|line| line.starts_with("pulses ")).count(), 1);
    for line in &lines {
        let known = line.starts_with("wait ") || zwidth::console::parse(line.as_bytes()).is_ok();
        assert!(known, "{line}");
    }
    assert!(json["guessed"].as_array().unwrap().is_empty());
    let text = done(folder.path(), &args[..4]);
    assert!(
        text.contains(
            "# zero: with the handle at the scene's position 0; its spring rests at 0.0517"
        ),
        "{text}"
    );
    assert!(!text.contains("hardly moves"), "{text}");
    let held = done(folder.path(), &["identify", "--plan", "--base", "epfl-paddle"]);
    assert!(held.contains("hardly moves the handle, friction holds it"), "{held}");
    let bare = done(folder.path(), &["identify", "--plan", "--base", "paper-1um"]);
    assert!(bare.contains("# guessed, not in the scene: safety.travel_low_m"), "{bare}");
    refused(folder.path(), &["identify", "--plan", "log.csv"], "--plan");
    refused(folder.path(), &["identify"], "LOG");
}

/// Without a base scene, nothing of one is assumed.
#[test]
fn a_log_without_a_base_scene_gives_its_own_count_and_needs_the_latency() {
    let folder = folder();
    let folder = folder.path();
    let found = |args: &[&str]| -> serde_json::Value {
        let args = [&["identify", "log.csv", "--gain", "0.5906", "--json"], args].concat();
        serde_json::from_str(&done(folder, &args)).unwrap()
    };
    let without = found(&["--latency", "10"]);
    let based = found(&["--base", "paper-1um"]);
    for key in ["mass_kg", "latency_s", "residual"] {
        assert_eq!(without[key], based[key], "{key}");
    }
    let log = ["identify", "log.csv", "--gain", "0.5906"];
    refused(
        folder,
        &log,
        "give --latency (0 if it acts at the time of its row), --fit-latency, or",
    );
    with_header(folder, "t/s,voltage_V,encoder_ticks", [1.0, 1.0, 1e6]);
    let counts = ["identify", "other.csv", "--gain", "0.5906", "--latency", "10"];
    refused(folder, &counts, "needs the size of a count: give it as --resolution, or");
    fs::write(folder.join("capture.bin"), [0xff; 64]).unwrap();
    let capture = ["identify", "capture.bin", "--gain", "0.5906", "--latency", "0"];
    refused(folder, &capture, "give the scene of its device as --base");
}

#[test]
fn another_record_is_predicted() {
    let folder = folder();
    let folder = folder.path();
    let args = ["identify", "log.csv", "--base", "paper-1um", "--gain", "0.5906"];
    let with = |more: &[&'static str]| [&args[..], more].concat();
    let text = done(folder, &with(&["--check", "log.csv"]));
    let json = done(folder, &with(&["--check", "log.csv", "--json"]));
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let [check, fitted] = [&json["check"], &json["residual"]];
    let [rms_m, fitted_m] = [check, fitted].map(|one| one["rms_m"].as_f64().unwrap());
    assert!((rms_m / fitted_m - 1.0).abs() < 1e-3, "{rms_m} {fitted_m}");
    assert_eq!((&check["log"], &check["rows"]), (&"log.csv".into(), &json["rows"]));
    assert!(text.contains("check log.csv: ") && text.contains("prediction off by "), "{text}");
    with_header(folder, "t/s,force_N,encoder_ticks", [1.0, 0.5906, 1e6]);
    refused(folder, &with(&["--check", "other.csv"]), "other.csv has a force, needed a voltage");
}
