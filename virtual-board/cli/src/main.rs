//! The command line: `cargo board run|hit|walk|serve SCENE`, `cargo board fuzz|campaign`.
#![forbid(unsafe_code)]

mod typed;

use std::{
    io::IsTerminal as _,
    path::PathBuf,
    process::ExitCode,
    sync::mpsc::RecvTimeoutError,
    thread,
    time::{Duration, Instant},
};

use board_trials::{campaign, fuzz};
use clap::{Args, Parser, Subcommand};
use host_sim::{
    error::Error,
    interrupt,
    output::{
        files::{Outputs, Place},
        in_units::{self, InUnits},
        terminal::{self, note, print_json, print_text},
    },
    scene::NamedScene,
    study::asked,
};
use serde::Serialize;
use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    device,
    link::serve::{self, Ports},
    mcu::{LINK, RENDER, SAMPLE},
    session::{BoardHit, BoardPush, Session, WalkReport, ask},
    world::World,
};
use zwidth::period::PERIODS;

use typed::{place_name, stdin, typed};

/// Runs the firmware's release ELF in closed loop with a simulated device.
#[derive(Parser)]
#[command(name = "board", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Open a console. It takes the commands of a real board. An empty line asks for the status. `hand METRES` holds
    /// the handle there (`hand RADIANS` in a rotary scene). `hand off` lets it go. `wait SECONDS` waits.
    Run {
        #[command(flatten)]
        common: Common,
        /// Write the telemetry to this file, for `cargo sim telemetry FILE`. It is also written if the session ends by
        /// Ctrl-C or by a fault.
        #[arg(long, value_name = "FILE")]
        telemetry: Option<PathBuf>,
        /// Replace FILE if it is there.
        #[arg(long)]
        force: bool,
    },
    /// Run one wall hit. The firmware itself runs it.
    Hit {
        #[command(flatten)]
        common: Common,
        /// Print one JSON object on stdout, and nothing else there.
        #[arg(long)]
        json: bool,
        /// Nominal cutoff in Hz [default: `velocity.cutoff_hz` of the scene, or the only cutoff of its sweep].
        #[arg(long)]
        cutoff: Option<f64>,
        /// K in N/m, or in N m/rad for a rotary scene.
        #[arg(long)]
        stiffness: f64,
        /// B in N s/m, or in N m s/rad for a rotary scene.
        #[arg(long)]
        damping: f64,
        /// Write the telemetry since the board was switched on, for `cargo sim telemetry FILE`.
        #[arg(long, value_name = "FILE")]
        telemetry: Option<PathBuf>,
        /// Replace FILE if it is there.
        #[arg(long)]
        force: bool,
    },
    /// Cause faults while the force is on, in free motion and in contact. Measures the time until the force is off.
    Campaign(campaign::report::Campaign),
    /// Run random sessions of console, hand, switches and resets. Compares the board with the firmware's library.
    Fuzz(fuzz::report::Fuzz),
    /// Run the board in real time, for other tools. It offers RTT over TCP on 127.0.0.1. Channel n has the port PORT +
    /// n. The first line on stdout is the address of channel 0.
    Serve {
        #[command(flatten)]
        common: Common,
        /// First of three consecutive ports. 0 stands for any free ports.
        #[arg(long, value_name = "PORT", default_value_t = 9090)]
        rtt: u16,
        /// A port for gdb. 0 stands for any free port. Its address is the second line on stdout. A halt by gdb switches
        /// the force off.
        #[arg(long, value_name = "PORT")]
        gdb: Option<u16>,
    },
    /// Run a boundary walk over the scene's grid. The firmware itself runs it.
    Walk {
        #[command(flatten)]
        common: Common,
        /// Nominal cutoff in Hz [default: `velocity.cutoff_hz` of the scene, or the only cutoff of its sweep].
        #[arg(long)]
        cutoff: Option<f64>,
        /// Write the boundary to this file. Its columns are `cutoff_hz`, damping and stiffness. The last two are in the
        /// scene's units.
        #[arg(long, value_name = "FILE")]
        csv: Option<PathBuf>,
        /// Replace FILE if it is there.
        #[arg(long)]
        force: bool,
        /// Print one JSON object on stdout, and nothing else there.
        #[arg(long)]
        json: bool,
    },
}

#[derive(Args)]
struct Common {
    /// A built-in scene or a file. SCENE:DESIGN uses this design of the scene as its estimator.
    scene: String,
    #[arg(long, default_value = NUCLEO_F446RE.name, help = Board::names(" or "))]
    board: String,
    /// The firmware's ELF. It is built if this option is missing.
    #[arg(long)]
    elf: Option<PathBuf>,
    /// The device record for the board's flash. It is a file from `cargo sim prepare` [default: a record made from the
    /// scene, without an envelope; for the board's own scene, the image's record].
    #[arg(long, value_name = "FILE")]
    device: Option<PathBuf>,
    /// Samples per output in place of the scene's value: 1, 2, 5 or 10. `run` starts with this value.
    #[arg(long, value_name = "SAMPLES")]
    period: Option<u32>,
}

