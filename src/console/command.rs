//! Parses a line into a command.

use core::fmt;

use super::{number, spoken::Spoken};
use crate::{
    device::designs::is_design_name,
    experiment::{Criterion, WalkSettings},
    store::Name,
    velocity::{EstimatorName, UnknownEstimator},
};

/// A command of the console.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// List all commands with their usage.
    Help,
    /// Say which firmware and device this is.
    Version,
    /// Report the state of supervisor and experiment.
    Status,
    /// Say which settings are in force.
    Get,
    /// Make the present position zero.
    Zero,
    /// Switch the force on: sign test, then ramp.
    Arm,
    /// Switch the force off.
    Disarm,
    /// Stiffness K of the wall, in N/m.
    Stiffness(f64),
    /// Damping B, in N s/m.
    Damping(f64),
    /// Surface of the wall, in m.
    Wall(f64),
    /// Cutoff of the velocity filter, in Hz.
    Cutoff(f64),
    /// The estimator's tuning, in its own unit: see [`EstimatorName::parameters`].
    Tuning(f64),
    /// A further parameter of the estimator, in the parameter's own unit. The `usize` is the index of the parameter
    /// among all parameters of the estimator. It begins at 1, the second parameter.
    Further(usize, f64),
    /// Choose the velocity estimator by its name.
    Estimator(EstimatorName),
    /// Say which designs the device has.
    Designs,
    /// Use the estimator and all parameters of the design with this name.
    Design(Name),
    /// Output period, in samples.
    Period(f64),
    /// The force with which the experiments push, in N. The command itself moves nothing.
    Push(f64),
    /// Run a wall hit.
    Hit,
    /// Run a pulse train with this force, in N.
    Pulses(f64),
    /// Walk along the boundary.
    Walk,
    /// End the experiment that is running.
    Stop,
    /// Allow gains beyond the envelope until the force goes off.
    UnlockEnvelope,
    /// Telemetry on or off.
    Stream(bool),
    /// Write the settings to flash.
    Save,
    /// Load the settings from flash.
    Load,
    /// Show the latched fault and all causes.
    Faults,
    /// Clear the latched fault, if its cause is gone.
    Clear,
    /// Hold a constant force for calibration, in percent of full scale.
    Calibrate(f64),
    /// Force at full command, in N. A calibration measures it.
    FullScale(f64),
    /// Start of hits, in m.
    Start(f64),
    /// Time before a hit is judged, in s.
    Settle(f64),
    /// Time over which a hit is judged, in s.
    Window(f64),
    /// Limit of a stable hit's RMS, in m.
    RmsLimit(f64),
    /// Criterion of a stable hit.
    Criterion(Criterion),
    /// Limit of the force's RMS, in N, for a hit that the criterion `quiet` judges. With 0 the limit is a share of the
    /// push.
    ForceRmsLimit(f64),
    /// Grid of the walk.
    Grid(GridValue, f64),
    /// Whether the motor is mounted the other way round.
    MotorReversed(bool),
    /// Whether the encoder is mounted the other way round.
    EncoderReversed(bool),
    /// Test the board, with the force off.
    SelfTest,
    /// The host is present, and will send this command again within this time, in ms. With 0 the host need not send it
    /// again.
    Alive(f64),
}

/// A value of the walk's grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridValue {
    /// First K of the walk, in N/m.
    StiffnessStart,
    /// Step of K, in N/m.
    StiffnessStep,
    /// Largest K of the walk, in N/m.
    StiffnessMax,
    /// First B, in N s/m.
    DampingStart,
    /// Step of B, in N s/m.
    DampingStep,
    /// Largest B, in N s/m.
    DampingMax,
}

impl GridValue {
    /// Name of the command that sets this value.
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

    /// Unit of the value at the handle: N/m or N s/m.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::StiffnessStart | Self::StiffnessStep | Self::StiffnessMax => "N/m",
            Self::DampingStart | Self::DampingStep | Self::DampingMax => "N s/m",
        }
    }

    /// Field of this value in the settings of a walk.
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

