//! Compares the linear analysis with values that another program computed in double precision. Tests the ends of the
//! accepted range too.

use super::*;

/// Tolerance for the printed values, which have four to eight digits.
const PRINTED: f64 = 1e-3;

fn paper(cutoff: Option<f64>) -> TransferFunction {
    cutoff.map_or_else(
        || TransferFunction::finite_difference(1e4),
        |hz| TransferFunction::paper(1e4, hz).unwrap(),
    )
}

fn assert_printed(ours: f64, printed: f64, what: &str) {
    if printed == 0.0 {
        assert_eq!(ours, 0.0, "{what}");
    } else {
        assert!((ours / printed - 1.0).abs() <= PRINTED, "{what}: {ours} is not {printed}");
    }
}

#[test]
fn single_rate_boundary_as_printed() {
    // The loop of the paper's section 2.1 at 10 kHz.
    let dampings = [0.0, 10.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0];
    let table: [(Option<f64>, [f64; 8]); 10] = [
        (Some(20.0), [110_414., 97_717., 3_883., 0., 0., 0., 0., 0.]),
        (Some(50.0), [110_414., 69_765., 34_989., 20_837., 0., 0., 0., 0.]),
        (Some(100.0), [110_414., 126_536., 124_764., 106_938., 65_257., 0., 0., 0.]),
        (Some(200.0), [110_414., 217_626., 343_080., 366_886., 333_248., 115_709., 0., 0.]),
        (
            Some(500.0),
            [110_414., 288_360., 782_433., 1_114_431., 1_389_005., 1_334_739., 594_641., 0.],
        ),
        (
            Some(1000.0),
            [
                110_414., 302_663., 979_186., 1_648_048., 2_560_124., 3_559_221., 3_166_776.,
                398_305.,
            ],
        ),
        (
            Some(1700.0),
            [
                110_414., 306_459., 1_041_246., 1_856_979., 3_193_959., 5_533_348., 6_427_946.,
                3_965_641.,
            ],
        ),
        (
            Some(2000.0),
            [
                110_414., 307_110., 1_052_255., 1_895_897., 3_324_638., 6_050_856., 7_499_028.,
                5_455_343.,
            ],
        ),
        (
            Some(4000.0),
            [
                110_414.,
                308_643.,
                1_078_598.,
                1_991_072.,
                3_659_563.,
                7_579_526.,
                11_346_813.,
                12_472_772.,
            ],
        ),
        (
            None,
            [
                110_414.,
                309_714.,
                1_097_375.,
                2_060_750.,
                3_918_406.,
                8_966_800.,
                15_801_005.,
                24_578_136.,
            ],
        ),
    ];
    for (cutoff, row) in table {
        let boundary =
            Boundary::new(&Loop::single_rate(Device::PAPER, 1e4, paper(cutoff))).unwrap();
        for (damping, printed) in dampings.into_iter().zip(row) {
            let limit = boundary.at(damping).unwrap();
            assert_printed(limit.stiffness_max, printed, &format!("{cutoff:?} B {damping}"));
            assert_eq!(limit.unstable_at_zero, printed == 0.0);
        }
    }
}

#[test]
fn latency_as_printed() {
    // The force changes at 1 kHz. The estimator is the plain difference. The latency has whole samples.
    let table: [(f64, &[(f64, f64)]); 5] = [
        (
            0.0,
            &[
                (0., 11_063.5),
                (5., 20_835.),
                (10., 30_374.),
                (20., 48_766.),
                (50., 98_747.),
                (100., 166_395.),
            ],
        ),
        (1.0, &[(0., 3_693.), (20., 16_171.)]),
        (2.0, &[(0., 2_220.)]),
        (3.0, &[(0., 1_589.)]),
        (5.0, &[(0., 1_016.), (20., 4_154.)]),
    ];
    for (latency_samples, row) in table {
        let estimator = TransferFunction::finite_difference(1e3);
        let of = Loop { latency_samples, ..Loop::single_rate(Device::PAPER, 1e3, estimator) };
        let boundary = Boundary::new(&of).unwrap();
        for (damping, printed) in row {
            let limit = boundary.at(*damping).unwrap();
            assert_printed(
                limit.stiffness_max,
                *printed,
                &format!("latency {latency_samples} B {damping}"),
            );
        }
    }
}

