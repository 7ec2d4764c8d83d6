//! The command line: `cargo board run|hit|walk SCENE`.

use std::{
    fs::File,
    io::{BufRead as _, IsTerminal as _, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
    sync::mpsc::{Receiver, TryRecvError, channel},
    thread,
    time::{Duration, Instant},
};

use clap::{Args, Parser, Subcommand};
use host_sim::{cli::SCHEMA_VERSION, error::Error, output::files, scene::NamedScene};
use serde::Serialize;

use crate::{
    board::{BOARDS, Board},
    elf::Elf,
    image, log,
    mcu::{LINK, RENDER, SAMPLE},
    session::{Failed, Session},
    world::World,
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
    /// A console: type the commands that a real board takes. An empty line asks for the status;
    /// `hand METRES` holds the handle there, `hand off` lets it go, `wait SECONDS` waits.
    Run {
        #[command(flatten)]
        common: Common,
        /// Write the telemetry as it comes, for `cargo sim telemetry FILE`.
        #[arg(long, value_name = "FILE")]
        telemetry: Option<PathBuf>,
        /// Replace FILE if it is there.
        #[arg(long)]
        force: bool,
    },
    /// One wall hit, run by the firmware itself.
    Hit {
        #[command(flatten)]
        common: Common,
        /// One JSON object on stdout, and nothing else there.
        #[arg(long)]
        json: bool,
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
    /// A boundary walk over the scene's grid, run by the firmware itself.
    Walk {
        #[command(flatten)]
        common: Common,
        /// Nominal cutoff, Hz.
        #[arg(long)]
        cutoff: f64,
        /// Write the boundary: cutoff_hz,damping_n_s_per_m,stiffness_n_per_m.
        #[arg(long, value_name = "FILE")]
        csv: Option<PathBuf>,
        /// Replace FILE if it is there.
        #[arg(long)]
        force: bool,
        /// One JSON object on stdout, and nothing else there.
        #[arg(long)]
        json: bool,
    },
}

#[derive(Args)]
struct Common {
    /// A built-in scene or a file.
    scene: String,
    #[arg(long, default_value = BOARDS[0].name, help = Board::names(" or "))]
    board: String,
    /// The firmware; built if not given.
    #[arg(long)]
    elf: Option<PathBuf>,
}

/// Runs the command line; 2 for bad input, 1 for a program that ended.
pub fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Run { common, telemetry, force } => {
            let telemetry = telemetry.as_deref();
            free(telemetry, force)
                .and_then(|()| session(&common))
                .and_then(|session| run(&session, telemetry))
        }
        Command::Hit { common, json, cutoff, stiffness, damping } => {
            session(&common).and_then(|session| hit(&session, [cutoff, stiffness, damping], json))
        }
        Command::Walk { common, cutoff, csv, force, json } => {
            let csv = csv.as_deref();
            free(csv, force)
                .and_then(|()| session(&common))
                .and_then(|session| walk(&session, cutoff, csv, force, json))
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failed::Refused(text)) => {
            eprintln!("error: {}", text.trim_start_matches("error: "));
            ExitCode::from(2)
        }
        Err(Failed::Program(ended)) => {
            eprintln!("error: the firmware: {ended:?}");
            ExitCode::FAILURE
        }
    }
}

/// Nothing would be replaced that must not be.
fn free(path: Option<&Path>, force: bool) -> Result<(), Failed> {
    path.map_or(Ok(()), |path| files::refuse_existing(path, force).map_err(refused))
}

fn session(common: &Common) -> Result<Session, Failed> {
    let board = Board::named(&common.board)
        .ok_or_else(|| format!("--board is {}, allowed {}", common.board, Board::names(", ")))?;
    let scene = NamedScene::load(&common.scene).map_err(|error| error.to_string())?;
    let path = match &common.elf {
        Some(path) => path.clone(),
        None => image::build(board.name)?,
    };
    let elf = Elf::load(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let table = log::table(&elf.bytes)?;
    Ok(Session { board, scene, elf, table })
}

/// Samples between two looks at the keyboard.
const SLICE: u64 = 100;
/// Samples that are still run after the last line, so that its reply comes.
const LAST: u64 = 2_000;
/// Longest `wait`, s.
const WAIT_MAX_S: f64 = 3600.0;

/// As fast as it goes, at most as fast as real time; out of a file or pipe as fast as it goes.
fn run(session: &Session, telemetry: Option<&Path>) -> Result<(), Failed> {
    let mut world = session.boot()?;
    let mut capture = match telemetry {
        None => None,
        Some(path) => {
            Some(File::create(path).map_err(|error| format!("{}: {error}", path.display()))?)
        }
    };
    let live = std::io::stdin().is_terminal();
    let lines = stdin();
    let (start, mut samples) = (Instant::now(), 0u64);
    if live {
        eprintln!(
            "type help; hand METRES, hand off, wait SECONDS are not the board's; end with Ctrl-D"
        );
    }
    let mut waiting = 0u64;
    let mut ended = false;
    loop {
        if waiting == 0 {
            if ended {
                return Ok(());
            }
            // From a pipe the next line is waited for, so that a run is the same every time.
            let line = if live {
                lines.try_recv()
            } else {
                lines.recv().map_err(|_| TryRecvError::Disconnected)
            };
            match line {
                Ok(line) => waiting = typed(&mut world, line.trim())?,
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => (waiting, ended) = (LAST, true),
            }
        }
        world.run(SLICE)?;
        samples += SLICE;
        waiting = waiting.saturating_sub(SLICE);
        let bytes = std::mem::take(&mut world.telemetry);
        if let Some(file) = &mut capture {
            file.write_all(&bytes).map_err(|error| format!("telemetry: {error}"))?;
        }
        for line in world.lines.drain(..) {
            println!("{line}");
        }
        world.replies.clear();
        let ahead = Duration::from_micros(100 * samples).saturating_sub(start.elapsed());
        if live && ahead > Duration::from_millis(20) {
            thread::sleep(ahead);
        }
    }
}

/// What a person typed: for the board, or for the hand. Returns the samples to wait for.
fn typed(world: &mut World<'_>, line: &str) -> Result<u64, Failed> {
    let mut words = line.split_whitespace();
    let number = |text: Option<&str>| text.and_then(|text| text.parse::<f64>().ok());
    match words.next() {
        Some("hand") => match words.next() {
            Some("off") => world.hold(world.position_m(), false),
            place => match number(place).filter(|place| place.abs() <= 1.0) {
                Some(place) => move_by_hand(world, place)?,
                None => println!("error: hand METRES, -1 to 1, or hand off"),
            },
        },
        Some("wait") => match number(words.next()).filter(|s| (0.0..=WAIT_MAX_S).contains(s)) {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "0 to 36 million"
            )]
            Some(seconds) => return Ok((seconds * 10_000.0) as u64),
            None => println!("error: wait SECONDS, 0 to {WAIT_MAX_S}"),
        },
        _ => {
            let line = if line.is_empty() { "status" } else { line };
            world.send(&format!("{line}\n"))?;
        }
    }
    Ok(SLICE)
}

