//! Tests the command `cargo sim telemetry`.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use tempfile::TempDir;
use zwidth::telemetry::{Frame, Record};

fn sim(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("it starts")
}

#[test]
fn a_capture_becomes_csv_and_one_json_object() {
    let folder = TempDir::new().unwrap();
    let mut bytes = b"noise".to_vec();
    for sequence in [4, 6] {
        let record = Record { sample: u64::from(sequence) * 10, ..Record::default() };
        bytes.extend(Frame { sequence, record }.encode());
    }
    fs::write(folder.path().join("capture.bin"), bytes).unwrap();
    let args = ["telemetry", "capture.bin", "--csv", "out.csv", "--json"];
    let output = sim(folder.path(), &args);
    assert!(output.status.success());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let of = |key: &str| json[key].as_u64().unwrap();
    assert_eq!((of("frames"), of("dropped"), of("garbage_bytes")), (2, 1, 5));
    assert_eq!((of("first_sample"), of("last_sample")), (40, 60));
    let csv = fs::read_to_string(folder.path().join("out.csv")).unwrap();
    assert_eq!(csv.lines().last(), Some("6,60,0,0,0,0,0,0,0"));
    // the figure has the units of the control core, or the units of a scene
    for more in [&["--plot", "a.svg"][..], &["--plot", "b.png", "--scene", "paper-1um"]] {
        let args = [&["telemetry", "capture.bin"][..], more].concat();
        assert!(sim(folder.path(), &args).status.success());
        assert!(fs::metadata(folder.path().join(more[1])).unwrap().len() > 1000);
    }
    let args_gif = ["telemetry", "capture.bin", "--plot", "c.gif"];
    assert_eq!(sim(folder.path(), &args_gif).status.code(), Some(2));
    // a second run does not replace the file
    assert_eq!(sim(folder.path(), &args).status.code(), Some(2));
}

#[test]
fn what_is_no_capture_is_bad_input() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("text"), "no telemetry here").unwrap();
    for (file, says) in [("text", "no telemetry frame"), ("missing", "cannot be read")] {
        let output = sim(folder.path(), &["telemetry", file, "--csv", "out.csv"]);
        assert_eq!(output.status.code(), Some(2));
        let line = String::from_utf8(output.stderr).unwrap();
        assert!(line.contains(file) && line.contains(says), "{line}");
    }
    assert!(!folder.path().join("out.csv").exists());
}

/// In a capture of the virtual board from `examples/`, every sample agrees with the core. If a bit is flipped, a frame
/// is lost or a velocity is changed, the command finds and names it. No other value changes.
#[test]
fn a_capture_of_every_sample_is_checked_and_what_is_wrong_with_it_is_named() {
    let folder = TempDir::new().unwrap();
    let whole = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/samples.bin")).unwrap();
    let run = |bytes: &[u8]| {
        fs::write(folder.path().join("c.bin"), bytes).unwrap();
        let args = ["telemetry", "c.bin", "--samples", "s.csv", "--json", "--force"];
        let output = sim(folder.path(), &args);
        assert!(output.status.success(), "{output:?}");
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let rows = fs::read_to_string(folder.path().join("s.csv")).unwrap();
        (json, rows.lines().skip(1).map(str::to_owned).collect::<Vec<_>>())
    };
    let (json, rows) = run(&whole);
    let of = |json: &serde_json::Value, key: &str| json[key].as_u64().unwrap();
    assert!(of(&json, "samples") > 20_000 && json["first_difference"].is_null(), "{json}");
    assert!(of(&json, "samples") - of(&json, "computed") < 1_000, "{json}");
    assert_eq!((of(&json, "dropped"), json["gaps"].as_array().unwrap().len()), (0, 0));
    assert!(of(&json, "states_equal") > 20 && of(&json, "forces_equal") > 500);
    assert!(json["unknown"].as_array().unwrap().is_empty());

    // All other values are unchanged.
    let subset = |other: &[String]| {
        let before: std::collections::HashMap<_, _> =
            rows.iter().map(|row| row.split_once(',').unwrap()).collect();
        other.iter().filter(|row| !row.contains(",,")).all(|row| {
            let (sample, rest) = row.split_once(',').unwrap();
            before.get(sample) == Some(&rest)
        })
    };
    let frames: Vec<usize> =
        whole.windows(3).enumerate().filter(|(_, w)| *w == b"ZW\x02").map(|(n, _)| n).collect();
    let (at, next) = (frames[700], frames[701]);
    for bit in [0, 77, 131, 290, 400] {
        let mut flipped = whole.clone();
        flipped[at + bit / 8] ^= 1 << (bit % 8);
        let (json, rows) = run(&flipped);
        assert_eq!((of(&json, "dropped"), json["gaps"].as_array().unwrap().len()), (1, 1), "{bit}");
        assert!(
            json["first_difference"].is_null() && of(&json, "garbage_bytes") as usize == next - at
        );
        assert!(subset(&rows), "{bit}");
    }
    // The reader of the capture stops for a while, and continues in the middle of a frame.
    let (json, rows) = run(&[&whole[..at + 11], &whole[frames[900] + 9..]].concat());
    assert_eq!(json["gaps"].as_array().unwrap().len(), 1);
    assert!(json["first_difference"].is_null() && subset(&rows));
    // One velocity has a wrong bit, but the CRC of its frame is correct. So the difference is reported at this output.
    let mut other = whole.clone();
    let length = next - at;
    other[at + 20] ^= 1;
    let crc = crc32(&other[at..next - 4]);
    other[at + length - 4..next].copy_from_slice(&crc.to_le_bytes());
    let (json, rows) = run(&other);
    let sample = u64::from_le_bytes(whole[at + 8..at + 16].try_into().unwrap());
    assert_eq!(of(&json["first_difference"], "sample"), sample);
    assert_eq!(json["first_difference"]["what"], "velocity");
    assert!(subset(&rows) && of(&json, "computed") + 1 >= sample - 1_000);
}

