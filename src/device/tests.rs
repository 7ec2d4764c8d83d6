//! Tests the plans that are computed from a device, and settings that a device refuses.

use std::{sync::LazyLock, vec::Vec};

use super::*;
use crate::{
    Output, VelocitySettings, WallSettings,
    safety::{
        FaultSet,
        envelope::{Boundary, Point},
    },
};

pub(crate) const fn point(damping_n_s_per_m: f64, stiffness_high_n_per_m: f64) -> Point {
    Point { damping_n_s_per_m, stiffness_low_n_per_m: 0.0, stiffness_high_n_per_m }
}

/// The envelope of the test device, for a cutoff of 1500 Hz and outputs at 1 kHz.
pub(crate) const BOUNDARY: Boundary<'static> = Boundary {
    key: Key { estimator: EstimatorName::Butterworth, cutoff_hz: 1500.0, period: 10, design: 0 },
    points: &[point(0.0, 4000.0), point(50.0, 20_000.0)],
};

static ENVELOPE: LazyLock<Vec<u32>> = LazyLock::new(|| {
    let mut words = [0; 16];
    Envelope::put(&[BOUNDARY], &mut words).unwrap().to_vec()
});

/// The paper's device. Beside the count it senses only the force.
pub(crate) static DEVICE: LazyLock<Device<'static>> = LazyLock::new(|| Device {
    board: Name::of("a-board"),
    key: DeviceKey { name: Name::of("bench"), hash: 0x0123_4567 },
    scene_hash: 0x0BAD_CAFE,
    design: Design {
        rate_hz: 10_000.0,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Dac { bits: 12 },
    },
    latency_samples: 0.115,
    senses: &[Sense::Force],
    envelope: Envelope::read(&ENVELOPE).unwrap(),
    designs: Designs::NONE,
    safety: SafetySettings {
        speed_max_m_per_s: 1.0,
        speed_believable_m_per_s: 5.0,
        travel_low_m: -0.04,
        travel_high_m: 0.11,
        ramp_in_s: 0.2,
        sign_test_force: 0.05,
        sign_test_counts: 200,
        heaviest_mass_kg: 8.0,
        heaviest_damping_n_s_per_m: 110.0,
        passive_acceleration_m_per_s2: 0.0,
    },
    duty: DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 },
    current: CurrentSettings { rest: 0.5, full: 0.8 },
    radius_m: 0.0,
    back: ReturnSettings::SOFT,
    calibration: CalibrationSettings {
        percent: 0.0,
        rise_percent_per_s: 2.0,
        hold_s: 30.0,
        travel_m: 1e-3,
    },
    settings: Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
        wall: WallSettings {
            position_m: 0.07,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        },
    },
    hit: HitSettings { push_n: 0.0, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 },
    walk: WalkSettings {
        stiffness_start_n_per_m: 2000.0,
        stiffness_step_n_per_m: 2000.0,
        stiffness_max_n_per_m: 1e7,
        damping_start_n_s_per_m: 10.0,
        damping_step_n_s_per_m: 10.0,
        damping_max_n_s_per_m: 4000.0,
    },
    signs: Signs::default(),
    criterion: Criterion::Rms,
});

fn loaded(stored: Stored) -> Loaded {
    Loaded { stored, source: Source::Newest, damaged: 0 }
}

#[track_caller]
fn refused<T: core::fmt::Debug>(result: Result<T, SettingsError>, parameter: &str) {
    assert_eq!(result.unwrap_err().parameter, parameter);
}

#[test]
fn defaults_are_the_devices_and_can_be_run() {
    let stored = DEVICE.defaults();
    assert_eq!((stored.device, stored.settings), (DEVICE.key, DEVICE.settings));
    assert_eq!((stored.settle_s, stored.window_s, stored.start_m), (4.0, 2.0, 0.0));
    assert_eq!((stored.full_scale_n, stored.grid), (5.906, DEVICE.walk));
    let plan = DEVICE.hit_sequence(&stored, true).unwrap();
    let late = DEVICE.hit_sequence(&stored, false).unwrap();
    assert_eq!((plan.look, late.look), (32, HitSequencePlan::NEVER));
    // with a weaker motor the hit is shorter, with the same proportions
    let weak = Device { duty: DutySettings { time_constant_s: 3.0, ..DEVICE.duty }, ..*DEVICE };
    let short = weak.defaults();
    assert!(short.settle_s < 2.0 && (short.settle_s - 2.0 * short.window_s).abs() < 1e-12);
    assert!(weak.hit_sequence(&short, false).is_ok());
    refused(weak.hit_sequence(&stored, false), "settle_s and window_s together");
}

