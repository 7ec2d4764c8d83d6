//! A host that sends without a pause, during a hit in contact. The watchdog must be fed, outputs must be right and in
//! time, and no data may be lost. `disarm` after the flood must be obeyed in time.

use rayon::prelude::*;
use virtual_board::{
    board::{Board, Powered},
    mcu::{LINK, RENDER},
    world::{Snapshot, World},
};
use zwidth::period::PERIODS;

use crate::{
    figure::figure,
    firmware::{Firmware, ok, until_armed},
    period::records,
};

each_board!(a_flood_changes_nothing_and_the_watchdog_is_fed);
each_board!(the_watchdog_is_fed_with_the_force_off_as_well);
each_board!(
    disarm_behind_a_full_channel_is_obeyed_in_time,
    ignored: "every line at every period; CI runs it"
);
each_board!(
    many_lines_are_all_answered,
    ignored: "seconds of a flood; CI runs it"
);

/// Longest time from one feeding of the watchdog to the next, in s.
const FED_S: f64 = 0.02;
/// Largest fraction of the time that `link` may take.
const LOAD: f64 = 0.3;
/// Longest time from the sampling event to the write of the force, in s. In this time the logger may mask `render`
/// before `render` runs.
const OUTPUT_S: f64 = 80e-6;
/// Longest time from the last byte of `disarm`, in a full channel, until enable is inactive, in s (docs/faults.md).
const BEHIND_S: f64 = 0.4;
/// Number of samples for which the host sends. This is twice the watchdog's timeout.
const SENDS: u64 = 1_000;

/// Texts that the host repeats.
fn floods() -> [(&'static str, Vec<u8>); 5] {
    // A multiplicative generator. The generator gives all bytes, including ends of lines.
    let noise = (0..4096).scan(1u32, |seed, _| {
        *seed = seed.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        Some((*seed >> 24) as u8)
    });
    [
        ("get", b"get\n".to_vec()),
        ("refused", b"k 1e9\n".to_vec()),
        ("mixed", b"status\nhelp\nget\nrubbish\n\n".to_vec()),
        ("endless", b"endless ".to_vec()),
        ("noise", noise.collect()),
    ]
}

/// An armed board at this period, with the handle free.
fn armed(firmware: &Firmware, period: u32) -> World<'_> {
    let mut world = firmware.boot();
    let period = format!("period {period}");
    for line in ["zero", "unlock envelope", &period, "wall 0.005", "k 8000", "b 30"] {
        ok(&mut world, line);
    }
    for line in ["push 2.835", "settle 3", "window 2", "arm"] {
        ok(&mut world, line);
    }
    until_armed(&mut world);
    world
}

/// A board in a hit at this period. The handle is held inside the wall.
fn in_contact(firmware: &Firmware, period: u32) -> World<'_> {
    let mut world = armed(firmware, period);
    ok(&mut world, "hit");
    world.run(1_500).unwrap();
    let place_m = world.position_m();
    world.hold(place_m, true);
    world.run(200).unwrap();
    let status = ok(&mut world, "status");
    assert!(
        status.contains("armed, fault none, hit,") && status.contains("in contact"),
        "{status}"
    );
    world.telemetry.clear();
    world
}

/// A host and the text that it sends.
struct Host<'a> {
    bytes: &'a [u8],
    at: usize,
    reads: bool,
}

impl Host<'_> {
    /// Fills the channel and runs a sample.
    fn sample(&mut self, world: &mut World<'_>, n: u64) {
        let Powered { mcu, rtt, .. } = &mut world.powered;
        loop {
            let sent = rtt.write(mcu, 0, &self.bytes[self.at..]);
            self.at = (self.at + sent) % self.bytes.len();
            if sent == 0 {
                break;
            }
        }
        pass(world, n, self.reads);
    }

    /// Ends the present line and sends `disarm` as room becomes free. Returns the time from the last byte of `disarm`
    /// until enable is inactive, in s.
    fn disarm(self, world: &mut World<'_>) -> f64 {
        let begun = self.bytes[self.at..].split_inclusive(|byte| *byte == b'\n').next();
        let ends = begun.filter(|line| line.ends_with(b"\n")).unwrap_or(b"\n");
        let bytes = [ends, b"disarm\n"].concat();
        let (mut rest, mut n) = (&bytes[..], 0);
        loop {
            let Powered { mcu, rtt, .. } = &mut world.powered;
            rest = &rest[rtt.write(mcu, 0, rest)..];
            if rest.is_empty() {
                break;
            }
            n += 1;
            pass(world, n, self.reads);
        }
        let begun = world.powered.mcu.now();
        while world.powered.amplifier.is_enabled() {
            n += 1;
            assert!(n < 10_000, "disarm is not obeyed");
            pass(world, n, self.reads);
        }
        let off = world.powered.amplifier.changes().disabled_at.unwrap();
        off.saturating_sub(begun) as f64 / world.powered.mcu.core_hz() as f64
    }
}

