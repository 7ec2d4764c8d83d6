//! Tests that every command is understood, and that any other input is at most refused.

use super::*;
use crate::console::{LINE_MAX, Line, LineReader, REPLY_MAX, Text};
use proptest::prelude::*;

#[test]
fn every_command_is_read() {
    use Command as C;
    for (line, command) in [
        ("help", C::Help),
        ("version", C::Version),
        ("status", C::Status),
        ("get", C::Get),
        ("zero", C::Zero),
        ("arm", C::Arm),
        ("disarm", C::Disarm),
        ("k 2000", C::Stiffness(2000.0)),
        ("b 5", C::Damping(5.0)),
        ("wall 0.07", C::Wall(0.07)),
        ("cutoff 1500", C::Cutoff(1500.0)),
        ("tuning 16", C::Tuning(16.0)),
        ("tuning2 0.4", C::Further(1, 0.4)),
        #[cfg(feature = "estimators")]
        ("tuning4 -0.1", C::Further(3, -0.1)),
        #[cfg(feature = "estimators")]
        ("tuning5 1.5", C::Further(4, 1.5)),
        #[cfg(feature = "estimators")]
        ("tuning6 1", C::Further(5, 1.0)),
        #[cfg(feature = "estimators")]
        ("tuning7 0", C::Further(6, 0.0)),
        #[cfg(feature = "estimators")]
        ("tuning8 0.5", C::Further(7, 0.5)),
        ("estimator butterworth", C::Estimator(EstimatorName::Butterworth)),
        ("estimator butterworth-prewarped", C::Estimator(EstimatorName::ButterworthPrewarped)),
        ("designs", C::Designs),
        ("design quiet-2", C::Design(Name::of("quiet-2"))),
        ("period 5", C::Period(5.0)),
        ("push 2.835", C::Push(2.835)),
        ("hit", C::Hit),
        ("walk", C::Walk),
        ("stop", C::Stop),
        ("unlock envelope", C::UnlockEnvelope),
        ("stream on", C::Stream(true)),
        ("stream off", C::Stream(false)),
        ("save", C::Save),
        ("load", C::Load),
        ("faults", C::Faults),
        ("clear", C::Clear),
        ("pulses -1.2", C::Pulses(-1.2)),
        ("calibrate -20", C::Calibrate(-20.0)),
        ("fullscale 5.9", C::FullScale(5.9)),
        ("start 0", C::Start(0.0)),
        ("settle 4", C::Settle(4.0)),
        ("window 2", C::Window(2.0)),
        ("rms 1.5e-5", C::RmsLimit(1.5e-5)),
        ("criterion rms", C::Criterion(Criterion::Rms)),
        ("Criterion QUIET", C::Criterion(Criterion::Quiet)),
        ("force_rms 0.2", C::ForceRmsLimit(0.2)),
        ("motor -", C::MotorReversed(true)),
        ("motor +", C::MotorReversed(false)),
        ("encoder -", C::EncoderReversed(true)),
        ("encoder +", C::EncoderReversed(false)),
        ("alive 200", C::Alive(200.0)),
        ("selftest", C::SelfTest),
        ("  K\t-1e3  ", C::Stiffness(-1000.0)),
    ] {
        assert_eq!(parse(line.as_bytes()), Ok(command), "{line}");
    }
    assert_eq!(usages().count(), if cfg!(feature = "estimators") { 52 } else { 46 });
}

#[test]
fn every_value_of_the_grid_has_a_command_of_its_name() {
    use GridValue as G;
    let mut plan = WalkSettings {
        stiffness_start_n_per_m: 1.0,
        stiffness_step_n_per_m: 2.0,
        stiffness_max_n_per_m: 3.0,
        damping_start_n_s_per_m: 4.0,
        damping_step_n_s_per_m: 5.0,
        damping_max_n_s_per_m: 6.0,
    };
    let values = [
        (G::StiffnessStart, 1.0),
        (G::StiffnessStep, 2.0),
        (G::StiffnessMax, 3.0),
        (G::DampingStart, 4.0),
        (G::DampingStep, 5.0),
        (G::DampingMax, 6.0),
    ];
    for (value, expected) in values {
        let line = std::format!("{} 7", value.text());
        assert_eq!(parse(line.as_bytes()), Ok(Command::Grid(value, 7.0)));
        assert_eq!(*value.of(&mut plan), expected);
    }
}

