//! The work of the tasks, and what goes between them.
//!
//! ```text
//!           Up, positions            Report                   single-producer,
//! sample ───────────────▶ render ───────────────▶ link        single-consumer queues
//!        ◀───────────────        ◀───────────────
//!           Control, Down            Order
//! ```
//! No queue is waited for. [`Down`] is a handful of single words in [`Flags`], each read on its own.

mod device;
mod envelope;
mod idle;
mod link;
mod order;
mod render;
mod sample;

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

pub use idle::Idle;
pub use link::Link;
use order::{Order, Report};
pub use render::Render;
pub use sample::Sample;
use stm32f4xx_hal::pac::Interrupt;
use zwidth::{
    Control, CounterWidth,
    safety::{Down, Fault, FaultRecord, GuardedSampler, Supervisor, Up, boot_fault},
    units::Position,
};

use crate::board::{self, Board, Queue};

/// Outputs that may wait for `render`, and the positions that belong to them.
const UPS: usize = 4;
const POSITIONS: usize = 64;
/// Outputs that may wait for `link`, which at 1 kHz is 15 ms.
const REPORTS: usize = 16;
/// Settings and orders come one at a time.
const CONTROLS: usize = 2;
const ORDERS: usize = 2;

/// Memory of the queues.
pub struct Queues {
    ups: Queue<Up, UPS>,
    positions: Queue<Position, POSITIONS>,
    controls: Queue<Control, CONTROLS>,
    reports: Queue<Report, REPORTS>,
    orders: Queue<Order, ORDERS>,
}

impl Queues {
    /// Empty.
    pub const fn new() -> Self {
        Self {
            ups: Queue::new(),
            positions: Queue::new(),
            controls: Queue::new(),
            reports: Queue::new(),
            orders: Queue::new(),
        }
    }
}

/// Single words that one task writes and others read.
struct Flags {
    /// [`Down`], written by `render`.
    rendered: AtomicU32,
    acknowledged: AtomicU32,
    zeros: AtomicU32,
    /// Bit 0: force is on; bit 1: flash is being written.
    facts: AtomicU32,
    /// Passes of `link`, for the watchdog.
    links: AtomicU32,
}

static FLAGS: Flags = Flags {
    rendered: AtomicU32::new(0),
    acknowledged: AtomicU32::new(0),
    zeros: AtomicU32::new(0),
    facts: AtomicU32::new(0),
    links: AtomicU32::new(0),
};

impl Flags {
    fn publish(&self, down: &Down) {
        self.acknowledged.store(down.acknowledged, Relaxed);
        self.zeros.store(down.zeros, Relaxed);
        self.facts.store(u32::from(down.on) | u32::from(down.stall) << 1, Relaxed);
        self.rendered.store(down.rendered, Relaxed);
    }

    #[inline(always)]
    fn down(&self) -> Down {
        let facts = self.facts.load(Relaxed);
        Down {
            rendered: self.rendered.load(Relaxed),
            acknowledged: self.acknowledged.load(Relaxed),
            zeros: self.zeros.load(Relaxed),
            on: facts & 1 != 0,
            stall: facts & 2 != 0,
        }
    }
}

/// Makes the tasks of a board that has just been set up.
///
/// Settings that cannot be built leave the defaults in force, with the fault `settings` latched.
pub fn start(board: Board, queues: &'static mut Queues) -> (Sample, Render, Link, Idle) {
    let (ups_in, ups_out) = queues.ups.split();
    let (positions_in, positions_out) = queues.positions.split();
    let (controls_in, controls_out) = queues.controls.split();
    let (reports_in, reports_out) = queues.reports.split();
    let (orders_in, orders_out) = queues.orders.split();

    let loaded = zwidth::store::load(&board.settings, device::defaults());
    let built = link::control(&loaded.stored);
    let stored = if built.is_ok() { loaded.stored } else { device::defaults() };
    let control = built.or_else(|_| link::control(&device::defaults()));
    let duty = device::trial(&device::defaults(), false).map(|trial| trial.duty);
    let (Ok(control), Ok(plan), Ok(duty)) = (control, device::safety(), duty) else {
        // The defaults are constants that every board is tested with.
        panic!();
    };
    let fault = boot_fault(&board.memory.read(), board.reset_cause)
        .or_else(|| (loaded.stored != stored).then(|| FaultRecord::bare(Fault::Settings)));
    board::turn_encoder(stored.signs.encoder_reversed);
    // The two timers start next to each other: their distance sets the phase of the PWM.
    let Board { mut drive, mut pace, encoder, .. } = board;
    drive.start();
    pace.start();
    let sampler = GuardedSampler::new(plan, encoder.count(), CounterWidth::Bits32);
    let outputs =
        render::Outputs { drive, stop: board.stop, supply: board.supply, memory: board.memory };
    let ends = render::Ends {
        ups: ups_out,
        positions: positions_out,
        controls: controls_in,
        orders: orders_out,
        reports: reports_in,
    };
    (
        Sample::new(encoder, pace, sampler, control, controls_out, ups_in, positions_in),
        Render::new(outputs, ends, Supervisor::new(plan, fault), control, stored.signs, duty),
        Link::new(board.link, board.settings, reports_out, orders_in, stored, loaded.source),
        Idle::new(board.watchdog),
    )
}

fn pend_render() {
    rtic::pend(Interrupt::SPI3);
}

fn pend_link() {
    rtic::pend(Interrupt::SPI2);
}
