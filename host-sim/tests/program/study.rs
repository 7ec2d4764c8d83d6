//! Tests `study` and `study-plan`: runs that are killed, meet a full disk, are resumed, or have errors.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Command, Output, Stdio},
    time::Duration,
};

use rand::{RngExt as _, SeedableRng as _, rngs::SmallRng};
use serde_json::Value;
use tempfile::TempDir;

use crate::{
    cli::{SCENE, refused, sim},
    page,
};

/// A study of forty-eight units. Each takes a few milliseconds.
const STUDY: &str = "measure = \"walk\"\nscenes = [\"mine.toml\"]\ncutoffs_hz = [500, 1500]\nstarts_counts = [0, 0.5]\n\
    points_per_unit = 1\n[product]\nactuator.latency = \"0:1:11\"\n";

/// A folder with a study of a scene whose walks are short.
fn folder(study: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    let mut scene = SCENE.to_owned();
    for (from, to) in [
        ("settle_s = 4.0", "settle_s = 0.6"),
        ("window_s = 2.0", "window_s = 0.4"),
        ("stiffness_step_n_per_m = 2000", "stiffness_step_n_per_m = 20000"),
        ("damping_step_n_s_per_m = 10", "damping_step_n_s_per_m = 200"),
    ] {
        assert!(scene.contains(from), "{from}");
        scene = scene.replace(from, to);
    }
    fs::write(folder.path().join("mine.toml"), scene).unwrap();
    fs::write(folder.path().join("study.toml"), study).unwrap();
    folder
}

/// Names and bytes of all files in a folder.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(Result::unwrap);
    let of = |entry: fs::DirEntry| {
        (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())
    };
    entries.map(of).collect()
}

/// Asserts that the contents are equal. If not, the message names the files that differ, but does not print their
/// bytes.
#[track_caller]
fn are_same(folder: &Path, wanted: &BTreeMap<String, Vec<u8>>, what: &str) {
    let found = contents(folder);
    let names = found.keys().chain(wanted.keys());
    let other: Vec<&String> = names.filter(|name| found.get(*name) != wanted.get(*name)).collect();
    assert!(other.is_empty(), "{what}: {other:?}");
}

fn study(folder: &Path, out: &str, more: &[&str]) -> Output {
    sim(folder, &[&["study", "study.toml", "--out", out], more].concat())
}

#[track_caller]
fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_study_that_is_killed_at_any_instant_comes_to_the_same_bytes() {
    let folder = folder(STUDY);
    let path = folder.path();
    let whole = json(&study(path, "whole", &["--json"]));
    page::has_keys_of("## `study STUDY", &whole);
    assert_eq!((&whole["units"], &whole["units_made"]), (&48.into(), &48.into()));
    let wanted = contents(&path.join("whole"));
    assert_eq!(wanted.len(), 50);
    let mut random = SmallRng::seed_from_u64(19);
    let (mut kills, mut between) = (0, 0);
    for round in 0..4 {
        let out = format!("killed{round}");
        for _ in 0..10 {
            let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
            command.args(["study", "study.toml", "--resume", "--out", &out]).current_dir(path);
            let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            std::thread::sleep(Duration::from_micros(random.random_range(0..150_000)));
            kills += usize::from(child.try_wait().unwrap().is_none());
            let _ = child.kill();
            child.wait().unwrap();
            let manifest = fs::read_to_string(path.join(&out).join("manifest.jsonl"));
            between +=
                usize::from((1..48).contains(&manifest.map_or(0, |text| text.lines().count())));
        }
        json(&study(path, &out, &["--resume", "--json"]));
        are_same(&path.join(&out), &wanted, &format!("round {round}"));
    }
    assert!(kills >= 10 && between >= 5, "{kills} kills, {between} of them with parts to come");
    // a folder with an incomplete line, with a part that has no line, and with a draft
    let torn = path.join("torn");
    fs::create_dir(&torn).unwrap();
    for (name, bytes) in &wanted {
        fs::write(torn.join(name), bytes).unwrap();
    }
    for cut in [1, 100, 700, 9_000] {
        let manifest = &wanted["manifest.jsonl"];
        fs::write(torn.join("manifest.jsonl"), &manifest[..manifest.len() - cut]).unwrap();
        fs::write(torn.join(".zwidth-part-00000047.csv.draft"), "half").unwrap();
        assert!(study(path, "torn", &["--resume"]).status.success());
        are_same(&torn, &wanted, &format!("{cut} bytes cut"));
    }
    // missing or changed parts are computed again
    fs::remove_file(torn.join("part-00000003.csv")).unwrap();
    fs::write(torn.join("part-00000007.csv"), "x").unwrap();
    let mut other = wanted["part-00000009.csv"].clone();
    *other.last_mut().unwrap() = b' ';
    fs::write(torn.join("part-00000009.csv"), other).unwrap();
    assert_eq!(json(&study(path, "torn", &["--resume", "--json"]))["units_made"], 3);
    are_same(&torn, &wanted, "the manifest is in order again");
    assert_eq!(json(&study(path, "torn", &["--resume", "--json"]))["units_made"], 0);
}

