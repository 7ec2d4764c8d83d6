//! The work of the tasks, and what goes between them.
//!
//! ```text
//! sample --motions--> render --records--> link        single-producer, single-consumer queues
//! sample <-controls-- render <-proposals- link
//! ```
//! No queue is waited for. Flags between tasks are single words in [`Flags`].

mod idle;
mod link;
mod render;
mod sample;

use core::sync::atomic::{AtomicBool, AtomicU32};

use heapless::spsc::Queue;
pub use idle::Idle;
pub use link::Link;
pub use render::{Record, Render};
pub use sample::Sample;
use stm32f4xx_hal::pac::Interrupt;
use zwidth::{Control, CounterWidth, Design, Motion, Sampler, Settings, SettingsError};

use crate::board::{self, Board};

/// Samples that may wait for `render`: three periods of ten.
const MOTIONS: usize = 32;
/// Outputs that may wait for `link`, which at 1 kHz is 31 ms.
const RECORDS: usize = 32;

/// Memory of the queues.
pub struct Queues {
    motions: Queue<Motion, MOTIONS>,
    controls: Queue<Control, 2>,
    records: Queue<Record, RECORDS>,
    proposals: Queue<Control, 2>,
}

impl Queues {
    /// Empty.
    pub const fn new() -> Self {
        Self {
            motions: Queue::new(),
            controls: Queue::new(),
            records: Queue::new(),
            proposals: Queue::new(),
        }
    }
}

/// Single words that one task writes and others read.
pub struct Flags {
    /// Low half of the number of the last sample that `render` has answered.
    answered: AtomicU32,
    /// `sample` has switched off, because `render` was late by a period.
    late: AtomicBool,
    /// Passes of `link`, for the watchdog.
    links: AtomicU32,
}

static FLAGS: Flags = Flags {
    answered: AtomicU32::new(0),
    late: AtomicBool::new(false),
    links: AtomicU32::new(0),
};

/// Makes the tasks of a board that has just been set up.
pub fn start(board: Board, queues: &'static mut Queues) -> (Sample, Render, Link, Idle) {
    let (motions_in, motions_out) = queues.motions.split();
    let (controls_in, controls_out) = queues.controls.split();
    let (records_in, records_out) = queues.records.split();
    let (proposals_in, proposals_out) = queues.proposals.split();
    let Board {
        encoder,
        pace,
        drive,
        stop,
        supply,
        watchdog,
        link,
    } = board;
    let Ok(control) = default_control() else {
        panic!()
    };
    let sampler = Sampler::new(encoder.count(), CounterWidth::Bits32);
    (
        Sample::new(encoder, pace, sampler, control, controls_out, motions_in),
        Render::new(
            drive,
            stop,
            supply,
            control,
            motions_out,
            controls_in,
            proposals_out,
            records_in,
        ),
        Link::new(link, records_out, proposals_in),
        Idle::new(watchdog),
    )
}

fn pend_render() {
    rtic::pend(Interrupt::SPI3);
}

fn pend_link() {
    rtic::pend(Interrupt::SPI2);
}

/// Low 32 bits of a sample number, which is what fits into a word between tasks.
#[expect(clippy::cast_possible_truncation, reason = "compared modulo 2^32")]
#[inline(always)]
const fn low_half(sample: u64) -> u32 {
    sample as u32
}

/// The device of the paper at 1 um, with no wall.
fn default_control() -> Result<Control, SettingsError> {
    let design = Design {
        rate_hz: f64::from(board::RATE_HZ),
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: board::OUTPUT,
    };
    Settings {
        velocity: zwidth::VelocitySettings::Butterworth {
            cutoff_hz: 1500.0,
            prewarp: false,
        },
        wall: zwidth::WallSettings {
            position_m: 0.07,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        },
    }
    .build(&design)
}