/// Four pairs, each of a damping and the limit that the other program printed.
type Row = [(f64, f64); 4];

#[test]
fn multirate_boundary_as_printed() {
    // The estimator runs at 10 kHz, the force changes at 1 kHz.
    let table: [(Option<f64>, Row); 6] = [
        (Some(50.0), [(0., 11_064.), (20., 19_684.), (50., 18_661.), (100., 11_183.)]),
        (Some(100.0), [(0., 11_064.), (20., 35_174.), (50., 47_614.), (100., 46_923.)]),
        (Some(500.0), [(0., 11_064.), (100., 167_389.), (300., 282_439.), (500., 223_183.)]),
        (Some(1000.0), [(0., 11_064.), (100., 185_557.), (300., 410_838.), (500., 511_011.)]),
        (Some(2000.0), [(0., 11_064.), (100., 195_756.), (300., 485_033.), (500., 684_770.)]),
        (None, [(0., 11_064.), (100., 206_535.), (300., 570_203.), (500., 899_552.)]),
    ];
    for (cutoff, row) in table {
        let of = Loop { period: 10, ..Loop::single_rate(Device::PAPER, 1e4, paper(cutoff)) };
        let boundary = Boundary::new(&of).unwrap();
        for (damping, printed) in row {
            let limit = boundary.at(damping).unwrap();
            assert_printed(limit.stiffness_max, printed, &format!("{cutoff:?} B {damping}"));
        }
    }
}

#[test]
fn passivity_as_printed() {
    let at = |stiffness: f64, damping: f64, rate: f64, estimator: &TransferFunction| {
        passivity::tests::demand(stiffness, damping, rate, estimator).unwrap().damping_n_s_per_m
    };
    let plain = TransferFunction::finite_difference(1e3);
    for (damping, printed) in [(0.0, 0.5), (5.0, 5.5), (-2.0, 2.5)] {
        assert_printed(at(1000.0, damping, 1e3, &plain), printed, "plain difference");
    }
    for (cutoff, printed) in [(50.0, 2.2663), (100.0, 2.8602), (200.0, 3.6879)] {
        assert_printed(
            at(1000.0, 5.0, 1e3, &TransferFunction::paper(1e3, cutoff).unwrap()),
            printed,
            "1 kHz",
        );
    }
    for (cutoff, printed) in
        [(100.0, 5.7639), (500.0, 8.0651), (1000.0, 10.4406), (2000.0, 13.7515), (3000.0, 15.7913)]
    {
        assert_printed(
            at(20_000.0, 20.0, 1e4, &TransferFunction::paper(1e4, cutoff).unwrap()),
            printed,
            "10 kHz",
        );
    }
    assert_printed(
        at(20_000.0, 20.0, 1e4, &TransferFunction::finite_difference(1e4)),
        21.0,
        "10 kHz, unfiltered",
    );
    // A first-order filter that was made with the backward mapping. Its time constant tau is in samples.
    for (tau, positive, negative) in [(1.0, 2.1667, 5.5), (5.0, 0.9545, 5.5)] {
        let gain = 1e3 / (1.0 + tau);
        let filtered =
            TransferFunction { num: vec![gain, -gain], den: vec![1.0, -tau / (1.0 + tau)] };
        assert_printed(at(1000.0, 5.0, 1e3, &filtered), positive, "backward mapping");
        assert_printed(
            at(1000.0, -5.0, 1e3, &filtered),
            negative,
            "backward mapping, negative damping",
        );
    }
    // The largest passive K at B = 0 is 2 b / T.
    let b = Device::PAPER.damping_n_s_per_m;
    for (rate, printed) in [(1e3, 11_039.0), (1e4, 110_390.0)] {
        assert_printed(at(printed, 0.0, rate, &plain), b, "2 b / T");
    }
}

