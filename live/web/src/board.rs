//! The board in a worker of the page. It is the release ELF, or the core without a chip. This file also carries out
//! what people do, and exchanges messages with the page.

use std::{
    cell::RefCell,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

use host_sim::{error::Error, scene::NamedScene};
use live::{
    hub::{Hub, Talk},
    page::{Page, Shared},
};
use serde_json::json;
use virtual_board::{
    board::Board,
    device,
    elf::Elf,
    link::{CoreBoard, SteppedBoard, Wires},
    session::{Failed, Session},
};

use crate::question::{Answered, Question};

/// Largest number of rows that a saved table may have.
const ROWS_MAX: u64 = 200_000;

enum Runs {
    /// The release ELF on the emulated chip.
    Elf(Box<SteppedBoard>),
    /// The firmware's library, which controls the simulator's plant in a closed loop.
    Core(Box<CoreBoard>),
}

impl Runs {
    fn millisecond(&mut self, speed: f64) -> Result<(), Failed> {
        match self {
            Self::Elf(board) => board.millisecond(speed),
            Self::Core(board) => {
                board.millisecond(speed);
                Ok(())
            }
        }
    }

    fn wires(&self) -> &Arc<Wires> {
        match self {
            Self::Elf(board) => &board.wires,
            Self::Core(board) => &board.wires,
        }
    }
}

struct Running {
    board: Runs,
    talk: Talk,
    shared: Arc<Shared>,
    page: Page,
    /// The board's time in us. It is the only clock, so a suspended tab does not miss an `alive`.
    time_us: Arc<AtomicU64>,
}

thread_local! {
    static RUNNING: RefCell<Option<Running>> = const { RefCell::new(None) };
}

fn running<T>(with: impl FnOnce(&mut Running) -> Result<T, Error>) -> Result<T, Error> {
    RUNNING.with_borrow_mut(|running| match running {
        Some(running) => with(running),
        None => Err(Error::Input("no board has been started".to_owned())),
    })
}

fn session(board: Board, scene: NamedScene, elf: Vec<u8>) -> Result<Session, Error> {
    let record = device::record(&scene, board)?;
    Session::of(board, Elf::parse(elf, "the image")?, "the image", scene, record)
}

pub fn start(question: &Question, elf: Vec<u8>) -> Answered {
    let (board, scene) = (question.board()?, question.scene()?);
    let (runs, elf) = match question.core {
        true => (Runs::Core(Box::new(CoreBoard::start(&scene, board)?)), None),
        false => {
            let session = session(board, scene.clone(), elf)?;
            let elf = session.elf.bytes.clone();
            (Runs::Elf(Box::new(SteppedBoard::start(session)?)), Some(elf))
        }
    };
    let running = Running::new(runs, elf.as_deref(), scene, board);
    let hello = running.page.hello();
    RUNNING.set(Some(running));
    Ok((json!({}), vec![hello.into_bytes()]))
}

impl Running {
    fn new(board: Runs, elf: Option<&[u8]>, scene: NamedScene, of: Board) -> Self {
        let time_us = Arc::new(AtomicU64::new(0));
        let clock = Arc::clone(&time_us);
        let clock = Box::new(move || Duration::from_micros(clock.load(Relaxed)));
        let (hub, talk) =
            Hub::new(Box::new(board.wires().link()), Some(Arc::clone(board.wires())), elf, clock);
        hub.attend(Duration::MAX); // the page and this worker start and end together
        let shared = Arc::new(Shared::new(hub, scene, of, None));
        let page = Page::enter(&shared);
        Self { board, talk, shared, page, time_us }
    }

    fn millisecond(&mut self, speed: f64) -> bool {
        if let Err(failed) = self.board.millisecond(speed) {
            self.board.wires().lose(Error::from(failed).to_string());
        }
        self.time_us.fetch_add(1000, Relaxed);
        self.talk.turn()
    }
}

/// Runs the board for `ms` milliseconds.
pub fn run(question: &Question) -> Answered {
    running(|running| {
        let runs = (0..question.ms).all(|_| running.millisecond(question.speed));
        Ok((json!({ "runs": runs }), vec![]))
    })
}

pub fn say(question: &Question) -> Answered {
    running(|running| {
        let answer = match running.page.take(&question.message) {
            Ok(None) => json!({}),
            Ok(Some(asked)) => json!({ "predict": asked }),
            Err(refused) => json!({ "refused": refused }),
        };
        Ok((answer, vec![]))
    })
}

/// The messages for the page, as blocks of bytes. The JSON says whether the last block is text. All other blocks are
/// values to plot.
pub fn tick() -> Answered {
    running(|running| {
        let tick = running.page.tick();
        let mut bytes = tick.pictures;
        let text = tick.state.is_some();
        bytes.extend(tick.state.map(String::into_bytes));
        Ok((json!({ "text": text }), bytes))
    })
}

/// The rows as the text of a table, in the units of the scene.
pub fn rows(question: &Question) -> Answered {
    running(|running| {
        let table = running.shared.table(question.from, question.rows.min(ROWS_MAX));
        Ok((json!({}), vec![table.into_bytes()]))
    })
}

/// Runs one wall hit on a separate board, as `cargo board hit` does. Returns the firmware's line and all telemetry.
pub fn hit(question: &Question, elf: Vec<u8>) -> Answered {
    let scene = question.scene()?;
    let filter = host_sim::study::asked::filter(&scene, question.cutoff_hz)?;
    let cutoff_hz = filter.cutoff_hz().unwrap_or_default();
    let units = scene.scene.units;
    let wall =
        [cutoff_hz, units.stiffness_n_per_m(question.k), units.damping_n_s_per_m(question.b)];
    let session = session(question.board()?, scene, elf)?;
    let (hit, world) = session.hit(wall)?;
    #[expect(clippy::cast_precision_loss, reason = "for people")]
    let board_s = world.powered.mcu.now() as f64 / world.powered.mcu.core_hz() as f64;
    let answer = json!({
        "line": hit.line, "verdict": hit.verdict.name(), "rms_m": hit.rms_m, "mean_m": hit.mean_m, "board_s": board_s,
    });
    Ok((answer, vec![world.telemetry]))
}
