//! `compare` on the command line.

use std::{fs, path::Path, process::Command};

use serde_json::Value;
use tempfile::TempDir;

use crate::page;

/// A scene with short walks, because only the search is tested.
fn scene(folder: &Path) {
    let text = include_str!("../../../scenes/paper-2um.toml");
    let text = text
        .replace("stiffness_step_n_per_m = 2000", "stiffness_step_n_per_m = 8000")
        .replace("damping_step_n_s_per_m = 10", "damping_step_n_s_per_m = 60")
        // with an observer that gets the force, a walk ends only at a cap
        .replace("damping_max_n_s_per_m = 4000", "damping_max_n_s_per_m = 1200")
        .replace("stiffness_max_n_per_m = 1e7", "stiffness_max_n_per_m = 200_000")
        .replace("settle_s = 4.0", "settle_s = 1.0")
        .replace("window_s = 2.0", "window_s = 0.5");
    fs::write(folder.join("coarse.toml"), text).unwrap();
}

fn is_judged(extra: &[&str]) -> bool {
    ["--limit", "--criterion"].iter().any(|option| extra.contains(option))
}

fn compare(folder: &Path, extra: &[&str]) -> (i32, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .current_dir(folder)
        .args(["compare", "coarse.toml"])
        .args(if extra.contains(&"--budget") { &[][..] } else { &["--budget", "6"][..] })
        .args(if extra.contains(&"--repeat") { &[][..] } else { &["--repeat", "2"][..] })
        .args(if is_judged(extra) { &[][..] } else { &["--criterion", "rms"][..] })
        .args(extra)
        .output()
        .unwrap();
    let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    (output.status.code().unwrap(), out, err)
}

#[test]
fn the_result_is_complete_the_same_for_any_thread_count_and_names_winners() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let few = "--estimators=difference,butterworth,least-squares-1";
    let (code, one, _) = compare(folder.path(), &["--json", few, "--threads", "1", "--out", "a"]);
    assert_eq!(code, 0);
    let (_, two, _) = compare(folder.path(), &["--json", few, "--threads", "2", "--out", "b"]);
    assert_eq!(one, two);
    for name in
        ["compare.csv", "tuning.csv", "boundary.csv", "fidelity.csv", "zwidth.svg", "report.html"]
    {
        let [a, b] = ["a", "b"].map(|out| fs::read(folder.path().join(out).join(name)).unwrap());
        assert!(a == b && !a.is_empty(), "{name}");
    }
    let json: Value = serde_json::from_str(&one).unwrap();
    let rows = json["estimators"].as_array().unwrap();
    assert_eq!(rows.len(), 3);
    let area = |name: &str| {
        let row = rows.iter().find(|row| row["estimator"] == name).unwrap();
        row["area_n2_s_per_m2"].as_f64().unwrap()
    };
    assert!(area("butterworth") > 1.5 * area("difference"), "2 um asks for a filter");
    let winners = json["winners"].as_array().unwrap();
    let winner = |key: &str| winners.iter().find(|winner| winner["criterion"] == key).unwrap();
    assert_eq!(winner("delay_hand_s")["best"][0], "difference");
    let area_winner = winner("area_n2_s_per_m2");
    assert!(area_winner["butterworth_rank"].as_u64().unwrap() <= 2);
    assert_eq!(area_winner["class"], "position_only");
    assert!(json["impedance_error_of_loop"].as_f64().unwrap() > 0.0);
    // the file has all tunings that were tried, and whether the search converged; a tuning has two walks, or fewer if
    // it lost early
    let tuning = fs::read_to_string(folder.path().join("a/tuning.csv")).unwrap();
    let tried = |name: &str| tuning.lines().filter(|line| line.starts_with(name)).count();
    assert!((4..=6).contains(&tried("butterworth")) && tried("difference") == 0, "{tuning}");
    for row in rows {
        let name = row["estimator"].as_str().unwrap();
        let (walks, tried_once) = (row["search_walks"].as_u64().unwrap(), tried(name) as u64);
        assert!((tried_once..=2 * tried_once).contains(&walks), "{name}");
        assert!(row["hits"].as_u64().unwrap() > 20 * walks, "{name}");
        assert_eq!(row["search_settled"], tried(name) < 6, "{name}");
    }
    page::has_keys_of("## Of `compare`", &json);
    let table = fs::read_to_string(folder.path().join("a/compare.csv")).unwrap();
    page::has_columns_of("compare.csv", &table);
    // the impedance error is the geometric mean over three walls and seven frequencies in fidelity.csv
    let fidelity = fs::read_to_string(folder.path().join("a/fidelity.csv")).unwrap();
    let shares = fidelity.lines().filter(|line| line.starts_with("butterworth,"));
    let shares: Vec<f64> =
        shares.map(|line| line.split(',').nth(5).unwrap().parse().unwrap()).collect();
    assert_eq!(shares.len(), 21);
    let mean = shares.iter().map(|share| share.max(1e-3).ln()).sum::<f64>() / 21.0;
    let butterworth = rows.iter().find(|row| row["estimator"] == "butterworth").unwrap();
    let share = butterworth["impedance_error_of_estimator"].as_f64().unwrap();
    assert!((share / mean.exp() - 1.0).abs() < 1e-9, "{share}");
    // the motion in these sixteen hits is chaotic
    let [low, mean, high] = ["roughness_low_n", "roughness_n", "roughness_high_n"]
        .map(|key| butterworth[key].as_f64().unwrap());
    assert!(low < mean && mean < high, "{low} {mean} {high}");
    assert_eq!(json["walls"].as_array().unwrap().len(), 3);
    let (code, _, error) = compare(folder.path(), &[few, "--out", "a"]);
    assert!(code == 2 && error.contains("--force"), "{error}");
    // the wall for contacts comes from the tuned Butterworth, even if the list does not contain Butterworth
    let (_, alone, _) =
        compare(folder.path(), &["--json", "--estimators=difference", "--out", "c"]);
    let alone: Value = serde_json::from_str(&alone).unwrap();
    assert_eq!(alone["stiffness_n_per_m"], json["stiffness_n_per_m"]);
    let difference = rows.iter().find(|row| row["estimator"] == "difference").unwrap();
    assert_eq!(alone["estimators"][0], *difference);
}

