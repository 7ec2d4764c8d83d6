//! `cargo live`: serves the page.
#![forbid(unsafe_code)]

mod probe;
mod server;

use std::{
    path::PathBuf,
    process::ExitCode,
    sync::{Arc, Mutex},
};

use clap::Parser;
use host_sim::{
    engine::Engine,
    error::Error,
    interrupt,
    output::{
        files::Outputs,
        terminal::{self, note},
    },
    scene::{NamedScene, record::board_facts},
    simulation::prepared::Numeric,
    study::{
        How,
        board_envelope::{
            DeviceRecord, Part, first_settings, fitting, says_first, with_first_estimator,
        },
        recommended::recommended,
    },
};
use live::{
    hub::{Hub, Tape, Virtual, lock},
    page::Shared,
};
use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    device,
    elf::Elf,
    image,
    link::{Begin, Link, LiveBoard, RttTcp},
    session::Session,
};

/// Shows a board in the browser: see, turn and push the wall. It does not open the browser. The first line on stdout is
/// the address, which only this machine can reach.
#[derive(Parser)]
#[command(name = "live", version)]
struct Cli {
    /// A built-in scene or a file.
    #[arg(default_value = NUCLEO_F446RE.name)]
    scene: String,
    #[arg(long, default_value = NUCLEO_F446RE.name, help = Board::names(" or "))]
    board: String,
    /// The firmware of the virtual board, or the program that a real board runs, to read its log; built if not given.
    #[arg(long)]
    elf: Option<PathBuf>,
    /// The board's device record, a file from `cargo sim prepare` [default: made from the scene, with its envelope; for
    /// the board's own scene: the image's record]. If a real board has another record, the page shows an error.
    #[arg(long, value_name = "FILE")]
    device: Option<PathBuf>,
    /// Port on 127.0.0.1. With 0, the system selects a free port.
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// A real board behind RTT over TCP (OpenOCD, J-Link, `cargo board serve`), in place of the virtual one. Channel n
    /// is on port PORT + n.
    #[arg(long, value_name = "HOST:PORT")]
    rtt_tcp: Option<String>,
    #[command(flatten)]
    probe: probe::Options,
    /// Write the telemetry, for `cargo sim telemetry FILE`.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Replace FILE if it is there.
    #[arg(long)]
    force: bool,
}

fn main() -> ExitCode {
    ExitCode::from(terminal::run(execute))
}

fn execute(cli: Cli) -> Result<(), Error> {
    let board = Board::asked(&cli.board)?;
    #[cfg_attr(not(feature = "probe"), expect(unused_variables, reason = "there are none"))]
    let with_probe = cli.probe.is_wanted(&cli.scene)?;
    let scene = NamedScene::load(&cli.scene)?;
    let inputs: Vec<PathBuf> =
        scene.files.iter().chain(&cli.elf).chain(&cli.device).cloned().collect();
    let mut outputs = Outputs::new(cli.force, &inputs);
    let record = outputs.option(cli.record.as_ref())?;
    let mut record_bytes = match &cli.device {
        Some(path) => Some(device::given(path, board, &scene)?),
        None => made(&scene, board)?,
    };
    let mut live = None; // runs until the program ends
    let program = || -> Result<Elf, Error> {
        match &cli.elf {
            Some(path) => Elf::load(path),
            None => Elf::load(&image::build(board.name).map_err(Error::Internal)?),
        }
    };
    let (link, virtual_board, elf): (Box<dyn Link>, Virtual, _) = match &cli.rtt_tcp {
        #[cfg(feature = "probe")]
        _ if with_probe => {
            let (link, elf) = cli.probe.connect(board, program)?;
            (link, None, elf.bytes)
        }
        Some(address) => {
            let elf = program()?;
            let link = RttTcp::connect(address)
                .map_err(|error| Error::Input(format!("--rtt-tcp: {error}")))?;
            (Box::new(link), None, elf.bytes)
        }
        None => {
            let start = |record: &Option<Vec<u8>>| {
                let elf = cli.elf.as_ref();
                let session = Session::open_with(board, elf, scene.clone(), record.clone())?;
                let elf = session.elf.bytes.clone();
                let begin = Begin { zeroed: true, period: None };
                Ok::<_, Error>((LiveBoard::start(session, begin)?, elf))
            };
            let started = start(&record_bytes).or_else(|error| {
                // The image may not have the scene's estimator.
                if cli.device.is_some() {
                    return Err(error);
                }
                note(&format!("without an envelope: {error}"));
                record_bytes = device::record(&scene, board)?;
                start(&record_bytes)
            });
            let (board, elf) = started?;
            let board = live.insert(board);
            (Box::new(board.wires.link()), Some(Arc::clone(&board.wires)), elf)
        }
    };
    let device = match &record_bytes {
        Some(bytes) => device::read(bytes, board)?,
        None => *device::built_in(board),
    };
    let tape = Arc::new(Mutex::new(outputs)); // the file is complete when the program ends
    let written = record.map(|place| {
        let tape = Arc::clone(&tape);
        let write =
            move |bytes: &[u8]| lock(&tape).write(place, bytes).map_err(|error| error.to_string());
        Box::new(write) as Tape
    });
    let (hub, thread) = Hub::start(link, virtual_board, Some(&elf), written);
    let shared = Shared::new(Arc::clone(&hub), scene, board, Some(device));
    let served = server::serve(shared, cli.port);
    hub.end();
    let _ = thread.join();
    drop(live);
    let tape = Arc::into_inner(tape).and_then(|tape| tape.into_inner().ok());
    tape.map_or(Ok(()), Outputs::commit).and(served)
}

/// The record of a scene on that board, as `cargo sim prepare` makes it. If `prepare` refuses the scene, the record has
/// no envelope. `None` for the board's own scene, whose record is in the image.
fn made(scene: &NamedScene, board: Board) -> Result<Option<Vec<u8>>, Error> {
    if device::is_built_in(scene, board) {
        return Ok(None);
    }
    let facts = board_facts(board.name)?;
    let on_board = scene.on(&facts);
    let (engine, numeric) = (Engine::lanes(), Numeric::default());
    let how = How { engine, numeric, stop: interrupt::flag() };
    let with_envelope = || {
        let of = &on_board.scene;
        fitting(&on_board, &facts, first_settings(of, None)?, true)?; // checked before any walk
        let quiet = (!says_first(of)).then(|| {
            note(&format!("looking for the cutoff to begin with: quiet walls of {}", scene.name));
            let first = with_first_estimator(&on_board)?;
            recommended(how, &first, &of.sweep.cutoffs_hz, true, |_| ())
        });
        let quiet_hz = quiet.transpose()?.and_then(|study| study.cutoff_hz());
        let first = first_settings(of, quiet_hz)?;
        let parts = Part::all(of, &first)?;
        let walks: u64 = parts.iter().map(Part::walks).sum();
        note(&format!("computing the envelope of {}: {walks} walks", scene.name));
        let of = (first, parts);
        DeviceRecord::of(&on_board, &facts, of, how, || {})
    };
    match with_envelope() {
        Ok(made) => Ok(Some(made.bytes)),
        Err(Error::Input(why)) => {
            note(&format!("without an envelope: {why}"));
            device::record(scene, board)
        }
        Err(error) => Err(error),
    }
}
