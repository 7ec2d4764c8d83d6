//! One line to one command.

use core::fmt;

use super::number;
use crate::{experiment::WalkSettings, velocity::EstimatorName};

/// What a person asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// List the commands.
    Help,
    /// Say what runs.
    Version,
    /// Say how things stand.
    Status,
    /// Say which settings are in force.
    Get,
    /// The count is 0 here.
    Zero,
    /// Sign test, ramp, force.
    Arm,
    /// Force off.
    Disarm,
    /// Stiffness K, N/m.
    Stiffness(f64),
    /// Damping B, N s/m.
    Damping(f64),
    /// Surface of the wall, m.
    Wall(f64),
    /// Cutoff of the velocity filter, Hz.
    Cutoff(f64),
    /// The estimator's tuning, in its own unit: see [`EstimatorName::parameters`].
    Tuning(f64),
    /// A further parameter of the estimator by its place, 1 for the second one, in its own unit.
    Further(usize, f64),
    /// Velocity estimator.
    Estimator(EstimatorName),
    /// Output period, samples.
    Period(f64),
    /// Push of the experiments, N; does nothing by itself.
    Push(f64),
    /// Run a wall hit.
    Hit,
    /// Walk along the boundary.
    Walk,
    /// End the experiment.
    Stop,
    /// Allow gains beyond the envelope until the force goes off.
    UnlockEnvelope,
    /// Telemetry on or off.
    Stream(bool),
    /// Write the settings to flash.
    Save,
    /// Take the settings from flash.
    Load,
    /// Show the faults.
    Faults,
    /// Forget the fault.
    Clear,
    /// Hold a constant force for calibration, percent of full scale.
    Calibrate(f64),
    /// What the calibration found: the force at full command, N.
    FullScale(f64),
    /// Where hits start, m.
    Start(f64),
    /// Time before a hit is judged, s.
    Settle(f64),
    /// Time over which it is judged, s.
    Window(f64),
    /// Limit of a stable hit's RMS, m.
    RmsLimit(f64),
    /// Grid of the walk.
    Grid(GridValue, f64),
    /// The motor is mounted the other way round.
    MotorReversed(bool),
    /// The encoder is mounted the other way round.
    EncoderReversed(bool),
    /// The host is there, and will say so again within that time, ms; 0: it promises nothing any more.
    Alive(f64),
}

/// A value of the walk's grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridValue {
    /// First K, N/m.
    StiffnessStart,
    /// Step of K, N/m.
    StiffnessStep,
    /// Largest K, N/m.
    StiffnessMax,
    /// First B, N s/m.
    DampingStart,
    /// Step of B, N s/m.
    DampingStep,
    /// Largest B, N s/m.
    DampingMax,
}

impl GridValue {
    /// As it is typed.
    pub const fn text(self) -> &'static str {
        match self {
            Self::StiffnessStart => "kstart",
            Self::StiffnessStep => "kstep",
            Self::StiffnessMax => "kmax",
            Self::DampingStart => "bstart",
            Self::DampingStep => "bstep",
            Self::DampingMax => "bmax",
        }
    }

    /// Its unit.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::StiffnessStart | Self::StiffnessStep | Self::StiffnessMax => "N/m",
            Self::DampingStart | Self::DampingStep | Self::DampingMax => "N s/m",
        }
    }

    /// Its place in a plan.
    pub const fn of(self, plan: &mut WalkSettings) -> &mut f64 {
        match self {
            Self::StiffnessStart => &mut plan.stiffness_start_n_per_m,
            Self::StiffnessStep => &mut plan.stiffness_step_n_per_m,
            Self::StiffnessMax => &mut plan.stiffness_max_n_per_m,
            Self::DampingStart => &mut plan.damping_start_n_s_per_m,
            Self::DampingStep => &mut plan.damping_step_n_s_per_m,
            Self::DampingMax => &mut plan.damping_max_n_s_per_m,
        }
    }
}