fn main() -> ExitCode {
    ExitCode::from(terminal::run(|cli: Cli| execute(cli.command)))
}

fn execute(command: Command) -> Result<(), Error> {
    match command {
        Command::Run { common, telemetry, force } => {
            let (scene, mut outputs) = common.open(force)?;
            let capture = outputs.option(telemetry.as_ref())?;
            let session = common.session(scene)?;
            let ended = run(&session, common.period, &mut outputs, capture);
            // The capture is always complete up to now. The capture is most useful when the program has stopped.
            outputs.commit().and(ended)
        }
        Command::Hit { common, json, cutoff, stiffness, damping, telemetry, force } => {
            let (scene, mut outputs) = common.open(force)?;
            let capture = outputs.option(telemetry.as_ref())?;
            let cutoff = cutoff_of(&scene, cutoff)?;
            let units = scene.scene.units;
            let wall = [units.stiffness_n_per_m(stiffness), units.damping_n_s_per_m(damping)];
            let session = common.session(scene)?;
            let (report, world) = session.hit([cutoff, wall[0], wall[1]])?;
            if let Some(capture) = capture {
                outputs.write(capture, &world.telemetry)?;
            }
            outputs.commit()?;
            hit(&session, [cutoff, wall[0], wall[1]], (&report, &world), json)
        }
        Command::Campaign(options) => campaign::report::execute(&options),
        Command::Fuzz(options) => fuzz::report::execute(&options),
        Command::Serve { common, rtt, gdb } => {
            let (scene, _) = common.open(false)?;
            serve::serve(common.session(scene)?, common.period, Ports { rtt, gdb })
        }
        Command::Walk { common, cutoff, csv, force, json } => {
            let (scene, mut outputs) = common.open(force)?;
            let csv = outputs.option(csv.as_ref())?;
            let cutoff = cutoff_of(&scene, cutoff)?;
            walk(&common.session(scene)?, cutoff, csv, outputs, json)
        }
    }
}

/// The cutoff of the command line. If it is missing, the scene's cutoff. An estimator without a cutoff ignores the
/// value.
fn cutoff_of(scene: &NamedScene, asked: Option<f64>) -> Result<f64, Error> {
    let own = || asked::filter(scene, None).map(|own| own.cutoff_hz().unwrap_or_default());
    asked.map_or_else(own, Ok)
}

impl Common {
    fn open(&self, force: bool) -> Result<(NamedScene, Outputs), Error> {
        let mut scene = NamedScene::load(&self.scene)?;
        if let Some(period) = self.period {
            check_period("--period", period)?;
            scene.scene.actuator.period = period;
        }
        let files = scene.files.iter().chain(&self.elf).chain(&self.device);
        let inputs: Vec<PathBuf> = files.cloned().collect();
        Ok((scene, Outputs::new(force, &inputs)))
    }

    fn session(&self, scene: NamedScene) -> Result<Session, Error> {
        check_period("actuator.period", scene.scene.actuator.period)?;
        let board = Board::asked(&self.board)?;
        let Some(path) = &self.device else {
            return Session::open(board, self.elf.as_ref(), scene);
        };
        let record = device::given(path, board, &scene)?;
        Session::open_with(board, self.elf.as_ref(), scene, Some(record))
    }
}

/// Checks that boards accept this number of samples per output.
fn check_period(name: &str, period: u32) -> Result<(), Error> {
    if PERIODS.contains(&period) {
        return Ok(());
    }
    let known = PERIODS.map(|period| period.to_string()).join(", ");
    Err(Error::Input(format!("{name} is {period}, allowed on a board {known}")))
}

/// Number of samples between two checks of the keyboard.
const SLICE: u64 = 100;
/// Number of samples that the board runs after the last line, so that its reply arrives.
const LAST: u64 = 2_000;
/// Longest wait between two checks of the interrupt flag.
const LOOK: Duration = Duration::from_millis(50);