#[test]
fn a_hit_starts_inside_the_travel_and_before_the_wall() {
    let with = |start_m, position_m| {
        let mut stored = Stored { start_m, ..DEVICE.defaults() };
        stored.settings.wall.position_m = position_m;
        DEVICE.hit_sequence(&stored, false)
    };
    assert!(with(-0.04, 0.07).is_ok() && with(0.069_99, 0.07).is_ok());
    for (start_m, wall_m) in [(-0.0401, 0.07), (0.07, 0.07), (0.11, 0.2), (f64::NAN, 0.07)] {
        refused(with(start_m, wall_m), "start_m");
    }
    assert!(with(0.1099, 0.2).is_ok());
}

/// The settings of experiments can be set one by one, whatever the wall is. The ends of a printed range are accepted.
#[test]
fn settings_of_experiments_do_not_wait_for_a_wall_and_their_printed_ends_are_accepted() {
    for position_m in [-1.0, -0.04, 0.0, 0.07, 1.0] {
        let mut stored = DEVICE.defaults();
        stored.settings.wall.position_m = position_m;
        for start_m in [-0.04, 0.0, 0.11] {
            let stored = Stored { start_m, ..stored };
            assert!(DEVICE.experiment(&stored).is_ok());
            let Err(error) = DEVICE.hit_sequence(&stored, false) else { continue };
            assert!(error.range.start() < error.range.end(), "{error}");
            let [low, high] = crate::ends(&error.range);
            for end in [low, high] {
                let mut stored = stored;
                match error.parameter {
                    "start_m" => stored.start_m = end,
                    "position_m" => {
                        stored.settings.wall.position_m = end;
                        stored.start_m = -0.04;
                    }
                    other => panic!("{other}"),
                }
                assert_eq!(DEVICE.hit_sequence(&stored, false).err(), None, "{error}");
            }
        }
    }
    for time_constant_s in [3.0, 7.1, 9.7, 13.3] {
        let duty = DutySettings { time_constant_s, ..DEVICE.duty };
        let device = Device { duty, ..*DEVICE };
        let long = Stored { settle_s: 50.0, window_s: 50.0, ..device.defaults() };
        let error = device.experiment(&long).unwrap_err();
        assert_eq!(error.parameter, "settle_s and window_s together");
        let [_, most] = crate::ends(&error.range);
        for part in [0.1, 0.333_33, 0.500_05, 2.0 / 3.0] {
            let settle_s = (most * part * 1e5).round() / 1e5;
            let stored = Stored { settle_s, window_s: most - settle_s, ..long };
            assert_eq!(device.experiment(&stored).err(), None, "{most} {part}");
        }
    }
}

#[test]
fn a_calibrated_full_scale_scales_what_the_motor_stands_and_bounds_the_return() {
    let with = |full_scale_n| {
        let stored = Stored { full_scale_n, ..DEVICE.defaults() };
        DEVICE.hit_sequence(&stored, false)
    };
    let nominal = with(5.906).unwrap();
    let weak = with(2.0).unwrap();
    assert_eq!(weak.approach.duty, nominal.approach.duty);
    assert!(weak.approach.back.force() > nominal.approach.back.force());
    for full_scale_n in [5.906 / 3.01, 5.906 * 3.01, f64::NAN] {
        refused(with(full_scale_n), "full_scale_n");
        let stored = Stored { full_scale_n, ..DEVICE.defaults() };
        refused(DEVICE.control(&stored), "full_scale_n");
    }
    assert!(with(5.906 * 2.99).is_ok());
}

#[test]
fn a_board_starts_with_what_was_saved_or_with_the_defaults_and_a_fault() {
    let mut saved = DEVICE.defaults();
    saved.settings.wall.stiffness_n_per_m = 1000.0;
    let start = DEVICE.start(&loaded(saved), None).unwrap();
    assert_eq!((start.stored, start.source, start.fault), (saved, Source::Newest, None));
    assert_eq!(start.control, DEVICE.control(&saved).unwrap());
    let boot = FaultRecord { sample: 7, ..FaultRecord::bare(Fault::WatchdogReset) };
    assert_eq!(DEVICE.start(&loaded(saved), Some(boot)).unwrap().fault, Some(boot));
    // settings that cannot be built, and an estimator that needs a sense that the board lacks
    let mut wrong = saved;
    wrong.settings.wall.stiffness_n_per_m = 1e9;
    let blind = blind_estimator().map(|name| {
        let mut blind = saved;
        blind.settings.velocity = name.defaults();
        blind
    });
    for bad in [Some(wrong), blind].into_iter().flatten() {
        let start = DEVICE.start(&loaded(bad), None).unwrap();
        let found = (start.stored, start.source);
        assert_eq!(found, (DEVICE.defaults(), Source::Unusable));
        assert_eq!(start.control, DEVICE.control(&DEVICE.defaults()).unwrap());
        assert_eq!(start.fault, Some(FaultRecord::bare(Fault::Settings)));
        let both = DEVICE.start(&loaded(bad), Some(boot)).unwrap().fault.unwrap();
        assert_eq!((both.fault, both.sample), (Fault::WatchdogReset, 7));
        let causes = FaultSet::EMPTY.with(Fault::WatchdogReset).with(Fault::Settings);
        assert_eq!(both.causes, causes);
    }
}

