//! The task `link`, with priority 1. `render` requests it with every output. It moves data between the console and the
//! probe link.
//!
//! A host's commands may take a fifth of the time ([`Pace`]). A pass takes one line. Further bytes wait in the channel.
//! When the channel is full, they wait at the host. Telemetry is not part of this fifth.

use core::{fmt::Write as _, sync::atomic::Ordering::Relaxed};

use heapless::spsc::{Consumer, Producer};
use zwidth::{
    LoopParameters,
    console::{Console, Pace, Port, REPLY_MAX, Refused, Text, Unread, Unusable},
    contract::{CommandChannel as _, SelfTest as _, UpChannel as _, Watchdog as _},
    device::Device,
    experiment::{Event, Order, Report},
    image::PassWatch,
    safety::{Fault, GuardedSampler},
    self_test::{Found, Part},
    store::{self, Loaded, SaveError, Source, Stored},
    units::Position,
};

use super::{FLAGS, Numbered, ORDERS, REPORTS, sample::Sampling};
use crate::board::{
    self, Commands, FlashError, Replies, SelfTest, SettingsFlash, Telemetry, Watchdog,
};
use crate::sync::{DoubleBuffer, Viewer, position_ring};

/// Length of the longest piece of a line in one frame of the log, in bytes. The length is limited because `render`
/// waits while the logger copies a frame.
const LOG_LINE: usize = 200;

/// The console's access to the board's channels, flash and `render`.
struct Channels {
    replies: Replies,
    /// Number of lines that `replies` had no room for, and that were sent to the log alone.
    missed: u32,
    telemetry: Telemetry,
    commands: Commands,
    sampler: Viewer<Sampling>,
    flash: SettingsFlash,
    self_test: SelfTest,
    orders: Producer<'static, Numbered, ORDERS>,
    /// Number of orders that were given so far.
    ordered: u32,
}

/// The commit, from build.rs.
const COMMIT: &str = env!("ZWIDTH_COMMIT");

impl Port for Channels {
    const COMMIT: &'static str = COMMIT;

    fn read(&mut self) -> Option<u8> {
        self.commands.read()
    }

    fn write_line(&mut self, line: &str) -> bool {
        let logged = log(line);
        let replied = self.tell_missed() && self.replies.write(line.as_bytes());
        if logged && !replied {
            self.missed = self.missed.saturating_add(1);
        }
        replied || logged
    }

    fn write_frame(&mut self, frame: &[u8]) -> bool {
        self.telemetry.write(frame)
    }

    fn samples(&mut self, newest: u64, places: &mut [Position]) -> Option<GuardedSampler> {
        position_ring::read(newest, places);
        let sampler = self.sampler.read();
        let oldest = newest.saturating_sub(places.len() as u64);
        position_ring::is_kept(oldest, sampler.sampler().next()).then(|| sampler.of_any_width())
    }

    fn order(&mut self, order: Order) -> bool {
        let number = self.ordered.wrapping_add(1);
        let given = self.orders.enqueue(Numbered { number, order }).is_ok();
        if given {
            self.ordered = number;
        }
        given
    }

    fn is_in_force(&mut self, asked: &LoopParameters) -> bool {
        DoubleBuffer::look::<Sampling>()
            .is_some_and(|in_force: LoopParameters| asked.does_as(&in_force))
    }

    fn load(&mut self, defaults: Stored) -> Loaded {
        store::load(&mut self.flash, defaults)
    }

    fn test(&mut self, part: Part) -> Found {
        self.self_test.test(part)
    }

    fn save(&mut self, stored: &Stored) -> bool {
        let saved = store::save(&mut self.flash, stored);
        if let Err(SaveError::Flash(FlashError(status))) = saved {
            defmt::error!("flash status {=u32:#x}", status);
        }
        saved.is_ok()
    }
}

impl Channels {
    /// Tells a reader of `replies` how many lines he has missed, if any. Returns whether he knows it.
    fn tell_missed(&mut self) -> bool {
        if self.missed > 0 {
            let mut told = Text::<96>::new();
            let written = writeln!(told, "{}", Unread { ignored: 0, lost: self.missed });
            if written.is_ok() && self.replies.write(told.as_str().as_bytes()) {
                self.missed = 0;
            }
        }
        self.missed == 0
    }
}

/// Writes a line to the log, in several frames if necessary. Returns whether all of them had room.
fn log(line: &str) -> bool {
    let before = board::log_dropped();
    let mut rest = line.strip_suffix('\n').unwrap_or(line);
    while let Some((piece, after)) = rest.split_at_checked(LOG_LINE) {
        defmt::info!("{=str}~", piece);
        rest = after;
    }
    defmt::info!("{=str}", rest);
    board::log_dropped() == before
}

/// The task `link`. Only this task and the logger send to the host.
pub struct Link {
    console: Console<Channels>,
    reports: Consumer<'static, Report, REPORTS>,
    pace: Pace,
    passes: u32,
    image: PassWatch,
}

impl Link {
    pub(super) fn new(
        link: board::Link,
        flash: SettingsFlash,
        self_test: SelfTest,
        (reports, sampler): (Consumer<'static, Report, REPORTS>, Viewer<Sampling>),
        orders: Producer<'static, Numbered, ORDERS>,
        device: &'static Device<'static>,
        (stored, source): (Stored, Source),
    ) -> Self {
        let board::Link { telemetry, replies, commands } = link;
        let channels = Channels {
            replies,
            missed: 0,
            telemetry,
            commands,
            sampler,
            flash,
            self_test,
            orders,
            ordered: 0,
        };
        let console = Console::new(channels, device, stored, source);
        Self { console, reports, pace: Pace::default(), passes: 0, image: PassWatch::default() }
    }

    /// Handles the reports and bytes that came since the last pass. If `link` is late, `render` drops reports. Then the
    /// telemetry has gaps in its samples.
    pub fn run(&mut self) {
        let (sample, checked) = (FLAGS.rendered.load(Relaxed), FLAGS.checked.load(Relaxed));
        if self.image.is_wrong(sample, checked) {
            board::end(Fault::Image);
        }
        let listens = self.pace.begin(board::clock());
        let mut worked = false;
        while let Some(report) = self.reports.dequeue() {
            worked |= !matches!(report.event, Event::None);
            self.console.report(&report);
        }
        worked |= self.console.pass(listens);
        if self.console.is_deaf() {
            board::end(Fault::Memory);
        }
        if worked {
            self.pace.end(board::clock());
        }
        self.passes = self.passes.wrapping_add(1);
        FLAGS.links.store(self.passes, Relaxed);
    }
}

/// Says why no task runs, and answers the commands that are then possible. It never returns, and everything stays off.
pub(super) fn refuse(mut link: board::Link, mut watchdog: Watchdog, why: &Unusable) -> ! {
    let mut console = Refused::new(board::FACTS.name, COMMIT, why);
    let mut said = Some(console.reason());
    loop {
        if let Some(line) = said.take() {
            let text = Text::<{ REPLY_MAX + 1 }>::of(format_args!("{line}\n"));
            log(text.as_str());
            link.replies.write(text.as_bytes());
        }
        if let Some(byte) = link.commands.read() {
            said = console.push(byte);
        }
        watchdog.feed();
    }
}