/// Runs a session. With lines from a keyboard, the board is never faster than real time. With lines from a file or
/// pipe, it runs as fast as possible.
fn run(
    session: &Session,
    period: Option<u32>,
    outputs: &mut Outputs,
    capture: Option<Place>,
) -> Result<(), Error> {
    let mut world = session.boot()?;
    if let Some(period) = period {
        ask(&mut world, &format!("period {period}"))?;
    }
    if let Some(capture) = capture {
        outputs.write(capture, &[])?; // an empty file, if the board sends nothing
    }
    let live = std::io::stdin().is_terminal();
    let units = session.scene.scene.units;
    let place = place_name(units);
    let lines = stdin();
    let (start, mut samples) = (Instant::now(), 0u64);
    if live {
        note(&format!(
            "type help; hand {place}, hand off, wait SECONDS are not the board's; end with Ctrl-D"
        ));
    }
    let mut waiting = 0u64;
    let mut ended = false;
    loop {
        interrupt::check()?;
        if waiting == 0 {
            if ended {
                return Ok(());
            }
            // The program waits for input from a pipe, so that each run gives the same result.
            match lines.recv_timeout(if live { Duration::ZERO } else { LOOK }) {
                Ok(line) => waiting = typed(&mut world, units, line?.trim())?,
                Err(RecvTimeoutError::Timeout) if live => {}
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => (waiting, ended) = (LAST, true),
            }
        }
        let stepped = world.run(SLICE);
        samples += SLICE;
        waiting = waiting.saturating_sub(SLICE);
        let bytes = std::mem::take(&mut world.telemetry);
        if let Some(capture) = capture {
            outputs.write(capture, &bytes)?;
        }
        for line in world.lines.drain(..) {
            print_text(&line)?;
        }
        stepped?;
        world.replies.clear();
        let ahead = Duration::from_micros(100 * samples).saturating_sub(start.elapsed());
        if live && ahead > Duration::from_millis(20) {
            thread::sleep(ahead.min(LOOK));
        }
    }
}

#[derive(Serialize)]
struct HitJson<'a> {
    scene: &'a str,
    board: &'static str,
    cutoff_hz: f64,
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    verdict: &'a str,
    stable: bool,
    rms_m: f64,
    mean_m: f64,
    #[serde(flatten)]
    quiet: Option<QuietJson<'a>>,
}

/// Additional JSON fields of a hit with the criterion `quiet`. They are the values of the push that decided the
/// verdict, and a list of all pushes.
#[derive(Serialize)]
struct QuietJson<'a> {
    force_rms_n: f64,
    penetration_ratio: Option<f64>,
    pushes: &'a [BoardPush],
}

#[derive(Serialize)]
struct WalkJson<'a> {
    scene: &'a str,
    board: &'static str,
    cutoff_hz: f64,
    #[serde(flatten)]
    report: WalkReport,
}

fn hit(
    session: &Session,
    wall: [f64; 3],
    (report, world): (&BoardHit, &World<'_>),
    json: bool,
) -> Result<(), Error> {
    let watch = world.powered.mcu.watch();
    for (name, exception) in [("sample", SAMPLE), ("render", RENDER), ("link", LINK)] {
        let cycles = watch.tasks.get(&exception).copied().unwrap_or_default();
        note(&format!("{name}: {} to {} cycles", cycles.least, cycles.most));
    }
    if !json {
        for push in &report.pushes {
            print_text(&push.line)?;
        }
        return print_text(&report.line);
    }
    let quiet = report.deciding().map(|deciding| QuietJson {
        force_rms_n: deciding.force_rms_n,
        penetration_ratio: deciding.penetration_ratio,
        pushes: &report.pushes,
    });
    let [cutoff_hz, stiffness_n_per_m, damping_n_s_per_m] = wall;
    let json = HitJson {
        scene: &session.scene.name,
        board: session.board.name,
        cutoff_hz,
        stiffness_n_per_m,
        damping_n_s_per_m,
        verdict: report.verdict.name(),
        stable: report.verdict == zwidth::experiment::Verdict::Stable,
        rms_m: report.rms_m,
        mean_m: report.mean_m,
        quiet,
    };
    print_json(InUnits(session.scene.scene.units, json))
}

fn walk(
    session: &Session,
    cutoff_hz: f64,
    csv: Option<Place>,
    mut outputs: Outputs,
    json: bool,
) -> Result<(), Error> {
    let units = session.scene.scene.units;
    let begun = Instant::now();
    let mut printed = Ok(());
    let report = session.walk(cutoff_hz, |line| match json {
        true => note(line),
        false if printed.is_ok() => printed = print_text(line),
        false => {}
    })?;
    printed?;
    note(&format!(
        "{:.0} s on the board, {:.0} s here",
        report.virtual_s,
        begun.elapsed().as_secs_f64()
    ));
    if let Some(csv) = csv {
        let mut text = String::from("cutoff_hz,damping_n_s_per_m,stiffness_n_per_m\n");
        for [b, k] in &report.points {
            text.push_str(&format!("{cutoff_hz},{b},{k}\n"));
        }
        outputs.write(csv, in_units::csv(units, text).as_bytes())?;
    }
    outputs.commit()?;
    if !json {
        return Ok(());
    }
    let (scene, board) = (&session.scene.name, session.board.name);
    print_json(InUnits(units, WalkJson { scene, board, cutoff_hz, report }))
}