#[test]
fn a_full_disk_is_one_line_and_resume_goes_on() {
    // the disk becomes full inside a line of the manifest, or inside a part
    let parts = STUDY.replace("per_unit = 1", "per_unit = 200").replace("0:1:11", "0:0.1:9.9");
    for (study_text, full) in [(STUDY, "manifest.jsonl"), (&parts, "part-00000000.csv")] {
        let folder = folder(study_text);
        let path = folder.path();
        assert!(study(path, "whole", &[]).status.success());
        let wanted = contents(&path.join("whole"));
        let mut command = Command::new("sh");
        let first = "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\""; // 8 blocks of 512 bytes
        command.args(["-c", first, env!("CARGO_BIN_EXE_host-sim")]).current_dir(path);
        let output = command.args(["study", "study.toml", "--out", "full"]).output().unwrap();
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{line}");
        assert_eq!(line.trim_end().lines().count(), 1, "{line}");
        assert!(line.contains(&format!("full/{full}: File too large")), "{line}");
        let left = contents(&path.join("full"));
        assert!(left["manifest.jsonl"].is_empty() || left["manifest.jsonl"].ends_with(b"\n"));
        assert!(
            left.len() > 1 && left.keys().all(|name| !name.starts_with('.')),
            "{:?}",
            left.keys()
        );
        assert!(study(path, "full", &["--resume"]).status.success());
        are_same(&path.join("full"), &wanted, full);
    }
}

#[test]
fn bits_do_not_depend_on_threads_and_engine() {
    for text in [
        STUDY.to_owned(),
        STUDY.replace("walk", "hit").replace(
            "points_per_unit = 1",
            "points_per_unit = 5\nstiffnesses = [4000, 90000]\ndampings = [20]",
        ),
        STUDY.replace("walk", "sweep").replace("starts_counts = [0, 0.5]", "repeat = 2"),
    ] {
        let folder = folder(&text);
        let path = folder.path();
        for (out, threads, engine) in
            [("one", "1", "lanes"), ("two", "2", "lanes"), ("core", "2", "core")]
        {
            let output = study(path, out, &["--threads", threads, "--engine", engine]);
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        let wanted = contents(&path.join("one"));
        assert!(wanted.len() > 3);
        are_same(&path.join("two"), &wanted, "two threads");
        are_same(&path.join("core"), &wanted, "core");
    }
}

#[test]
fn the_folder_of_another_study_scene_or_version_is_refused() {
    let folder = folder(STUDY);
    let path = folder.path();
    assert!(study(path, "out", &[]).status.success());
    let line =
        |more: &[&str]| refused(path, &[&["study", "study.toml", "--out", "out"], more].concat());
    assert!(line(&[]).contains("out holds a study already; --resume goes on with it"));
    assert!(line(&["--force"]).contains("--force is not of study"));
    assert!(
        line(&["--resume", "--numeric", "f64"])
            .contains("another study: its numeric is fixed, here f64")
    );
    let changed = |file: &str, from: &str, to: &str, wanted: &str| {
        let file = path.join(file);
        let text = fs::read_to_string(&file).unwrap();
        assert!(text.contains(from), "{from}");
        fs::write(&file, text.replacen(from, to, 1)).unwrap();
        let said = line(&["--resume"]);
        assert!(said.contains("out holds another study: ") && said.contains(wanted), "{said}");
        fs::write(&file, text).unwrap();
    };
    changed("study.toml", "[500, 1500]", "[500, 1501]", "its points or units are others than here");
    changed("study.toml", "0:1:11", "0:1:10", "its points or units are others than here");
    changed("study.toml", "per_unit = 1", "per_unit = 2", "its points or units are others");
    changed(
        "study.toml",
        "mine.toml",
        "paper-1um",
        "its scenes are mine with butterworth, here paper-1um",
    );
    changed(
        "mine.toml",
        "mass_kg = 0.4160",
        "mass_kg = 0.4161",
        "its scene mine is another one than here",
    );
    changed("out/study.json", "\"version\": \"", "\"version\": \"9", "its version is 9");
    changed("out/study.json", "\"sources\": \"", "\"sources\": \"9", "its sources is 9");
    changed(
        "out/study.json",
        "\"schema_version\": ",
        "\"schema_version\": 9",
        "its schema_version is 91",
    );
    // a changed comment does not change the study
    let text = fs::read_to_string(path.join("study.toml")).unwrap();
    fs::write(path.join("study.toml"), format!("# the same\n{text}")).unwrap();
    assert_eq!(json(&study(path, "out", &["--resume", "--json"]))["units_made"], 0);
    fs::write(path.join("out/study.json"), "{}").unwrap();
    assert!(line(&["--resume"]).contains("out/study.json: no study of this program"));
    fs::remove_file(path.join("out/study.json")).unwrap();
    assert!(line(&[]).contains("out/manifest.jsonl is there already"));
}

#[test]
fn one_run_at_a_time_has_a_folder() {
    let folder = folder(&STUDY.replace("0:1:11", "0:0.01:11"));
    let path = folder.path();
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command.args(["study", "study.toml", "--out", "out"]).current_dir(path);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !path.join("out/part-00000000.csv").exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(5));
    }
    let other = study(path, "out", &["--resume"]);
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(other.status.code(), Some(2));
    let line = String::from_utf8(other.stderr).unwrap();
    assert!(line.contains("out is being written by another run"), "{line}");
}