#[test]
fn a_board_starts_with_the_period_that_was_saved_if_there_is_one_and_time_for_it() {
    for period in [0, 1, 2, 3, 5, 10, 11, u32::MAX] {
        let saved = Stored { period, ..DEVICE.defaults() };
        let start = DEVICE.start(&loaded(saved), None).unwrap();
        let known = PERIODS.contains(&period);
        let in_force = if known { period } else { 10 };
        assert_eq!((start.stored.period, start.control.period.get()), (in_force, in_force));
        assert_eq!(start.fault.is_none(), known);
        let plan = DEVICE.period(&Stored { period: in_force, ..saved }).unwrap();
        assert_eq!((start.period, plan.keep), (plan, 10 / in_force));
        let safety = DEVICE.safety.build(&Design { period: in_force, ..DEVICE.design });
        assert_eq!(Ok(start.safety), safety);
        assert_eq!(DEVICE.hit_sequence(&start.stored, true).unwrap().look, 320 / in_force);
    }
    // An estimator that leaves no time for this period makes the settings unusable.
    let slow = EstimatorName::ALL.iter().find(|name| leaves_time(**name, 1).is_err());
    if let Some(&name) = slow {
        let mut saved = Stored { period: 1, ..DEVICE.defaults() };
        saved.settings.velocity = name.defaults();
        assert_eq!(DEVICE.start(&loaded(saved), None).unwrap().source, Source::Unusable);
        saved.period = 2;
        assert_eq!(DEVICE.start(&loaded(saved), None).unwrap().source, Source::Newest);
    }
}

/// An estimator that needs a sense that the board lacks, if this build has one.
pub(crate) fn blind_estimator() -> Option<EstimatorName> {
    let names = EstimatorName::ALL.iter().copied();
    names.into_iter().find(|name| name.missing(DEVICE.senses).is_some())
}

#[test]
fn numbers_of_the_device_that_are_not_allowed_are_named() {
    let named = |device: Device, parameter| {
        refused(device.start(&loaded(DEVICE.defaults()), None), parameter);
    };
    let safety = SafetySettings { ramp_in_s: 0.0, ..DEVICE.safety };
    named(Device { safety, ..*DEVICE }, "ramp_in_s");
    let duty = DutySettings { continuous_force_n: 6.0, ..DEVICE.duty };
    named(Device { duty, ..*DEVICE }, "duty_continuous_force_n");
    let back = ReturnSettings { speed_m_per_s: 2.0, ..DEVICE.back };
    named(Device { back, ..*DEVICE }, "return_speed_m_per_s");
}

#[test]
fn the_envelope_is_asked_for_what_is_in_force() {
    let mut stored = DEVICE.defaults();
    stored.settings.wall.stiffness_n_per_m = 4000.0;
    assert_eq!(DEVICE.inside(&stored), Ok(()));
    let expected = Order::LoopParameters(DEVICE.control(&stored).unwrap(), Gains::Inside);
    assert_eq!(DEVICE.order(&stored).unwrap(), expected);
    stored.settings.wall.stiffness_n_per_m = 4001.0;
    assert!(matches!(DEVICE.inside(&stored), Err(Outside::Stiffness { .. })));
    let order = DEVICE.order(&stored).unwrap();
    assert!(matches!(order, Order::LoopParameters(_, Gains::Outside)));
    stored.settings.wall.stiffness_n_per_m = 1000.0;
    stored.settings.velocity = VelocitySettings::Butterworth { cutoff_hz: 1400.0 };
    assert_eq!(DEVICE.inside(&stored), Err(Outside::UnknownKey));
    stored.settings.wall.stiffness_n_per_m = 0.0;
    assert_eq!(DEVICE.inside(&stored), Ok(())); // without a wall nothing is refused
    stored.settings.wall.stiffness_n_per_m = 1000.0;
    stored.settings.velocity = DEVICE.settings.velocity;
    let fast = Stored { period: 1, ..stored };
    assert_eq!(DEVICE.inside(&stored), Ok(()));
    assert_eq!(DEVICE.inside(&fast), Err(Outside::UnknownKey));
}

#[test]
fn a_calibration_is_bounded() {
    assert!(DEVICE.calibration(&DEVICE.defaults(), 20.0).is_ok());
    refused(DEVICE.calibration(&DEVICE.defaults(), 31.0), "calibrate");
}
