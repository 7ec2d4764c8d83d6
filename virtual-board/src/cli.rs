//! The command line: `cargo board run|hit|walk SCENE`.

use std::{
    io::BufRead as _,
    path::PathBuf,
    process::ExitCode,
    sync::mpsc::{Receiver, TryRecvError, channel},
    thread,
    time::{Duration, Instant},
};

use clap::{Args, Parser, Subcommand};
use defmt_decoder::Table;
use host_sim::scene::{NamedScene, Scene};
use zwidth::{
    telemetry,
    velocity::{EstimatorName, Sense},
};

use crate::{
    board::{BOARDS, Board},
    elf::Elf,
    image, log,
    mcu::{LINK, RENDER, SAMPLE},
    world::{Ended, World},
};

/// Runs the firmware's release ELF in closed loop with a simulated device.
#[derive(Parser)]
#[command(name = "board", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// A console: type the commands that a real board takes; an empty line asks for the status.
    Run(Common),
    /// One wall hit, run by the firmware itself.
    Hit {
        #[command(flatten)]
        common: Common,
        /// Nominal cutoff, Hz.
        #[arg(long)]
        cutoff: f64,
        /// K, N/m.
        #[arg(long)]
        stiffness: f64,
        /// B, N s/m.
        #[arg(long)]
        damping: f64,
    },
    /// A boundary walk (the firmware cannot do that yet).
    Walk(Common),
}

#[derive(Args)]
struct Common {
    /// A built-in scene or a file.
    scene: String,
    /// nucleo-f446re or discovery-f407.
    #[arg(long, default_value = BOARDS[0].name)]
    board: String,
    /// The firmware; built if not given.
    #[arg(long)]
    elf: Option<PathBuf>,
}

/// What every subcommand needs.
struct Ready {
    board: Board,
    scene: NamedScene,
    elf: Elf,
    table: Table,
}

/// Runs the command line; 2 for bad input, 1 for a program that ended.
pub fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Run(common) => ready(&common).and_then(|ready| run(&ready)),
        Command::Hit { common, cutoff, stiffness, damping } => {
            ready(&common).and_then(|ready| hit(&ready, [cutoff, stiffness, damping]))
        }
        Command::Walk(common) => ready(&common).and_then(|ready| walk(&ready)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failed::Input(text)) => {
            eprintln!("error: {text}");
            ExitCode::from(2)
        }
        Err(Failed::Program(ended)) => {
            eprintln!("error: the firmware: {ended:?}");
            ExitCode::FAILURE
        }
    }
}

enum Failed {
    Input(String),
    Program(Ended),
}

impl From<Ended> for Failed {
    fn from(ended: Ended) -> Self {
        Self::Program(ended)
    }
}

impl From<String> for Failed {
    fn from(text: String) -> Self {
        Self::Input(text)
    }
}

fn ready(common: &Common) -> Result<Ready, Failed> {
    let board = Board::named(&common.board).ok_or_else(|| {
        let names = BOARDS.map(|board| board.name).join(", ");
        format!("--board is {}, allowed {names}", common.board)
    })?;
    let scene = NamedScene::load(&common.scene).map_err(|error| error.to_string())?;
    let path = match &common.elf {
        Some(path) => path.clone(),
        None => image::build(board.name)?,
    };
    let elf = Elf::load(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let table = log::table(&elf.bytes)?;
    Ok(Ready { board, scene, elf, table })
}

impl Ready {
    /// A board with the handle at rest at the scene's rest position, booted.
    fn boot(&self) -> Result<World<'_>, Failed> {
        let scene = &self.scene.scene;
        let start_m = scene.device.rest_position_m;
        let mut world = World::new(self.board, &self.elf, &self.table, scene, start_m)?;
        world.run(500)?;
        world.hold(start_m, false);
        Ok(world)
    }
}