/// Why a line is not a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParseError {
    /// No command has that name.
    Unknown,
    /// This command needs a value.
    Missing(&'static str),
    /// This command takes no further value.
    Extra(&'static str),
    /// This is not a number.
    Number(&'static str),
    /// This command takes one of a few words.
    Word(&'static str),
    /// No estimator of this build has that name.
    Estimator(UnknownEstimator),
    /// A design cannot have this name.
    Design,
    /// The line is longer than [`LINE_MAX`](super::LINE_MAX).
    TooLong,
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.say(f, Spoken::AT_HANDLE)
    }
}

impl ParseError {
    /// Writes the error with numbers in the units of `spoken`.
    pub(super) fn say(&self, f: &mut fmt::Formatter<'_>, spoken: Spoken) -> fmt::Result {
        match self {
            Self::Unknown => f.write_str("unknown command: help lists them"),
            Self::Missing(usage) => write!(f, "something is missing: {}", spoken.usage(usage)),
            Self::Extra(usage) => write!(f, "too many words: {}", spoken.usage(usage)),
            Self::Number(usage) => {
                let usage = spoken.usage(usage);
                write!(f, "not a number of at most 15 digits such as 2000, 0.07 or 1.5e3: {usage}")
            }
            Self::Word(usage) => write!(f, "unknown word: {}", spoken.usage(usage)),
            Self::Estimator(unknown) => fmt::Display::fmt(unknown, f),
            Self::Design => {
                f.write_str("no name of a design (at most 16 bytes): designs lists them")
            }
            Self::TooLong => write!(f, "line too long: at most {} bytes", super::LINE_MAX),
        }
    }
}

/// Which words may follow a command's name, and the command that they make.
enum Form {
    Plain(Command),
    Number(fn(f64) -> Command),
    Word(&'static [(&'static str, Command)]),
    Estimator,
    Design,
}

/// Name of a command, its usage as `help` prints it, and the form of its words.
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
        ("designs", "designs", Plain(C::Designs)),
        ("design", "design NAME", Form::Design),
        ("period", "period SAMPLES", Number(C::Period)),
        ("push", "push NEWTONS", Number(C::Push)),
        ("hit", "hit", Plain(C::Hit)),
        ("pulses", "pulses NEWTONS", Number(C::Pulses)),
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
        (
            "criterion",
            "criterion rms|quiet",
            Word(&[
                (Criterion::Rms.name(), C::Criterion(Criterion::Rms)),
                (Criterion::Quiet.name(), C::Criterion(Criterion::Quiet)),
            ]),
        ),
        ("force_rms", "force_rms NEWTONS", Number(C::ForceRmsLimit)),
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
        ("selftest", "selftest", Plain(C::SelfTest)),
    ]
};

/// The usage of each command, in the order of `help`.
pub fn usages() -> impl Iterator<Item = &'static str> {
    TABLE.iter().map(|(_, usage, _)| *usage)
}

/// Reads one line. It has a name and at most one word or number, with blanks around them, in upper or lower case. The
/// input may be any bytes. Here only the form of a number is checked. Its range is checked where the settings are
/// built.
///
/// # Errors
/// Says what is allowed.
pub fn parse(line: &[u8]) -> Result<Command, ParseError> {
    parse_in(line, Spoken::AT_HANDLE)
}

/// Does what [`parse`] does, but the user types the numbers in the units of `spoken`. The returned command has them in
/// units at the handle.
///
/// # Errors
/// Says what is allowed.
pub fn parse_in(line: &[u8], spoken: Spoken) -> Result<Command, ParseError> {
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
            let typed = number::parse(word).ok_or(ParseError::Number(usage))?;
            command(spoken.at_handle(usage, typed))
        }
        Form::Word(known) => {
            let word = words.next().ok_or(ParseError::Missing(usage))?;
            let found = known.iter().find(|(text, _)| word.eq_ignore_ascii_case(text.as_bytes()));
            found.ok_or(ParseError::Word(usage))?.1
        }
        Form::Estimator => {
            let word = words.next().ok_or(ParseError::Missing(usage))?;
            let name = core::str::from_utf8(word).unwrap_or_default().parse();
            Command::Estimator(name.map_err(ParseError::Estimator)?)
        }
        Form::Design => {
            let word = words.next().ok_or(ParseError::Missing(usage))?;
            let name = core::str::from_utf8(word).ok().filter(|name| is_design_name(name));
            Command::Design(name.and_then(Name::new).ok_or(ParseError::Design)?)
        }
    };
    match words.next() {
        None => Ok(command),
        Some(_) => Err(ParseError::Extra(usage)),
    }
}

#[cfg(test)]
mod tests;
