//! Tests the answers to a worker's questions.

use serde_json::{Value, json};

use super::answer;

fn ask(question: &Value) -> (Value, Vec<Vec<u8>>) {
    let mut answers = answer(vec![question.to_string().into_bytes()]);
    let bytes = answers.split_off(1);
    (serde_json::from_slice(&answers[0]).unwrap(), bytes)
}

fn error(question: &Value) -> String {
    let (answer, bytes) = ask(question);
    assert!(bytes.is_empty());
    answer["error"].as_str().unwrap_or_else(|| panic!("{question}: {answer}")).to_owned()
}

/// Several workers may share a sweep and exchange their results as JSON. The result then equals an undivided sweep to
/// the last bit.
#[test]
fn a_sweep_in_parts_is_the_sweep() {
    let parts = |parts: &[&[f64]]| {
        let mut walked = vec![];
        for cutoffs_hz in parts {
            let (answer, _) = ask(&json!({
                "ask": "walk", "scene": "paper-2um", "cutoffs_hz": cutoffs_hz, "repeat": 2,
            }));
            walked.extend(answer["walked"].as_array().unwrap().clone());
        }
        ask(&json!({ "ask": "sweep", "scene": "paper-2um", "walked": walked, "repeat": 2 }))
    };
    let (whole, split) =
        (parts(&[&[200.0, 1000.0, 3000.0]]), parts(&[&[3000.0], &[200.0, 1000.0]]));
    assert_eq!(whole, split);
    let boundary = String::from_utf8(whole.1[0].clone()).unwrap();
    let head = "cutoff_hz,repeat,start_offset_counts,damping_n_s_per_m,stiffness_n_per_m\n200,0,0,";
    assert!(boundary.starts_with(head) && boundary.lines().count() > 50, "{boundary}");
    assert!(whole.0["ideal_cutoff_hz"].is_number());
}

/// Bad input gives one line that names the key and the allowed values. It does not cause a panic.
#[test]
fn bad_input_is_one_line() {
    let paper = host_sim::scene::NamedScene::load("paper-1um").unwrap().text;
    let mass = paper.replace("mass_kg = ", "mass_kg = -");
    let deep = format!("a = {}", "[".repeat(20_000));
    for (question, said) in [
        (json!({ "ask": "cutoffs", "scene": "nowhere" }), "scene is nowhere, allowed paper-1um, "),
        (json!({ "ask": "cutoffs", "scene": "my.toml", "text": "" }), "my.toml"),
        (json!({ "ask": "cutoffs", "scene": "my.toml", "text": mass }), "mass_kg"),
        (json!({ "ask": "scene", "scene": "my.toml", "text": deep }), "my.toml"),
        (json!({ "ask": "nothing" }), "nobody can be asked `nothing`"),
        (json!({ "ask": "run", "nonsense": 1 }), "unknown field `nonsense`"),
        (json!({ "ask": "tick" }), "no board has been started"),
        (
            json!({ "ask": "walk", "scene": "paper-1um", "repeat": 0 }),
            "repeat is 0, allowed 1 to 1000",
        ),
        (
            json!({ "ask": "grid", "scene": "paper-1um", "cutoffs_hz": [1e3] }),
            "0 walls, allowed 1 to",
        ),
        (
            json!({ "ask": "hit", "scene": "paper-1um", "cutoff_hz": 1e3, "k": -1.0 }),
            "stiffness is -1, allowed",
        ),
        (
            json!({ "ask": "design", "scene": "paper-1um", "budget": 7 }),
            "budget is 7, allowed 100 to",
        ),
        (json!({ "ask": "start", "scene": "paper-1um", "board": "none" }), "allowed nucleo-f446re"),
        (json!({ "ask": "start", "scene": "paper-1um" }), "is no program of a board"),
    ] {
        let line = error(&question);
        assert!(line.contains(said) && !line.contains('\n'), "{question}: {line}");
    }
    assert!(answer(vec![])[0].starts_with(b"{\"error\":"));
    assert!(answer(vec![b"\xff".to_vec()])[0].starts_with(b"{\"error\":"));
}

