//! The encoder's signals A and B. TIM2 counts their edges. On a board that also wires the signals to TIM3, TIM3
//! captures the times of the edges.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};

use rsemu::core::{
    device::SinkPin,
    wire::{Level, WireId},
};

use super::{
    Mcu,
    bus::{Clock, Lazy, Port},
};

/// The first two inputs of a timer.
pub(super) type Inputs = [(WireId, SinkPin); 2];

/// Offset of a timer's counter register.
const CNT: u64 = 0x24;
/// Offsets of a timer's capture registers.
const CCR1: u64 = 0x34;
const CCR2: u64 = 0x38;

/// The signals A and B, with each edge at its own time.
#[derive(Debug)]
pub(super) struct EncoderInput {
    pub(super) counter: Lazy,
    pub(super) capture: Lazy,
    inputs: Vec<Inputs>,
    state: Mutex<Edges>,
    /// Cycle of the last reading of the counter.
    pub(super) read_at: AtomicU64,
    readings: Mutex<Vec<u32>>,
    notes: Mutex<Option<EdgeNotes>>,
}

/// Times of the encoder's edges and of the program's readings.
#[derive(Clone, Debug, Default)]
pub struct EdgeNotes {
    /// Cycle and count of each edge.
    pub edges: Vec<(u64, i32)>,
    /// Cycle of each reading of the encoder's counter.
    pub read_at: Vec<u64>,
    /// Cycle of each reading of the capturing timer's counter.
    pub captures_read_at: Vec<u64>,
    /// One entry for each reading of the counter. It has the cycles at which the captures of A and B were read
    /// afterwards. `None` if a capture was not read.
    pub captured_at: Vec<[Option<u64>; 2]>,
}

#[derive(Clone, Debug, Default)]
struct Edges {
    waiting: VecDeque<(u64, i32)>,
    /// The count that A and B show now. `last` is the count after the last waiting edge.
    shown: i32,
    last: i32,
    /// Channels whose level does not change.
    dead: [bool; 2],
    levels: [bool; 2],
}

#[derive(Clone, Debug)]
pub(super) struct EncoderState {
    edges: Edges,
    read_at: u64,
    readings: Vec<u32>,
    notes: Option<EdgeNotes>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl EncoderInput {
    /// Takes the counting timer, and the capturing timer with its inputs, if the board has them.
    pub(super) fn new(
        (counter, counted): (Lazy, Inputs),
        (capture, captured): (Lazy, Option<Inputs>),
    ) -> Self {
        Self {
            counter,
            capture,
            inputs: [Some(counted), captured].into_iter().flatten().collect(),
            state: Mutex::default(),
            read_at: AtomicU64::new(0),
            readings: Mutex::default(),
            notes: Mutex::default(),
        }
    }

    /// Moves A and B to `count`. The first edge comes at cycle `from`, the others follow every `spacing` cycles.
    pub(super) fn go_to(&self, count: i32, from: u64, spacing: u64) {
        let mut edges = lock(&self.state);
        let mut at = from;
        while edges.last != count {
            edges.last += (i64::from(count) - i64::from(edges.last)).signum() as i32;
            let step = (at, edges.last);
            edges.waiting.push_back(step);
            at += spacing;
        }
    }

    /// Shows `count` at once, before the firmware's counter starts.
    pub(super) fn start_at(&self, count: i32) {
        let mut edges = lock(&self.state);
        *edges = Edges { shown: count, last: count, ..Edges::default() };
        self.show(&mut edges);
    }

    /// Delivers the edges that are due by `now`.
    pub(super) fn deliver(&self, now: u64) {
        let mut edges = lock(&self.state);
        while let Some(&(at, count)) = edges.waiting.front() {
            if at > now {
                break;
            }
            edges.waiting.pop_front();
            edges.shown = count;
            self.advance_to(at);
            self.show(&mut edges);
            self.note(|notes| notes.edges.push((at, count)));
        }
        self.counter.bring_to(now);
        self.capture.bring_to(now);
    }

    fn advance_to(&self, cycle: u64) {
        self.counter.advance_to(cycle);
        self.capture.advance_to(cycle);
    }

    /// Takes over the signals of `before`, the input before a reset. A reset does not move the handle.
    pub(super) fn go_on_from(&self, before: &Self) {
        let mut edges = lock(&self.state);
        *edges = std::mem::take(&mut *lock(&before.state));
        self.show(&mut edges);
    }

    /// Freezes a channel at its present level, or lets it work again.
    pub(super) fn kill(&self, channel: usize, dead: bool) {
        let mut edges = lock(&self.state);
        edges.dead[channel & 1] = dead;
        self.show(&mut edges);
    }

    /// Sets the level of a channel from a source other than the encoder.
    pub(super) fn set_level(&self, channel: usize, high: bool, now: u64) {
        self.advance_to(now);
        let mut edges = lock(&self.state);
        edges.levels[channel & 1] = high;
        self.drive(&edges);
    }

    pub(super) fn readings(&self) -> Vec<u32> {
        lock(&self.readings).clone()
    }

    pub(super) fn take_readings(&self) -> Vec<u32> {
        std::mem::take(&mut *lock(&self.readings))
    }

    /// Starts new notes, and returns the previous notes.
    pub(super) fn take_notes(&self) -> EdgeNotes {
        lock(&self.notes).replace(EdgeNotes::default()).unwrap_or_default()
    }

    fn note(&self, what: impl FnOnce(&mut EdgeNotes)) {
        if let Some(notes) = &mut *lock(&self.notes) {
            what(notes);
        }
    }

    /// Sets the levels of the present count in Gray code: A leads B while the count rises.
    fn show(&self, edges: &mut Edges) {
        let count = edges.shown;
        let levels = [(count + 1) >> 1 & 1, count >> 1 & 1];
        for (channel, level) in levels.into_iter().enumerate() {
            if !edges.dead[channel] {
                edges.levels[channel] = level == 1;
            }
        }
        self.drive(edges);
    }

    fn drive(&self, edges: &Edges) {
        self.counter.pay();
        self.capture.pay();
        for inputs in &self.inputs {
            for ((id, pin), level) in inputs.iter().zip(edges.levels) {
                pin.sink.set_level(*id, pin.line, Level::from_bool(level));
            }
        }
    }

    pub(super) fn state(&self) -> EncoderState {
        EncoderState {
            edges: lock(&self.state).clone(),
            read_at: self.read_at.load(Relaxed),
            readings: self.readings(),
            notes: lock(&self.notes).clone(),
        }
    }

    /// Restores the signals. Restore the timers after this call, since they read the levels.
    pub(super) fn restore(&self, from: &EncoderState) {
        self.drive(&from.edges);
        lock(&self.state).clone_from(&from.edges);
        self.read_at.store(from.read_at, Relaxed);
        lock(&self.readings).clone_from(&from.readings);
        lock(&self.notes).clone_from(&from.notes);
    }
}

/// Registers of TIM2, which counts.
#[derive(Debug)]
pub(super) struct CounterPort(pub(super) Arc<EncoderInput>, pub(super) Arc<Clock>);

impl Port for CounterPort {
    fn before(&self) {
        self.0.deliver(self.1.now());
    }

