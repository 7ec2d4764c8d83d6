//! Tests the command line without a firmware: bad input, output files, interruption. Tests with a firmware are in
//! tests/elf.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a test fails loudly")]

use std::{
    fs,
    path::Path,
    process::{Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use serde_json::Value;
use tempfile::TempDir;

const WALL: [&str; 6] = ["--cutoff", "500", "--stiffness", "4000", "--damping", "20"];

fn board(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_virtual-board"));
    command.args(args).current_dir(folder).stdin(Stdio::null());
    command
}

fn folder() -> TempDir {
    let folder = TempDir::new().unwrap();
    let scene = include_str!("../../../scenes/nucleo-f446re.toml");
    fs::write(folder.path().join("mine.toml"), scene).unwrap();
    folder
}

fn hit<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["hit"], more, &WALL[..]].concat()
}

fn walk<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["walk", "mine.toml", "--cutoff", "500"], more].concat()
}

fn line(output: &Output) -> String {
    let line = String::from_utf8(output.stderr.clone()).unwrap();
    assert!(line.starts_with("error: ") && line.trim_end().lines().count() == 1, "{line}");
    line
}

#[test]
fn bad_input_is_one_line_and_writes_nothing() {
    let folder = folder();
    let path = folder.path();
    fs::write(path.join("text"), "no program").unwrap();
    for (args, wanted) in [
        (hit(&["mine.toml", "--elf", "/dev/zero"]), "larger than a program may be, allowed 64 MiB"),
        (hit(&["mine.toml", "--elf", "text"]), "text is no program of a board"),
        (hit(&["mine.toml", "--elf", "missing"]), "missing cannot be read"),
        (hit(&["mine.toml", "--elf", "/bin/sh"]), "/bin/sh is no program of a board"),
        (hit(&["/dev/zero"]), "larger than a scene may be, allowed 1 MiB"),
        (hit(&["mine.toml", "--board", "nucl\u{1b}o"]), "nucl\\u{1b}o, allowed nucleo-f446re"),
        (hit(&["mine.toml", "--telemetry", "mine.toml", "--force"]), "is the input mine.toml"),
        (walk(&["--csv", "./mine.toml", "--force"]), "is the input mine.toml; it is not replaced"),
        (walk(&["--elf", "text", "--csv", "text", "--force"]), "is the input text"),
        (walk(&["--elf", "text", "--csv", "no/such/w.csv"]), "text is no program"),
        (vec!["run", "mine.toml", "--telemetry", "mine.toml"], "is the input mine.toml"),
        (vec!["run", "mine.toml", "--cutoff", "1"], "unexpected argument '--cutoff'"),
        (vec!["hti"], "unrecognized subcommand 'hti'"),
    ] {
        let output = board(path, &args).output().unwrap();
        let line = line(&output);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {line}");
        assert!(line.contains(wanted), "{line} should say {wanted}");
        assert!(output.stdout.is_empty());
    }
    assert_eq!(fs::read_dir(path).unwrap().count(), 2);
    let output = board(path, &hit(&["no-scene", "--json"])).output().unwrap();
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["command"], &json["schema_version"]), (&"hit".into(), &2.into()));
    assert!(json["error"]["message"].as_str().unwrap().contains("no-scene"), "{json}");
    assert!(line(&output).contains("no-scene"));
}

#[test]
fn a_scene_that_goes_with_no_record_is_refused_before_anything_runs() {
    let folder = folder();
    let path = folder.path();
    let text = include_str!("../../../scenes/nucleo-f446re.toml");
    for (from, to, wanted) in [
        ("rate_hz = 10000", "rate_hz = 9000", "control.rate_hz on the board nucleo-f446re is 9000"),
        ("start_position_m = 0.0", "start_position_m = -0.1", "start_m is -0.1, allowed -0.04"),
    ] {
        assert!(text.contains(from));
        fs::write(path.join("other.toml"), text.replace(from, to)).unwrap();
        for args in [hit(&["other.toml"]), vec!["run", "other.toml"]] {
            let output = board(path, &args).output().unwrap();
            let line = line(&output);
            assert_eq!(output.status.code(), Some(2), "{args:?}: {line}");
            assert!(line.contains(wanted), "{line} should say {wanted}");
        }
    }
    fs::write(path.join("long.device"), vec![0; 16_385]).unwrap();
    for (file, wanted) in [
        ("long.device", "long.device is longer than a record may be, 16 KiB"),
        ("missing.device", "missing.device cannot be read"),
    ] {
        let output = board(path, &hit(&["mine.toml", "--device", file])).output().unwrap();
        let line = line(&output);
        assert_eq!(output.status.code(), Some(2), "{line}");
        assert!(line.contains(wanted), "{line} should say {wanted}");
    }
}

#[test]
fn an_image_of_the_other_board_is_named() {
    // The smallest ELF that has a board's name in flash: header, one segment, the name.
    let mut elf = b"\x7fELF\x01\x01\x01".to_vec();
    elf.resize(16, 0);
    let word = |value: u32| value.to_le_bytes();
    elf.extend([word(2 | 40 << 16), word(1), word(0), word(52), word(0), word(0)].concat());
    elf.extend([word(52 | 32 << 16), word(1), word(0)].concat());
    let name = b"discovery-f407";
    let bytes = u32::try_from(name.len()).unwrap();
    elf.extend([1, 84, 0x800_0000, 0x800_0000, bytes, bytes, 4, 4].map(word).concat());
    elf.extend(name);
    let folder = folder();
    fs::write(folder.path().join("image"), elf).unwrap();
    let output = board(folder.path(), &hit(&["mine.toml", "--elf", "image"])).output().unwrap();
    let line = line(&output);
    assert_eq!(output.status.code(), Some(2), "{line}");
    assert!(
        line.contains("image is an image of discovery-f407, --board is nucleo-f446re"),
        "{line}"
    );
}

#[test]
fn a_signal_ends_it_within_a_second() {
    let folder = folder();
    let path = folder.path();
    assert!(Command::new("mkfifo").arg(path.join("pipe")).status().unwrap().success());
    let args = ["run", "mine.toml", "--elf", "pipe", "--telemetry", "new/t.bin"];
    for signal in ["-INT", "-TERM", "-HUP"] {
        let mut child = board(path, &args).stderr(Stdio::null()).spawn().unwrap();
        thread::sleep(Duration::from_millis(300));
        let pid = child.id().to_string();
        assert!(Command::new("kill").args([signal, &pid]).status().unwrap().success());
        let begun = Instant::now();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        assert!(begun.elapsed() < Duration::from_secs(1), "{signal}");
        assert!(!path.join("new").exists());
    }
}
