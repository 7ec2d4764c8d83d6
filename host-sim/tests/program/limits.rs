//! Tests `sweep --limits` and `sweep --plain`.

use std::{collections::BTreeSet, fs};

use tempfile::TempDir;

use crate::{
    cli::{refused, sim},
    page,
};

#[test]
#[ignore = "two more reports; CI makes them"]
fn plain_leaves_out_the_limits_and_nothing_else() {
    let folder = TempDir::new().unwrap();
    let sweep = |out: &str, extra: &[&str]| {
        let args = ["sweep", "paper-2um", "--cutoffs", "100", "--repeat", "2", "--out", out];
        assert!(sim(folder.path(), &[&args[..], extra].concat()).status.success());
    };
    sweep("default", &[]);
    sweep("plain", &["--plain"]);
    let names = |of: &str| -> BTreeSet<String> {
        let files = fs::read_dir(folder.path().join(of)).unwrap();
        files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect()
    };
    let [default, plain] = ["default", "plain"].map(names);
    let more: Vec<&String> = default.difference(&plain).collect();
    assert!(plain.is_subset(&default), "{plain:?}");
    let quiet = ["quiet.png", "quiet.svg", "quiet_area.png", "quiet_area.svg", "quiet_areas.csv"];
    assert_eq!(more, [&["limits.csv"], &quiet[..], &["quiet_boundary.csv"]].concat());
    for name in ["areas.csv", "boundary.csv", "envelope.csv", "area.svg", "zwidth.svg"] {
        let bytes = |of: &str| fs::read(folder.path().join(of).join(name)).unwrap();
        assert!(bytes("default") == bytes("plain"), "{name} depends on --plain");
    }
}

#[test]
fn limits_are_rows_by_who_pushes_and_in_whose_hand() {
    let folder = TempDir::new().unwrap();
    let args =
        ["sweep", "paper-2um", "--cutoffs", "200,500", "--repeat", "1", "--out", "out", "--limits"];
    let more = ["5e-6,felt", "--arms", "light", "--steps", "16000,160", "--engine", "core"];
    for (out, more) in [("out", &more[..5]), ("core", &more)] {
        let args: Vec<&str> =
            args.iter().map(|arg| if *arg == "out" { out } else { *arg }).collect();
        let output = sim(folder.path(), &[&args[..], more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let read = |of: &str| fs::read_to_string(folder.path().join(of).join("limits.csv")).unwrap();
    let text = read("out");
    assert_eq!(text, read("core"));
    page::has_columns_of("limits.csv", &text);
    let summary = fs::read_to_string(folder.path().join("out/summary.json")).unwrap();
    page::has_keys_of("## `sweep [SCENE..]`", &serde_json::from_str(&summary).unwrap());
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|row| row.split(',').collect()).collect();
    // there are five limits and five situations (motor, hand, motor with the arm, hand with the arm, the worst case);
    // each has rows for two cutoffs and for the true velocity
    assert_eq!(rows.len(), 5 * 5 * 3);
    assert!(rows.iter().all(|row| row.len() == text.lines().next().unwrap().split(',').count()));
    let area = |push: &str, arm: &str, limit: &str, cutoff: &str| -> f64 {
        let row = rows.iter().find(|row| row[..3] == [push, arm, limit] && row[5] == cutoff);
        row.unwrap()[6].parse().unwrap()
    };
    for cutoff in ["200", "500"] {
        let all = [("motor", ""), ("hand", ""), ("motor", "light"), ("hand", "light")];
        let areas = all.map(|(push, arm)| area(push, arm, "0.000005", cutoff));
        let least = areas.into_iter().fold(f64::INFINITY, f64::min);
        assert_eq!(area("worst", "", "0.000005", cutoff), least);
        assert!(area("motor", "", "30", cutoff) > area("motor", "", "0", cutoff));
    }
    assert!(area("motor", "", "0.000005", "") > area("motor", "", "0.000005", "500"), "the truth");
}

#[test]
fn what_cannot_be_asked_is_refused() {
    let folder = TempDir::new().unwrap();
    for (args, expected) in [
        (
            &["--limits", "1e-6,x"][..],
            "`x` is no limit, allowed an RMS in m (above 0), quiet, felt, or felt=DB (DB over the threshold)",
        ),
        (&["--limits", "1e-12"], "--limits: wall_hit.rms_limit_m is 0.000000000001, allowed"),
        (
            &["--limits", "1e-6", "--arms", "nobody"],
            "there is no arm `nobody`, allowed heavy, light",
        ),
        (
            &["--limits", "1e-6", "--steps", "500"],
            "`500`: two numbers K,B are needed, for example 500,5",
        ),
        (&["--limits", "1e-6", "--starts", "0,5"], "walk.stiffness_start_n_per_m is 0, allowed"),
    ] {
        let line = refused(folder.path(), &[&["sweep", "paper-1um"][..], args].concat());
        assert!(line.contains(expected), "{line}");
    }
    let curve = "wall_hit.felt_curve";
    let scene = include_str!("../../../scenes/paper-1um.toml");
    let scene = scene.replace("push_n = 2.835", "push_n = 2.835\nfelt_curve = \"my.csv\"");
    fs::write(folder.path().join("mine.toml"), scene).unwrap();
    let walk = ["walk", "mine.toml", "--cutoff", "500"];
    assert!(refused(folder.path(), &walk).contains(curve), "no such file");
    fs::write(folder.path().join("my.csv"), "frequency_hz,threshold_rms_m\n10,1e-6\n5,1e-6\n")
        .unwrap();
    assert!(
        refused(folder.path(), &walk)
            .contains("my.csv: line 3: frequency_hz is 5, allowed above 10")
    );
}
