//! NaN and infinities at every entrance: each number that a person or a file can give is refused by
//! name, and nothing behind the entrances ever sees one.

use host_sim::scene::NamedScene;
use zwidth::{
    Design, HitSettings, Output, Settings, VelocitySettings, WallSettings,
    console::parse,
    experiment::{CalibrationSettings, DutySettings, ReturnSettings, WalkSettings},
    safety::SafetySettings,
    velocity::EstimatorName,
};

const BAD: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

/// Every optional element, so that every number of a scene stands in it.
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
[arm]
mass_kg = 1.2
damping_n_s_per_m = 12.0
stiffness_n_per_m = 20.0
rest_position_m = 0.05
grip_damping_n_s_per_m = 25.0
grip_stiffness_n_per_m = 1200.0
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
"#;

/// Every place of a number below `value`, as keys and indices.
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
    assert!(places.len() > 60, "{}", places.len());
    for place in &places {
        for bad in BAD {
            let mut broken = whole.clone();
            *at(&mut broken, place) = toml::Value::Float(bad);
            let error = scene(toml::to_string(&broken).unwrap()).unwrap_err().to_string();
            let key = place.iter().rfind(|key| key.parse::<usize>().is_err()).unwrap();
            // Of a table that has kinds the reader of TOML names the table only.
            let named = error.contains(key.as_str()) || error.contains(&format!("[{}]", place[0]));
            assert!(named, "{}: {error}", place.join("."));
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
}

const DESIGN: Design = Design {
    rate_hz: 1e4,
    resolution_m: 1e-6,
    full_scale_n: 5.906,
    period: 10,
    output: Output::Dac { bits: 12 },
};

#[test]
fn every_number_of_the_core_is_refused() {
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
    for bad in BAD {
        for design in [
            Design { rate_hz: bad, ..DESIGN },
            Design { resolution_m: bad, ..DESIGN },
            Design { full_scale_n: bad, ..DESIGN },
        ] {
            assert!(good.build(&design).is_err() && hit.build(&design).is_err(), "{design:?}");
            assert!(safety.build(&design).is_err() && back.build(&design).is_err());
            assert!(duty.build(&design, 60_000).is_err());
        }
        for wall in [
            WallSettings { position_m: bad, ..wall },
            WallSettings { stiffness_n_per_m: bad, ..wall },
            WallSettings { damping_n_s_per_m: bad, ..wall },
        ] {
            assert!(Settings { velocity, wall }.build(&DESIGN).is_err(), "{wall:?}");
        }
        // Every parameter of every estimator.
        for name in EstimatorName::ALL {
            let good = name.defaults();
            assert!(Settings { velocity: good, wall }.build(&DESIGN).is_ok(), "{good:?}");
            let places = 0..name.keys().len();
            for velocity in places.map(|place| good.with_parameter(place, bad)) {
                assert!(Settings { velocity, wall }.build(&DESIGN).is_err(), "{velocity:?}");
            }
        }
        for hit in [
            HitSettings { push_n: bad, ..hit },
            HitSettings { settle_s: bad, ..hit },
            HitSettings { window_s: bad, ..hit },
            HitSettings { rms_limit_m: bad, ..hit },
        ] {
            assert!(hit.build(&DESIGN).is_err(), "{hit:?}");
        }
        for safety in [
            SafetySettings { speed_max_m_per_s: bad, ..safety },
            SafetySettings { speed_believable_m_per_s: bad, ..safety },
            SafetySettings { travel_low_m: bad, ..safety },
            SafetySettings { travel_high_m: bad, ..safety },
            SafetySettings { ramp_in_s: bad, ..safety },
            SafetySettings { sign_test_force: bad, ..safety },
        ] {
            assert!(safety.build(&DESIGN).is_err(), "{safety:?}");
        }
        for back in [
            ReturnSettings { start_m: bad, ..back },
            ReturnSettings { speed_m_per_s: bad, ..back },
            ReturnSettings { force_n: bad, ..back },
            ReturnSettings { stiffness_n_per_m: bad, ..back },
            ReturnSettings { damping_n_s_per_m: bad, ..back },
            ReturnSettings { integral_n_per_m_s: bad, ..back },
            ReturnSettings { tolerance_m: bad, ..back },
            ReturnSettings { timeout_s: bad, ..back },
        ] {
            assert!(back.build(&DESIGN).is_err(), "{back:?}");
        }
        for duty in [
            DutySettings { continuous_force_n: bad, ..duty },
            DutySettings { time_constant_s: bad, ..duty },
        ] {
            assert!(duty.build(&DESIGN, 60_000).is_err(), "{duty:?}");
        }
        for calibration in [
            CalibrationSettings { percent: bad, ..calibration },
            CalibrationSettings { rise_percent_per_s: bad, ..calibration },
            CalibrationSettings { hold_s: bad, ..calibration },
            CalibrationSettings { travel_m: bad, ..calibration },
        ] {
            assert!(calibration.build(&DESIGN).is_err(), "{calibration:?}");
        }
        for walk in [
            WalkSettings { stiffness_start_n_per_m: bad, ..walk },
            WalkSettings { stiffness_step_n_per_m: bad, ..walk },
            WalkSettings { stiffness_max_n_per_m: bad, ..walk },
            WalkSettings { damping_start_n_s_per_m: bad, ..walk },
            WalkSettings { damping_step_n_s_per_m: bad, ..walk },
            WalkSettings { damping_max_n_s_per_m: bad, ..walk },
        ] {
            assert!(walk.check().is_err(), "{walk:?}");
        }
    }
}

#[test]
fn what_is_typed_on_a_board_is_never_one() {
    for word in ["nan", "NaN", "inf", "-inf", "infinity", "1e999", "-1e999", "1e309", "0x1p3"] {
        for name in ["k", "b", "wall", "cutoff", "tuning", "tuning2", "push", "fullscale", "kmax"] {
            assert!(parse(format!("{name} {word}").as_bytes()).is_err(), "{name} {word}");
        }
    }
}