/// The page compares these settings with the settings of its board. The cutoff may differ.
#[test]
fn the_scene_says_what_its_studies_are_of() {
    let paper = host_sim::scene::NamedScene::load("paper-1um").unwrap().text;
    let (cutoff, _) = ask(&json!({ "ask": "scene", "scene": "paper-1um" }));
    let wanted = json!({ "estimator": "butterworth", "wall": cutoff["wanted"]["wall"] });
    assert_eq!((&cutoff["has_cutoff"], &cutoff["wanted"]), (&json!(true), &wanted));
    let window = paper.replace(
        "estimator = \"butterworth\"\nprewarp = false",
        "estimator = \"foaw-best\"\nwindow_samples = 12\nnoise_counts = 2",
    );
    let (of, _) = ask(&json!({ "ask": "scene", "scene": "mine.toml", "text": &window }));
    assert_eq!(of["has_cutoff"], false, "{of}");
    let tunings = [&of["wanted"]["tuning"], &of["wanted"]["tuning2"]];
    assert_eq!(tunings, [&json!(12.0), &json!(2.0)], "{of}");
}

/// A file that has the name of a built-in scene is not the built-in scene, so it has no envelope.
#[test]
fn a_file_is_no_built_in_scene() {
    let text = host_sim::scene::NamedScene::load("nucleo-f446re").unwrap().text;
    let rows = |text: Option<&str>| {
        let (answer, _) = ask(&json!({
            "ask": "predict", "scene": "nucleo-f446re", "text": text, "estimator": "butterworth", "cutoff_hz": 1500.0,
        }));
        answer["predicted"]["envelope"].as_array().unwrap().len()
    };
    assert!(rows(None) > 10);
    assert_eq!(rows(Some(&text)), 0);
}

/// The core without a chip serves the page. It obeys commands, replies, and can be stopped.
#[test]
fn the_core_is_a_board_for_the_page() {
    let (_, hello) = ask(&json!({ "ask": "start", "scene": "paper-2um", "core": true }));
    let hello: Value = serde_json::from_slice(&hello[0]).unwrap();
    assert_eq!((&hello["type"], &hello["virtual"]), (&json!("hello"), &json!(true)));
    let run = |ms: u32| {
        let (answer, _) = ask(&json!({ "ask": "run", "ms": ms, "speed": 1.0 }));
        assert_eq!(answer["runs"], true);
    };
    let state = || -> Value {
        loop {
            let (answer, bytes) = ask(&json!({ "ask": "tick" }));
            assert!(!bytes.is_empty());
            if answer["text"] == true {
                return serde_json::from_slice(bytes.last().unwrap()).unwrap();
            }
        }
    };
    let say = |message: &Value| ask(&json!({ "ask": "say", "message": message.to_string() })).0;
    run(1000);
    assert!(state()["settings"].as_str().unwrap().starts_with("ok get k 0 N/m"));
    for line in ["k 1500", "b 10", "unlock envelope", "arm"] {
        assert_eq!(say(&json!({ "type": "command", "line": line })), json!({}));
        run(50);
    }
    run(1000);
    assert_eq!(state()["record"]["armed"], true);
    say(&json!({ "type": "finger", "target_m": 0.08 }));
    run(1000);
    let seen = state();
    assert!(
        seen["record"]["contact"] == true && seen["handle"]["finger_n"].as_f64().unwrap() > 0.5,
        "{seen}"
    );
    let refused = say(&json!({ "type": "command", "line": "k 1\ndisarm" }));
    assert!(refused["refused"].as_str().unwrap().contains("a value that cannot be"));
    let predict = json!({ "type": "predict", "estimator": "butterworth", "cutoff_hz": 1500.0 });
    assert_eq!(say(&predict)["predict"]["cutoff_hz"], 1500.0);
    say(&json!({ "type": "stop", "id": 7 }));
    run(20);
    let seen = state();
    assert_eq!(seen["record"]["on"], false, "{seen}");
    assert_eq!(seen["stopped"][0]["id"], 7);
    let (_, rows) = ask(&json!({ "ask": "rows", "from": 0, "rows": 10 }));
    assert!(rows[0].starts_with(b"time_s,position_m,"));
}
