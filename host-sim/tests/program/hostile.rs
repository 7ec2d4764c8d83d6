//! Hostile inputs and environments: wrong options, invalid files, failures at bad times.

use std::{
    fs,
    path::Path,
    process::{Child, Command, ExitStatus, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use host_sim::analysis::identify::Record;
use serde_json::Value;
use tempfile::TempDir;
use zwidth::telemetry::{Frame, Record as TelemetryRecord};

use crate::{
    cli::{SCENE, WALL, hit, listing, refused, scene, sim},
    identify_command::log_of,
};

/// Longest time from a signal to the end of a program.
const ENDS_IN: Duration = Duration::from_secs(1);
/// Longest time of a command that is not interrupted. After this time the test kills the command.
const TAKES: Duration = Duration::from_secs(20);

/// The command, limited to 2 GB of address space. It has more threads than processors.
fn command(folder: &Path, args: &[&str]) -> Command {
    shell(folder, "ulimit -v 2000000", args)
}

/// A shell that executes the line `first`, and then runs the command.
fn shell(folder: &Path, first: &str, args: &[&str]) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", &format!("{first}; exec \"$0\" \"$@\" --threads 2")]);
    command.arg(env!("CARGO_BIN_EXE_host-sim")).args(args).current_dir(folder);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// A child process that is killed at the end of its test.
struct Started(Child);

impl Started {
    fn new(mut command: Command) -> Self {
        Self(command.spawn().unwrap())
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.0.kill(); // in most cases it has already ended
        let _ = self.0.wait();
    }
}

