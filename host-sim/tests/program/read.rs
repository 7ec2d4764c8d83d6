//! `cargo sim read`: converts a device record back into a scene.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;

const SIM: &str = env!("CARGO_BIN_EXE_host-sim");

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes")
}

fn run(folder: &Path, args: &[&str]) -> Output {
    Command::new(SIM).args(args).current_dir(folder).output().unwrap()
}

fn whole(output: Output) -> Vec<u8> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

#[test]
fn a_record_becomes_a_scene_whose_record_says_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    let record = scenes().join("nucleo-f446re.device");
    let record = record.to_str().unwrap();
    let read: Value = serde_json::from_slice(&whole(run(
        place,
        &["read", record, "--out", "back.toml", "--json"],
    )))
    .unwrap();
    assert_eq!((&read["device"], &read["board"]), (&read["board"], &"nucleo-f446re".into()));
    assert_eq!(read["scene"]["motor"]["continuous_force_n"], Value::from(4.1));
    assert!(read["settings"].is_null() && read["radius_m"].is_null());
    assert!(read["rows"].as_u64().unwrap() > 100);
    // The written scene is valid, and its record gives the same tables.
    let args = ["prepare", "back.toml", "--starter", "--board", "nucleo-f446re"];
    whole(run(place, &args));
    let again: Value =
        serde_json::from_slice(&whole(run(place, &["read", "back.device", "--json"]))).unwrap();
    for table in ["encoder", "actuator", "wall", "walk", "wall_hit", "control", "output"] {
        assert_eq!(read["scene"][table], again["scene"][table], "{table}");
    }
    let text = String::from_utf8(whole(run(place, &["read", record]))).unwrap();
    assert!(text.starts_with("# nucleo-f446re on the board nucleo-f446re: record "), "{text}");
    assert!(text.contains("[safety]") && text.contains("[return]"), "{text}");
    // Existing files are not replaced.
    assert_eq!(run(place, &["read", record, "--out", "back.toml"]).status.code(), Some(2));
}

#[test]
fn a_rotary_record_is_read_at_the_handle() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    whole(run(place, &["prepare", "hapkit", "--starter", "--out", "hapkit.device"]));
    let args = ["read", "hapkit.device", "--base", "hapkit", "--out", "back.toml", "--json"];
    let read: Value = serde_json::from_slice(&whole(run(place, &args))).unwrap();
    assert!(read["radius_m"].as_f64().unwrap() > 0.01);
    let back =
        ["hit", "back.toml", "--cutoff", "500", "--stiffness", "1000", "--damping", "5", "--json"];
    let hit: Value = serde_json::from_slice(&whole(run(place, &back))).unwrap();
    assert_eq!(hit["verdict"], "stable");
}

#[test]
fn what_is_no_record_is_one_line_and_an_old_one_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    let good = fs::read(scenes().join("nucleo-f446re.device")).unwrap();
    let mut old = good.clone();
    old[3] = 2;
    let mut damaged = good.clone();
    damaged[500] ^= 1;
    for (bytes, why) in [
        (old, "its layout is 2, this firmware takes 4; make it anew: cargo sim prepare"),
        (damaged, "it is damaged: its checksum is wrong"),
        (good[..400].to_vec(), "its length is"),
        (b"hello".to_vec(), "what is in its place is none"),
        (vec![], "what is in its place is none"),
    ] {
        fs::write(place.join("x.device"), bytes).unwrap();
        let output = run(place, &["read", "x.device"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{said}");
        assert!(said.contains("x.device") && said.contains(why), "{said}");
    }
    fs::write(place.join("good.device"), good).unwrap();
    fs::write(place.join("flash.bin"), [0_u8; 100]).unwrap();
    let output = run(place, &["read", "good.device", "--settings", "flash.bin"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.code() == Some(2) && said.contains("flash.bin: 100 bytes, needed 32768"),
        "{said}"
    );
}
