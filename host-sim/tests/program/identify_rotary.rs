//! `identify` with a rotary base scene. The results are compared with the linear scene of the same device.

use std::{fs, path::Path};

use serde_json::Value;
use tempfile::TempDir;

use crate::cli::{refused, sim};

/// Radius of the handle in m. The linear scene is `examples/known.toml`.
const RADIUS_M: f64 = 0.08;
const KNOWN: &str = include_str!("../../../examples/known.toml");
const PULSE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/pulse.bin");
/// Relative tolerance of the comparisons. It allows for results that have twelve digits.
const ROUNDING: f64 = 1e-10;

/// `known.toml` as a rotary scene with a ratio of 2. With `resistance_ohm` the scene has a voltage amplifier.
fn rotary(resistance_ohm: Option<f64>) -> String {
    let r = RADIUS_M;
    let known: toml::Table = KNOWN.parse().unwrap();
    let of = |table: &str, key: &str| known[table][key].as_float().unwrap();
    let torque_constant = of("actuator", "gain_n_per_v") * r / 2.0 * resistance_ohm.unwrap_or(1.0);
    let drive = match resistance_ohm {
        None => "drive = \"current\"\namplifier_a_per_v = 1.0".to_owned(),
        Some(ohm) => format!("drive = \"voltage\"\nresistance_ohm = {ohm:?}\nsupply_v = 10.0"),
    };
    let limit = if resistance_ohm.is_none() { "limit_v = 10.0\n" } else { "" };
    format!(
        "estimated = [\"rotary.handle_inertia_kg_m2\", \"rotary.motor_inertia_kg_m2\", \"rotary.damping_n_m_s_per_rad\"]\n\
         [rotary]\nhandle_radius_m = {r}\nratio = 2.0\ncounts_per_turn = {:?}\nencoder_on = \"handle\"\n\
         handle_inertia_kg_m2 = 0.003\nmotor_inertia_kg_m2 = 2e-5\ndamping_n_m_s_per_rad = 0.01\n\
         stiffness_n_m_per_rad = 0.05\nrest_angle_rad = 0.0\nstart_angle_rad = 0.0\n\
         torque_constant_n_m_per_a = {torque_constant:?}\n{drive}\n\
         [encoder]\nrounding = \"floor\"\n[actuator]\n{limit}period = 10\nlatency = 0.115\n\
         [control]\nrate_hz = 10000\n[velocity]\nestimator = \"butterworth\"\nprewarp = false\n\
         [wall]\nposition_rad = 0.375\npush_only = true\n\
         [wall_hit]\npush_n_m = 0.16\nsettle_s = 1.0\nwindow_s = 0.3\nrms_limit_rad = 1.875e-4\n\
         [walk]\nstiffness_start_n_m_per_rad = 12.8\nstiffness_step_n_m_per_rad = 25.6\nstiffness_max_n_m_per_rad = 6400.0\n\
         damping_start_n_m_s_per_rad = 0.128\ndamping_step_n_m_s_per_rad = 0.128\ndamping_max_n_m_s_per_rad = 0.384\n\
         [sweep]\ncutoffs_hz = [1500]\n[amplifier]\nbandwidth_hz = 1500\n[output]\nkind = \"dac\"\nbits = 12\n",
        2.0 * std::f64::consts::PI * r / of("encoder", "resolution_m"),
    )
}

const SPAN: [&str; 4] = ["--from", "0.061", "--to", "3.238"];