#[test]
fn force_is_compared_at_a_damping_that_the_boundary_reaches() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let file = folder.path().join("coarse.toml");
    let text = fs::read_to_string(&file).unwrap();
    for (max, damping) in [("1200", 100.0), ("150", 10.0)] {
        let most = format!("damping_max_n_s_per_m = {max}");
        fs::write(&file, text.replace("damping_max_n_s_per_m = 1200", &most)).unwrap();
        let few = ["--json", "--estimators=butterworth", "--budget", "3", "--force"];
        let (code, out, error) = compare(folder.path(), &few);
        assert_eq!(code, 0, "{error}");
        let json: Value = serde_json::from_str(&out).unwrap();
        assert_eq!(json["damping_n_s_per_m"], damping);
        let row = &json["estimators"][0];
        assert!(row["stiffness_at_damping_mean_n_per_m"].as_f64().unwrap() > 0.0, "{row}");
    }
}

/// By default walls must be quiet, and the walks use a special grid. The area by the scene's own criterion is the same
/// as the area that `walk` gives.
#[test]
fn quiet_walls_rank_and_the_scene_s_criterion_stands_beside() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let few = ["--json", "--estimators", "butterworth,kalman-3", "--budget", "3", "--repeat", "1"];
    let run = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
        let all = [&["compare", "coarse.toml"][..], &few, more].concat();
        let output = command.current_dir(folder.path()).args(all).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let quiet = run(&["--out", "quiet"]);
    assert_eq!(quiet, run(&["--criterion", "quiet", "--out", "again"]));
    let row = &quiet["estimators"][0];
    let of = |value: &Value| value.as_f64().unwrap();
    assert!(of(&row["area_n2_s_per_m2"]) < of(&row["scene_area_n2_s_per_m2"]), "{row}");
    let hz = row["tuning"].to_string();
    let mut walk = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    let args = ["walk", "coarse.toml", "--cutoff", &hz, "--json"];
    let output = walk.current_dir(folder.path()).args(args).output().unwrap();
    let walked: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(walked["area_n2_s_per_m2"], row["scene_area_n2_s_per_m2"]);
    let own = run(&["--criterion", "rms", "--out", "own"]);
    assert!(own["estimators"][0]["scene_area_n2_s_per_m2"].is_null());
}