#[test]
fn extremes_give_numbers() {
    let devices = [
        Device::PAPER,
        Device { mass_kg: 1.0, damping_n_s_per_m: 0.0, stiffness_n_per_m: 0.0 },
        Device { mass_kg: 1e-3, damping_n_s_per_m: 0.0, stiffness_n_per_m: 1e9 },
        Device { mass_kg: 100.0, damping_n_s_per_m: 0.0, stiffness_n_per_m: 1e-3 },
        Device { mass_kg: 1e-3, damping_n_s_per_m: 1e6, stiffness_n_per_m: 0.0 },
        Device { mass_kg: 1e-3, damping_n_s_per_m: 1e6, stiffness_n_per_m: 1e9 },
        Device { mass_kg: 100.0, damping_n_s_per_m: 1e-9, stiffness_n_per_m: 0.0 },
    ];
    for device in devices {
        for rate_hz in [1e3, 5e4] {
            for cutoff in [None, Some(zwidth::velocity::CUTOFF_MIN), Some(0.1), Some(0.49)] {
                for (period, latency_samples) in
                    [(1, 0.0), (1, 0.5), (1, 100.0), (10, 10.0), (7, 3.3)]
                {
                    let plain = TransferFunction::finite_difference(rate_hz);
                    let estimator = cutoff
                        .map_or(plain, |c| TransferFunction::paper(rate_hz, c * rate_hz).unwrap());
                    let elements = Elements::default();
                    let of = Loop { device, elements, rate_hz, period, latency_samples, estimator };
                    let boundary = Boundary::new(&of).unwrap();
                    for damping in [0.0, -1.0, 1e-6, 1.0, 1e4, 1e12] {
                        let limit = boundary.at(damping).unwrap();
                        assert!(limit.stiffness_max >= 0.0, "{of:?} B {damping}: {limit:?}");
                        assert!(
                            limit.phase_crossings.iter().all(|c| c.stiffness_n_per_m.is_finite())
                        );
                        // If the filter is far below the frequency of the spring, even the damping of 1e12 can be
                        // stable.
                        if damping == 1e12 && cutoff.is_none() {
                            assert_eq!(limit.stiffness_max, 0.0, "{of:?}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn undamped_device_needs_virtual_damping() {
    let device = Device { mass_kg: 0.4, damping_n_s_per_m: 0.0, stiffness_n_per_m: 0.0 };
    for stiffness_n_per_m in [0.0, 10.0, 1e5] {
        let device = Device { stiffness_n_per_m, ..device };
        let of = Loop::single_rate(device, 1e4, TransferFunction::finite_difference(1e4));
        let boundary = Boundary::new(&of).unwrap();
        let without = boundary.at(0.0).unwrap();
        assert!(without.stiffness_max == 0.0 && without.unstable_at_zero, "{without:?}");
        // With damping B, the limit is about B / (T/2).
        let with = boundary.at(10.0).unwrap().stiffness_max;
        assert!((with / 2e5 - 1.0).abs() < 0.02, "k {stiffness_n_per_m}: {with}");
        assert_eq!(boundary.at(-1.0).unwrap().stiffness_max, 0.0);
    }
}

#[test]
fn refuses_what_is_no_number() {
    let good = Loop::single_rate(Device::PAPER, 1e4, TransferFunction::finite_difference(1e4));
    let boundary = Boundary::new(&good).unwrap();
    assert!(boundary.at(f64::NAN).is_err() && boundary.at(f64::INFINITY).is_err());
    let bad = [
        Loop { rate_hz: 0.0, ..good.clone() },
        Loop { rate_hz: f64::NAN, ..good.clone() },
        Loop { period: 0, ..good.clone() },
        Loop { latency_samples: -1.0, ..good.clone() },
        Loop { device: Device { mass_kg: 0.0, ..Device::PAPER }, ..good.clone() },
        Loop { device: Device { damping_n_s_per_m: -1.0, ..Device::PAPER }, ..good.clone() },
        Loop { estimator: TransferFunction { num: vec![1.0], den: vec![] }, ..good.clone() },
        Loop {
            estimator: TransferFunction { num: vec![f64::NAN], den: vec![1.0] },
            ..good.clone()
        },
        Loop {
            estimator: TransferFunction { num: vec![1.0], den: vec![0.0, 1.0] },
            ..good.clone()
        },
    ];
    for of in bad {
        assert!(Boundary::new(&of).is_err() && Monodromy::new(&of).is_err(), "{of:?}");
    }
}
