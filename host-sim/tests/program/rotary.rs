//! A rotary scene and the linear scene of the same device give the same results in different units.

use std::{fs, path::Path};

use host_sim::scene::Units;
use serde_json::Value;
use tempfile::TempDir;

use crate::cli::{refused, sim};

const RADIUS_M: f64 = 0.07;
const HAND: Units = Units::Rotary { radius_m: RADIUS_M };
/// Relative tolerance of the comparisons. It allows for results that have twelve digits in rotary units.
const ROUNDING: f64 = 1e-11;

const ROTARY: &str = include_str!("paddle/rotary.toml");
const BY_HAND: &str = include_str!("paddle/by-hand.toml");

/// The texts at these JSON keys contain numbers with units.
const IN_WORDS: [&str; 5] = ["change", "what", "cost", "answers", "reason"];
/// Relative tolerance for numbers in texts, because these numbers have three digits.
const READ: f64 = 1e-2;
/// What the texts count the encoder's counts per: for a rotary scene, and for a linear scene.
const COUNTS: [(&str, &str); 1] = [("turn of the handle", "mm of handle")];

/// A scene file with a fixed name, in its own folder.
fn scene(of: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("mine.toml"), of).unwrap();
    folder
}

/// The name that a linear key has in rotary units, and the factor for its numbers.
fn told(key: &str) -> (String, f64) {
    let (r, one) = (RADIUS_M, 1.0);
    for (linear, rotary, factor) in [
        ("n2_s_per_m2", "n2_m2_s_per_rad2", r.powi(4)),
        ("mass_kg", "inertia_kg_m2", r * r),
        ("n_per_m", "n_m_per_rad", r * r),
        ("n_s_per_m", "n_m_s_per_rad", r * r),
        ("m_per_s", "rad_per_s", one / r),
        ("_n", "_n_m", r),
        ("_m", "_rad", one / r),
    ] {
        if let Some(stem) = key.strip_suffix(linear) {
            return (format!("{stem}{rotary}"), factor);
        }
    }
    (key.into(), if key.starts_with("area") { r.powi(4) } else { one })
}

#[track_caller]
fn is_told(at_handle: f64, rotary: f64, factor: f64, what: &str) {
    let due = at_handle * factor;
    if factor == 1.0 {
        assert_eq!(rotary, at_handle, "{what}");
    } else {
        assert!((rotary - due).abs() <= ROUNDING * due.abs(), "{what}: {rotary} for {due}");
    }
}

#[track_caller]
fn same_tables(rotary: &Path, by_hand: &Path) {
    let [rotary_text, hand_text] = [rotary, by_hand].map(|file| fs::read_to_string(file).unwrap());
    let mut lines = rotary_text.lines().zip(hand_text.lines());
    let (head, hand_head) = lines.next().unwrap();
    let columns: Vec<(String, f64)> = hand_head.split(',').map(told).collect();
    let names: Vec<&str> = columns.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(head, names.join(","));
    assert_eq!(rotary_text.lines().count(), hand_text.lines().count());
    for (row, hand_row) in lines {
        for ((cell, hand_cell), (name, factor)) in
            row.split(',').zip(hand_row.split(',')).zip(&columns)
        {
            match (cell.parse(), hand_cell.parse()) {
                (Ok(cell), Ok(hand_cell)) => is_told(hand_cell, cell, *factor, name),
                _ => assert_eq!(cell, hand_cell, "{name}"),
            }
        }
    }
}

/// The text with each force in N, without a unit prefix.
fn unprefixed(text: &str) -> String {
    let mut words: Vec<String> = text.split(' ').map(str::to_owned).collect();
    for n in 1..words.len() {
        let prefix = [("kN", 1e3), ("MN", 1e6), ("mN", 1e-3), ("uN", 1e-6)];
        let found = prefix.into_iter().find(|(prefix, _)| words[n].starts_with(prefix));
        let number = words[n - 1].trim_start_matches('(').parse::<f64>();
        if let (Some((_, times)), Ok(number)) = (found, number) {
            let open = if words[n - 1].starts_with('(') { "(" } else { "" };
            words[n - 1] = format!("{open}{}", (number * times * 1e9).round() / 1e9);
            words[n].remove(0);
        }
    }
    words.join(" ")
}