#[test]
fn errors_say_what_is_allowed() {
    use ParseError as E;
    for (line, error) in [
        ("", E::Unknown),
        ("kk 5", E::Unknown),
        ("k", E::Missing("k N_PER_M")),
        ("k 5 N", E::Extra("k N_PER_M")),
        ("k five", E::Number("k N_PER_M")),
        ("k nan", E::Number("k N_PER_M")),
        ("stream", E::Missing("stream on|off")),
        ("stream maybe", E::Word("stream on|off")),
        ("unlock", E::Missing("unlock envelope")),
        ("unlock all", E::Word("unlock envelope")),
        ("arm now", E::Extra("arm")),
        ("calibrate", E::Missing("calibrate PERCENT")),
        ("motor reversed", E::Word("motor +|-")),
        ("estimator none", E::Estimator("none".parse::<EstimatorName>().unwrap_err())),
        ("estimator", E::Missing("estimator NAME")),
        ("design", E::Missing("design NAME")),
        ("design a_b", E::Design),
        ("design 0123456789abcdefg", E::Design),
    ] {
        assert_eq!(parse(line.as_bytes()), Err(error), "{line}");
    }
}

#[test]
#[cfg(feature = "estimators")]
fn an_estimator_that_is_no_more_says_what_replaces_it() {
    let error = parse(b"estimator dual-rate").unwrap_err();
    let said = std::format!("{error}");
    assert_eq!(said, "this estimator is no more: use window-difference");
}

#[test]
fn every_estimator_is_read_by_its_name() {
    for &name in EstimatorName::ALL {
        let line = std::format!("estimator {}", name.text());
        assert_eq!(parse(line.as_bytes()), Ok(Command::Estimator(name)));
    }
}

/// Arbitrary bytes. About half of them are pieces of real commands.
fn input() -> impl Strategy<Value = std::vec::Vec<u8>> {
    let piece = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..12),
        prop::sample::select(std::vec![
            "k ",
            "b 5",
            "wall",
            "0.07",
            "stream on",
            "unlock envelope",
            "arm",
            "1e",
            "-",
            ".",
            "\r\n",
            "\n",
            " ",
            "\t",
            "disarm\n",
            "push 2.835\n",
            "kstep ",
            "encoder -\n",
            "calibrate ",
            "1e22",
            "999999999999999",
        ])
        .prop_map(|text| text.as_bytes().to_vec()),
    ];
    prop::collection::vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}

/// Checks that no input panics, that all numbers are finite, and that every line gets one reply of one line.
fn feed(cases: u32) {
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(cases)
    });
    let outcome = runner.run(&input(), |bytes| {
        let mut reader = LineReader::<LINE_MAX>::new();
        for byte in bytes.into_iter().chain(*b"\nstatus\n") {
            let result = match reader.push(byte) {
                None => continue,
                Some(Line::TooLong) => Err(ParseError::TooLong),
                Some(Line::Text(text)) => parse(text),
            };
            match result {
                Ok(
                    Command::Stiffness(value)
                    | Command::Damping(value)
                    | Command::Wall(value)
                    | Command::Cutoff(value)
                    | Command::Tuning(value)
                    | Command::Further(_, value)
                    | Command::Push(value)
                    | Command::Calibrate(value)
                    | Command::FullScale(value)
                    | Command::Start(value)
                    | Command::Settle(value)
                    | Command::Window(value)
                    | Command::RmsLimit(value)
                    | Command::Grid(_, value)
                    | Command::Alive(value),
                ) => prop_assert!(value.is_finite()),
                Ok(_) => {}
                Err(error) => {
                    let text = Text::<REPLY_MAX>::of(error);
                    prop_assert!(!text.as_str().contains(['\n', '\r', '~']));
                }
            }
        }
        Ok(())
    });
    outcome.unwrap();
}

#[test]
fn arbitrary_bytes_never_panic() {
    feed(if cfg!(miri) { 5 } else { 20_000 });
}

#[test]
#[ignore = "the full campaign takes seconds more than all other tests together; a short one runs by default"]
fn a_million_arbitrary_inputs_never_panic() {
    feed(1_000_000);
}