/// Runs a sample. The host reads the board's output from time to time.
fn pass(world: &mut World<'_>, n: u64, reads: bool) {
    world.sample().unwrap();
    if reads && n.is_multiple_of(20) {
        world.probe().unwrap();
    }
}

/// Compares two runs from the same state. In one the host floods the board, in the other it sends nothing.
fn flood(
    world: &mut World<'_>,
    kept: &Snapshot,
    name: &str,
    bytes: &[u8],
    reads: bool,
    period: u32,
) {
    world.restore(kept);
    (0..SENDS).for_each(|n| pass(world, n, reads));
    world.probe().unwrap();
    let (quiet, _) = records(world);

    world.restore(kept);
    let settings = ok(world, "get");
    world.restore(kept);
    world.powered.mcu.watch_mut().clear();
    let begun = world.powered.mcu.now();
    let mut host = Host { bytes, at: 0, reads };
    (0..SENDS).for_each(|n| host.sample(world, n));
    let mcu = &world.powered.mcu;
    let (watch, took) = (mcu.watch().clone(), (mcu.now() - begun) as f64);
    let hz = mcu.core_hz() as f64;
    let (fed_s, load) = (watch.longest_unfed as f64 / hz, watch.tasks[&LINK].total as f64 / took);
    let output_s = watch.commands.most as f64 / hz;
    let resets = mcu.resets();
    world.probe().unwrap();
    let (told, _) = records(world);
    let off_s = if resets == 0 { host.disarm(world) } else { f64::NAN };
    println!(
        "{} period {period}, {name}, read {reads}: fed after {:.1} ms, link {:.1} %, register after {:.1} us, \
         {} outputs, {} told, off after {:.1} ms",
        world.powered.board.name,
        1e3 * fed_s,
        100.0 * load,
        1e6 * output_s,
        watch.tasks[&RENDER].runs,
        told.len(),
        1e3 * off_s,
    );
    let what = format!("period {period}, {name}, read {reads}");
    assert_eq!(resets, 0, "{what}: it was reset");
    assert!(fed_s <= FED_S, "{what}: fed after {fed_s} s");
    assert!(load <= LOAD, "{what}: link takes {load}");
    assert_eq!(watch.tasks[&RENDER].runs, SENDS / u64::from(period), "{what}");
    assert!(output_s <= OUTPUT_S, "{what}: an output after {output_s} s");
    assert!(watch.delay_spread() <= 64, "{what}: {:?}", watch.delays);
    assert_eq!((watch.primask, watch.forbidden_basepri), (0, 0), "{what}");
    let same = quiet.iter().zip(&told).take_while(|(quiet, told)| quiet == told).count();
    assert!(same > 20 && same + 20 >= quiet.len().min(told.len()), "{what}: {same} are the same");
    if reads {
        assert!(told.len() as u64 + 20 >= SENDS / u64::from(period), "{what}: {}", told.len());
    }
    assert!(off_s <= BEHIND_S, "{what}: off after {off_s} s");
    assert_eq!(world.powered.mcu.resets(), 0, "{what}: it was reset");
    world.run(1_000).unwrap();
    assert_eq!(ok(world, "get"), settings, "{what}");
    let status = ok(world, "status");
    assert!(
        status.contains("ok status off, fault none") && status.contains(", zeroed"),
        "{status}"
    );
}

fn a_flood_changes_nothing_and_the_watchdog_is_fed(board: Board) {
    let firmware = Firmware::of(board);
    PERIODS.par_iter().for_each(|&period| {
        let mut world = in_contact(&firmware, period);
        let kept = world.snapshot();
        for (name, bytes) in floods() {
            for reads in [true, false] {
                flood(&mut world, &kept, name, &bytes, reads, period);
            }
        }
    });
}

