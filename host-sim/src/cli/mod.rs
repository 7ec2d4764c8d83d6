//! The command line: `cargo sim COMMAND SCENE ...`.

mod agree;
mod compare;
mod conditions;
mod design;
mod draws;
mod explain;
mod grid;
mod hit;
mod identify;
mod limits;
mod linear;
mod passivity;
mod peers;
mod prepare;
mod progress;
mod read;
mod reference;
mod replay;
mod schema;
mod shared;
mod study;
mod sweep;
mod telemetry;
mod trade;
mod usable;
mod walk;

use std::path::PathBuf;

use clap::{
    Args, CommandFactory as _, Parser, Subcommand,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser as _, ValueParser},
};

use crate::{
    engine::Engine,
    error::Error,
    interrupt,
    output::{files::Outputs, terminal},
    simulation::prepared::Numeric,
    study::{How, list},
};

/// Which cutoff of the velocity filter gives a haptic device the largest Z-width? The Z-width is the range of virtual
/// walls that stay stable. SCENE is a built-in name (paper-1um, paper-2um, nucleo-f446re, discovery-f407, epfl-paddle,
/// rice-paddle, hapkit, smartknob) or a TOML file. SCENE:DESIGN is the scene with its [designs.DESIGN] as estimator.
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
    Agree(agree::AgreeArgs),
    Grid(grid::GridArgs),
    Sweep(sweep::SweepArgs),
    Linear(linear::LinearArgs),
    Compare(compare::CompareArgs),
    Design(design::DesignArgs),
    Explain(explain::ExplainArgs),
    Passivity(passivity::PassivityArgs),
    Trade(trade::TradeArgs),
    Identify(Box<identify::IdentifyArgs>),
    Telemetry(telemetry::TelemetryArgs),
    Prepare(prepare::PrepareArgs),
    Read(read::ReadArgs),
    Reference(reference::ReferenceArgs),
    Replay(replay::ReplayArgs),
    Schema(schema::SchemaArgs),
    Study(study::StudyArgs),
    StudyPlan(study::PlanArgs),
}

/// Options of every command.
#[derive(Debug, Args)]
struct Common {
    /// Print only one JSON object on stdout, also for an error.
    #[arg(long, global = true)]
    json: bool,
    /// Number of worker threads. The number does not change the results. Default: all cores.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Arithmetic of the controller.
    #[arg(long, global = true, value_parser = named(&NUMERICS), default_value = "fixed")]
    numeric: Numeric,
    /// Implementation that runs the hits. All implementations give the same results.
    #[arg(long, global = true, value_parser = named(&[CORE, ("lanes", LANES, Engine::lanes())]), default_value = "lanes")]
    engine: Engine,
    /// Folder for the results, with one folder per scene if there are several scenes [default: zwidth-out/SCENE].
    /// `identify` and `read` write a scene file to this path instead, `prepare` writes the record. Other commands have
    /// an option for each file.
    #[arg(long, global = true, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace existing results.
    #[arg(long, global = true)]
    force: bool,
    /// Write each table of a result folder as Parquet too. The format of a single file follows from its ending, .csv or
    /// .parquet (feature open-files: `cargo sim-files`).
    #[arg(long, global = true)]
    parquet: bool,
}

impl Common {
    /// How hits are run: engine, arithmetic, and the flag that stops them.
    fn how(&self) -> How<'static> {
        How { engine: self.engine, numeric: self.numeric, stop: interrupt::flag() }
    }

    /// The output files of a command. They never replace a file in `inputs`.
    fn outputs(&self, inputs: &[PathBuf]) -> Result<Outputs, Error> {
        let outputs = Outputs::new(self.force, inputs);
        if self.parquet { outputs.with_parquet() } else { Ok(outputs) }
    }
}

const CORE: (&str, &str, Engine) = (
    "core",
    "The controller itself, hit by hit: with fixed-point arithmetic the core, as on the board",
    Engine::Core,
);
const LANES: &str =
    "Many hits side by side, by a second text of its arithmetic for vectors, where a scene has it";
