//! Connections between a virtual board and its surroundings. They are the bytes of the channels, the finger at the
//! handle, the switch of the emergency stop, and the state for the display.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
};

use super::{Link, UP_CHANNELS};
use crate::{
    board::Powered,
    session::Failed,
    world::{Finger, World},
};

/// Largest number of bytes of one channel that can wait for the host. Further bytes stay on the board. The board drops
/// bytes when its buffer is full.
const WAITING: usize = 1 << 16;
/// Number of samples from one exchange with the channels to the next. It is 1 ms.
pub const SLICE: u64 = 10;

/// State of the device for the display.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Time on the board since it was switched on, in s.
    pub time_s: f64,
    /// Position of the handle in the scene, in m.
    pub position_m: f64,
    /// Force of the finger on the handle, in N.
    pub finger_n: f64,
    pub enabled: bool,
    /// Time at which enable last became inactive, in s of the board's time.
    pub disabled_s: Option<f64>,
    /// Recent speed of the simulation, in simulated seconds per real second.
    pub speed: f64,
}

#[derive(Default)]
pub struct Wires {
    up: [Mutex<VecDeque<u8>>; UP_CHANNELS],
    /// Whether each channel is read. The bytes of other channels stay on the board.
    read: [AtomicBool; UP_CHANNELS],
    down: Mutex<VecDeque<u8>>,
    finger: Mutex<Option<Finger>>,
    stop_open: AtomicBool,
    seen: Mutex<Seen>,
    lost: Mutex<Option<String>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Wires {
    /// Sets whether the channel is read. On the board, the buffer of a channel that is not read becomes full.
    pub fn attend(&self, channel: usize, read: bool) {
        if let (Some(flag), Some(bytes)) = (self.read.get(channel), self.up.get(channel)) {
            flag.store(read, Relaxed);
            if !read {
                lock(bytes).clear();
            }
        }
    }

    pub fn link(self: &Arc<Self>) -> WiredLink {
        WiredLink(Arc::clone(self))
    }

    /// Sets the finger that acts on the handle from now on, or none.
    pub fn touch(&self, finger: Option<Finger>) {
        *lock(&self.finger) = finger;
    }

    pub fn emergency_stop(&self, open: bool) {
        self.stop_open.store(open, Relaxed);
    }

    pub fn seen(&self) -> Seen {
        *lock(&self.seen)
    }

    pub fn lose(&self, why: String) {
        *lock(&self.lost) = Some(why);
    }

    /// Takes bytes that the program has written to a channel, as far as there is room.
    pub(super) fn take(&self, channel: usize, said: &mut Vec<u8>) {
        let Some(bytes) = self.up.get(channel) else { return };
        let mut bytes = lock(bytes);
        let room = WAITING.saturating_sub(bytes.len());
        bytes.extend(said.drain(..said.len().min(room)));
    }

    pub(super) fn typed(&self, room: usize) -> Vec<u8> {
        let mut down = lock(&self.down);
        let count = down.len().min(room);
        down.drain(..count).collect()
    }

    pub(super) fn finger(&self) -> Option<Finger> {
        *lock(&self.finger)
    }

    pub(super) fn is_stop_open(&self) -> bool {
        self.stop_open.load(Relaxed)
    }

    pub(super) fn show(&self, seen: Seen) {
        *lock(&self.seen) = seen;
    }

    /// Exchanges bytes each millisecond, as a probe does.
    pub(super) fn exchange(&self, world: &mut World<'_>) {
        let Powered { mcu, rtt, .. } = &mut world.powered;
        mcu.take_counter_readings(); // otherwise the notes, which have no reader, fill the memory in hours
        for (channel, (bytes, read)) in (0..).zip(self.up.iter().zip(&self.read)) {
            let mut bytes = lock(bytes);
            let room = WAITING.saturating_sub(bytes.len());
            if read.load(Relaxed) && room > 0 {
                bytes.extend(rtt.read_up_to(mcu, channel, room));
            }
        }
        let mut down = lock(&self.down);
        if !down.is_empty() {
            let written = rtt.write(mcu, 0, down.make_contiguous());
            down.drain(..written);
        }
    }

    pub(super) fn look(&self, world: &World<'_>, speed: f64) {
        let Powered { mcu, amplifier, .. } = &world.powered;
        #[expect(clippy::cast_precision_loss, reason = "for people; exact for a year")]
        let seconds = |cycle: u64| cycle as f64 / mcu.core_hz() as f64;
        self.show(Seen {
            time_s: seconds(mcu.now()),
            position_m: world.position_m(),
            finger_n: world.finger_n(),
            enabled: amplifier.is_enabled(),
            disabled_s: amplifier.changes().disabled_at.map(seconds),
            speed,
        });
    }
}

#[derive(Clone)]
pub struct WiredLink(Arc<Wires>);

impl Link for WiredLink {
    fn read(&mut self, channel: usize, into: &mut Vec<u8>) {
        let Some(bytes) = self.0.up.get(channel) else { return };
        self.0.read[channel].store(true, Relaxed);
        into.extend(lock(bytes).drain(..));
    }

    fn write(&mut self, channel: usize, bytes: &[u8]) -> usize {
        if channel != super::COMMANDS {
            return 0;
        }
        let mut down = lock(&self.0.down);
        let taken = bytes.len().min(WAITING.saturating_sub(down.len()));
        down.extend(&bytes[..taken]);
        taken
    }

    fn lost(&self) -> Option<String> {
        lock(&self.0.lost).clone()
    }
}

/// Runs a board in steps of a millisecond. The actions of people take effect before each step. The board's output is
/// passed on after each step.
pub struct Slices {
    wires: Arc<Wires>,
    stop_open: bool,
}

impl Slices {
    pub fn new(wires: Arc<Wires>) -> Self {
        Self { wires, stop_open: false }
    }

    pub(super) fn before(&mut self, world: &mut World<'_>) {
        world.finger = self.wires.finger();
        let wanted = self.wires.is_stop_open();
        if wanted != self.stop_open {
            world.emergency_stop(wanted);
            self.stop_open = wanted;
        }
    }

    /// Runs one millisecond.
    ///
    /// # Errors
    /// The program ended.
    pub fn run(&mut self, world: &mut World<'_>) -> Result<(), Failed> {
        self.before(world);
        for _ in 0..SLICE {
            world.sample().map_err(Failed::Program)?;
        }
        self.wires.exchange(world);
        Ok(())
    }
}