/// As fast as it goes, at most as fast as real time.
fn run(ready: &Ready) -> Result<(), Failed> {
    let mut world = ready.boot()?;
    let lines = stdin();
    let mut decoder = telemetry::Decoder::new();
    let (start, mut samples) = (Instant::now(), 0u64);
    eprintln!("type help; end with Ctrl-D");
    loop {
        match lines.try_recv() {
            Ok(line) => {
                let line = if line.trim().is_empty() { "status".to_owned() } else { line };
                world.send(&format!("{line}\n"))?;
            }
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => return Ok(()),
        }
        world.run(100)?;
        samples += 100;
        for byte in world.telemetry.drain(..) {
            decoder.push(byte);
        }
        for line in world.lines.drain(..) {
            println!("{line}");
        }
        world.replies.clear();
        let ahead = Duration::from_micros(100 * samples).saturating_sub(start.elapsed());
        if ahead > Duration::from_millis(20) {
            thread::sleep(ahead);
        }
    }
}

/// Lines from the keyboard, until its end.
fn stdin() -> Receiver<String> {
    let (send, receive) = channel();
    thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if send.send(line).is_err() {
                return;
            }
        }
    });
    receive
}

/// Asks, and takes an error of the firmware as bad input.
fn ask(world: &mut World<'_>, line: &str) -> Result<(), Failed> {
    let reply = world.ask(line)?;
    if reply.starts_with("ok") { Ok(()) } else { Err(format!("{line}: {reply}").into()) }
}

/// What the firmware is told of the scene's estimator: the command that tunes it, and its name. Whether
/// it has that estimator is for the firmware to say.
fn tuning(scene: &Scene, cutoff_hz: f64) -> Result<(String, &'static str), Failed> {
    let settings = scene.velocity.settings(cutoff_hz);
    let estimator = settings.name();
    if let Some(sense) = estimator.missing(&[Sense::Force]) {
        let (name, sense) = (estimator.text(), sense.text());
        return Err(format!("velocity.estimator {name} needs {sense}, which no board has").into());
    }
    // The firmware knows no second parameter but its device's own.
    let (_, [_, asked]) = EstimatorName::of(&settings);
    let (_, [_, known]) = EstimatorName::of(&estimator.defaults());
    if asked != known {
        return Err(
            format!("velocity: the firmware has {known} where the scene has {asked}").into()
        );
    }
    let line = settings.tuning().map_or_else(String::new, |(_, value)| format!("tuning {value}"));
    Ok((line, estimator.text()))
}

fn hit(ready: &Ready, [cutoff, stiffness, damping]: [f64; 3]) -> Result<(), Failed> {
    let scene = &ready.scene.scene;
    let (tuning, estimator) = tuning(scene, cutoff)?;
    let mut world = ready.boot()?;
    // The firmware counts from where it was zeroed: the rest position.
    let wall_m = scene.wall.position_m - scene.device.rest_position_m;
    for line in [
        "zero".to_owned(),
        "unlock envelope".to_owned(),
        format!("estimator {estimator}"),
        tuning,
        format!("wall {wall_m:.6}"),
        format!("k {stiffness}"),
        format!("b {damping}"),
        format!("push {}", scene.wall_hit.push_n),
        "arm".to_owned(),
    ] {
        if !line.is_empty() {
            ask(&mut world, &line)?;
        }
    }
    world.run(4_000)?;
    ask(&mut world, "hit")?;
    println!("{}", world.reply(100_000)?);
    let watch = world.powered.mcu.watch();
    for (name, exception) in [("sample", SAMPLE), ("render", RENDER), ("link", LINK)] {
        let cycles = watch.tasks.get(&exception).copied().unwrap_or_default();
        eprintln!("{name}: {} to {} cycles", cycles.least, cycles.most);
    }
    Ok(())
}

/// Not in the firmware yet: what it answers.
fn walk(ready: &Ready) -> Result<(), Failed> {
    let mut world = ready.boot()?;
    ask(&mut world, "walk")
}