const NUMERICS: [(&str, &str, Numeric); 3] = [
    ("fixed", "Fixed point: the core's arithmetic, as on the board", Numeric::Fixed),
    ("f64", "Its twin in 64-bit floats", Numeric::F64),
    (
        "f64-rounded",
        "The twin with its velocity rounded to the fixed-point LSB",
        Numeric::F64Rounded,
    ),
];

/// Parser that finds values by name. Each value has a help text, which may be empty.
fn named<T: Copy + Send + Sync + 'static>(all: &[(&'static str, &'static str, T)]) -> ValueParser {
    let all = all.to_vec();
    let names = all.iter().map(|&(name, help, _)| match help {
        "" => PossibleValue::new(name),
        help => PossibleValue::new(name).help(help),
    });
    let of = PossibleValuesParser::new(names.collect::<Vec<_>>());
    ValueParser::new(of.try_map(move |name: String| {
        let found = all.iter().find(|(known, ..)| *known == name);
        found.map(|&(.., value)| value).ok_or("unknown")
    }))
}

impl Command {
    /// Whether the result folder of this command has tables.
    fn fills_a_folder_with_tables(&self) -> bool {
        use Command::{Compare, Design, Explain, Passivity, Sweep, Trade};
        matches!(self, Sweep(_) | Compare(_) | Design(_) | Explain(_) | Passivity(_) | Trade(_))
    }

    /// Name of the command, and the options that name its files. `None` for a command with a result folder.
    fn named_outputs(&self) -> Option<[&'static str; 2]> {
        Some(match self {
            Self::Hit(_) => ["hit", "--trace and --plot"],
            Self::Walk(_) => ["walk", "--csv"],
            Self::Agree(_) => ["agree", "--csv and --plot"],
            Self::Grid(_) => ["grid", "--csv"],
            Self::Linear(_) => ["linear", "--csv and --plot"],
            Self::Telemetry(_) => ["telemetry", "--csv and --plot"],
            Self::Replay(_) => ["replay", "--csv"],
            Self::StudyPlan(_) => ["study-plan", "none"],
            Self::Reference(_) => ["reference", "none"],
            Self::Schema(_) => ["schema", "none"],
            _ => return None,
        })
    }
}

/// Runs the command line and returns the exit code. See [`terminal::run`].
pub fn run() -> u8 {
    terminal::run(execute)
}

fn execute(Cli { command, common }: Cli) -> Result<(), Error> {
    if let (Some(_), Some([command, options])) = (&common.out, command.named_outputs()) {
        return Err(Error::Input(format!("--out is not of {command}, whose files are {options}")));
    }
    if let (true, Some([command, options])) = (common.parquet, command.named_outputs()) {
        return Err(Error::Input(format!(
            "--parquet is not of {command}, whose files are {options}: end their names in .parquet"
        )));
    }
    if common.parquet && !command.fills_a_folder_with_tables() {
        return Err(Error::input(
            "--parquet is of sweep, compare, design, explain, passivity and trade only, which fill a folder with tables",
        ));
    }
    let threads = usize::from(common.threads.unwrap_or(0)); // for rayon 0 means all cores
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|error| Error::Internal(format!("cannot start threads: {error}")))?;
    pool.install(|| match command {
        Command::Hit(args) => hit::run(&args, &common),
        Command::Walk(args) => walk::run(&args, &common),
        Command::Agree(args) => agree::run(&args, &common),
        Command::Grid(args) => grid::run(&args, &common),
        Command::Sweep(args) => sweep::run(&args, &common),
        Command::Linear(args) => linear::run(&args, &common),
        Command::Compare(args) => compare::run(&args, &common),
        Command::Design(args) => design::run(&args, &common),
        Command::Explain(args) => explain::run(&args, &common),
        Command::Passivity(args) => passivity::run(&args, &common),
        Command::Trade(args) => trade::run(&args, &common),
        Command::Identify(args) => identify::run(&args, &common),
        Command::Telemetry(args) => telemetry::run(&args, &common),
        Command::Prepare(args) => prepare::run(&args, &common),
        Command::Read(args) => read::run(&args, &common),
        Command::Reference(args) => reference::run(&args, &Cli::command()),
        Command::Replay(args) => replay::run(&args, &common),
        Command::Schema(_) => schema::run(),
        Command::Study(args) => study::run(&args, &common),
        Command::StudyPlan(args) => study::plan(&args, &common),
    })
}
