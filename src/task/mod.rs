//! The work of the tasks, and the values that they exchange.
//!
//! ```text
//!      SampleReport, Guard,          Report
//!      positions
//! sample ───────────────▶ render ───────────────▶ link
//!        ◀───────────────        ◀───────────────
//!           LoopParameters, GuardCommand            Order
//! ```
//! No task waits. `Report` and `Order` go through single-producer, single-consumer queues. Positions go through a
//! [`position_ring`](crate::sync::position_ring). `link` reads the positions there too. It also reads the sampler
//! itself ([`Viewer`](crate::sync::Viewer)). Of all other values only the newest is needed. From `sample` to `render`,
//! `SampleReport` and `Guard` go through a [`Seqlock`](crate::sync::Seqlock). From `render` to `sample`,
//! `LoopParameters` and `GuardCommand` go through a [`DoubleBuffer`](crate::sync::DoubleBuffer).

mod idle;
mod link;
mod render;
mod sample;

use core::sync::atomic::AtomicU32;

use heapless::spsc::Queue;
pub use idle::Idle;
pub use link::Link;
pub use render::Render;
pub use sample::Sample;
use zwidth::{
    contract::{Encoder as _, FaultMemory as _},
    device::{
        Device, Start,
        record::{BadRecord, record_in},
    },
    encoder::Bits32,
    experiment::{Order, Report},
    image::{BadImage, Pass},
    period::PERIODS,
    safety::{Fault, FaultRecord, GuardCommand, GuardedSampler, Supervisor, boot_fault},
};

use crate::board::{self, Board};
use crate::sync::{DoubleBuffer, Seqlock, position_ring};

/// Length of the queue of reports. It holds one less: 15 outputs may wait for `link`, which are 15 ms at 1 kHz.
const REPORTS: usize = 16;
/// Length of the queue of orders. It holds one less: one order may wait for `render`, because orders come one at a
/// time.
const ORDERS: usize = 2;

// `render` reads the positions of a whole output period.
const _: () = {
    let mut periods: &[u32] = &PERIODS;
    while let [period, rest @ ..] = periods {
        assert!((*period as usize) < position_ring::FOLLOWED);
        periods = rest;
    }
};

/// An order with its number. A flipped bit in the indices of the queue could bring an old order back. With the number
/// each order is carried out only once.
pub struct Numbered {
    number: u32,
    order: Order,
}

/// Memory that the tasks share.
pub struct Queues {
    reports: Queue<Report, REPORTS>,
    orders: Queue<Numbered, ORDERS>,
    /// The device, which all tasks read and none writes.
    device: Option<Device<'static>>,
}

impl Queues {
    pub const fn new() -> Self {
        Self { reports: Queue::new(), orders: Queue::new(), device: None }
    }
}

/// Values that a task writes and other tasks watch.
struct Flags {
    rendered: AtomicU32,
    /// Number of passes of `link` so far.
    links: AtomicU32,
    /// Sum of the checksums of all passes of `idle` over the image, see [`PassWatch`](zwidth::image::PassWatch).
    checked: AtomicU32,
}

static FLAGS: Flags =
    Flags { rendered: AtomicU32::new(0), links: AtomicU32::new(0), checked: AtomicU32::new(0) };

/// Makes the tasks of a board that has just been set up.
///
/// If the image differs from the build, or the device record is refused, the board says so, and nothing runs.
pub fn make(mut board: Board, queues: &'static mut Queues) -> (Sample, Render, Link, Idle) {
    let (due_in, due_out) = Seqlock::split();
    let (guard_in, guard_out) = Seqlock::split();
    let (reports_in, reports_out) = queues.reports.split();
    let (orders_in, orders_out) = queues.orders.split();

    let image = board::image();
    let boot = boot_fault(&board.memory.read(), board.reset_cause);
    if let Err(why) = image.check() {
        // The fault is recorded, so that it stays even if the next boot reads the flash correctly.
        let damaged = (why == BadImage::Damaged).then(|| FaultRecord::bare(Fault::Image));
        if let Some(record) = boot.or(damaged) {
            board.memory.write(&record.to_words());
        }
        link::refuse(board.link, board.watchdog, &why.into());
    }
    let device = match Device::from_record(board::device_record(), &board::FACTS) {
        Ok(device) => queues.device.insert(device),
        Err(error) => link::refuse(board.link, board.watchdog, &error.into()),
    };
    let loaded = zwidth::store::load(&mut board.settings, device.defaults());
    let Start { stored, source, control, safety, period, current, fault } =
        match device.start(&loaded, boot) {
            Ok(start) => start,
            Err(error) => {
                link::refuse(board.link, board.watchdog, &BadRecord::from(error).into());
            }
        };
    let acts = (board::output_watch(), current);
    if let Some(record) = fault {
        // The record may now also have the fault of a watchdog reset. It must survive the next reset too, so it is
        // written again.
        board.memory.write(&record.to_words());
    }
    let (control_in, control_out) = DoubleBuffer::split(control);
    let (down_in, down_out) = DoubleBuffer::split(GuardCommand::start(&safety));
    board::turn_encoder(stored.signs.encoder_reversed);
    let Board {
        drive,
        sample_timer,
        encoder,
        stop,
        supply,
        halts,
        output_watchdog,
        set_up,
        read_back,
        memory,
        ..
    } = board;
    let sampler = GuardedSampler::new(encoder.count(), Bits32);
    let outputs =
        render::Outputs { drive, stop, supply, halts, output_watchdog, set_up, read_back, memory };
    let (sample, viewer) =
        Sample::new(encoder, sample_timer, sampler, control_out, down_out, due_in, guard_in);
    let ends = render::Ends {
        due: due_out,
        guard: guard_out,
        sampling: render::ToSample { control: control_in, down: down_in },
        sampler: viewer.clone(),
        orders: orders_out,
        reports: reports_in,
    };
    (
        sample,
        Render::new(
            outputs,
            ends,
            Supervisor::new(safety, fault),
            control,
            stored.signs,
            period,
            acts,
        ),
        Link::new(
            board.link,
            board.settings,
            board.self_test,
            (reports_out, viewer),
            orders_in,
            device,
            (stored, source),
        ),
        Idle::new(board.watchdog, Pass::new(&image, record_in(board::device_record()))),
    )
}