fn wait(child: &mut Child, longest: Duration) -> Option<ExitStatus> {
    let begun = Instant::now();
    while begun.elapsed() < longest {
        if let Some(status) = child.try_wait().unwrap() {
            return Some(status);
        }
        thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    None
}

fn text(pipe: Option<impl std::io::Read>) -> String {
    let mut text = String::new();
    pipe.unwrap().read_to_string(&mut text).unwrap();
    text
}

/// Asserts exit code 2, one short line that contains `wanted`, and no new file.
#[track_caller]
fn bounded(folder: &Path, args: &[&str], wanted: &str) {
    let before = listing(folder);
    let mut child = Started::new(command(folder, args));
    let status = wait(&mut child.0, TAKES);
    let line = text(child.0.stderr.take());
    let code = status.and_then(|status| status.code());
    assert_eq!(code, Some(2), "{args:.100?}: {line:.2000}");
    assert!(line.contains(wanted), "{line:.2000} should say {wanted}");
    assert!(line.len() < 2000 && line.trim_end().lines().count() == 1, "{line:.2000}");
    assert!(!line.trim_end().contains(|c: char| c.is_control()), "{line:?}");
    assert_eq!(listing(folder), before, "{args:.100?} left something behind");
}

fn signal(child: &Child, name: &str) {
    let pid = child.id().to_string();
    assert!(Command::new("kill").args([name, &pid]).status().unwrap().success());
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A log with `rows` rows. The handle in it oscillates.
fn log(rows: usize) -> String {
    let wave = |n: usize, size: f64| size * (n as f64 * 1e-3).sin();
    Record {
        name: "log".into(),
        start_s: 0.0,
        step_s: 1e-4,
        command: (0..rows).map(|n| wave(n, 3.0)).collect(),
        position_m: (0..rows).map(|n| (wave(n, 1e4) - 5e3).floor() * 1e-6).collect(),
        drive: Default::default(),
        may_clip: true,
    }
    .csv()
}

/// A device that needs 10,000 integration steps per sample, so that a hit takes minutes.
fn stiff() -> TempDir {
    let integrator = "[integrator]\nmethod = \"rk4\"\nsteps_per_sample = 10000\n\n[sweep]";
    scene("[sweep]", integrator)
}

#[test]
fn every_command_ends_within_a_second_of_a_signal() {
    let folder = stiff();
    let folder = folder.path();
    assert!(Command::new("mkfifo").arg(folder.join("pipe")).status().unwrap().success());
    fs::write(folder.join("log.csv"), log_of(0.0, 1_000_000)).unwrap();
    let before = listing(folder);
    let hit = hit("mine.toml", &["--trace", "t.csv", "--plot", "t.svg"]);
    let hit: Vec<&str> = hit.iter().map(String::as_str).collect();
    let dampings = ["--cutoffs", "1001:1:1100", "--dampings", "0:0.1:999.9"];
    let grid = ["grid", "mine.toml", "--cutoffs", "500", "--dampings", "20", "--stiffnesses"];
    // The fit is the first case, because a later fit could end before its interruption.
    let cases: [(&str, Vec<&str>); 11] = [
        (
            "-TERM",
            vec!["identify", "--base", "paper-1um", "log.csv", "--gain", "0.6", "--out", "o.toml"],
        ),
        ("-INT", vec!["walk", "pipe", "--cutoff", "500", "--csv", "w.csv"]),
        ("-TERM", vec!["identify", "--base", "paper-1um", "pipe", "--gain", "1", "--csv", "i.csv"]),
        ("-HUP", vec!["telemetry", "pipe", "--csv", "a/b/t.csv"]),
        ("-INT", hit),
        ("-TERM", vec!["walk", "mine.toml", "--cutoff", "500", "--csv", "v.csv"]),
        ("-INT", [&grid[..], &["2000", "--csv", "g.csv"]].concat()),
        ("-TERM", vec!["sweep", "mine.toml", "--cutoffs", "500", "--out", "sweep"]),
        ("-INT", [&["linear", "paper-1um"], &dampings[..], &["--csv", "l.csv"]].concat()),
        ("-INT", vec!["trade", "paper-1um", "--out", "trade"]),
        ("-TERM", vec!["compare", "paper-1um", "--out", "compare"]),
    ];
    let mut late = vec![];
    // Only a few cases run at the same time. On two processors, all together would be too slow.
    for cases in cases.chunks(3) {
        let started = cases.iter().map(|(_, args)| Started::new(command(folder, args)));
        let mut children: Vec<Started> = started.collect();
        thread::sleep(Duration::from_millis(600));
        for ((name, args), Started(child)) in cases.iter().zip(&mut children) {
            assert!(child.try_wait().unwrap().is_none(), "{args:?} had ended");
            signal(child, name);
            let begun = Instant::now();
            let code = wait(child, 2 * ENDS_IN).and_then(|status| status.code());
            let said = text(child.stderr.take());
            if code != Some(130) || begun.elapsed() > ENDS_IN || !said.contains("interrupted") {
                late.push(format!("{args:?}: {code:?} after {:?}: {said}", begun.elapsed()));
            }
        }
    }
    assert!(late.is_empty(), "{late:#?}");
    assert_eq!(listing(folder), before);
}

#[test]
fn inputs_have_a_size_that_is_said() {
    let folder = scene("[sweep]", &format!("# {}\n[sweep]", "x".repeat(1 << 20)));
    let at = |args: &[&str], wanted: &str| bounded(folder.path(), args, wanted);
    at(&["walk", "/dev/zero", "--cutoff", "500"], "larger than a scene may be, allowed 1 MiB");
    at(&["walk", "mine.toml", "--cutoff", "500"], "larger than a scene may be, allowed 1 MiB");
    at(
        &["identify", "--base", "paper-1um", "/dev/zero", "--gain", "1"],
        "larger than a record may be, allowed 256 MiB",
    );
    at(&["telemetry", "/dev/zero"], "larger than a record may be, allowed 256 MiB");
    fs::write(folder.path().join("log.csv"), log(1_000_001)).unwrap();
    let rows = "1000001 rows of data, allowed 100 to 1000000; --from and --to take a part";
    at(&["identify", "--base", "paper-1um", "log.csv", "--gain", "1"], rows);
    let many = "1000,".repeat(10_001);
    fs::write(
        folder.path().join("mine.toml"),
        SCENE.replacen("cutoffs_hz = [", &format!("cutoffs_hz = [{many}"), 1),
    )
    .unwrap();
    at(
        &["walk", "mine.toml", "--cutoff", "500"],
        "sweep.cutoffs_hz has 10013 values, allowed 1 to 10000",
    );
    at(&["sweep", "--cutoffs", &many[..many.len() - 1]], "10001 values, allowed 10000");
    let points = ["linear", "paper-1um", "--cutoffs", "1000:1:2000", "--dampings", "0:1:999"];
    at(&points, "make 1001000 points, allowed 1000000");
    let settle = SCENE.replacen("settle_s = 4.0", "settle_s = 1600", 1);
    fs::write(folder.path().join("mine.toml"), settle).unwrap();
    let long = hit("mine.toml", &["--trace", "t.csv"]);
    let long: Vec<&str> = long.iter().map(String::as_str).collect();
    at(&long, "make 16020000 samples, allowed 2000000 in a trace");
}

#[test]
fn an_input_is_never_replaced() {
    let folder = scene("[sweep]", "[sweep]");
    let path = folder.path();
    fs::write(path.join("log.csv"), log(200)).unwrap();
    let record = TelemetryRecord { sample: 10, ..TelemetryRecord::default() };
    fs::write(path.join("capture.bin"), Frame { sequence: 1, record }.encode()).unwrap();
    fs::hard_link(path.join("mine.toml"), path.join("hard.toml")).unwrap();
    std::os::unix::fs::symlink(".", path.join("soft")).unwrap();
    fs::create_dir(path.join("result")).unwrap();
    fs::copy(path.join("mine.toml"), path.join("result/areas.csv")).unwrap();
    let walk = ["walk", "mine.toml", "--cutoff", "500", "--force", "--csv"];
    for (args, input) in [
        ([&walk[..], &["mine.toml"]].concat(), "mine.toml"),
        ([&walk[..], &["./mine.toml"]].concat(), "mine.toml"),
        ([&walk[..], &["soft/mine.toml"]].concat(), "mine.toml"),
        ([&walk[..], &["hard.toml"]].concat(), "mine.toml"),
        (
            vec![
                "identify",
                "--base",
                "paper-1um",
                "log.csv",
                "--gain",
                "1",
                "--csv",
                "log.csv",
                "--force",
            ],
            "log.csv",
        ),
        (
            vec![
                "identify",
                "log.csv",
                "--base",
                "mine.toml",
                "--gain",
                "1",
                "--out",
                "mine.toml",
                "--force",
            ],
            "mine.toml",
        ),
        (vec!["telemetry", "capture.bin", "--csv", "capture.bin", "--force"], "capture.bin"),
        (vec!["sweep", "result/areas.csv", "--out", "result", "--force"], "result/areas.csv"),
    ] {
        let line = refused(path, &args);
        assert!(line.contains(&format!("is the input {input}; it is not replaced")), "{line}");
    }
    let same = hit("mine.toml", &["--trace", "./a.svg", "--plot", "a.svg"]);
    let same: Vec<&str> = same.iter().map(String::as_str).collect();
    assert!(refused(path, &same).contains("a.svg and ./a.svg are the same file"));
    assert_eq!(fs::read_to_string(path.join("mine.toml")).unwrap(), SCENE);
}

#[test]
fn a_place_that_another_run_writes_is_refused_and_a_killed_run_is_cleaned_up() {
    let folder = TempDir::new().unwrap();
    let args = ["sweep", "paper-1um", "--repeat", "1000", "--out", "result"];
    let draft = folder.path().join("result/.zwidth-manifest.json.draft");
    let made = || fs::metadata(&draft).and_then(|draft| draft.modified()).ok();
    let begin = || {
        let (before, begun) = (made(), Instant::now());
        let child = Started::new(command(folder.path(), &args));
        while made().is_none() || made() == before {
            assert!(begun.elapsed() < TAKES, "the sweep does not begin");
            thread::sleep(Duration::from_millis(10));
        }
        child
    };
    let mut killed = begin();
    killed.0.kill().unwrap();
    killed.0.wait().unwrap();
    assert!(draft.exists(), "it had no time to clean up");
    let mut first = begin();
    let second = sim(folder.path(), &args);
    assert_eq!(second.status.code(), Some(2));
    let line = String::from_utf8(second.stderr).unwrap();
    assert!(line.contains("is being written by another run"), "{line}");
    assert_eq!(line.trim_end().lines().count(), 1, "{line}");
    signal(&first.0, "-TERM");
    assert_eq!(wait(&mut first.0, 2 * ENDS_IN).and_then(|status| status.code()), Some(130));
    // only the folder of the killed run is left
    assert_eq!(listing(folder.path()).len(), 1);
}

#[test]
fn several_outputs_appear_together_or_not_at_all() {
    let folder = TempDir::new().unwrap();
    let path = folder.path();
    fs::write(path.join("log.csv"), log_of(0.0, 20_000)).unwrap();
    // The disk is full: there is space for the scene, but not for the CSV.
    let args = [
        "identify",
        "--base",
        "paper-1um",
        "log.csv",
        "--gain",
        "0.5906",
        "--out",
        "new.toml",
        "--csv",
        "new/i.csv",
    ];
    let before = listing(path);
    let full = shell(path, "trap '' XFSZ; ulimit -f 200", &args).output().unwrap();
    let line = String::from_utf8(full.stderr).unwrap();
    assert_eq!(full.status.code(), Some(1), "{line}");
    assert!(line.contains("new/i.csv: File too large"), "{line}");
    assert_eq!(listing(path), before);
    assert!(sim(path, &args).status.success());
    // The steps are 2^52 samples, so the rows can be written, but the figure cannot be drawn.
    let frames = (0..3).map(|n| {
        let record = TelemetryRecord { sample: u64::from(n) << 52, ..TelemetryRecord::default() };
        Frame { sequence: n, record }.encode()
    });
    fs::write(path.join("far.bin"), frames.collect::<Vec<_>>().concat()).unwrap();
    let before = listing(path);
    let far = sim(path, &["telemetry", "far.bin", "--csv", "far.csv", "--plot", "far.svg"]);
    assert_eq!(far.status.code(), Some(1));
    assert_eq!(listing(path), before);
    // The second of two scenes cannot be written.
    fs::create_dir_all(path.join("both/paper-2um/areas.csv")).unwrap();
    let before = listing(path);
    let both = ["sweep", "--cutoffs", "100", "--repeat", "1", "--out", "both", "--force"];
    assert_eq!(sim(path, &both).status.code(), Some(2));
    assert_eq!(listing(path), before);
}

#[test]
fn a_doubled_column_and_a_strange_cell_are_named() {
    let folder = TempDir::new().unwrap();
    let twice: Vec<String> = log(200).lines().map(|line| format!("{line},{line}")).collect();
    for (text, wanted) in [
        (twice.join("\n"), "several columns time_s"),
        (log(200).replacen("0.0001000,", "0.0001000,\u{1b}[31m", 1), "voltage_v is `\\u{1b}[31m"),
    ] {
        fs::write(folder.path().join("log.csv"), text).unwrap();
        bounded(
            folder.path(),
            &["identify", "--base", "paper-1um", "log.csv", "--gain", "1"],
            wanted,
        );
    }
}

#[test]
fn a_message_is_one_short_printable_line() {
    let folder = scene("mass_kg", "mass\u{1b}[31m_kg");
    let path = folder.path();
    bounded(path, &["walk", "mine.toml", "--cutoff", "500"], "mass\\u{1b}[31m_kg");
    bounded(path, &["walk", "no\u{1b}[31m\nscene", "--cutoff", "500"], "no\\u{1b}[31m\\nscene");
    bounded(path, &["walk", "paper-1um", "--cutoff", &"x".repeat(100_000)], "characters ..] ");
    bounded(path, &["walk", &"x/".repeat(2000), "--cutoff", "1"], "built-in scenes: paper-1um");
    // the name of a scene is printed too
    let named = "e\u{1b}[31m.toml";
    fs::write(path.join(named), SCENE).unwrap();
    let output = sim(path, &[&["hit", named], &WALL[..]].concat());
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.starts_with("e\\u{1b}[31m: stable"), "{said:?}");
    // if nothing can be printed, only the exit code shows the error
    for (args, code) in [(vec!["walk", "no-scene"], 2), (vec!["wlak"], 2)] {
        let status = shell(path, "exec 2>/dev/full", &args).status().unwrap();
        assert_eq!(status.code(), Some(code), "{args:?}");
    }
    let full = shell(path, "exec >/dev/full", &[&["hit", "paper-1um"], &WALL[..]].concat());
    assert_eq!({ full }.stdout(Stdio::inherit()).status().unwrap().code(), Some(1));
}

#[test]
fn errors_are_json_where_results_are() {
    let folder = TempDir::new().unwrap();
    let path = folder.path();
    for (args, command, wanted) in [
        (vec!["walk", "no-scene", "--cutoff", "1", "--json"], Value::from("walk"), "no-scene"),
        (vec!["--json", "walk", "paper-1um"], Value::from("walk"), "a cutoff is missing"),
        (vec!["walk", "paper-1um", "--cutof", "1", "--json"], Value::from("walk"), "--cutof"),
        (vec!["wlak", "paper-1um", "--json"], Value::Null, "wlak"),
    ] {
        let output = sim(path, &args);
        assert_eq!(output.status.code(), Some(2));
        let json = json(&output);
        let error = &json["error"];
        assert_eq!((&json["schema_version"], &json["command"]), (&Value::from(2), &command));
        assert_eq!((&error["kind"], &error["exit_code"]), (&Value::from("input"), &Value::from(2)));
        assert!(error["message"].as_str().unwrap().contains(wanted), "{json}");
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(line, format!("error: {}\n", error["message"].as_str().unwrap()));
    }
}

#[test]
fn a_quantity_has_one_name_and_a_file_says_its_version() {
    let folder = TempDir::new().unwrap();
    let path = folder.path();
    let walk = json(&sim(path, &["walk", "paper-2um", "--cutoff", "100", "--json"]));
    assert!(walk["area_n2_s_per_m2"].as_f64().unwrap() > 0.0 && walk["area"].is_null());
    let sweep = ["sweep", "paper-2um", "--cutoffs", "100", "--repeat", "1", "--out", "r"];
    let sweep = json(&sim(path, &[&sweep[..], &["--json"]].concat()));
    let read = |name: &str| fs::read_to_string(path.join("r").join(name)).unwrap();
    let summary: Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert_eq!(sweep["scenes"][0], summary);
    let cutoff = &summary["cutoffs"][0];
    assert_eq!(cutoff["area_n2_s_per_m2"], walk["area_n2_s_per_m2"]);
    assert_eq!(cutoff["walks"][0]["area_n2_s_per_m2"], walk["area_n2_s_per_m2"]);
    let manifest: Value = serde_json::from_str(&read("manifest.json")).unwrap();
    for of in [&walk, &sweep, &summary, &manifest] {
        assert_eq!(of["schema_version"], 2);
    }
    assert!(manifest["git_dirty"].is_boolean() || manifest["git_dirty"].is_null());
    // scripts read these files by their columns
    let head = "cutoff_hz,true_cutoff_hz,area,area_low,area_high,stiffness_peak_n_per_m,";
    assert!(read("areas.csv").starts_with(head));
}
