//! NaN and infinities at every input. If a person or a file gives one of these values, the value is refused with its
//! name. So no later code gets these values.

use host_sim::scene::NamedScene;
use zwidth::{
    Design, HitSettings, Output, Settings, SettingsError, VelocitySettings, WallSettings,
    console::{parse, usages},
    experiment::{CalibrationSettings, DutySettings, ReturnSettings, WalkSettings},
    safety::{CurrentSettings, SafetySettings},
    velocity::EstimatorName,
};

const BAD: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

/// All optional elements of a scene. With them the text has every number that a scene can have.
const ELEMENTS: &str = r#"
[output]
kind = "dac"
bits = 12
[amplifier]
bandwidth_hz = 1500.0
[mode]
mass_kg = 0.15
stiffness_n_per_m = 6e4
damping_n_s_per_m = 4.0
[backlash]
gap_m = 1e-5
[amplifier_error]
cubic = 0.1
[arm]
mass_kg = 1.2
damping_n_s_per_m = 12.0
stiffness_n_per_m = 20.0
rest_position_m = 0.05
grip_damping_n_s_per_m = 25.0
grip_stiffness_n_per_m = 1200.0
[offset]
force_n = 0.05
[friction]
coulomb_n = 0.1
static_n = 0.15
stribeck_speed_m_per_s = 0.01
[cogging]
amplitude_n = 0.1
pitch_m = 0.004
phase_rad = 0.3
[travel]
stop = "spring"
low_m = -0.01
high_m = 0.1
stiffness_n_per_m = 5e4
damping_n_s_per_m = 50.0
[encoder_error]
cycle_m = 2e-5
first_m = 3e-7
second_m = 1e-7
phase_rad = 0.0
[encoder_noise]
rms_m = 5e-7
seed = 1
[jitter]
peak_s = 5e-6
seed = 1
[accelerometer]
full_scale_m_per_s2 = 40.0
resolution_m_per_s2 = 0.01
noise_m_per_s2_per_sqrt_hz = 0.001
bias_m_per_s2 = 0.0
bandwidth_hz = 1000.0
[integrator]
method = "dormand-prince"
relative_tolerance = 1e-8
absolute_tolerance_m = 1e-12
[board]
name = "a-board"
cutoff_hz = 1500.0
periods = [5]
[safety]
speed_max_m_per_s = 1.0
speed_believable_m_per_s = 5.0
travel_low_m = -0.04
travel_high_m = 0.11
ramp_in_s = 0.2
sign_test_force = 0.05
sign_test_counts = 200
calibration_travel_m = 1e-3
[motor]
continuous_force_n = 4.1
time_constant_s = 30.0
[return]
speed_m_per_s = 0.15
force_n = 1.4
stiffness_n_per_m = 300.0
damping_n_s_per_m = 15.0
integral_n_per_m_s = 600.0
tolerance_m = 5e-5
timeout_s = 10.0
"#;

/// Collects the path of every number in `value`. A path has keys and indices.
fn numbers(value: &toml::Value, path: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                path.push(key.clone());
                numbers(value, path, found);
                path.pop();
            }
        }
        toml::Value::Array(values) => {
            for (n, value) in values.iter().enumerate() {
                path.push(n.to_string());
                numbers(value, path, found);
                path.pop();
            }
        }
        toml::Value::Integer(_) | toml::Value::Float(_) => found.push(path.clone()),
        _ => {}
    }
}

fn at<'a>(value: &'a mut toml::Value, path: &[String]) -> &'a mut toml::Value {
    path.iter().fold(value, |value, key| match value {
        toml::Value::Table(table) => table.get_mut(key).unwrap(),
        toml::Value::Array(values) => &mut values[key.parse::<usize>().unwrap()],
        _ => unreachable!("a path leads through tables and arrays"),
    })
}