/// Runs the commands for one scene, once at the lowest and once at the highest sample rate.
fn at_both_rates(commands: impl Fn(u32, &str) -> Vec<Vec<String>>) {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let text = fs::read_to_string(folder.path().join("coarse.toml")).unwrap();
    for (rate_hz, every) in [(1000, 1), (50_000, 50)] {
        let text = text
            .replace("rate_hz = 10000", &format!("rate_hz = {rate_hz}"))
            .replace("period = 10 ", &format!("period = {every} "))
            .replace("latency = 10.0", &format!("latency = {every}.0"))
            .replace("500, 1000, 1200, 1500, 1700, 2000, 2500, 3000, 4000]", "400]");
        let name = format!("at{rate_hz}.toml");
        fs::write(folder.path().join(&name), text).unwrap();
        for args in commands(rate_hz, &name) {
            let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
            let output = command.current_dir(folder.path()).args(&args).output().unwrap();
            let error = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{args:?}: {error}");
        }
    }
}

fn words(text: String) -> Vec<String> {
    text.split(' ').map(str::to_owned).collect()
}

#[test]
fn every_command_runs_at_the_lowest_and_the_highest_rate() {
    at_both_rates(|rate_hz, name| {
        let some = match rate_hz {
            1000 => "butterworth,kalman-3,levant-explicit,observer,time-stamps",
            _ => "butterworth,kalman-3",
        };
        [
            format!("hit {name} --cutoff 200 --stiffness 2000 --damping 10"),
            format!("walk {name} --cutoff 200"),
            format!("grid {name} --cutoffs 200 --dampings 10 --stiffnesses 2000"),
            format!("linear {name} --cutoffs 200 --dampings 10 --multirate"),
            format!("sweep {name} --repeat 1"),
            format!("compare {name} --criterion rms --estimators {some} --budget 3 --repeat 1"),
        ]
        .map(words)
        .to_vec()
    });
}

#[test]
#[ignore = "50 s; CI runs it"]
fn trade_runs_at_the_lowest_and_the_highest_rate() {
    at_both_rates(|_, name| vec![words(format!("trade {name} --cutoffs 200 --repeat 1"))]);
}

#[test]
fn the_terminal_gets_tables_of_at_most_120_columns_with_what_each_estimator_needs() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let some = "--estimators=first-order,levant-explicit,observer,foaw-best,time-stamps,kalman-3";
    let extra = [some, "--budget", "4", "--repeat", "2"];
    let (code, text, error) = compare(folder.path(), &extra);
    assert_eq!(code, 0, "{error}");
    let widest = text.lines().map(|line| line.chars().count()).max().unwrap();
    assert!((80..=120).contains(&widest), "{widest} columns:\n{text}");
    for part in
        ["position only", "commanded force + mass", "edge times", "lambda_ratio", "mass -20 %"]
    {
        assert!(text.contains(part), "{part}:\n{text}");
    }
    // with few tunings, some best tunings are at the end of a range; each of these has a star and a reason
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let stars = text.matches('*').count() - 1; // one star is in the heading
    assert!(stars > 0 && stars == words.matches("is an end of its range").count(), "{text}");
    // each estimator with one parameter has the same number of tunings; an estimator with two parameters has four times
    // as many
    let tuning =
        fs::read_to_string(folder.path().join("zwidth-out/coarse/compare/tuning.csv")).unwrap();
    for (name, most) in
        [("first-order", 4), ("levant-explicit", 16), ("observer", 16), ("kalman-3", 4)]
    {
        let tried = tuning.lines().filter(|line| line.starts_with(&format!("{name},"))).count();
        assert!(tried <= most && tried > most / 2, "{name}: {tried}");
    }
    let csv =
        fs::read_to_string(folder.path().join("zwidth-out/coarse/compare/compare.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{csv}");
    let column = |key: &str| rows[0].iter().position(|head| *head == key).unwrap();
    for row in &rows[1..] {
        let model = row[0] == "observer";
        assert_eq!(!row[column("left_when_mass_low")].is_empty(), model, "{row:?}");
        // only for estimators that use the motor's force does it matter whether motor or hand pushes
        let [hand, motor] =
            ["phase_100_hz_hand_deg", "phase_100_hz_motor_deg"].map(|k| row[column(k)]);
        assert_eq!(hand != motor, model, "{row:?}");
    }
}