#[test]
fn a_bad_study_is_refused_before_anything_is_written() {
    let folder = folder(STUDY);
    let path = folder.path();
    let line = |from: &str, to: &str| {
        assert!(STUDY.contains(from), "{from}");
        fs::write(path.join("study.toml"), STUDY.replacen(from, to, 1)).unwrap();
        let planned = refused(path, &["study-plan", "study.toml"]);
        assert_eq!(refused(path, &["study", "study.toml", "--out", "out"]), planned);
        planned
    };
    assert!(
        line("measure", "messure").contains("study.toml:1: `messure = \"walk\"`: unknown field")
    );
    assert!(
        line("mine.toml", "yours.toml").contains("study.toml: scenes: yours.toml cannot be read")
    );
    assert!(line("[500, 1500]", "[500, 15000]").contains(
        "study.toml: mine with actuator.latency = 0.0: cutoffs_hz is 15000, allowed 0.35 to 4990"
    ));
    assert!(line("0:1:11", "0:100:2000").contains(
        "mine with actuator.latency = 1100.0: actuator.latency is 1100, allowed 0 to 1000"
    ));
    assert!(
        line("per_unit = 1", "per_unit = 0").contains("points_per_unit is 0, allowed 1 to 1000000")
    );
    let missing = refused(path, &["study", "missing.toml", "--out", "out"]);
    assert!(missing.contains("missing.toml cannot be read"), "{missing}");
    let out = refused(path, &["study-plan", "study.toml", "--out", "out"]);
    assert!(out.contains("--out is not of study-plan"), "{out}");
}

#[test]
fn a_plan_that_tries_every_point_has_the_figures_of_the_study() {
    let folder = folder(STUDY);
    let path = folder.path();
    let plan = json(&sim(path, &["study-plan", "study.toml", "--json"]));
    page::has_keys_of("## `study-plan STUDY", &plan);
    let made = json(&study(path, "out", &["--json"]));
    assert_eq!((&plan["points"], &plan["trial_points"]), (&48.into(), &48.into()));
    assert_eq!(plan["hits"].as_f64().unwrap().round(), made["hits"].as_f64().unwrap());
    assert_eq!((&plan["hits_uncertainty"], &plan["bytes_uncertainty"]), (&0.0.into(), &0.0.into()));
    let part = fs::read_to_string(path.join("out/part-00000000.csv")).unwrap();
    let heads = 48 * (part.lines().next().unwrap().len() + 1);
    assert_eq!(
        plan["bytes"].as_f64().unwrap().round() as usize + heads,
        made["bytes"].as_u64().unwrap() as usize
    );
}

#[test]
fn a_rotary_study_speaks_its_unit_and_its_columns_are_on_the_page() {
    for (measure, more) in [
        ("walk", "starts_counts = [0]"),
        ("hit", "stiffnesses = [0.5]\ndampings = [0.001]"),
        ("sweep", "repeat = 1"),
    ] {
        let text = format!(
            "measure = \"{measure}\"\nscenes = [\"hapkit\"]\ncutoffs_hz = [100]\n{more}\n[product]\nwall_hit.settle_s = [1.0]\n"
        );
        let folder = folder(&text);
        assert!(study(folder.path(), "out", &[]).status.success());
        let part = fs::read_to_string(folder.path().join("out/part-00000000.csv")).unwrap();
        let told = ["n_m_per_rad", "n_m_s_per_rad", "n2_m2_s_per_rad2", "rms_rad"];
        assert!(told.iter().any(|unit| part.contains(unit)) && !part.contains("n_per_m"), "{part}");
    }
    for (measure, more) in
        [("walk", ""), ("hit", "stiffnesses = [4000]\ndampings = [20]"), ("sweep", "repeat = 1")]
    {
        let text = format!(
            "measure = \"{measure}\"\nscenes = [\"mine.toml\"]\ncutoffs_hz = [500]\n{more}\n"
        );
        let folder = folder(&text);
        assert!(study(folder.path(), "out", &[]).status.success());
        let part = fs::read_to_string(folder.path().join("out/part-00000000.csv")).unwrap();
        page::has_columns_of(&format!("part.csv` of `{measure}"), &part);
        let head: Value =
            serde_json::from_slice(&fs::read(folder.path().join("out/study.json")).unwrap())
                .unwrap();
        page::has_keys_of("## `study STUDY", &head);
    }
}