/// Speed of the hand, m per sample: 0.1 m/s.
const HAND_M: f64 = 1e-5;

/// Takes the handle to `place_m` and holds it there.
fn move_by_hand(world: &mut World<'_>, place_m: f64) -> Result<(), Failed> {
    let mut at_m = world.position_m();
    while at_m != place_m {
        at_m += (place_m - at_m).clamp(-HAND_M, HAND_M);
        world.hold(at_m, true);
        world.run(1)?;
    }
    Ok(())
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

#[derive(Serialize)]
struct HitJson<'a> {
    schema_version: u32,
    command: &'static str,
    scene: &'a str,
    board: &'static str,
    cutoff_hz: f64,
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    verdict: &'a str,
    stable: bool,
    rms_m: f64,
    mean_m: f64,
}

#[derive(Serialize)]
struct WalkJson<'a> {
    schema_version: u32,
    command: &'static str,
    scene: &'a str,
    board: &'static str,
    cutoff_hz: f64,
    area: f64,
    stiffness_peak_n_per_m: f64,
    damping_max_n_s_per_m: f64,
    hits: u32,
    ended_by: &'a str,
    virtual_s: f64,
}

fn print(json: &impl Serialize) -> Result<(), Failed> {
    let text = serde_json::to_string_pretty(json).map_err(|error| error.to_string())?;
    println!("{text}");
    Ok(())
}

fn refused(error: Error) -> Failed {
    Failed::Refused(error.to_string())
}

fn hit(session: &Session, wall: [f64; 3], json: bool) -> Result<(), Failed> {
    let (report, world) = session.hit(wall)?;
    let watch = world.powered.mcu.watch();
    for (name, exception) in [("sample", SAMPLE), ("render", RENDER), ("link", LINK)] {
        let cycles = watch.tasks.get(&exception).copied().unwrap_or_default();
        eprintln!("{name}: {} to {} cycles", cycles.least, cycles.most);
    }
    if !json {
        println!("{}", report.line);
        return Ok(());
    }
    let [cutoff_hz, stiffness_n_per_m, damping_n_s_per_m] = wall;
    print(&HitJson {
        schema_version: SCHEMA_VERSION,
        command: "hit",
        scene: &session.scene.name,
        board: session.board.name,
        cutoff_hz,
        stiffness_n_per_m,
        damping_n_s_per_m,
        verdict: report.verdict.name(),
        stable: report.verdict == zwidth::experiment::Verdict::Stable,
        rms_m: report.rms_m,
        mean_m: report.mean_m,
    })
}

fn walk(
    session: &Session,
    cutoff_hz: f64,
    csv: Option<&Path>,
    force: bool,
    json: bool,
) -> Result<(), Failed> {
    let begun = Instant::now();
    let report = session
        .walk(cutoff_hz, |line| if json { eprintln!("{line}") } else { println!("{line}") })?;
    eprintln!(
        "{:.0} s on the board, {:.0} s here",
        report.virtual_s,
        begun.elapsed().as_secs_f64()
    );
    if let Some(path) = csv {
        let mut text = String::from("cutoff_hz,damping_n_s_per_m,stiffness_n_per_m\n");
        for [b, k] in &report.points {
            text.push_str(&format!("{cutoff_hz},{b},{k}\n"));
        }
        files::write_file(path, text.as_bytes(), force).map_err(refused)?;
    }
    if !json {
        return Ok(());
    }
    print(&WalkJson {
        schema_version: SCHEMA_VERSION,
        command: "walk",
        scene: &session.scene.name,
        board: session.board.name,
        cutoff_hz,
        area: report.area,
        stiffness_peak_n_per_m: report.stiffness_peak_n_per_m,
        damping_max_n_s_per_m: report.damping_max_n_s_per_m,
        hits: report.hits,
        ended_by: &report.ended_by,
        virtual_s: report.virtual_s,
    })
}