/// Why a line is no command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParseError {
    /// No command has that name.
    Unknown,
    /// This command needs something behind it.
    Missing(&'static str),
    /// This command takes nothing more.
    Extra(&'static str),
    /// This is no number.
    Number(&'static str),
    /// This command takes one of a few words.
    Word(&'static str),
    /// No estimator of this build has that name.
    Estimator,
    /// The line is longer than [`LINE_MAX`](super::LINE_MAX).
    TooLong,
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => f.write_str("unknown command: help lists them"),
            Self::Missing(usage) => write!(f, "something is missing: {usage}"),
            Self::Extra(usage) => write!(f, "too many words: {usage}"),
            Self::Number(usage) => {
                write!(f, "not a number of at most 15 digits such as 2000, 0.07 or 1.5e3: {usage}")
            }
            Self::Word(usage) => write!(f, "unknown word: {usage}"),
            Self::Estimator => {
                f.write_str("unknown estimator, allowed")?;
                EstimatorName::ALL.iter().try_for_each(|name| write!(f, " {}", name.text()))
            }
            Self::TooLong => write!(f, "line too long: at most {} bytes", super::LINE_MAX),
        }
    }
}

/// What stands behind the name of a command.
enum Form {
    Plain(Command),
    Number(fn(f64) -> Command),
    Word(&'static [(&'static str, Command)]),
    Estimator,
}

/// Name, use, form.
type Entry = (&'static str, &'static str, Form);

static TABLE: &[Entry] = {
    use Command as C;
    use Form::{Number, Plain, Word};
    use GridValue as G;
    &[
        ("help", "help", Plain(C::Help)),
        ("version", "version", Plain(C::Version)),
        ("status", "status", Plain(C::Status)),
        ("get", "get", Plain(C::Get)),
        ("zero", "zero", Plain(C::Zero)),
        ("arm", "arm", Plain(C::Arm)),
        ("disarm", "disarm", Plain(C::Disarm)),
        ("k", "k N_PER_M", Number(C::Stiffness)),
        ("b", "b N_S_PER_M", Number(C::Damping)),
        ("wall", "wall METRES", Number(C::Wall)),
        ("cutoff", "cutoff HZ", Number(C::Cutoff)),
        ("tuning", "tuning VALUE", Number(C::Tuning)),
        ("tuning2", "tuning2 VALUE", Number(|value| C::Further(1, value))),
        #[cfg(feature = "estimators")]
        ("tuning3", "tuning3 VALUE", Number(|value| C::Further(2, value))),
        #[cfg(feature = "estimators")]
        ("tuning4", "tuning4 VALUE", Number(|value| C::Further(3, value))),
        #[cfg(feature = "estimators")]
        ("tuning5", "tuning5 VALUE", Number(|value| C::Further(4, value))),
        #[cfg(feature = "estimators")]
        ("tuning6", "tuning6 VALUE", Number(|value| C::Further(5, value))),
        #[cfg(feature = "estimators")]
        ("tuning7", "tuning7 VALUE", Number(|value| C::Further(6, value))),
        #[cfg(feature = "estimators")]
        ("tuning8", "tuning8 VALUE", Number(|value| C::Further(7, value))),
        ("estimator", "estimator NAME", Form::Estimator),
        ("period", "period SAMPLES", Number(C::Period)),
        ("push", "push NEWTONS", Number(C::Push)),
        ("hit", "hit", Plain(C::Hit)),
        ("walk", "walk", Plain(C::Walk)),
        ("stop", "stop", Plain(C::Stop)),
        ("unlock", "unlock envelope", Word(&[("envelope", C::UnlockEnvelope)])),
        ("stream", "stream on|off", Word(&[("on", C::Stream(true)), ("off", C::Stream(false))])),
        ("save", "save", Plain(C::Save)),
        ("load", "load", Plain(C::Load)),
        ("faults", "faults", Plain(C::Faults)),
        ("clear", "clear", Plain(C::Clear)),
        ("calibrate", "calibrate PERCENT", Number(C::Calibrate)),
        ("fullscale", "fullscale NEWTONS", Number(C::FullScale)),
        ("start", "start METRES", Number(C::Start)),
        ("settle", "settle SECONDS", Number(C::Settle)),
        ("window", "window SECONDS", Number(C::Window)),
        ("rms", "rms METRES", Number(C::RmsLimit)),
        ("kstart", "kstart N_PER_M", Number(|k| C::Grid(G::StiffnessStart, k))),
        ("kstep", "kstep N_PER_M", Number(|k| C::Grid(G::StiffnessStep, k))),
        ("kmax", "kmax N_PER_M", Number(|k| C::Grid(G::StiffnessMax, k))),
        ("bstart", "bstart N_S_PER_M", Number(|b| C::Grid(G::DampingStart, b))),
        ("bstep", "bstep N_S_PER_M", Number(|b| C::Grid(G::DampingStep, b))),
        ("bmax", "bmax N_S_PER_M", Number(|b| C::Grid(G::DampingMax, b))),
        (
            "motor",
            "motor +|-",
            Word(&[("+", C::MotorReversed(false)), ("-", C::MotorReversed(true))]),
        ),
        (
            "encoder",
            "encoder +|-",
            Word(&[("+", C::EncoderReversed(false)), ("-", C::EncoderReversed(true))]),
        ),
        ("alive", "alive MS", Number(C::Alive)),
    ]
};

