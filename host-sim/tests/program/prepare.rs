//! Tests `prepare`, which makes the device records for the boards' images, and its errors.

use std::{fs, path::Path};

use host_sim::scene::{
    BUILT_IN,
    record::{board_facts, words},
};
use serde_json::Value;
use tempfile::TempDir;
use zwidth::device::Device;

use crate::cli::{refused, sim};

const NUCLEO: &str = include_str!("../../../scenes/nucleo-f446re.toml");

/// A scene for the NUCLEO with short walks. Each pair of `edits` is (from, to): in the scene's text, `from` is replaced
/// with `to`.
fn scene(edits: &[(&str, &str)]) -> TempDir {
    let mut text = NUCLEO.to_owned();
    let short = [
        ("stiffness_step_n_per_m = 5000", "stiffness_step_n_per_m = 50000"),
        ("damping_step_n_s_per_m = 10", "damping_step_n_s_per_m = 200"),
        ("[50, 100, 200, 500, 1000, 1200, 1500, 1700, 2000, 2500, 3000, 4000]", "[500, 1500]"),
    ];
    for (from, to) in short.iter().chain(edits) {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("mine.toml"), text).unwrap();
    folder
}

#[test]
fn the_first_cutoff_is_the_boards_then_the_filters() {
    let first = |edits: &[(&str, &str)]| {
        let folder = scene(edits);
        let output = sim(folder.path(), &["prepare", "mine.toml", "--json"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()["cutoff_hz"].clone()
    };
    let of_filter = ("prewarp = false", "prewarp = false\ncutoff_hz = 800");
    assert_eq!(first(&[of_filter]), 360.0);
    assert_eq!(first(&[("cutoff_hz = 360 #", "#"), of_filter]), 800.0);
    // without a cutoff in the scene, the board gets the recommended cutoff
    let folder = scene(&[("cutoff_hz = 360 #", "#")]);
    let output = sim(folder.path(), &["prepare", "mine.toml", "--json"]);
    let made: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(made["cutoff_hz"], made["recommended"]["cutoff_hz"]);
    assert_eq!(made["envelope"][0]["boundaries"], 3, "its walls are in the envelope");
    // the cutoff is for the estimator of the board, not for the scene's own estimator
    let other =
        ("name = \"nucleo-f446re\"", "name = \"nucleo-f446re\"\nestimators = [\"first-order\"]");
    let folder = scene(&[("cutoff_hz = 360 #", "#"), other]);
    let output = sim(folder.path(), &["prepare", "mine.toml", "--json"]);
    let of_first: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(of_first["cutoff_hz"], of_first["recommended"]["cutoff_hz"]);
    assert_ne!(of_first["recommended"], made["recommended"]);
}

/// `prepare` and `sweep` recommend the same cutoff. A note appears if the first cutoff is outside the recommended
/// range.
#[test]
fn it_says_which_cutoff_to_dial_in() {
    let folder = scene(&[]);
    let json = |command: &str| {
        let output = sim(folder.path(), &[command, "mine.toml", "--json", "--force"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let recommended = json("prepare")["recommended"].clone();
    assert_eq!(recommended, json("sweep")["scenes"][0]["recommended"]);
    let [low, high] = [0, 1].map(|end| recommended["range_hz"][end].as_f64().unwrap());
    assert!(low >= 150.0 && high <= 1000.0, "{recommended}");
    for (first_hz, outside) in [(1500.0, true), ((low + high) / 2.0, false)] {
        let text = fs::read_to_string(folder.path().join("mine.toml")).unwrap();
        let text = text.replacen("cutoff_hz = 360 #", &format!("cutoff_hz = {first_hz} #"), 1);
        fs::write(folder.path().join("mine.toml"), text).unwrap();
        let output = sim(folder.path(), &["prepare", "mine.toml", "--force"]);
        let said = String::from_utf8(output.stdout).unwrap();
        let cutoff_hz = recommended["cutoff_hz"].as_f64().unwrap();
        assert!(said.contains(&format!("mine: dial in {cutoff_hz} Hz")), "{said}");
        let note = format!("note: at first {first_hz} Hz is outside of {low} to {high} Hz");
        assert_eq!(said.contains(&note), outside, "{said}");
    }
    let starter = ["prepare", "--starter", "--board", "nucleo-f446re", "--json"];
    let output = sim(folder.path(), &starter);
    let starter: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(starter.get("recommended").is_none(), "{starter}");
}

#[test]
#[ignore = "an envelope for each board; CI runs it"]
fn the_records_of_the_images_are_what_their_scenes_give() {
    let folder = TempDir::new().unwrap();
    let boards: Vec<&str> =
        BUILT_IN.iter().map(|(name, _)| *name).filter(|name| board_facts(name).is_ok()).collect();
    assert!(boards.len() > 1, "{boards:?}");
    for board in boards {
        let output = sim(folder.path(), &["prepare", board]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let made = fs::read(folder.path().join(format!("{board}.device"))).unwrap();
        let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
        let committed = fs::read(scenes.join(format!("{board}.device"))).unwrap();
        assert!(
            made == committed,
            "scenes/{board}.device is old: cargo sim prepare {board} --out scenes/{board}.device --force"
        );
    }
}

#[test]
fn a_record_has_what_the_scene_says_and_the_envelope_of_all_that_it_lists() {
    let edits = [(
        "name = \"nucleo-f446re\"",
        "name = \"nucleo-f446re\"\nestimators = [\"first-order\", \"butterworth\"]\nperiods = [5]\nmotor = \"-\"",
    )];
    let folder = scene(&edits);
    let path = folder.path();
    let output = sim(path, &["prepare", "mine.toml", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let record = words(&fs::read(path.join("mine.device")).unwrap());
    let device = Device::from_record(&record, &board_facts("nucleo-f446re").unwrap()).unwrap();
    assert_eq!(json["record_hash"], format!("{:08x}", device.key.hash));
    assert_eq!(json["envelope_hash"], format!("{:08x}", device.envelope.hash()));
    assert_eq!((device.key.name.text(), device.signs.motor_reversed), ("mine", true));
    assert_eq!(json["estimator"], "first-order");
    assert_eq!(device.settings.velocity.name().text(), "first-order");
    assert_eq!(json["guessed"].as_array().unwrap().len(), 0);
    let keys: Vec<_> = device
        .envelope
        .boundaries()
        .map(|(key, points)| (key.estimator.text(), key.cutoff_hz, key.period, points.count()))
        .collect();
    let of = |n: usize| (keys[n].0, keys[n].1, keys[n].2);
    assert_eq!(keys.len(), 10, "{keys:?}");
    assert_eq!([of(0), of(1)], [("first-order", 360.0, 10), ("first-order", 500.0, 10)]);
    assert_eq!([of(3), of(9)], [("first-order", 360.0, 5), ("butterworth", 1500.0, 5)]);
    assert!(keys.iter().all(|(.., rows)| *rows > 0), "{keys:?}");
    // the device is the same after a change of a comment, and another device after a change of a number
    let text = fs::read_to_string(path.join("mine.toml")).unwrap();
    for (text, same) in [
        (format!("# the same\n{text}"), true),
        (text.replace("settle_s = 4.0", "settle_s = 3.0"), false),
    ] {
        fs::write(path.join("mine.toml"), text).unwrap();
        let output = sim(path, &["prepare", "mine.toml", "--force"]);
        assert!(output.status.success());
        let said = String::from_utf8(output.stdout).unwrap();
        let judged = "judged by  RMS of the counts below 15 um; the motor pushes ([wall_hit])";
        assert!(said.contains(judged) && !said.contains("beyond the travel"), "{said}");
        let again = words(&fs::read(path.join("mine.device")).unwrap());
        assert_eq!(again == record, same);
    }
}

/// The record has predicted walls for each design and output period. They are the same walls as those of the scene with
/// this design as its filter.
#[test]
fn a_design_has_rows_of_its_own_for_every_period() {
    let edits = [(
        "name = \"nucleo-f446re\"",
        "name = \"nucleo-f446re\"\nperiods = [5]\ndesign = \"stiff\"",
    )];
    let folder = scene(&edits);
    let path = folder.path();
    let text = fs::read_to_string(path.join("mine.toml")).unwrap();
    let stiff = "estimator = \"biquad\"\ncutoff_hz = 555\ndamping = 0.561\nlead_s = 0.0002099\nzero = -0.6651\n";
    let low = "estimator = \"butterworth\"\ncutoff_hz = 1500\n";
    fs::write(
        path.join("mine.toml"),
        format!("{text}\n[designs.stiff]\n{stiff}[designs.low]\n{low}"),
    )
    .unwrap();
    let output = sim(path, &["prepare", "mine.toml", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["estimator"], &json["cutoff_hz"]), (&"biquad".into(), &555.0.into()));
    let parts: Vec<_> =
        json["envelope"].as_array().unwrap().iter().map(|part| &part["design"]).collect();
    assert_eq!(
        parts,
        [
            &Value::Null,
            &Value::Null,
            &"low".into(),
            &"low".into(),
            &"stiff".into(),
            &"stiff".into()
        ]
    );
    let record = words(&fs::read(path.join("mine.device")).unwrap());
    let device = Device::from_record(&record, &board_facts("nucleo-f446re").unwrap()).unwrap();
    let named: Vec<_> = device.designs.iter().map(|(_, design)| design).collect();
    assert_eq!(named.iter().map(|design| design.name.text()).collect::<Vec<_>>(), ["low", "stiff"]);
    let rows = |wanted: u8, cutoff: f64, period: u32| {
        let mut found = device.envelope.boundaries().filter(|(key, _)| {
            (key.design, key.period) == (wanted, period) && key.cutoff_hz == cutoff
        });
        found.next().map(|(_, points)| points.collect::<Vec<_>>()).unwrap()
    };
    for period in [10, 5] {
        assert!(!rows(2, 555.0, period).is_empty());
        // A design with the same filter as one of the scene's cutoffs has the walls of this cutoff.
        assert_eq!(rows(1, 1500.0, period), rows(0, 1500.0, period));
    }
    let mut stored = device.defaults();
    assert_eq!(device.key(&stored).design, 2);
    let [.., last] = rows(2, 555.0, 10)[..] else { panic!("no rows") };
    stored.settings.wall.damping_n_s_per_m = last.damping_n_s_per_m;
    stored.settings.wall.stiffness_n_per_m = last.stiffness_high_n_per_m;
    assert_eq!(device.inside(&stored), Ok(()));
    stored.settings.velocity = stored.settings.velocity.with_parameter(1, 0.57);
    assert!(device.inside(&stored).is_err());
}

#[test]
fn what_is_left_out_is_guessed_and_said_and_a_starter_has_no_walls() {
    let (device, _) = NUCLEO.split_once("[safety]").unwrap();
    let folder = TempDir::new().unwrap();
    let path = folder.path();
    fs::write(path.join("mine.toml"), device).unwrap();
    let output = sim(path, &["prepare", "mine.toml", "--starter", "--json"]);
    let why = String::from_utf8_lossy(&output.stderr);
    assert!(why.contains("estimated has `motor.continuous_force_n`, allowed keys that"), "{why}");
    let measured = |line: &&str| !line.starts_with("estimated = ");
    let device: Vec<&str> = device.lines().filter(measured).collect();
    fs::write(path.join("mine.toml"), device.join("\n")).unwrap();
    let output = sim(path, &["prepare", "mine.toml", "--starter", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let guessed = json["guessed"].as_array().unwrap();
    for key in ["safety.travel_low_m -0.04", "safety.travel_high_m 0.11", "return.timeout_s 10"] {
        assert!(guessed.iter().any(|said| said == key), "{key}: {guessed:?}");
    }
    assert_eq!(
        (&json["speed_max_m_per_s"], &json["envelope"]),
        (&0.1.into(), &Value::Array(vec![]))
    );
    let output = sim(path, &["prepare", "--starter", "--board", "discovery-f407"]);
    assert!(output.status.success());
    assert!(path.join("starter.device").is_file());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("every wall is refused until unlock envelope"), "{text}");
    assert!(!text.contains("judged by"), "{text}");
    let near = NUCLEO.replace("travel_high_m = 0.11", "travel_high_m = 0.06");
    assert_ne!(near, NUCLEO);
    fs::write(path.join("near.toml"), near).unwrap();
    let output = sim(path, &["prepare", "near.toml", "--starter"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("note: the wall, 70 mm, is beyond the travel: fault 15"), "{text}");
}

#[test]
fn what_does_not_fit_a_board_is_one_line_with_the_key() {
    for (from, to, wanted) in [
        (
            "name = \"nucleo-f446re\"",
            "name = \"nucleo\"",
            "the board is `nucleo`, allowed nucleo-f446re, ",
        ),
        ("name = \"nucleo-f446re\"", "name = \"\"", "board.name is ``, allowed 1 to 16 bytes"),
        ("name = \"nucleo-f446re\"", "", "missing field `name`"),
        ("bits = 12", "bits = 10", "needs [output] kind = \"dac\", bits = 12"),
        (
            "latency = 0.115",
            "latency = 0.1",
            "actuator.latency on the board nucleo-f446re is 0.1, allowed 0.115",
        ),
        (
            "rate_hz = 10000",
            "rate_hz = 9000",
            "control.rate_hz on the board nucleo-f446re is 9000, allowed 10000",
        ),
        ("cutoff_hz = 360", "cutoff_hz = 9000", "board.cutoff_hz is 9000, allowed 0.35 to 4990"),
        ("cutoff_hz = 360", "estimators = [\"butter\"]", "board.estimators has `butter`, allowed "),
        (
            "cutoff_hz = 360",
            "estimators = [\"algebraic-1\"]",
            "board.estimators has `algebraic-1`, which is no more: use least-squares-1",
        ),
        (
            "cutoff_hz = 360",
            "estimators = [\"time-stamps\"]",
            "`time-stamps`, which needs edge times",
        ),
        ("cutoff_hz = 360", "periods = [3]", "board.periods has 3, allowed 1, 2, 5, 10"),
        ("cutoff_hz = 360", "motor = \"left\"", "unknown variant `left`"),
        ("travel_low_m = -0.04", "travel_low_m = 0.01", "safety.travel_low_m is 0.01, allowed -"),
        ("ramp_in_s = 0.2", "ramp_in_s = 0.0", "safety.ramp_in_s is 0, allowed 0.02 to 10"),
        (
            "sign_test_counts = 200",
            "sign_test_counts = 1",
            "safety.sign_test_counts is 1, allowed 10 to",
        ),
        (
            "calibration_travel_m = 1e-3",
            "calibration_travel_m = 1e-9",
            "safety.calibration_travel_m is 0.000000001",
        ),
        (
            "continuous_force_n = 4.1",
            "continuous_force_n = 9",
            "motor.continuous_force_n is 9, allowed",
        ),
        (
            "time_constant_s = 30",
            "time_constant_s = 0",
            "motor.time_constant_s is 0, allowed 1 to 3600",
        ),
        (
            "speed_m_per_s = 0.15",
            "speed_m_per_s = 5",
            "return.speed_m_per_s is 5, allowed 0.001 to 1",
        ),
        (
            "tolerance_m = 5e-5",
            "tolerance_m = 5e-7",
            "return.tolerance_m is 0.0000005, allowed 0.000004 to",
        ),
        ("ramp_in_s = 0.2", "rampin_s = 0.2", "unknown field `rampin_s`"),
        (
            "travel_high_m = 0.11",
            "travel_high_m = 0.00001\ntravel_low_x = 1",
            "unknown field `travel_low_x`",
        ),
        (
            "start_position_m = 0.0",
            "start_position_m = -0.05",
            "start_m is -0.05, allowed -0.04 to",
        ),
        // these values contradict the device
        (
            "sign_test_counts = 200",
            "sign_test_counts = 900",
            "moves by 887.3 counts in the sign test: safety.sign_test_counts is 900, allowed 10 to 887",
        ),
        (
            "heaviest_mass_kg = 8",
            "heaviest_mass_kg = 0.4",
            "safety.heaviest_mass_kg is 0.4, allowed 0.416 to 1000000",
        ),
        (
            "heaviest_damping_n_s_per_m = 110",
            "heaviest_damping_n_s_per_m = 5",
            "safety.heaviest_damping_n_s_per_m is 5, allowed 5.5195 to 1000000",
        ),
        (
            "[safety]",
            "[integrator]\nmethod = \"rk4\"\nsteps_per_sample = 1\n[travel]\nstop = \"rigid\"\nrestitution = 0.5\n\
             low_m = -0.1\nhigh_m = 0.1\n[safety]",
            "the rigid stops of [travel] come first: safety.travel_high_m is 0.11, allowed 0.000001 to 0.1",
        ),
        (
            "time_constant_s = 30",
            "time_constant_s = 30\ncurrent_sense_rest = 0.5",
            "motor.current_sense_full is missing, motor.current_sense_rest is 0.5, allowed both or neither",
        ),
        (
            "time_constant_s = 30",
            "time_constant_s = 30\ncurrent_sense_full = 0.9",
            "motor.current_sense_rest is missing, motor.current_sense_full is 0.9, allowed both or neither",
        ),
    ] {
        let folder = scene(&[(from, to)]);
        let line = refused(folder.path(), &["prepare", "mine.toml"]);
        assert!(line.contains(wanted), "{line} should say {wanted}");
    }
    let folder = scene(&[
        ("cutoff_hz = 360", "estimators = [\"tracking-loop\"]\ncutoff_hz = 360"),
        ("[500, 1500]", "[4500]"),
    ]);
    let line = refused(folder.path(), &["prepare", "mine.toml"]);
    let wanted =
        "mine.toml: with tracking-loop of the envelope: sweep.cutoffs_hz is 4500, allowed ";
    assert!(line.contains(wanted), "{line}");
    let folder = scene(&[]);
    let path = folder.path();
    fs::rename(path.join("mine.toml"), path.join("a-name-of-17-byte.toml")).unwrap();
    let line = refused(path, &["prepare", "a-name-of-17-byte.toml"]);
    assert!(line.contains("allowed 1 to 16 bytes"), "{line}");
    let line = refused(path, &["prepare", "paper-1um"]);
    assert!(line.contains("board.name is missing, or --board"), "{line}");
}
