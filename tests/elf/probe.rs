//! The release image behind a debug probe, as `cargo live --probe` uses it. The virtual board simulates the probe's
//! halts and the time of its accesses.

use std::{
    sync::mpsc::{Receiver, Sender, channel},
    thread,
};

use virtual_board::{
    board::Board,
    link::{COMMANDS, Core, LOG, Link as _, Met, Probe, ProbeLink, REPLIES, TELEMETRY},
    log::Decoder,
    mcu::AfterHalt,
    rtt::Memory,
    world::World,
};
use zwidth::telemetry;

use crate::firmware::Firmware;

each_board!(
    a_board_is_met_with_its_force_on_and_left_with_it_off,
    every_frame_comes_through_and_a_reset_is_no_end
);

/// Duration of one access by the probe, in samples. It is half a millisecond, as with an ST-LINK.
const ACCESS: u64 = 5;
/// Duration of probe-rs' halt, in samples.
const HALT: u64 = 200;
const FLASH: u32 = 0x0800_0000;

type Act = Box<dyn FnOnce(&mut World<'static>) + Send>;

/// A board in its own thread. The board's time advances with each access.
#[derive(Clone)]
struct Bench(Sender<Act>);

impl Bench {
    fn start(switch_on: impl FnOnce() -> World<'static> + Send + 'static) -> Self {
        let (acts, done): (Sender<Act>, Receiver<Act>) = channel();
        thread::spawn(move || {
            let mut world = switch_on();
            for act in done {
                act(&mut world);
            }
        });
        Self(acts)
    }

    fn with<T: Send + 'static>(
        &self,
        act: impl FnOnce(&mut World<'static>) -> T + Send + 'static,
    ) -> T {
        let (say, hear) = channel();
        self.0.send(Box::new(move |world| drop(say.send(act(world))))).unwrap();
        hear.recv().unwrap()
    }

    fn is_enabled(&self) -> bool {
        self.with(|world| world.powered.amplifier.is_enabled())
    }

    fn attach(&self, firmware: &Firmware) -> (ProbeLink<Attached>, Met) {
        ProbeLink::attach(Attached::to(self.clone()), &firmware.elf).unwrap()
    }
}

/// Lets time pass. `run` is not used, since it also reads the channels.
fn pass(world: &mut World<'_>, samples: u64) {
    for _ in 0..samples {
        world.sample().unwrap();
    }
}

fn halt(world: &mut World<'_>) {
    let cycles = HALT * world.powered.board.cycles_per_sample();
    world.halt(cycles, AfterHalt::Kept);
    pass(world, 50);
}

/// A simulated probe-rs, which halts the core when it attaches and when it detaches.
struct Attached(Bench);

impl Attached {
    fn to(bench: Bench) -> Self {
        bench.with(halt);
        Self(bench)
    }
}

impl Drop for Attached {
    fn drop(&mut self) {
        self.0.with(halt);
    }
}

impl Memory for Opened {
    type Error = String;

    fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), String> {
        let length = into.len();
        let bytes = self.0.with(move |world| {
            pass(world, ACCESS);
            let mut bytes = vec![0; length];
            if address < 0x2000_0000 {
                let at = (address - FLASH) as usize;
                bytes.copy_from_slice(&world.powered.mcu.flash()[at..at + length]);
            } else {
                world.powered.mcu.read(address, &mut bytes);
            }
            bytes
        });
        into.copy_from_slice(&bytes);
        Ok(())
    }

    fn write(&mut self, address: u32, from: &[u8]) -> Result<(), String> {
        let bytes = from.to_vec();
        self.0.with(move |world| {
            pass(world, ACCESS);
            world.powered.mcu.write(address, &bytes);
        });
        Ok(())
    }
}

impl Probe for Attached {
    fn core(&mut self) -> Result<impl Core, String> {
        Ok(Opened(self.0.clone()))
    }
}

struct Opened(Bench);

impl Core for Opened {
    fn is_halted(&mut self) -> Result<bool, String> {
        Ok(false)
    }
}

/// Types lines, and waits for a line that contains `wanted`.
fn type_until(link: &mut ProbeLink<Attached>, lines: &str, wanted: &str) {
    assert_eq!(link.write(COMMANDS, lines.as_bytes()), lines.len(), "{lines}");
    let mut replies = vec![];
    for _ in 0..10_000 {
        link.read(REPLIES, &mut replies);
        if String::from_utf8_lossy(&replies).contains(wanted) {
            return;
        }
        assert_eq!(link.lost(), None);
    }
    panic!("{wanted}: {}", String::from_utf8_lossy(&replies));
}

/// Attaching to a board with its force on causes fault 32, and has no other effect. When the probe detaches, the force
/// is off before the halt. So this halt is no fault.
fn a_board_is_met_with_its_force_on_and_left_with_it_off(board: Board) {
    let firmware: &Firmware = Box::leak(Box::new(Firmware::of(board)));
    let bench = Bench::start(|| firmware.armed());
    assert!(bench.is_enabled());
    let (mut link, met) = bench.attach(firmware);
    assert_eq!(met, Met::Halted);
    assert!(!bench.is_enabled());
    type_until(&mut link, "clear\n", "ok clear");
    drop(link);
    let (mut link, met) = bench.attach(firmware);
    assert_eq!(met, Met::Off);
    type_until(&mut link, "zero\narm\n", "ok arm");
    // Time for the sign test and the ramp.
    bench.with(|world| pass(world, 5_000));
    type_until(&mut link, "status\n", "ok status armed");
    assert!(bench.is_enabled());
    drop(link);
    assert!(!bench.is_enabled());
    let (link, met) = bench.attach(firmware);
    assert_eq!(met, Met::Off, "it was halted before it was off");
    drop(link);
}

/// Log and telemetry are complete, before a reset and after it.
fn every_frame_comes_through_and_a_reset_is_no_end(board: Board) {
    let firmware: &Firmware = Box::leak(Box::new(Firmware::of(board)));
    let bench = Bench::start(|| firmware.boot());
    let (mut link, met) = bench.attach(firmware);
    assert_eq!(met, Met::Off);
    for life in 0..2 {
        let mut log = Decoder::new(&firmware.table);
        let mut decoder = telemetry::Decoder::new();
        let mut lines = vec![];
        type_until(&mut link, "version\n", "ok version");
        let begun = bench.with(|world| world.powered.mcu.now());
        let second = board.chip.core_hz;
        while bench.with(|world| world.powered.mcu.now()) < begun + second / 2 {
            let (mut frames, mut bytes) = (vec![], vec![]);
            link.read(TELEMETRY, &mut frames);
            link.read(LOG, &mut bytes);
            for byte in frames {
                decoder.push(byte);
            }
            lines.extend(log.feed(&bytes).unwrap());
        }
        assert_eq!(link.lost(), None);
        assert!(decoder.frames > 100, "{} frames", decoder.frames);
        assert_eq!((decoder.dropped, decoder.garbage), (0, 0), "life {life}");
        assert!(lines.iter().any(|line| line.starts_with("ok version")), "{lines:?}");
        bench.with(|world| {
            world.reset();
            pass(world, 500);
        });
    }
}