/// Asserts that the texts for people have the same words. Their numbers must agree in rotary units, with few digits.
#[track_caller]
fn same_words(rotary: &str, by_hand: &str) {
    let digits = |word: &str| word.chars().filter(char::is_ascii_digit).count();
    assert!(rotary.split(' ').all(|word| digits(word) <= 6), "{rotary}");
    let mut due = HAND.text(&unprefixed(by_hand));
    let rotary = &unprefixed(rotary);
    let mut counts = 1.0;
    for (turn, mm) in COUNTS {
        if due.contains(mm) {
            due = due.replace(mm, turn);
            counts = 2e3 * std::f64::consts::PI * RADIUS_M;
        }
    }
    let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let (words, due) = (words(rotary), words(&due));
    assert_eq!(words.len(), due.len(), "{rotary}: {by_hand}");
    for (n, (word, due)) in words.iter().zip(&due).enumerate() {
        let bare = |word: &str| word.trim_matches(['(', ')', ',', ';', '?', '.', '>']).to_owned();
        let (Ok(value), Ok(hand)) = (bare(word).parse::<f64>(), bare(due).parse::<f64>()) else {
            assert_eq!(word, due, "{rotary}: {by_hand}");
            continue;
        };
        let is_counts = words.get(n + 1).is_some_and(|unit| unit == "counts");
        let hand = if is_counts { hand * counts } else { hand };
        // a count is shown as a whole number
        let slack = if is_counts { 0.5 * counts } else { READ * hand.abs() };
        assert!((value - hand).abs() <= slack, "{rotary}: {by_hand}, {word} for {hand}");
    }
}

#[track_caller]
fn same_json(rotary: &Value, by_hand: &Value, factor: f64, what: &str) {
    match (rotary, by_hand) {
        (Value::Object(rotary), Value::Object(by_hand)) => {
            assert_eq!(rotary.len(), by_hand.len(), "{what}");
            for (key, value) in by_hand {
                let (told_key, mut factor) = told(key);
                // the key `value` is the value of a winner; the winner's criterion determines the unit
                if let (Some(criterion), "value") = (by_hand.get("criterion"), key.as_str()) {
                    factor = told(criterion.as_str().unwrap()).1;
                }
                let rotary =
                    rotary.get(&told_key).unwrap_or_else(|| panic!("{what}: no {told_key}"));
                same_json(rotary, value, factor, key);
            }
        }
        (Value::Array(rotary), Value::Array(by_hand)) => {
            assert_eq!(rotary.len(), by_hand.len(), "{what}");
            rotary.iter().zip(by_hand).for_each(|(a, b)| same_json(a, b, factor, what));
        }
        (Value::Number(rotary), Value::Number(by_hand)) => {
            is_told(by_hand.as_f64().unwrap(), rotary.as_f64().unwrap(), factor, what);
        }
        (Value::String(rotary), Value::String(by_hand)) if what == "criterion" => {
            assert_eq!(*rotary, told(by_hand).0);
        }
        // each text selects its own power of ten
        (Value::String(_), Value::String(_)) if what == "notes" => {}
        (Value::String(rotary), Value::String(by_hand)) if IN_WORDS.contains(&what) => {
            same_words(rotary, by_hand);
        }
        _ => assert_eq!(rotary, by_hand, "{what}"),
    }
}