#[test]
fn bad_arguments_are_refused_with_what_is_allowed() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    for (extra, text) in [
        (["--estimators", "best"], "allowed butterworth"),
        (["--estimators", "levant-kalman"], "levant-kalman is no more: use kalman-3"),
        (["--damping", "1e9"], "--damping is 1000000000, allowed 10 to 1200"),
        (["--budget", "2"], "--budget"),
        (["--numeric", "f64"], "--numeric"),
        (["--estimators", "fusion"], "[accelerometer]"),
        (["--repeat", "0"], "--repeat"),
    ] {
        let (code, out, error) = compare(folder.path(), &extra);
        assert_eq!((code, out.as_str()), (2, ""), "{extra:?}");
        assert!(error.contains(text), "{extra:?}: {error}");
        assert_eq!(error.trim().lines().count(), 1);
    }
    assert!(!folder.path().join("zwidth-out").exists());
}

/// Compares the published order of estimators with a filter of 50 Hz that is not tuned. A tuned filter is as good as
/// the best of these estimators, as docs/lab/comparison.md shows.
#[test]
#[ignore = "a search of eight estimators; CI runs it"]
fn levant_windowing_and_kalman_raise_the_stiffest_wall_of_an_untuned_filter() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let peak = |json: &Value, name: &str| {
        let rows = json["estimators"].as_array().unwrap();
        let row = rows.iter().find(|row| row["estimator"] == name).unwrap();
        row["stiffness_peak_mean_n_per_m"].as_f64().unwrap()
    };
    // the resolution of 1 um, and enough tunings for the narrow range of Levant's explicit form
    let path = folder.path().join("coarse.toml");
    let fine =
        fs::read_to_string(&path).unwrap().replace("resolution_m = 2e-6", "resolution_m = 1e-6");
    fs::write(&path, fine).unwrap();
    let names = "--estimators=levant-explicit,levant-implicit,foaw-end,foaw-best,kalman-2,kalman-3,\
                 butterworth,first-order at 50 Hz";
    let extra = ["--json", "--out", "all", "--repeat", "1", "--budget", "12", names];
    let (code, all, error) = compare(folder.path(), &extra);
    assert_eq!(code, 0, "{error}");
    let json: Value = serde_json::from_str(&all).unwrap();
    let untuned = peak(&json, "first-order at 50 Hz");
    for (name, published) in [
        ("levant-explicit", 2.07),
        ("levant-implicit", 2.07),
        ("foaw-end", 1.93),
        ("foaw-best", 1.93),
        ("kalman-2", 1.33),
        ("kalman-3", 1.33),
        ("butterworth", 1.0),
    ] {
        let ratio = peak(&json, name) / untuned;
        println!("{name}: {ratio:.2} times the peak K of 50 Hz, published {published}");
        assert!(ratio >= published, "{name}: {ratio}");
    }
}