fn json(folder: &Path, args: &[&str]) -> Value {
    let output = sim(folder, &[args, &["--json"]].concat());
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn near(found: &Value, wanted: f64, what: &str) {
    let found = found.as_f64().unwrap_or_else(|| panic!("{what}: {found}"));
    assert!((found / wanted - 1.0).abs() < ROUNDING, "{what}: {found}, not {wanted}");
}

#[test]
fn a_rotary_scene_is_found_as_the_one_by_hand_and_written_in_its_keys() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("known.toml"), KNOWN).unwrap();
    fs::write(folder.path().join("paddle.toml"), rotary(None)).unwrap();
    let run = |base: &str, out: &str| {
        let words = ["identify", PULSE, "--base", base, "--out", out];
        json(
            folder.path(),
            &[&words[..], &SPAN, if base == "known.toml" { &["--gain", "0.5906"] } else { &[] }]
                .concat(),
        )
    };
    let (by_hand, turned) = (run("known.toml", "by-hand.toml"), run("paddle.toml", "found.toml"));
    let r = RADIUS_M;
    for (linear, rotary, factor) in [
        ("mass_kg", "inertia_kg_m2", r * r),
        ("damping_n_s_per_m", "damping_n_m_s_per_rad", r * r),
        ("stiffness_n_per_m", "stiffness_n_m_per_rad", r * r),
        ("rest_position_m", "rest_position_rad", 1.0 / r),
        ("gain_n_per_v", "gain_n_m_per_v", r),
    ] {
        for end in ["value", "low", "high"] {
            near(&turned[rotary][end], by_hand[linear][end].as_f64().unwrap() * factor, rotary);
        }
    }
    let friction = by_hand["terms"]["friction_n"]["value"].as_f64().unwrap();
    near(&turned["terms"]["friction_n_m"]["value"], friction * r, "friction");
    // The scene keeps its rotary keys, `estimated` does not list measured values, and the device is the same.
    let text = fs::read_to_string(folder.path().join("found.toml")).unwrap();
    let tables: toml::Table = text.parse().unwrap();
    assert_eq!(tables["estimated"].as_array().unwrap().len(), 1, "{text}");
    assert!(
        tables["friction"].get("coulomb_n_m").is_some() && !tables.contains_key("device"),
        "{text}"
    );
    let inertia = by_hand["mass_kg"]["value"].as_f64().unwrap() * r * r;
    let written = tables["rotary"]["handle_inertia_kg_m2"].as_float().unwrap();
    assert!((written + 4.0 * 2e-5 - inertia).abs() < 1e-9 * inertia, "{text}");
    let hit = |scene: &str, [k, b]: [&str; 2]| {
        json(folder.path(), &["hit", scene, "--cutoff", "1500", "--stiffness", k, "--damping", b])
    };
    let (hand, turn) = (hit("by-hand.toml", ["20000", "40"]), hit("found.toml", ["128", "0.256"]));
    assert_eq!(hand["verdict"], turn["verdict"]);
    let peak = hand["peak_penetration_m"].as_f64().unwrap();
    assert!(peak > 0.0);
    near(&turn["peak_penetration_rad"], peak / r, "peak");
}

#[test]
fn a_column_of_angles_is_read_and_one_of_metres_is_refused() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("paddle.toml"), rotary(None)).unwrap();
    let words = ["identify", PULSE, "--base", "paddle.toml", "--csv", "fit.csv"];
    let found = json(folder.path(), &[&words[..], &SPAN].concat());
    // The CSV that `identify` writes is a valid record.
    let fit = fs::read_to_string(folder.path().join("fit.csv")).unwrap();
    assert!(fit.starts_with("time_s,voltage_v,position_rad,model_rad,residual_rad\n"), "{fit:.80}");
    let again = json(folder.path(), &["identify", "fit.csv", "--base", "paddle.toml"]);
    let inertia = |of: &Value| of["inertia_kg_m2"]["value"].as_f64().unwrap();
    assert!((inertia(&again) / inertia(&found) - 1.0).abs() < 1e-3, "{again}");
    fs::write(folder.path().join("metres.csv"), fit.replace("position_rad", "position_m")).unwrap();
    let line = refused(folder.path(), &["identify", "metres.csv", "--base", "paddle.toml"]);
    assert!(line.contains("no column position_rad"), "{line}");
}

