//! A virtual board that runs in real time, in its own thread.

use std::{
    net::TcpListener,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};

use super::{
    gdb,
    wires::{SLICE, Slices, Wires},
};
use crate::{
    mcu::{Met, Stops},
    session::{Failed, Session, ask},
    world::{Ended, World},
};

/// Longest time by which the board may be ahead of real time.
const AHEAD: Duration = Duration::from_millis(1);
/// Longest time that the board catches up if it is behind real time.
const BEHIND: Duration = Duration::from_millis(20);

/// Set-up of the board before it runs in real time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Begin {
    /// If true, the zero was set while a hand held the handle at the scene's position 0. So the board's positions equal
    /// the scene's. If false, the handle rests at the device's rest position.
    pub zeroed: bool,
    /// Output period, in samples. It replaces the board's own period.
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

/// A virtual board in real time. Dropping this value switches the board off.
pub struct LiveBoard {
    pub wires: Arc<Wires>,
    ended: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl LiveBoard {
    /// Switches a board on.
    ///
    /// # Errors
    /// The image is not of this firmware, or refuses a command.
    pub fn start(session: Session, begin: Begin) -> Result<Self, Failed> {
        Self::with_gdb(session, begin, None)
    }

    /// Switches a board on as [`start`](Self::start) does, with a port for gdb. The listener must not block.
    pub fn with_gdb(
        session: Session,
        begin: Begin,
        gdb: Option<TcpListener>,
    ) -> Result<Self, Failed> {
        let wires = Arc::new(Wires::default());
        let ended = Arc::new(AtomicBool::new(false));
        let (booted, wait) = mpsc::channel();
        let (inside, over) = (Arc::clone(&wires), Arc::clone(&ended));
        let thread = thread::spawn(move || {
            let mut world = match begin.boot(&session) {
                Ok(world) => world,
                Err(failed) => return drop(booted.send(Err(failed))),
            };
            let _ = booted.send(Ok(()));
            let run = RealTime::new(&inside, &over).run(&mut world, gdb.map(gdb::Port::new));
            if let Err(Failed::Program(ended)) = run {
                inside.lose(format!("the firmware: {ended:?}"));
            }
        });
        let over = || Failed::Refused("the board's thread ended".to_owned());
        wait.recv().map_err(|_| over())??;
        Ok(Self { wires, ended, thread: Some(thread) })
    }
}

impl Drop for LiveBoard {
    fn drop(&mut self) {
        self.ended.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Runs slices of a millisecond in real time.
struct RealTime<'a> {
    wires: &'a Arc<Wires>,
    ended: &'a AtomicBool,
    slices: Slices,
    pace: Pace,
}

impl<'a> RealTime<'a> {
    fn new(wires: &'a Arc<Wires>, ended: &'a AtomicBool) -> Self {
        Self { wires, ended, slices: Slices::new(Arc::clone(wires)), pace: Pace::new() }
    }

    fn run(mut self, world: &mut World<'_>, mut gdb: Option<gdb::Port>) -> Result<(), Failed> {
        while !self.ended.load(Relaxed) {
            self.slices.run(world)?;
            self.wait(world);
            if let Some(port) = &mut gdb {
                port.look(world, &mut self)?;
            }
        }
        Ok(())
    }

    fn wait(&mut self, world: &World<'_>) {
        self.pace.count();
        self.wires.look(world, self.pace.speed);
        self.pace.wait();
    }
}

impl gdb::Board for RealTime<'_> {
    fn slice(&mut self, world: &mut World<'_>, stops: &Stops) -> Result<Option<Met>, Ended> {
        self.slices.before(world);
        for _ in 0..SLICE {
            if let Some(met) = world.sample_until_met(stops)? {
                return Ok(Some(met));
            }
        }
        self.wires.exchange(world);
        self.wait(world);
        Ok(None)
    }

    fn stands(&mut self, world: &mut World<'_>) -> bool {
        self.slices.before(world);
        self.wires.exchange(world);
        self.wires.look(world, 0.0);
        !self.ended.load(Relaxed)
    }

    fn goes_on(&mut self) {
        self.pace = Pace::new();
    }
}

/// Compares the board's time with real time.
struct Pace {
    begun: Instant,
    slices: u32,
    measured: (Instant, u32),
    speed: f64,
}

impl Pace {
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
