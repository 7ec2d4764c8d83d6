//! Limits that a person reads in messages and types.

use zwidth::{
    Design, HitSettings, Output, Settings, SettingsError, WallSettings,
    console::{Decimal, Reply, Text},
    device::{Device, designs::Designs},
    experiment::{CalibrationSettings, Criterion, DutySettings, ReturnSettings, WalkSettings},
    safety::{CurrentSettings, SafetySettings, envelope::Envelope},
    store::{DeviceKey, Name, Signs},
    velocity::EstimatorName,
};

use crate::{any, rig::NO_WALL};

/// Number of digits of a printed limit.
const DIGITS: i32 = 9;

type Refusal<'a> = dyn Fn(f64) -> Option<SettingsError> + 'a;

type With<T> = fn(T, f64) -> T;

/// The two texts of an error. One is for readers of scenes, the other for users of the console.
fn printed(error: &SettingsError) -> [String; 2] {
    [error.to_string(), Text::<200>::of(Reply::Range(error)).as_str().to_owned()]
}

/// Reads LOW and HIGH from `NAME is VALUE, allowed LOW to HIGH`.
fn ends(line: &str) -> [f64; 2] {
    let (_, range) = line.split_once("allowed ").unwrap();
    let (low, high) = range.split_once(" to ").unwrap();
    [low, high].map(|end| end.parse().unwrap())
}

/// Both printed ends are accepted when they are typed. The next number outside the range that has the same number of
/// digits is refused.
fn holds(name: &str, refusal: &Refusal<'_>) {
    let wrong = |value: f64| refusal(value).filter(|error| error.parameter == name);
    // Outside either end, and not a number.
    for far in [f64::NAN, -1e300, 1e300] {
        let Some(error) = wrong(far) else { continue };
        if error.range.start() > error.range.end() {
            continue; // nothing is allowed
        }
        for line in &printed(&error) {
            for (end, out) in ends(line).into_iter().zip([-1.0, 1.0]) {
                assert!(wrong(end).is_none(), "{line}: {end} is refused: {:?}", wrong(end));
                let unit = || 10f64.powi(end.abs().log10().floor() as i32 + 1 - DIGITS);
                let next = if end == 0.0 { out * 1e-300 } else { end + out * unit() };
                assert!(wrong(next).is_some(), "{line}: {next} is accepted");
            }
        }
    }
}

/// Checks the same as [`holds`], for whole numbers.
fn holds_whole(name: &str, refusal: &dyn Fn(u32) -> Option<SettingsError>) {
    let wrong = |value: f64| refusal(value as u32).filter(|error| error.parameter == name);
    let error = wrong(0.0).unwrap();
    for line in printed(&error) {
        let [low, high] = ends(&line);
        assert!(wrong(low).is_none() && wrong(high).is_none(), "{line}");
        assert!(wrong(low - 1.0).is_some() && wrong(high + 1.0).is_some(), "{line}");
    }
}

fn safety(design: &Design) -> SafetySettings {
    let unit = design.resolution_m * design.rate_hz;
    SafetySettings {
        speed_max_m_per_s: 100.0 * unit,
        speed_believable_m_per_s: 1000.0 * unit,
        travel_low_m: -1e4 * design.resolution_m,
        travel_high_m: 1e4 * design.resolution_m,
        ramp_in_s: 0.2,
        sign_test_force: 0.05,
        sign_test_counts: 100,
        heaviest_mass_kg: 8.0,
        heaviest_damping_n_s_per_m: 110.0,
        passive_acceleration_m_per_s2: 0.0,
    }
}

/// A device of this design. `hit` sets the length of the hit, up to the longest allowed length.
pub fn device(design: Design) -> Device<'static> {
    let far = 5e3 * design.resolution_m;
    Device {
        board: Name::of("a-board"),
        key: DeviceKey::of("bench"),
        scene_hash: 0,
        design,
        latency_samples: 0.1,
        senses: &[],
        envelope: Envelope::EMPTY,
        designs: Designs::NONE,
        safety: safety(&design),
        duty: DutySettings { continuous_force_n: 0.7 * design.full_scale_n, time_constant_s: 30.0 },
        current: CurrentSettings { rest: 0.5, full: 0.8 },
        radius_m: 0.0,
        back: ReturnSettings {
            start_m: 0.0,
            speed_m_per_s: 0.1,
            force_n: 0.2 * design.full_scale_n,
            stiffness_n_per_m: 100.0,
            damping_n_s_per_m: 1.0,
            integral_n_per_m_s: 100.0,
            tolerance_m: 10.0 * design.resolution_m,
            timeout_s: 10.0,
        },
        calibration: CalibrationSettings {
            percent: 0.0,
            rise_percent_per_s: 2.0,
            hold_s: 30.0,
            travel_m: 100.0 * design.resolution_m,
        },
        signs: Signs::default(),
        settings: Settings {
            velocity: EstimatorName::Difference.defaults(),
            wall: WallSettings { position_m: far, ..NO_WALL },
        },
        hit: HitSettings { push_n: 0.0, settle_s: 1.0, window_s: 1.0, rms_limit_m: 10.0 * design.resolution_m },
        criterion: Criterion::Rms,
        walk: GRID,
    }
}