#[test]
fn every_number_of_a_scene_is_refused_by_name() {
    let text = format!("{}\n{ELEMENTS}", include_str!("../../scenes/paper-1um.toml"));
    let scene = |text: String| NamedScene::parse("test".into(), text, "test.toml");
    scene(text.clone()).unwrap();
    let whole: toml::Value = toml::from_str(&text).unwrap();
    let mut places = vec![];
    numbers(&whole, &mut vec![], &mut places);
    assert!(places.len() > 78, "{}", places.len());
    for place in &places {
        for bad in BAD {
            let mut broken = whole.clone();
            *at(&mut broken, place) = toml::Value::Float(bad);
            let error = scene(toml::to_string(&broken).unwrap()).unwrap_err().to_string();
            let key = place.iter().rfind(|key| key.parse::<usize>().is_err()).unwrap();
            // For a table with several kinds, the TOML reader names only the table.
            let named = error.contains(key.as_str()) || error.contains(&format!("[{}]", place[0]));
            assert!(named, "{}: {error}", place.join("."));
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
}

/// Collects the path of every key in `value` whose value is no table.
fn keys(value: &toml::Value, path: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    match value {
        toml::Value::Table(table) => table.iter().for_each(|(key, value)| {
            path.push(key.clone());
            keys(value, path, found);
            path.pop();
        }),
        _ => found.push(path.clone()),
    }
}

/// Each key of a scene is left out, misspelled, or given another type. The result is a message that names the key, or a
/// scene if the key is optional.
fn every_key_is_missed(text: &str, may_be_missing: impl Fn(&[String]) -> bool) {
    let scene = |value: &toml::Value| {
        NamedScene::parse("test".into(), toml::to_string(value).unwrap(), "test.toml")
    };
    let whole: toml::Value = toml::from_str(text).unwrap();
    scene(&whole).unwrap();
    let mut places = vec![];
    keys(&whole, &mut vec![], &mut places);
    for place in &places {
        let [tables @ .., key] = place.as_slice() else { continue };
        let with = |edit: &dyn Fn(&mut toml::Table)| {
            let mut broken = whole.clone();
            edit(at(&mut broken, tables).as_table_mut().unwrap());
            scene(&broken).map_err(|error| error.to_string())
        };
        let is_named = |error: &str, key: &str| {
            // For a table with several kinds, the TOML reader names only the table.
            let table = [format!("[{}]", place[0]), format!(" {}: ", place[0])];
            let named = error.contains(key) || table.iter().any(|table| error.contains(table));
            named && error.lines().count() == 1 && error.starts_with("test.toml")
        };
        let what = place.join(".");
        let missing = with(&|table| {
            table.remove(key);
        });
        match missing {
            Ok(_) => assert!(may_be_missing(place), "{what} may be left out"),
            Err(error) => {
                assert!(!may_be_missing(place) && is_named(&error, key), "{what}: {error}");
            }
        }
        let wrong = format!("{key}x");
        let misspelled = with(&|table| {
            let value = table.remove(key).unwrap();
            table.insert(wrong.clone(), value);
        });
        let error = misspelled.map(|_| ()).expect_err(&what);
        assert!(is_named(&error, key), "{what} misspelled: {error}");
        let other = match at(&mut whole.clone(), place) {
            toml::Value::Boolean(_) => toml::Value::Integer(3),
            _ => toml::Value::Boolean(true),
        };
        let error = with(&|table| drop(table.insert(key.clone(), other.clone())))
            .map(|_| ())
            .expect_err(&what);
        assert!(is_named(&error, key), "{what} of another kind: {error}");
    }
}

#[test]
fn every_key_of_a_scene_is_missed_by_name() {
    let text = format!("{}\n{ELEMENTS}", include_str!("../../scenes/paper-1um.toml"));
    let optional = ["board", "safety", "motor", "return", "accelerometer"];
    every_key_is_missed(&text, |place| {
        optional.contains(&place[0].as_str())
            && place[1] != "name"
            && place[1] != "full_scale_m_per_s2"
            || place.join(".") == "velocity.prewarp"
    });
    let rotary = include_str!("../../scenes/epfl-paddle.toml");
    let rotary: toml::Table = toml::from_str(rotary).unwrap();
    let text = toml::to_string(&{
        let mut rotary = rotary;
        rotary.remove("estimated");
        rotary
    });
    every_key_is_missed(&text.unwrap(), |place| {
        optional.contains(&place[0].as_str()) && place[1] != "name"
            || place.join(".") == "velocity.prewarp"
    });
}

const DESIGN: Design = Design {
    rate_hz: 1e4,
    resolution_m: 1e-6,
    full_scale_n: 5.906,
    period: 10,
    output: Output::Dac { bits: 12 },
};

/// Checks that the value is refused, and that the message names it.
#[track_caller]
fn named<T>(name: &str, built: Result<T, SettingsError>) {
    let error = built.err().unwrap_or_else(|| panic!("{name} is taken")).to_string();
    assert!(error.contains(name), "{name}: {error}");
}

fn made<S, T>(
    settings: &S,
    build: impl Fn(&S) -> Result<T, SettingsError>,
) -> Result<T, SettingsError> {
    build(settings)
}

/// Sets one field after another to a number that is not finite. Each of these numbers is refused with the name of the
/// field.
macro_rules! each_bad {
    ($type:ident { $($field:ident),+ $(,)? } of $good:ident, $build:expr) => {$(
        for bad in BAD {
            named(stringify!($field), made(&$type { $field: bad, ..$good }, $build));
        }
    )+};
}

#[test]
fn every_number_of_the_core_is_refused_by_name() {
    let wall = WallSettings {
        position_m: 0.07,
        stiffness_n_per_m: 1e4,
        damping_n_s_per_m: 10.0,
        push_only: true,
    };
    let velocity = VelocitySettings::Butterworth { cutoff_hz: 1500.0 };
    let good = Settings { velocity, wall };
    let hit = HitSettings { push_n: 2.8, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 };
    let safety = SafetySettings {
        speed_max_m_per_s: 1.0,
        speed_believable_m_per_s: 5.0,
        travel_low_m: -0.04,
        travel_high_m: 0.11,
        ramp_in_s: 0.2,
        sign_test_force: 0.05,
        sign_test_counts: 20,
        heaviest_mass_kg: 8.0,
        heaviest_damping_n_s_per_m: 110.0,
        passive_acceleration_m_per_s2: 0.0,
    };
    let back = ReturnSettings::SOFT;
    let duty = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };
    let calibration = CalibrationSettings {
        percent: 20.0,
        rise_percent_per_s: 2.0,
        hold_s: 30.0,
        travel_m: 1e-3,
    };
    let walk = WalkSettings {
        stiffness_start_n_per_m: 2000.0,
        stiffness_step_n_per_m: 2000.0,
        stiffness_max_n_per_m: 1e7,
        damping_start_n_s_per_m: 10.0,
        damping_step_n_s_per_m: 10.0,
        damping_max_n_s_per_m: 4000.0,
    };
    assert!(good.build(&DESIGN).is_ok() && hit.build(&DESIGN).is_ok());
    assert!(safety.build(&DESIGN).is_ok() && back.build(&DESIGN).is_ok());
    assert!(duty.build(&DESIGN, 60_000).is_ok() && calibration.build(&DESIGN).is_ok());
    assert!(walk.check().is_ok());
    each_bad!(Design { rate_hz, resolution_m, full_scale_n } of DESIGN, |design| {
        assert!(hit.build(design).is_err() && safety.build(design).is_err());
        assert!(back.build(design).is_err() && duty.build(design, 60_000).is_err());
        good.build(design)
    });
    each_bad!(WallSettings { position_m, stiffness_n_per_m, damping_n_s_per_m } of wall, |wall| {
        Settings { velocity, wall: *wall }.build(&DESIGN)
    });
    // Every parameter of every estimator.
    for name in EstimatorName::ALL {
        let good = name.defaults();
        assert!(Settings { velocity: good, wall }.build(&DESIGN).is_ok(), "{good:?}");
        for (place, key) in name.keys().iter().enumerate() {
            for bad in BAD {
                let velocity = good.with_parameter(place, bad);
                named(key, Settings { velocity, wall }.build(&DESIGN));
            }
        }
    }
    each_bad!(HitSettings { push_n, settle_s, window_s, rms_limit_m } of hit, |hit| {
        hit.build(&DESIGN)
    });
    each_bad!(
        SafetySettings {
            speed_max_m_per_s,
            speed_believable_m_per_s,
            travel_low_m,
            travel_high_m,
            ramp_in_s,
            sign_test_force,
        } of safety,
        |safety| safety.build(&DESIGN)
    );
    each_bad!(
        ReturnSettings {
            start_m,
            speed_m_per_s,
            force_n,
            stiffness_n_per_m,
            damping_n_s_per_m,
            integral_n_per_m_s,
            tolerance_m,
            timeout_s,
        } of back,
        |back| back.build(&DESIGN)
    );
    each_bad!(DutySettings { continuous_force_n, time_constant_s } of duty, |duty| {
        duty.build(&DESIGN, 60_000)
    });
    each_bad!(
        CalibrationSettings { rise_percent_per_s, hold_s, travel_m } of calibration,
        |calibration| calibration.build(&DESIGN)
    );
    for bad in BAD {
        // The message must contain the name of the command.
        named("calibrate", CalibrationSettings { percent: bad, ..calibration }.build(&DESIGN));
        let sense = CurrentSettings { rest: 0.5, full: 0.8 };
        named("current_sense_rest", CurrentSettings { rest: bad, ..sense }.build(DESIGN.output));
        named("current_sense_full", CurrentSettings { full: bad, ..sense }.build(DESIGN.output));
    }
    each_bad!(
        WalkSettings {
            stiffness_start_n_per_m,
            stiffness_step_n_per_m,
            stiffness_max_n_per_m,
            damping_start_n_s_per_m,
            damping_step_n_s_per_m,
            damping_max_n_s_per_m,
        } of walk,
        |walk| walk.check()
    );
}

#[test]
fn what_is_typed_on_a_board_is_never_one() {
    // A word in capitals is a number, except for the name of an estimator.
    let numbers = usages().filter_map(|usage| usage.split_once(' ')).filter(|(_, what)| {
        *what != "NAME" && what.bytes().all(|byte| byte.is_ascii_uppercase() || byte == b'_')
    });
    let names: Vec<&str> = numbers.map(|(name, _)| name).collect();
    assert!(names.len() > 20 && names.contains(&"calibrate"), "{names:?}");
    for word in ["nan", "NaN", "inf", "-inf", "infinity", "1e999", "-1e999", "1e309", "0x1p3"] {
        for name in &names {
            let error = parse(format!("{name} {word}").as_bytes()).unwrap_err().to_string();
            assert!(error.contains(name), "{name} {word}: {error}");
        }
    }
}
