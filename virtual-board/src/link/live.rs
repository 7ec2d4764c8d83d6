//! A virtual board that runs by itself, in real time, in a thread of its own.

use std::{
    collections::VecDeque,
    net::TcpListener,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering::Relaxed},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};

use super::{Link, UP_CHANNELS, gdb};
use crate::{
    board::Powered,
    mcu::{Met, Stops},
    session::{Failed, Session, ask},
    world::{Ended, World},
};

pub use crate::world::Finger;

/// Bytes of a channel that wait for the host. What is more stays on the board, which drops what is too much.
const WAITING: usize = 1 << 16;
/// Samples between two looks at the channels: a millisecond.
const SLICE: u64 = 10;
/// How far it may run ahead of real time.
const AHEAD: Duration = Duration::from_millis(1);
/// Where it is behind by more, it does not try to catch up.
const BEHIND: Duration = Duration::from_millis(20);

/// What a person would see who looks at the device.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Time on the board since it was switched on, s.
    pub time_s: f64,
    /// Where the handle is in the scene, m.
    pub position_m: f64,
    /// Force of the finger on it, N.
    pub finger_n: f64,
    /// The amplifier is enabled.
    pub enabled: bool,
    /// When enable last dropped, in seconds on the board.
    pub disabled_s: Option<f64>,
    /// Seconds on the board for each second here, lately.
    pub speed: f64,
}

/// What comes before real time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Begin {
    /// A hand has held the handle at the scene's 0 and zeroed it there, so that the board's positions are the scene's;
    /// else it rests where the device rests.
    pub zeroed: bool,
    /// Another output period than the board's own.
    pub period: Option<u32>,
}

impl Begin {
    fn boot(self, session: &Session) -> Result<World<'_>, Failed> {
        let mut world = if self.zeroed { session.boot_at_zero()? } else { session.boot()? };
        if let Some(period) = self.period {
            ask(&mut world, &format!("period {period}"))?;
        }
        Ok(world)
    }
}

#[derive(Default)]
struct Shared {
    up: [Mutex<VecDeque<u8>>; UP_CHANNELS],
    /// Channels that nobody reads stay on the board.
    read: [AtomicBool; UP_CHANNELS],
    down: Mutex<VecDeque<u8>>,
    finger: Mutex<Option<Finger>>,
    stop_open: AtomicBool,
    seen: Mutex<Seen>,
    lost: Mutex<Option<String>>,
    ended: AtomicBool,
}