const GRID: WalkSettings = WalkSettings {
    stiffness_start_n_per_m: 100.0,
    stiffness_step_n_per_m: 100.0,
    stiffness_max_n_per_m: 1e5,
    damping_start_n_s_per_m: 1.0,
    damping_step_n_s_per_m: 1.0,
    damping_max_n_s_per_m: 100.0,
};

crate::properties! {
    /// Each printed limit of an estimator's parameters is accepted when it is typed. The next number outside is
    /// refused.
    of_estimators(1500, (design, name, parts) in (any::design(), any::estimator(), any::parts())) {
        let Some(settings) = any::tuned(name, parts, &design) else { return Ok(()) };
        let (_, numbers) = EstimatorName::of(&settings);
        for (place, key) in name.keys().iter().enumerate() {
            let whole = name.parameters()[place].is_some_and(|parameter| parameter.is_whole());
            holds(key, &|value| {
                let mut numbers = numbers;
                numbers[place] = value;
                name.settings(numbers).build(&design).err()
            });
            if whole {
                // A fraction of a sample is not allowed.
                let Some(SettingsError { range, .. }) = settings.with_tuning(-1.0).build(&design).err() else {
                    continue;
                };
                for value in [*range.start(), *range.end()] {
                    let mut numbers = numbers;
                    numbers[place] = value + if value == *range.end() { 0.4 } else { -0.4 };
                    assert!(name.settings(numbers).build(&design).is_err(), "{key} {}", numbers[place]);
                }
            }
        }
    }

    /// Each printed limit of designs, walls and hits is accepted when it is typed. The next number outside is refused.
    of_settings(800, (design, seed) in (any::design(), any::part())) {
        let numbers: [(&str, With<Design>); 3] = [
            ("rate_hz", |design, rate_hz| Design { rate_hz, ..design }),
            ("resolution_m", |design, resolution_m| Design { resolution_m, ..design }),
            ("full_scale_n", |design, full_scale_n| Design { full_scale_n, ..design }),
        ];
        for (name, with) in numbers {
            holds(name, &|value| with(design, value).check().err());
        }
        holds_whole("period", &|period| Design { period, ..design }.check().err());
        holds_whole("bits", &|bits| Design { output: Output::Dac { bits }, ..design }.check().err());
        holds_whole("steps", &|steps| Design { output: Output::Pwm { steps }, ..design }.check().err());
        let wall = WallSettings { stiffness_n_per_m: 1e3 * seed, ..NO_WALL };
        let walls: [(&str, With<WallSettings>); 3] = [
            ("position_m", |wall, position_m| WallSettings { position_m, ..wall }),
            ("stiffness_n_per_m", |wall, stiffness_n_per_m| WallSettings { stiffness_n_per_m, ..wall }),
            ("damping_n_s_per_m", |wall, damping_n_s_per_m| WallSettings { damping_n_s_per_m, ..wall }),
        ];
        for (name, with) in walls {
            let velocity = EstimatorName::Difference.defaults();
            holds(name, &|value| Settings { velocity, wall: with(wall, value) }.build(&design).err());
        }
        let hit = HitSettings { push_n: 0.0, settle_s: 1.0, window_s: 1.0, rms_limit_m: 10.0 * design.resolution_m };
        let hits: [(&str, With<HitSettings>); 4] = [
            ("push_n", |hit, push_n| HitSettings { push_n, ..hit }),
            ("settle_s", |hit, settle_s| HitSettings { settle_s, ..hit }),
            ("window_s", |hit, window_s| HitSettings { window_s, ..hit }),
            ("rms_limit_m", |hit, rms_limit_m| HitSettings { rms_limit_m, ..hit }),
        ];
        for (name, with) in hits {
            holds(name, &|value| with(hit, value).build(&design).err());
        }
    }

    /// Each printed limit of supervisor, duty, return move, calibration and walk is accepted when it is typed. The next
    /// number outside is refused.
    of_devices(800, (design, part) in (any::design(), any::part())) {
        let limits = safety(&design);
        let numbers: [(&str, With<SafetySettings>); 6] = [
            ("speed_max_m_per_s", |s, speed_max_m_per_s| SafetySettings { speed_max_m_per_s, ..s }),
            ("speed_believable_m_per_s", |s, speed_believable_m_per_s| SafetySettings { speed_believable_m_per_s, ..s }),
            ("travel_low_m", |s, travel_low_m| SafetySettings { travel_low_m, ..s }),
            ("travel_high_m", |s, travel_high_m| SafetySettings { travel_high_m, ..s }),
            ("ramp_in_s", |s, ramp_in_s| SafetySettings { ramp_in_s, ..s }),
            ("sign_test_force", |s, sign_test_force| SafetySettings { sign_test_force, ..s }),
        ];
        for (name, with) in numbers {
            holds(name, &|value| with(limits, value).build(&design).err());
        }
        let bench = device(design);
        let samples = any::between(1.0, 1e5, part) as u32;
        let duty = bench.duty;
        holds("duty_time_constant_s", &|time_constant_s| {
            DutySettings { time_constant_s, ..duty }.build(&design, samples).err()
        });
        holds("duty_continuous_force_n", &|continuous_force_n| {
            DutySettings { continuous_force_n, ..duty }.build(&design, samples).err()
        });
        let backs: [(&str, With<ReturnSettings>); 8] = [
            ("start_m", |s, start_m| ReturnSettings { start_m, ..s }),
            ("return_speed_m_per_s", |s, speed_m_per_s| ReturnSettings { speed_m_per_s, ..s }),
            ("return_force_n", |s, force_n| ReturnSettings { force_n, ..s }),
            ("return_stiffness_n_per_m", |s, stiffness_n_per_m| ReturnSettings { stiffness_n_per_m, ..s }),
            ("return_damping_n_s_per_m", |s, damping_n_s_per_m| ReturnSettings { damping_n_s_per_m, ..s }),
            ("return_integral_n_per_m_s", |s, integral_n_per_m_s| ReturnSettings { integral_n_per_m_s, ..s }),
            ("return_tolerance_m", |s, tolerance_m| ReturnSettings { tolerance_m, ..s }),
            ("return_timeout_s", |s, timeout_s| ReturnSettings { timeout_s, ..s }),
        ];
        for (name, with) in backs {
            holds(name, &|value| with(bench.back, value).build(&design).err());
        }
        holds("calibrate", &|percent| {
            CalibrationSettings { percent, ..bench.calibration }.build(&design).err()
        });
        let grids: [(&str, With<WalkSettings>); 6] = [
            ("stiffness_start_n_per_m", |s, stiffness_start_n_per_m| WalkSettings { stiffness_start_n_per_m, ..s }),
            ("stiffness_step_n_per_m", |s, stiffness_step_n_per_m| WalkSettings { stiffness_step_n_per_m, ..s }),
            ("stiffness_max_n_per_m", |s, stiffness_max_n_per_m| WalkSettings { stiffness_max_n_per_m, ..s }),
            ("damping_start_n_s_per_m", |s, damping_start_n_s_per_m| WalkSettings { damping_start_n_s_per_m, ..s }),
            ("damping_step_n_s_per_m", |s, damping_step_n_s_per_m| WalkSettings { damping_step_n_s_per_m, ..s }),
            ("damping_max_n_s_per_m", |s, damping_max_n_s_per_m| WalkSettings { damping_max_n_s_per_m, ..s }),
        ];
        let grid = WalkSettings {
            stiffness_max_n_per_m: any::between(1e3, 1e7, part),
            damping_max_n_s_per_m: any::between(10.0, 1e4, part),
            ..GRID
        };
        for (name, with) in grids {
            if name.contains("start") || !name.contains("stiffness_start") {
                holds(name, &|value| with(grid, value).check().err().filter(|_| value != 0.0));
            }
        }
    }

    /// Limits that depend on other numbers of a device behave in the same way. These limits are the full scale that a
    /// calibration may find, the start of a hit, and the longest sum of settle and window.
    of_hits(800, (design, wall, settle) in (any::design(), 0.0..1.0f64, 0.01..0.99f64)) {
        let bench = device(design);
        holds("full_scale_n", &|value| bench.calibrated(value).err());
        let mut stored = bench.defaults();
        if bench.hit_sequence(&stored, false).is_err() {
            return Ok(()); // no return move is possible on this design
        }
        stored.settings.wall.position_m = (1e3 + 2e4 * wall) * design.resolution_m;
        let with = |start_m: f64| bench.experiment(&zwidth::store::Stored { start_m, ..stored }).err();
        holds("start_m", &with);
        // The printed longest time, split into two. The first part is a whole number of milliseconds.
        let long = zwidth::store::Stored { settle_s: 100.0, window_s: 1e4 / design.rate_hz, ..stored };
        let Some(error) = bench.hit_sequence(&long, false).err() else { return Ok(()) };
        if error.parameter != "settle_s and window_s together" {
            return Ok(());
        }
        let longest = *error.range.end();
        for line in &printed(&error) {
            let [_, end] = ends(line);
            let settle_s: f64 = format!("{:.3}", settle * end).parse().unwrap();
            let window_s: f64 = Decimal(end - settle_s).to_string().parse().unwrap();
            let built = bench.hit_sequence(&zwidth::store::Stored { settle_s, window_s, ..stored }, false);
            assert!(built.is_ok(), "{line}: {settle_s} and {window_s}: {:?}", built.err());
            // The test adds a whole sample, since half a sample is rounded away.
            let window_s = window_s + 1.0 / design.rate_hz;
            let built = bench.hit_sequence(&zwidth::store::Stored { settle_s, window_s, ..stored }, false);
            assert!(built.is_err(), "{line}: {settle_s} and {window_s} of {longest} are accepted");
        }
    }
}
