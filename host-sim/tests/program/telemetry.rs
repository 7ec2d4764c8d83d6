//! `cargo sim telemetry` as a user meets it.

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
    // and a figure, in the units of the control or of a scene
    for more in [&["--plot", "a.svg"][..], &["--plot", "b.png", "--scene", "paper-1um"]] {
        let args = [&["telemetry", "capture.bin"][..], more].concat();
        assert!(sim(folder.path(), &args).status.success());
        assert!(fs::metadata(folder.path().join(more[1])).unwrap().len() > 1000);
    }
    let args_gif = ["telemetry", "capture.bin", "--plot", "c.gif"];
    assert_eq!(sim(folder.path(), &args_gif).status.code(), Some(2));
    // a second run does not replace it
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
