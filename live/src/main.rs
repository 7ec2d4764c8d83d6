//! `cargo live`: serves the page.
#![forbid(unsafe_code)]

mod probe;
mod server;

use std::{
    io::{self, Write},
    path::PathBuf,
    process::ExitCode,
    sync::{Arc, Mutex, PoisonError},
};

use clap::Parser;
use host_sim::{
    error::Error,
    output::{
        files::{Outputs, Place},
        terminal,
    },
    scene::NamedScene,
};
use live::hub::{Hub, Virtual};
use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    cli,
    elf::Elf,
    image,
    link::{Begin, Link, LiveBoard, RttTcp},
};

/// Shows a board in the browser: see, turn and push the wall. Opens nothing by itself: the first line on stdout is the
/// address. Nobody but this machine can reach it.
#[derive(Parser)]
#[command(name = "live", version)]
struct Cli {
    /// A built-in scene or a file.
    #[arg(default_value = NUCLEO_F446RE.name)]
    scene: String,
    #[arg(long, default_value = NUCLEO_F446RE.name, help = Board::names(" or "))]
    board: String,
    /// The firmware of the virtual board, or the program whose log is read; built if not given.
    #[arg(long)]
    elf: Option<PathBuf>,
    /// Port on 127.0.0.1; 0: any.
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// A real board behind RTT over TCP (OpenOCD, J-Link, `cargo board serve`), in place of the virtual one: channel n
    /// on port PORT + n.
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
    let board = cli::board(&cli.board)?;
    let with_probe = cli.probe.is_wanted(&cli.scene)?;
    let scene = NamedScene::load(&cli.scene)?;
    let inputs: Vec<PathBuf> = scene.files.iter().chain(&cli.elf).cloned().collect();
    let mut outputs = Outputs::new(cli.force, &inputs);
    let record = outputs.option(cli.record.as_ref())?;
    let mut live = None; // runs until the program ends
    let program = || -> Result<Elf, Error> {
        match &cli.elf {
            Some(path) => Elf::load(path),
            None => Elf::load(&image::build(board.name).map_err(Error::Internal)?),
        }
    };
    let (link, virtual_board, elf): (Box<dyn Link>, Virtual, _) = match &cli.rtt_tcp {
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
            let session = cli::session(board, cli.elf.as_ref(), scene.clone())?;
            let elf = session.elf.bytes.clone();
            let begin = Begin { zeroed: true, period: None };
            let board = live.insert(LiveBoard::start(session, begin)?);
            (Box::new(board.link()), Some(board.wires()), elf)
        }
    };
    let tape = Arc::new(Mutex::new(Tape { outputs, place: record }));
    let writer = record.map(|_| Box::new(Writer(Arc::clone(&tape))) as Box<dyn Write + Send>);
    let (hub, thread) = Hub::start(link, virtual_board, Some(&elf), writer);
    let served = server::serve(&hub, &scene, board, cli.port);
    hub.end();
    let _ = thread.join();
    drop(live);
    let tape = Arc::into_inner(tape).and_then(|tape| tape.into_inner().ok());
    tape.map_or(Ok(()), |tape| tape.outputs.commit()).and(served)
}

/// What is recorded, whole when the program ends.
struct Tape {
    outputs: Outputs,
    place: Option<Place>,
}

struct Writer(Arc<Mutex<Tape>>);

impl Write for Writer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut tape = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = tape.place {
            tape.outputs
                .write(place, bytes)
                .map_err(|error| io::Error::other(error.to_string()))?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