/// Texts of lines that are accepted only with the force off: flash, designs of estimators, the self-test. In the last
/// text, each line gives an order to `render`.
const OFF: [&str; 5] = [
    "load\n",
    "save\n",
    "estimator first-order\nestimator butterworth\ncutoff 90\n",
    "selftest\n",
    "arm\ndisarm\nzero\nperiod 1\nperiod 10\n",
];

fn the_watchdog_is_fed_with_the_force_off_as_well(board: Board) {
    let firmware = Firmware::of(board);
    PERIODS.par_iter().for_each(|&period| {
        let mut world = firmware.boot();
        ok(&mut world, &format!("period {period}"));
        let kept = world.snapshot();
        for lines in OFF {
            world.restore(&kept);
            world.powered.mcu.watch_mut().clear();
            let mut host = Host { bytes: lines.as_bytes(), at: 0, reads: true };
            (0..SENDS).for_each(|n| host.sample(&mut world, n));
            let mcu = &world.powered.mcu;
            let fed_s = mcu.watch().longest_unfed as f64 / mcu.core_hz() as f64;
            println!("{} period {period}, {lines:?}: fed after {:.1} ms", board.name, 1e3 * fed_s);
            assert!(fed_s <= FED_S, "period {period}, {lines:?}: fed after {fed_s} s");
            assert_eq!(mcu.resets(), 0, "period {period}, {lines:?}: it was reset");
        }
    });
}

/// Lines that cause much work for their length, and text that is no command.
const BEHIND: [(&str, &[u8]); 8] = [
    ("get", b"get\n"),
    ("help", b"help\n"),
    ("k 1", b"k 1\n"),
    ("push 1", b"push 1\n"),
    ("load", b"load\n"), // the handle is free: in contact `load` is refused
    ("x", b"x\n"),
    ("no line", b"x"),
    ("zeros", b"\0"),
];

fn disarm_behind_a_full_channel_is_obeyed_in_time(board: Board) {
    let firmware = Firmware::of(board);
    PERIODS.par_iter().for_each(|&period| {
        let mut world = armed(&firmware, period);
        let free = world.snapshot();
        let mut world = in_contact(&firmware, period);
        let pressed = world.snapshot();
        for (name, line) in BEHIND {
            for reads in [true, false] {
                world.restore(if name == "load" { &free } else { &pressed });
                let mut host = Host { bytes: line, at: 0, reads };
                host.sample(&mut world, 1);
                let off_s = host.disarm(&mut world);
                println!(
                    "{} period {period}, {name}, read {reads}: {:.1} ms",
                    board.name,
                    1e3 * off_s
                );
                assert!(off_s <= BEHIND_S, "{name}: {off_s} s");
                if reads {
                    figure(&format!("elf/flood/{}/{period}/{name}", board.name), off_s);
                }
            }
        }
    });
}

/// Number of replies to lines, without the reports of a hit.
fn answers(replies: &str) -> usize {
    replies.lines().filter(|reply| !reply.starts_with("ok hit ")).count()
}

fn many_lines_are_all_answered(board: Board) {
    let firmware = Firmware::of(board);
    PERIODS.par_iter().for_each(|&period| {
        let mut world = in_contact(&firmware, period);
        for (line, count) in [("get", 80), ("k 1e9", 250), ("version", 1_500)] {
            world.powered.mcu.watch_mut().clear();
            world.replies.clear();
            let bytes = format!("{line}\n").repeat(count);
            let mut rest = bytes.as_bytes();
            let mut n = 0;
            while n % 200 != 0 || answers(&world.replies) < count {
                let Powered { mcu, rtt, .. } = &mut world.powered;
                rest = &rest[rtt.write(mcu, 0, rest)..];
                n += 1;
                pass(&mut world, n, true);
                assert!(n < 60_000, "{period} {line}");
            }
            let watch = world.powered.mcu.watch();
            let fed_s = watch.longest_unfed as f64 / world.powered.mcu.core_hz() as f64;
            println!(
                "{} period {period}, {count} times {line}: {n} samples, fed after {fed_s} s",
                board.name
            );
            assert!(fed_s <= FED_S && world.powered.mcu.resets() == 0, "{period} {line}: {fed_s}");
        }
    });
}