#[test]
fn counts_per_turn_replace_those_of_the_base_scene() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let scene: toml::Table = rotary(None).parse().unwrap();
    let counts = scene["rotary"]["counts_per_turn"].as_float().unwrap();
    let mut other = scene.clone();
    other["rotary"]["counts_per_turn"] = 1000.0.into();
    fs::write(folder.join("paddle.toml"), scene.to_string()).unwrap();
    fs::write(folder.join("other.toml"), other.to_string()).unwrap();
    fs::write(folder.join("known.toml"), KNOWN).unwrap();
    let right = [&["identify", PULSE, "--base", "paddle.toml"][..], &SPAN].concat();
    let given = counts.to_string();
    let words = ["identify", PULSE, "--base", "other.toml", "--counts-per-turn", &given];
    let found = json(folder, &[&words[..], &["--out", "found.toml"], &SPAN].concat());
    let inertia = json(folder, &right)["inertia_kg_m2"]["value"].as_f64().unwrap();
    near(&found["inertia_kg_m2"]["value"], inertia, "inertia");
    let found = fs::read_to_string(folder.join("found.toml")).unwrap();
    let found: toml::Table = found.parse().unwrap();
    assert_eq!(found["rotary"]["counts_per_turn"].as_float(), Some(counts));
    for (base, counts, wanted) in [
        ("known.toml", "4000", "needs a rotary scene as --base"),
        ("paddle.toml", "0.5", "rotary.counts_per_turn is 0.5, allowed 1 to"),
    ] {
        let words = ["identify", PULSE, "--base", base, "--counts-per-turn", counts];
        let line = refused(folder, &words);
        assert!(line.contains(wanted), "{line}");
    }
}

/// Errors and warnings speak of angles. The messages name options and columns of a rotary scene.
#[test]
fn what_is_wrong_with_a_record_is_said_about_the_axis() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    fs::write(folder.join("paddle.toml"), rotary(None)).unwrap();
    let words = ["identify", PULSE, "--base", "paddle.toml", "--csv", "fit.csv"];
    json(folder, &[&words[..], &SPAN].concat());
    let fit = fs::read_to_string(folder.join("fit.csv")).unwrap();
    let mut lines = fit.lines();
    let header = lines.next().unwrap();
    let rows = lines.map(|line| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        cells[2] = (cells[2].parse::<f64>().unwrap() * 1e3).to_string();
        cells.join(",")
    });
    let rows: Vec<String> = [header.to_owned()].into_iter().chain(rows).collect();
    fs::write(folder.join("large.csv"), rows.join("\n")).unwrap();
    for (record, option, value, wanted) in [
        ("large.csv", "--resolution", "0", "position_rad is in rad: are"),
        (
            "fit.csv",
            "--resolution",
            "0.01",
            "counts of 0.573 deg from the first; give the encoder's --resolution in rad",
        ),
        (
            "fit.csv",
            "--rest-position",
            "1e9",
            "--rest-position is 1000000000, allowed -12500 to 12500 rad",
        ),
    ] {
        let args = ["identify", record, "--base", "paddle.toml", option, value];
        let line = refused(folder, &args);
        assert!(line.contains(wanted), "{line}");
    }
    // at its radius, the device has less than 5 g of mass
    let words = ["identify", "fit.csv", "--base", "paddle.toml", "--gain", "1e-4"];
    let found = json(folder, &[&words[..], &["--friction"]].concat());
    let warnings = found["warnings"].to_string();
    assert!(warnings.contains("kg m^2: is --gain in N m/V and position_rad in rad"), "{warnings}");
}

/// The damping that is found in a record includes the motor's back-EMF.
#[test]
fn back_emf_is_taken_off_the_damping_that_is_written_and_a_larger_one_is_told() {
    let folder = TempDir::new().unwrap();
    for (ohm, larger) in [(0.5, false), (50.0, true)] {
        fs::write(folder.path().join("paddle.toml"), rotary(Some(ohm))).unwrap();
        let words = ["identify", PULSE, "--base", "paddle.toml", "--out", "found.toml", "--force"];
        let output = sim(folder.path(), &[&words[..], &SPAN].concat());
        let told = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(told.contains("back-EMF"), larger, "{told}");
        let text = fs::read_to_string(folder.path().join("found.toml")).unwrap();
        let tables: toml::Table = text.parse().unwrap();
        let of = |key: &str| tables["rotary"][key].as_float().unwrap();
        let back_emf = (2.0 * of("torque_constant_n_m_per_a")).powi(2) / ohm;
        let found = json(
            folder.path(),
            &[&["identify", PULSE, "--base", "paddle.toml"][..], &SPAN].concat(),
        );
        let all = found["damping_n_m_s_per_rad"]["value"].as_f64().unwrap();
        let wanted = (all - back_emf).max(0.0);
        assert!((of("damping_n_m_s_per_rad") - wanted).abs() < 1e-9, "{text}");
        assert_eq!(larger, wanted == 0.0);
    }
}