/// A virtual board in real time. It is switched off when the last of its handles is dropped.
pub struct LiveBoard {
    shared: Arc<Shared>,
    thread: Option<thread::JoinHandle<()>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl LiveBoard {
    /// Switches a board on.
    ///
    /// # Errors
    /// The image is none of this firmware, or refuses what it was told.
    pub fn start(session: Session, begin: Begin) -> Result<Self, Failed> {
        Self::with_gdb(session, begin, None)
    }

    /// The same, with gdb's port, whose listener does not block.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn with_gdb(
        session: Session,
        begin: Begin,
        gdb: Option<TcpListener>,
    ) -> Result<Self, Failed> {
        let shared = Arc::new(Shared::default());
        let (booted, wait) = mpsc::channel();
        let inside = Arc::clone(&shared);
        let thread = thread::spawn(move || {
            let mut world = match begin.boot(&session) {
                Ok(world) => world,
                Err(failed) => return drop(booted.send(Err(failed))),
            };
            let _ = booted.send(Ok(()));
            if let Err(Failed::Program(ended)) = inside.run(&mut world, gdb.map(gdb::Port::new)) {
                *lock(&inside.lost) = Some(format!("the firmware: {ended:?}"));
            }
        });
        let over = || Failed::Refused("the board's thread ended".to_owned());
        wait.recv().map_err(|_| over())??;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// The channel is read from now on, or no longer: then the board finds it full.
    pub fn attend(&self, channel: usize, read: bool) {
        if let (Some(flag), Some(bytes)) =
            (self.shared.read.get(channel), self.shared.up.get(channel))
        {
            flag.store(read, Relaxed);
            if !read {
                lock(bytes).clear();
            }
        }
    }

    /// A finger pulls at the handle from now on, or none.
    pub fn touch(&self, finger: Option<Finger>) {
        *lock(&self.shared.finger) = finger;
    }

    /// The switch of the emergency stop.
    pub fn emergency_stop(&self, open: bool) {
        self.shared.stop_open.store(open, Relaxed);
    }

    /// What a person would see.
    pub fn seen(&self) -> Seen {
        *lock(&self.shared.seen)
    }

    /// Another end of the same link.
    pub fn link(&self) -> LiveLink {
        LiveLink(Arc::clone(&self.shared))
    }
}

impl Drop for LiveBoard {
    fn drop(&mut self) {
        self.shared.ended.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// An end of the link to a [`LiveBoard`].
#[derive(Clone)]
pub struct LiveLink(Arc<Shared>);

impl Link for LiveLink {
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

impl Shared {
    fn run(&self, world: &mut World<'_>, mut gdb: Option<gdb::Port>) -> Result<(), Failed> {
        let mut board = RealTime { shared: self, pace: Pace::new(), stop_open: false };
        while !self.ended.load(Relaxed) {
            board.before(world);
            for _ in 0..SLICE {
                world.sample().map_err(Failed::Program)?;
            }
            board.after(world);
            if let Some(port) = &mut gdb {
                port.look(world, &mut board)?;
            }
        }
        Ok(())
    }

    /// As a probe does, each millisecond.
    fn exchange(&self, world: &mut World<'_>) {
        let Powered { mcu, rtt, .. } = &mut world.powered;
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

    fn look(&self, world: &World<'_>, speed: f64) {
        let Powered { mcu, amplifier, .. } = &world.powered;
        #[expect(clippy::cast_precision_loss, reason = "for people; exact for a year")]
        let seconds = |cycle: u64| cycle as f64 / mcu.core_hz() as f64;
        *lock(&self.seen) = Seen {
            time_s: seconds(mcu.now()),
            position_m: world.position_m(),
            finger_n: world.finger_n(),
            enabled: amplifier.is_enabled(),
            disabled_s: amplifier.changes().disabled_at.map(seconds),
            speed,
        };
    }
}

/// Slices of a millisecond in real time.
struct RealTime<'a> {
    shared: &'a Shared,
    pace: Pace,
    stop_open: bool,
}

impl RealTime<'_> {
    fn before(&mut self, world: &mut World<'_>) {
        world.finger = *lock(&self.shared.finger);
        let wanted = self.shared.stop_open.load(Relaxed);
        if wanted != self.stop_open {
            world.emergency_stop(wanted);
            self.stop_open = wanted;
        }
    }

    fn after(&mut self, world: &mut World<'_>) {
        self.shared.exchange(world);
        self.pace.count();
        self.shared.look(world, self.pace.speed);
        self.pace.wait();
    }
}

impl gdb::Board for RealTime<'_> {
    fn slice(&mut self, world: &mut World<'_>, stops: &Stops) -> Result<Option<Met>, Ended> {
        self.before(world);
        for _ in 0..SLICE {
            if let Some(met) = world.sample_until_met(stops)? {
                return Ok(Some(met));
            }
        }
        self.after(world);
        Ok(None)
    }

    fn stands(&mut self, world: &mut World<'_>) -> bool {
        self.before(world);
        self.shared.exchange(world);
        self.shared.look(world, 0.0);
        !self.shared.ended.load(Relaxed)
    }

    fn goes_on(&mut self) {
        self.pace = Pace::new();
    }
}

/// How far it has come in real time.
struct Pace {
    begun: Instant,
    slices: u32,
    measured: (Instant, u32),
    speed: f64,
}

impl Pace {
    /// Length of a slice.
    const SLICE: Duration = Duration::from_millis(1);

    fn new() -> Self {
        Self { begun: Instant::now(), slices: 0, measured: (Instant::now(), 0), speed: 1.0 }
    }

    fn count(&mut self) {
        self.slices += 1;
        let (since, run) = (self.measured.0.elapsed(), self.slices.wrapping_sub(self.measured.1));
        if since > Duration::from_millis(500) {
            self.speed = f64::from(run) * Self::SLICE.as_secs_f64() / since.as_secs_f64();
            self.measured = (Instant::now(), self.slices);
        }
    }

    fn wait(&mut self) {
        let (due, now) = (self.begun + Self::SLICE * self.slices, Instant::now());
        if let Some(ahead) = due.checked_duration_since(now).filter(|ahead| *ahead > AHEAD) {
            thread::sleep(ahead);
        } else if now.saturating_duration_since(due) > BEHIND {
            (self.begun, self.slices) = (now, 0);
            self.measured = (now, 0);
        }
    }
}