#[test]
fn conditions_of_the_command_line_are_those_of_a_scene() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let file = folder.path().join("coarse.toml");
    let text = fs::read_to_string(&file).unwrap();
    let few = ["--json", "--estimators=butterworth", "--budget", "3", "--repeat", "1", "--force"];
    let asked = [
        "--limit",
        "4e-6",
        "--rms-of",
        "motion",
        "--push",
        "hand",
        "--latency",
        "9.5",
        "--period",
        "5",
    ];
    let asked = [&few[..], &asked].concat();
    let (code, typed, error) = compare(folder.path(), &asked);
    assert_eq!(code, 0, "{error}");
    let manifest =
        fs::read_to_string(folder.path().join("zwidth-out/coarse/compare/manifest.json"));
    let command = " --limit 4e-6 --rms-of motion --push hand --latency 9.5 --period 5 --damping";
    assert!(manifest.unwrap().contains(command));
    let (_, own, _) = compare(folder.path(), &few);
    assert_ne!(typed, own);
    let keys = "[wall_hit]\nrms_of = \"motion\"\npush_by = \"hand\"";
    let limited: String = text
        .replace("[wall_hit]", keys)
        .lines()
        .map(|line| match line.split_once(" = ") {
            Some(("rms_limit_m", _)) => "rms_limit_m = 4e-6\n".into(),
            Some(("latency", _)) => "latency = 9.5\n".into(),
            Some(("period", _)) => "period = 5\n".into(),
            _ => format!("{line}\n"),
        })
        .collect();
    fs::write(&file, limited).unwrap();
    let (_, written, error) = compare(folder.path(), &few);
    assert_eq!(typed, written, "{error}");
    let json: Value = serde_json::from_str(&written).unwrap();
    let row = &json["estimators"][0];
    let of = |value: &Value| value.as_f64().unwrap();
    let share = of(&row["area_n2_s_per_m2"]) / of(&json["true_velocity_area_n2_s_per_m2"]);
    assert!(
        (of(&row["share_of_true_velocity"]) - share).abs() < 1e-12 && share > 0.0 && share < 1.0
    );
    for (option, value, said) in [
        (
            "--limit",
            "0",
            "allowed an RMS in m (above 0), quiet, felt, or felt=DB (DB over the threshold)",
        ),
        ("--limit", "1e-6,felt", "allowed one"),
        ("--arm", "nobody", "--arm: "),
        ("--push", "foot", "hand"),
        ("--latency", "-1", "actuator.latency is -1, allowed 0"),
        ("--period", "0", "actuator.period is 0, allowed 1"),
    ] {
        let (code, _, error) = compare(folder.path(), &[option, value]);
        assert!(code == 2 && error.contains(said), "{option}: {error}");
    }
}

#[test]
fn peers_are_a_table_for_programs_and_one_for_people() {
    let folder = TempDir::new().unwrap();
    scene(folder.path());
    let asked = ["--peers", "--limits", "15e-6", "--steps", "8000,80", "--repeat", "1"];
    let run = |extra: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_host-sim"))
            .current_dir(folder.path())
            .args(["compare", "coarse.toml", "--force"])
            .args(asked)
            .args(extra)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let json: Value = serde_json::from_str(&run(&["--json", "--threads", "1"])).unwrap();
    let areas = json["areas"].as_array().unwrap();
    // there are three loops: the scene's, and those of two boards; each has 13 defaults, the scene's estimator at two
    // cutoffs, and the true velocity
    assert_eq!(areas.len(), 3 * 16);
    let csv = fs::read_to_string(folder.path().join("zwidth-out/coarse/peers/peers.csv")).unwrap();
    page::has_keys_of("### Of `compare --peers`", &json);
    page::has_columns_of("peers.csv", &csv);
    assert_eq!(csv.lines().count(), 1 + areas.len());
    for (area, line) in areas.iter().zip(csv.lines().skip(1)) {
        assert!(line.contains(area["estimator"].as_str().unwrap()), "{line}");
        assert!(line.contains(&format!(",{},", area["area_n2_s_per_m2"].as_f64().unwrap())));
        let share = area["share_of_true_velocity"].as_f64().unwrap();
        assert!(share == 1.0 || area["estimator"] != "true-velocity", "{area}");
    }
    let text = run(&["--threads", "2"]);
    assert!(
        text.contains("latency 0.14 samples") && text.contains("DHD_VELOCITY_WINDOW"),
        "{text}"
    );
}
