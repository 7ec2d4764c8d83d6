//! Tests of the console on a mock board, whose state is plain values.

use std::{
    collections::VecDeque,
    format,
    string::{String, ToString},
    vec::Vec,
};

use super::*;
use crate::{
    LoopParameters,
    device::{Device, tests::DEVICE},
    experiment::{Activity, Event, Order, Promise, Report},
    port::Exchanged,
    safety::{
        Fault, FaultRecord, FaultSet, GuardedSampler, Inputs, Refusal, Request, State, Status,
    },
    self_test::{Found, Part},
    store::{Loaded, Source, Stored},
    telemetry::Record,
    units::{Force, Position},
};

mod channel;
mod commands;
mod designs;
mod events;
mod quiet;
mod rotary;
mod self_test;
mod stream;
mod walk;

#[derive(Default)]
struct Board {
    typed: VecDeque<u8>,
    lines: Vec<String>,
    frames: Vec<Vec<u8>>,
    /// The position at every sample. `sampler` is the sampler after the last sample.
    positions: Vec<Position>,
    sampler: Option<GuardedSampler>,
    /// Whether the channel for telemetry frames is full.
    full: bool,
    orders: Vec<Order>,
    flash: Option<Stored>,
    /// Whether flash refuses every write.
    broken: bool,
    /// The part whose self-test fails.
    wrong: Option<Part>,
    tested: Vec<Part>,
    /// Whether nobody reads the lines.
    deaf: bool,
    /// Whether there is no room for an order.
    clogged: bool,
    /// The parameters of the last order.
    in_force: Option<LoopParameters>,
}

impl Port for Board {
    const COMMIT: &'static str = "0123456789ab";

    fn read(&mut self) -> Option<u8> {
        self.typed.pop_front()
    }

    fn write_line(&mut self, line: &str) -> bool {
        if !self.deaf {
            self.lines.push(line.strip_suffix('\n').expect("a line has an end").to_string());
        }
        !self.deaf
    }

    fn write_frame(&mut self, frame: &[u8]) -> bool {
        if !self.full {
            self.frames.push(frame.to_vec());
        }
        !self.full
    }

    fn samples(&mut self, newest: u64, places: &mut [Position]) -> Option<GuardedSampler> {
        let newest = usize::try_from(newest).ok()?;
        let from = (newest + 1).checked_sub(places.len())?;
        places.copy_from_slice(self.positions.get(from..=newest)?);
        self.sampler
    }

    fn order(&mut self, order: Order) -> bool {
        self.orders.push(order);
        if let Order::LoopParameters(parameters, _) = order {
            self.in_force = Some(parameters);
        }
        !self.clogged
    }

    fn is_in_force(&mut self, asked: &LoopParameters) -> bool {
        self.in_force.is_some_and(|in_force| asked.does_as(&in_force))
    }

    fn load(&mut self, defaults: Stored) -> Loaded {
        let source = if self.flash.is_some() { Source::Newest } else { Source::Empty };
        Loaded { stored: self.flash.unwrap_or(defaults), source, damaged: 0 }
    }

    fn test(&mut self, part: Part) -> Found {
        self.tested.push(part);
        Found::Clock(if self.wrong == Some(part) { 0 } else { 32_000 })
    }

    fn save(&mut self, stored: &Stored) -> bool {
        if !self.broken {
            self.flash = Some(*stored);
        }
        !self.broken
    }
}

/// The force is off, and all conditions of `arm` are fulfilled.
const OFF: Status = Status {
    state: State::Off,
    fault: None,
    causes: FaultSet::EMPTY,
    present: FaultSet::EMPTY,
    zeroed: true,
    unlocked: false,
    contact: false,
    inputs: Inputs {
        stop_closed: true,
        supply_good: true,
        settings_valid: true,
        halted: false,
        found: FaultSet::EMPTY,
    },
};
const ARMED: Status = Status { state: State::Armed, ..OFF };
const FREE: Status = Status { unlocked: true, ..ARMED };

struct Bench {
    console: Console<Board>,
    status: Status,
    activity: Activity,
}

const PORT: Exchanged = Exchanged { energy: -(1 << 40), given: 1 << 41 };

impl Bench {
    /// A bench after boot. Its first order is already accepted.
    fn new(status: Status) -> Self {
        Self::on(&DEVICE, status)
    }

    fn on(device: &'static Device<'static>, status: Status) -> Self {
        let console = Console::new(Board::default(), device, device.defaults(), Source::Empty);
        let mut bench = Self { console, status, activity: Activity::None };
        bench.report(Event::Answer(Ok(())));
        bench.take();
        bench
    }

    fn report(&mut self, event: Event) {
        self.tell(Record { sample: 42, ..Record::EMPTY }, event);
    }

    /// Reports an output with `record`. Checks that the following lines answer no command, unless `event` is an answer.
    fn tell(&mut self, record: Record, event: Event) {
        let Self { status, activity, .. } = *self;
        let (before, answers) = (self.console.port.lines.len(), matches!(event, Event::Answer(_)));
        self.console.report(&Report {
            record,
            streamed: record,
            push: Force::ZERO,
            port: PORT,
            status,
            activity,
            event,
        });
        let said = &self.console.port.lines[before..];
        assert!(answers || said.iter().all(|line| !is_answer(line)), "{said:?}");
    }

    /// Lines and orders since the last call.
    fn take(&mut self) -> (Vec<String>, Vec<Order>) {
        let board = &mut self.console.port;
        (std::mem::take(&mut board.lines), std::mem::take(&mut board.orders))
    }

    /// Types a command, and lets the console obey it. Returns the console's lines and orders.
    fn type_in(&mut self, line: &str) -> (Vec<String>, Vec<Order>) {
        self.console.port.typed.extend(format!("{line}\n").bytes());
        self.console.pass(true);
        self.take()
    }

    fn answer(&mut self, answer: Result<(), Refusal>) -> Vec<String> {
        self.report(Event::Answer(answer));
        self.take().0
    }

    /// Types a command to which the console must give one order to the board and no reply. Returns the order.
    #[track_caller]
    fn orders(&mut self, line: &str) -> Order {
        let (lines, orders) = self.type_in(line);
        assert!(lines.is_empty(), "{line}: {lines:?}");
        assert_eq!(orders.len(), 1, "{line}");
        orders[0]
    }

    /// Types a command to which the console must reply with one line, without an order to the board. Returns the reply.
    #[track_caller]
    fn says(&mut self, line: &str) -> String {
        let (mut lines, orders) = self.type_in(line);
        assert!(orders.is_empty(), "{line}: {orders:?}");
        assert_eq!(lines.len(), 1, "{line}: {lines:?}");
        assert!(is_answer(&lines[0]), "{line}: {lines:?}");
        lines.remove(0)
    }

    fn stored(&self) -> Stored {
        *self.console.stored
    }
}

fn version() -> String {
    let hash = DEVICE.envelope.hash();
    let version = env!("CARGO_PKG_VERSION");
    format!(
        "ok version {version}, commit 0123456789ab, board a-board, scene bench 0badcafe, envelope {hash:08x}, \
         layouts record 4, settings 5, telemetry 2"
    )
}
