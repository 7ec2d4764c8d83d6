//! The command line: `cargo sim COMMAND SCENE ...`.

mod compare;
mod grid;
mod hit;
mod identify;
mod linear;
mod list;
mod progress;
mod sweep;
mod telemetry;
mod trade;
mod walk;

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use clap::{Args, Parser, Subcommand, ValueEnum, error::ErrorKind};
use serde::Serialize;

use crate::{
    engine::Engine, error::Error, range::refused, scene::NamedScene, simulation::prepared,
};

/// Version of every JSON object that the commands print or write.
pub const SCHEMA_VERSION: u32 = 1;

/// Set by Ctrl-C; long work looks at it between two hits.
static STOP: AtomicBool = AtomicBool::new(false);

/// Which velocity-filter cutoff gives a haptic device the largest Z-width, the range of virtual
/// walls that stay stable? SCENE is a built-in name (paper-1um, paper-2um) or a TOML file.
#[derive(Debug, Parser)]
#[command(name = "host-sim", bin_name = "cargo sim", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    Hit(hit::HitArgs),
    Walk(walk::WalkArgs),
    Grid(grid::GridArgs),
    Sweep(sweep::SweepArgs),
    Linear(linear::LinearArgs),
    Compare(compare::CompareArgs),
    Trade(trade::TradeArgs),
    Identify(Box<identify::IdentifyArgs>),
    Telemetry(telemetry::TelemetryArgs),
}

/// Options of every command.
#[derive(Debug, Args)]
struct Common {
    /// Print one JSON object on stdout and nothing else.
    #[arg(long, global = true)]
    json: bool,
    /// Worker threads; the results do not depend on it. Default: all cores.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Arithmetic of the controller.
    #[arg(long, global = true, value_enum, default_value_t)]
    numeric: NumericArg,
    /// What runs the hits; the results do not depend on it.
    #[arg(long, global = true, value_enum, default_value_t)]
    engine: EngineArg,
    /// Folder for the results; with several scenes, one folder per scene in it
    /// [default: zwidth-out/SCENE]. For `identify` the scene file that is written.
    #[arg(long, global = true, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace results that are there already.
    #[arg(long, global = true)]
    force: bool,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum NumericArg {
    /// Fixed point: the core's arithmetic, as on the board.
    #[default]
    Fixed,
    /// Its twin in 64-bit floats.
    F64,
    /// The twin with its velocity rounded to the fixed-point LSB.
    F64Rounded,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum EngineArg {
    /// The controller itself, hit by hit: with fixed-point arithmetic the core, as on the board.
    Core,
    /// Many hits side by side, by a second text of its arithmetic for vectors, where a scene has it.
    #[default]
    Lanes,
}

impl From<EngineArg> for Engine {
    fn from(engine: EngineArg) -> Self {
        match engine {
            EngineArg::Core => Self::Core,
            EngineArg::Lanes => Self::lanes(),
        }
    }
}

impl From<NumericArg> for prepared::Numeric {
    fn from(numeric: NumericArg) -> Self {
        match numeric {
            NumericArg::Fixed => Self::Fixed,
            NumericArg::F64 => Self::F64,
            NumericArg::F64Rounded => Self::F64Rounded,
        }
    }
}

impl NumericArg {
    fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::F64 => "f64",
            Self::F64Rounded => "f64-rounded",
        }
    }
}

/// Runs the command line and returns the exit code: 0 done, 1 failed, 2 bad input, 130 Ctrl-C.
pub fn run() -> u8 {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return refuse(&error),
    };
    match execute(cli) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: {error}");
            error.exit_code()
        }
    }
}

/// Help and version as they are; everything else in one line.
fn refuse(error: &clap::Error) -> u8 {
    if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion)
        || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
    {
        let _ = error.print(); // a closed pipe is no reason to panic
        return u8::from(error.use_stderr()) * 2;
    }
    let text = error.to_string();
    let lines = text.lines().map(str::trim);
    let first: Vec<&str> = lines
        .take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"))
        .filter(|line| !line.is_empty())
        .collect();
    eprintln!("{} (see --help)", first.join(" "));
    2
}

fn execute(cli: Cli) -> Result<(), Error> {
    ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed))
        .map_err(|error| Error::Internal(format!("cannot watch for Ctrl-C: {error}")))?;
    let threads = usize::from(cli.common.threads.unwrap_or(0)); // 0 is rayon's "all cores"
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|error| Error::Internal(format!("cannot start threads: {error}")))?;
    let common = cli.common;
    pool.install(|| match cli.command {
        Command::Hit(args) => hit::run(&args, &common),
        Command::Walk(args) => walk::run(&args, &common),
        Command::Grid(args) => grid::run(&args, &common),
        Command::Sweep(args) => sweep::run(&args, &common),
        Command::Linear(args) => linear::run(&args, &common),
        Command::Compare(args) => compare::run(&args, &common),
        Command::Trade(args) => trade::run(&args, &common),
        Command::Identify(args) => identify::run(&args, &common),
        Command::Telemetry(args) => telemetry::run(&args, &common),
    })
}

/// The cutoff of the command line, which an estimator that has one needs and another one refuses;
/// 0 stands for none.
fn cutoff(scene: &NamedScene, asked: Option<f64>) -> Result<f64, Error> {
    let estimator = scene.scene.velocity;
    match (estimator.has_cutoff(), asked) {
        (true, Some(cutoff_hz)) => Ok(cutoff_hz),
        (false, None) => Ok(0.0),
        (true, None) => Err(Error::Input(format!(
            "{}: a cutoff is missing, the estimator {} needs it",
            scene.name,
            estimator.name()
        ))),
        (false, Some(_)) => Err(no_cutoff(scene)),
    }
}

/// Why a cutoff is refused.
fn no_cutoff(scene: &NamedScene) -> Error {
    Error::Input(format!(
        "{}: the estimator {} has no cutoff; its parameters are keys of [velocity]",
        scene.name,
        scene.scene.velocity.name()
    ))
}

/// A cutoff, K or B of the command line, checked by building the core's settings; `cutoff` is the
/// option that the cutoff came from.
fn check_wall(scene: &NamedScene, wall: &prepared::WallHit, cutoff: &str) -> Result<(), Error> {
    scene
        .scene
        .settings(wall.cutoff_hz, wall.stiffness_n_per_m, wall.damping_n_s_per_m)
        .build(&scene.scene.design())
        .map(|_| ())
        .map_err(|error| {
            let option = match error.parameter {
                "cutoff_hz" => cutoff,
                "stiffness_n_per_m" => "--stiffness",
                "damping_n_s_per_m" => "--damping",
                other => other,
            };
            Error::Input(refused(option, error.value, &error.range))
        })
}

/// Counts of `--start-offset`.
fn start_offset(counts: f64) -> Result<f64, Error> {
    const ALLOWED: std::ops::RangeInclusive<f64> = -1e6..=1e6;
    if ALLOWED.contains(&counts) {
        Ok(counts)
    } else {
        Err(Error::Input(refused("--start-offset", counts, &ALLOWED)))
    }
}

/// Prints `value` as the one JSON object of this command.
fn print_json(value: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|error| Error::Internal(format!("cannot write JSON: {error}")))?;
    print_text(&text)
}

/// Prints a line; a reader that hangs up is not an error of ours.
fn print_text(text: &str) -> Result<(), Error> {
    use std::io::Write as _;
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.map_err(Error::file(Path::new("stdout"))),
    }
}