/// How each command is typed, in the order of `help`.
pub fn usages() -> impl Iterator<Item = &'static str> {
    TABLE.iter().map(|(_, usage, _)| *usage)
}

/// Reads one line: a name and at most one word or number, with blanks around them. Upper case is as
/// good as lower case. Any bytes are fine as input; numbers are checked for form here, and for range
/// where the settings are built.
///
/// # Errors
/// Says what is allowed.
pub fn parse(line: &[u8]) -> Result<Command, ParseError> {
    let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    let name = words.next().ok_or(ParseError::Unknown)?;
    let (_, usage, form) = TABLE
        .iter()
        .find(|(known, _, _)| name.eq_ignore_ascii_case(known.as_bytes()))
        .ok_or(ParseError::Unknown)?;
    let command = match form {
        Form::Plain(command) => *command,
        Form::Number(command) => {
            let word = words.next().ok_or(ParseError::Missing(usage))?;
            command(number::parse(word).ok_or(ParseError::Number(usage))?)
        }
        Form::Word(known) => {
            let word = words.next().ok_or(ParseError::Missing(usage))?;
            let found = known.iter().find(|(text, _)| word.eq_ignore_ascii_case(text.as_bytes()));
            found.ok_or(ParseError::Word(usage))?.1
        }
        Form::Estimator => {
            let word = words.next().ok_or(ParseError::Missing(usage))?;
            let name = core::str::from_utf8(word).unwrap_or_default().parse();
            Command::Estimator(name.map_err(|_| ParseError::Estimator)?)
        }
    };
    match words.next() {
        None => Ok(command),
        Some(_) => Err(ParseError::Extra(usage)),
    }
}

#[cfg(test)]
mod tests {
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
            ("calibrate -20", C::Calibrate(-20.0)),
            ("fullscale 5.9", C::FullScale(5.9)),
            ("start 0", C::Start(0.0)),
            ("settle 4", C::Settle(4.0)),
            ("window 2", C::Window(2.0)),
            ("rms 1.5e-5", C::RmsLimit(1.5e-5)),
            ("motor -", C::MotorReversed(true)),
            ("motor +", C::MotorReversed(false)),
            ("encoder -", C::EncoderReversed(true)),
            ("encoder +", C::EncoderReversed(false)),
            ("alive 200", C::Alive(200.0)),
            ("  K\t-1e3  ", C::Stiffness(-1000.0)),
        ] {
            assert_eq!(parse(line.as_bytes()), Ok(command), "{line}");
        }
        assert_eq!(usages().count(), if cfg!(feature = "estimators") { 46 } else { 40 });
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
            ("estimator none", E::Estimator),
            ("estimator", E::Missing("estimator NAME")),
        ] {
            assert_eq!(parse(line.as_bytes()), Err(error), "{line}");
        }
    }

    #[test]
    fn every_estimator_is_read_by_its_name() {
        for &name in EstimatorName::ALL {
            let line = std::format!("estimator {}", name.text());
            assert_eq!(parse(line.as_bytes()), Ok(Command::Estimator(name)));
        }
    }

    /// Bytes as they may come: half of them pieces of real commands.
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

    /// No input panics, numbers are finite, and every line has one reply of one line.
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
}