    fn read(&self, offset: u64, value: u32) -> u32 {
        if offset == CNT {
            self.0.read_at.store(self.1.now(), Relaxed);
            lock(&self.0.readings).push(value);
            self.0.note(|notes| notes.read_at.push(self.1.now()));
        }
        value
    }

    fn look(&self, _: u64, value: u32) -> u32 {
        value
    }
}

/// Registers of TIM3, which captures edges.
#[derive(Debug)]
pub(super) struct CapturePort(pub(super) Arc<EncoderInput>, pub(super) Arc<Clock>);

impl Port for CapturePort {
    fn before(&self) {
        self.0.deliver(self.1.now());
    }

    fn read(&self, offset: u64, value: u32) -> u32 {
        let now = self.1.now();
        self.0.note(|notes| match offset {
            CNT => {
                notes.captures_read_at.push(now);
                notes.captured_at.push([None; 2]);
            }
            CCR1 | CCR2 => {
                if let Some(last) = notes.captured_at.last_mut() {
                    last[usize::from(offset == CCR2)] = Some(now);
                }
            }
            _ => {}
        });
        value
    }

    fn look(&self, _: u64, value: u32) -> u32 {
        value
    }
}

impl Mcu {
    /// Sets A and B to `count` before the program starts to count.
    pub fn encoder_at(&mut self, count: i32) {
        self.soc.encoder.start_at(count);
    }

    /// All values that the program has read from the encoder's counter since the last reset.
    pub fn counter_readings(&self) -> Vec<u32> {
        self.soc.encoder.readings()
    }

    /// Returns the same list as [`counter_readings`](Self::counter_readings), and clears this list.
    pub fn take_counter_readings(&mut self) -> Vec<u32> {
        self.soc.encoder.take_readings()
    }

    /// Moves A and B to `count`. The first edge comes at cycle `from`, the others follow every `spacing` cycles. Edges
    /// are delivered in the order of the calls.
    pub fn encoder_to(&mut self, count: i32, from: u64, spacing: u64) {
        self.soc.encoder.go_to(count, from, spacing);
    }

    /// Starts new notes of the encoder's edges, and returns the previous notes. A reset also ends the notes.
    pub fn take_edge_notes(&mut self) -> EdgeNotes {
        self.soc.encoder.take_notes()
    }
}