fn run(folder: &Path, args: &[&str]) -> Value {
    let output = sim(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or_default()
}

/// Runs a command with both scenes, and compares the results. `tables` are the files that the command writes.
#[track_caller]
fn same(rotary_args: &[&str], hand_args: &[&str], tables: &[&str]) {
    let (rotary, by_hand) = (scene(ROTARY), scene(BY_HAND));
    let json = run(rotary.path(), rotary_args);
    let hand_json = run(by_hand.path(), hand_args);
    assert!(json.is_object());
    same_json(&json, &hand_json, 1.0, "result");
    for table in tables {
        same_tables(&rotary.path().join(table), &by_hand.path().join(table));
    }
}

#[test]
fn hit_walk_and_grid_are_the_same_in_other_units() {
    let hit = |k, b| {
        let wall = ["--cutoff", "1000", "--stiffness", k, "--damping", b, "--trace", "t.csv"];
        [&["hit", "mine.toml", "--json"], &wall[..]].concat()
    };
    same(&hit("4.9", "0.049"), &hit("1000", "10"), &["t.csv"]);
    let walk = ["walk", "mine.toml", "--cutoff", "1000", "--csv", "w.csv", "--json"];
    same(&walk, &walk, &["w.csv"]);
    let grid = |k, b| {
        [
            "grid",
            "mine.toml",
            "--cutoffs",
            "1000",
            "--stiffnesses",
            k,
            "--dampings",
            b,
            "--csv",
            "g.csv",
            "--json",
        ]
    };
    same(&grid("4.9,98", "0.049"), &grid("1000,20000", "10"), &["g.csv"]);
}

#[test]
fn a_sweep_is_the_same_in_other_units_and_its_figures_name_them() {
    let sweep = ["sweep", "mine.toml", "--repeat", "2", "--out", "out", "--json"];
    let tables = ["areas", "boundary", "envelope", "limits"].map(|name| format!("out/{name}.csv"));
    same(&sweep, &sweep, &tables.each_ref().map(String::as_str));
    let rotary = scene(ROTARY);
    run(rotary.path(), &sweep);
    let file = |name: &str| fs::read_to_string(rotary.path().join("out").join(name)).unwrap();
    for (name, units) in [
        ("zwidth.svg", &["N m/rad", "N m s/rad"][..]),
        ("area.svg", &["N² m² s/rad²"]),
        ("hit.svg", &["True angle [deg]", "mdeg", "N m/rad"]),
        ("report.html", &["N m/rad", "N m s/rad", "N² m² s/rad²", "mdeg encoder"]),
    ] {
        let text = file(name);
        for unit in units {
            assert!(text.contains(unit), "{name} has no {unit}");
        }
        assert!(!text.contains("N/m") && !text.contains("N s/m"), "{name}");
    }
    assert!(file("summary.json").contains("stiffness_peak_n_m_per_rad"));
}

#[test]
fn assumptions_are_changed_in_the_scenes_units() {
    let sweep =
        ["sweep", "mine.toml", "--plain", "--sensitivity", "--cutoffs", "1000", "--repeat", "1"];
    let args = [&sweep[..], &["--out", "out", "--json"]].concat();
    same(&args, &args, &["out/sensitivity.csv"]);
    let rotary = scene(ROTARY);
    let text = String::from_utf8(sim(rotary.path(), &sweep).stdout).unwrap();
    for part in ["start at 14.3 deg instead of 0 deg", "RMS limit 45.8 mdeg instead of 22.9 mdeg"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains(" m instead") && !text.contains("um"), "{text}");
}

#[test]
fn what_limits_the_walls_is_the_same_in_other_units() {
    let explain = ["explain", "mine.toml", "--budget", "3", "--repeat", "2", "--out", "out"];
    let args = [&explain[..], &["--criterion", "rms", "--json"]].concat();
    same(&args, &args, &["out/boundary.csv"]);
    // Quiet walls, with shorter hits.
    let short = ROTARY.replace("settle_s = 1.0", "settle_s = 0.3");
    let rotary = scene(&short.replace("window_s = 0.5", "window_s = 0.1"));
    let output = sim(rotary.path(), &explain);
    let text = String::from_utf8(output.stdout).unwrap();
    let file = |name: &str| fs::read_to_string(rotary.path().join("out").join(name)).unwrap();
    let at_handle = ["N/m", "N s/m", "m/s", " um", " mm", "per mm", " >0.00"];
    for (name, text, units) in [
        ("text", text, &["N m/rad", "N m s/rad", "deg/s", "N² m² s/rad²", "mdeg"][..]),
        (
            "explain.csv",
            file("explain.csv"),
            &["mdeg", "2.6 N m", "106496 counts per turn of the handle"],
        ),
        ("explain.svg", file("explain.svg"), &["N m/rad", "N m s/rad", "\nas it is\n"]),
        ("report.html", file("report.html"), &["N m/rad", "N² m² s/rad²", "mdeg"]),
    ] {
        for unit in units {
            assert!(text.contains(unit), "{name} has no {unit}: {text}");
        }
        for unit in at_handle {
            assert!(!text.contains(unit), "{name} has {unit}: {text}");
        }
        // numbers in sentences have few digits, but files for programs have all digits
        let words = text.split([' ', ',', ';', '<', '>', '(', ')']);
        let long = words.filter(|word| word.parse::<f64>().is_ok_and(|_| word.len() > 9));
        let long: Vec<_> = long.collect();
        assert!(
            name == "explain.csv" || name == "explain.svg" || long.is_empty(),
            "{name}: {long:?}"
        );
    }
}

#[test]
fn linear_theory_and_a_comparison_are_the_same_in_other_units() {
    let linear = |b| {
        let options =
            ["--cutoffs", "200,1000", "--dampings", b, "--multirate", "--passivity", "--simulated"];
        [&["linear", "mine.toml", "--csv", "l.csv", "--json"], &options[..]].concat()
    };
    same(&linear("0,0.049,0.098"), &linear("0,10,20"), &["l.csv"]);
    let options = [
        "--estimators",
        "butterworth,kalman-2",
        "--budget",
        "3",
        "--repeat",
        "2",
        "--out",
        "out",
        "--json",
    ];
    let compare = [&["compare", "mine.toml"], &options[..]].concat();
    same(&compare, &compare, &["out/compare.csv", "out/boundary.csv", "out/fidelity.csv"]);
}

#[test]
fn a_record_says_the_same_device_in_other_units() {
    let (rotary, by_hand) = (scene(ROTARY), scene(BY_HAND));
    let [json, hand_json] =
        [&rotary, &by_hand].map(|folder| run(folder.path(), &["prepare", "mine.toml", "--json"]));
    for key in ["scene_hash", "envelope_hash", "sign_test_counts"] {
        assert_eq!(json[key], hand_json[key], "{key}");
    }
    let (full, at_handle) = (&json["full_scale_n_m"], &hand_json["full_scale_n"]);
    is_told(at_handle.as_f64().unwrap(), full.as_f64().unwrap(), RADIUS_M, "full scale");
    let text = sim(rotary.path(), &["prepare", "mine.toml", "--force"]).stdout;
    let text = String::from_utf8(text).unwrap();
    for part in
        ["from -28.65 to 57.3 deg", "1.3 N m at full command", "off above 802.1 deg/s", "N m/rad"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn what_a_rotary_scene_cannot_have_is_one_line_that_says_it() {
    let bad = |from: &str, to: &str| {
        assert!(ROTARY.contains(from), "{from}");
        let folder = scene(&ROTARY.replacen(from, to, 1));
        refused(
            folder.path(),
            &["hit", "mine.toml", "--cutoff", "500", "--stiffness", "1", "--damping", "0"],
        )
    };
    for (from, to, wanted) in [
        (
            "position_rad = 0.5",
            "position_m = 0.035",
            "wall.position_m: with [rotary] it is position_rad",
        ),
        (
            "position_rad = 0.5",
            "position_rad = 2e4",
            "wall.position_rad is 20000, allowed -14285.714",
        ),
        ("ratio = 13", "ratio = 0", "rotary.ratio is 0, allowed 0.001 to 10000"),
        ("ratio = 13\n", "", "missing field `ratio`"),
        ("ratio = 13", "ratio = 13\nradius = 1", "unknown field `radius`"),
        (
            "drive = \"current\"",
            "drive = \"voltage\"",
            "rotary.drive is `voltage`, which takes resistance_ohm",
        ),
        ("drive = \"current\"", "drive = \"power\"", "unknown variant `power`"),
        (
            "limit_v = 10",
            "gain_n_per_v = 1\nlimit_v = 10",
            "actuator.gain_n_per_v: with [rotary] it follows",
        ),
        ("[encoder]", "[device]\nmass_kg = 1\n\n[encoder]", "with [rotary] there is no [device]"),
        ("push_n_m = 0.14", "push_n_m = 2", "wall_hit.push_n_m is 2, allowed -1.29999"),
        (
            "handle_inertia_kg_m2 = 2.1e-4",
            "handle_inertia_kg_m2 = 0.9",
            "device.inertia_kg_m2 is 0.9",
        ),
        ("[rotary]", "estimated = [\"rotary.mass\"]\n[rotary]", "estimated has `rotary.mass`"),
    ] {
        let line = bad(from, to);
        assert!(line.contains(wanted) && line.contains("mine.toml"), "{wanted}: {line}");
    }
    let heavy = "[safety]\nheaviest_inertia_kg_m2 = 1e-5";
    let folder = scene(&ROTARY.replacen("[safety]", heavy, 1));
    let line = refused(folder.path(), &["prepare", "mine.toml"]);
    let wanted = "safety.heaviest_inertia_kg_m2 is 0.00001, allowed 0.000379";
    assert!(line.contains(wanted), "{line}");
    let folder = scene(&BY_HAND.replacen("position_m = 0.035", "position_rad = 0.5", 1));
    let line = refused(folder.path(), &["prepare", "mine.toml"]);
    assert!(line.contains("unknown field `position_rad`"), "{line}");
    let folder = scene(ROTARY);
    let line = refused(
        folder.path(),
        &["hit", "mine.toml", "--cutoff", "500", "--stiffness", "1e6", "--damping", "0"],
    );
    assert!(line.contains("--stiffness is 1000000, allowed 0 to 49000"), "{line}");
}

/// With a voltage amplifier, the back-EMF acts as damping. Full scale is the force that the supply voltage gives at
/// standstill.
#[test]
fn a_voltage_amplifier_damps_by_back_emf() {
    let voltage = ROTARY
        .replacen(
            "drive = \"current\"\namplifier_a_per_v = 0.5",
            "drive = \"voltage\"\nresistance_ohm = 2\nsupply_v = 10",
            1,
        )
        .replacen("limit_v = 10\n", "", 1);
    let torque = 13.0 * 0.02_f64;
    let by_hand = BY_HAND.replacen(
        "damping_n_s_per_m = 0.102040816326531",
        &format!(
            "damping_n_s_per_m = {:.14e}",
            (5e-4 + torque * torque / 2.0) / (RADIUS_M * RADIUS_M)
        ),
        1,
    );
    let (rotary, by_hand) = (scene(&voltage), scene(&by_hand));
    let wall = |k: &'static str, b: &'static str| {
        ["hit", "mine.toml", "--cutoff", "1000", "--json", "--stiffness", k, "--damping", b]
    };
    let json = run(rotary.path(), &wall("4.9", "0.049"));
    let hand_json = run(by_hand.path(), &wall("1000", "10"));
    same_json(&json, &hand_json, 1.0, "result");
}

/// A user types the output of `identify --plan` at the console, which expects rad and N m.
#[test]
fn a_plan_is_in_the_units_of_the_console() {
    let plan = |of: &str| {
        let folder = scene(of);
        let json = run(folder.path(), &["identify", "--plan", "--base", "mine.toml", "--json"]);
        let lines = json["console"].as_array().unwrap().iter();
        lines.map(|line| line.as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let (rotary, by_hand) = (plan(ROTARY), plan(BY_HAND));
    assert_eq!(rotary.len(), by_hand.len());
    let mut converted = 0;
    for (line, hand_line) in rotary.iter().zip(&by_hand) {
        let factor = match hand_line.split(' ').next() {
            Some("start") => 1.0 / RADIUS_M,
            Some("pulses") => RADIUS_M,
            _ => {
                assert_eq!(line, hand_line);
                continue;
            }
        };
        let number = |line: &str| line.split(' ').nth(1).unwrap().parse::<f64>().unwrap();
        let due = number(hand_line) * factor;
        assert!((number(line) / due - 1.0).abs() < 1e-3, "{line}: {hand_line}");
        converted += 1;
    }
    assert_eq!(converted, 2);
}