/// CRC-32 as zlib computes it, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            crc >> 1 ^ if crc & 1 != 0 { 0xEDB8_8320 } else { 0 }
        })
    })
}

/// Another estimator computes velocities from the counts of this capture. A figure shows them.
#[test]
fn another_estimator_is_run_over_every_sample_of_a_capture() {
    let folder = TempDir::new().unwrap();
    let capture = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/samples.bin");
    let replay = |more: &[&str]| {
        let args =
            [&["replay", capture, "--json", "--scene", "paper-1um", "--force"][..], more].concat();
        let output = sim(folder.path(), &args);
        assert!(output.status.success(), "{output:?}");
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    let slow = replay(&[
        "--estimator",
        "butterworth",
        "--cutoff",
        "100",
        "--plot",
        "a.svg",
        "--csv",
        "a.csv",
    ]);
    assert!(slow["samples"].as_u64().unwrap() > 20_000);
    // the expected delay is sqrt 2 / w, minus the delay of the board's own estimator
    let later_s = slow["later_s"].as_f64().unwrap();
    assert!((1.5e-3..2.3e-3).contains(&later_s), "{later_s}");
    assert!(slow["change_rms_m_per_s"].as_f64() < slow["board_change_rms_m_per_s"].as_f64());
    assert!(fs::read_to_string(folder.path().join("a.svg")).unwrap().contains("Velocity v [m/s]"));
    let rows = fs::read_to_string(folder.path().join("a.csv")).unwrap().lines().count() as u64;
    assert_eq!(rows, slow["samples"].as_u64().unwrap() + 1);
}

/// Estimators are ranked on the counts in a log. Wrong input gives errors.
#[test]
fn the_estimators_are_ranked_on_the_counts_of_a_log() {
    let folder = TempDir::new().unwrap();
    let rows = (0..3000).map(|n| {
        let t = f64::from(n) / 2000.0;
        format!("{t},0,{}\n", (300.0 * (9.0 * t).sin() + 50.0 * (40.0 * t).sin()).floor())
    });
    let log = format!("time_s,voltage_v,position_counts\n{}", rows.collect::<String>());
    fs::write(folder.path().join("log.csv"), log).unwrap();
    let rank = |more: &[&str]| {
        let args = ["replay", "log.csv", "--json", "--scene", "paper-1um"];
        sim(folder.path(), &[&args[..], more].concat())
    };
    let output = rank(&["--rank", "50", "--csv", "ranks.csv"]);
    assert!(output.status.success(), "{output:?}");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let errors: Vec<f64> = json["estimators"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["error_m_per_s"].as_f64().unwrap())
        .collect();
    assert!(errors.len() > 15 && errors.is_sorted(), "{errors:?}");
    let rows = fs::read_to_string(folder.path().join("ranks.csv")).unwrap();
    assert_eq!(rows.lines().count(), errors.len() + 1);
    for (more, expected) in [
        (&["--rank", "0"][..], "--rank is 0, allowed"),
        (&["--rank", "nan"], "--rank is NaN, allowed"),
        (&["--rank", "9000"], "--rank is 9000, allowed"),
        (&["--rank", "50", "--resolution", "-1"], "--resolution is -1, allowed"),
        (&["--rank", "50", "--cutoff", "100"], "cannot be used with"),
    ] {
        let output = rank(more);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(expected), "{said}");
    }
}
