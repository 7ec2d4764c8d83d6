//! Every command in any order, mixed with random text, while the loop runs. Each line gets one reply. Only a command
//! with the reply `ok` changes settings. No output is missed, and the program does not end.

use std::collections::BTreeSet;

use virtual_board::{board::NUCLEO_F446RE, world::World};
use zwidth::{
    console::{is_answer, usages},
    telemetry::{Decoder, Flags},
};

use crate::firmware::Firmware;

/// Number of lines. The test runs on one board, because this code is the same on both.
const LINES: usize = 120;

/// Random numbers by SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((bits ^ (bits >> 31)) % end as u64) as usize
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }
}

/// Step from one usage to the next. It is a prime number, so that all usages are reached.
const STEP: usize = 17;
const NUMBERS: [&str; 22] = [
    "0", "1", "-1", "2", "0.1", "0.5", "0.001", "0.005", "0.02", "-0.01", "5", "5.9", "30", "300",
    "1500", "5000", "20000", "1e9", "-1e9", "1e400", "nan", "2000x",
];
const NAMES: [&str; 6] =
    ["butterworth", "butterworth-prewarped", "first-order", "difference", "kalman-3", "nonsense"];

/// Makes a command from its usage. Its values may be allowed or not.
fn command(random: &mut Random, usage: &str) -> String {
    let Some((name, what)) = usage.split_once(' ') else { return usage.to_owned() };
    let word = match what {
        "NAME" => random.of(&NAMES),
        "envelope" => what,
        choice if choice.contains('|') => random.of(&choice.split('|').collect::<Vec<_>>()),
        _ => random.of(&NUMBERS),
    };
    match random.below(20) {
        0 => name.to_owned(),
        1 => format!("{name} {word} {word}"),
        2 => format!("  {} {word}\t", name.to_uppercase()),
        _ => format!("{name} {word}"),
    }
}

/// Random text that is no command, sometimes longer than the longest line.
fn garbage(random: &mut Random) -> String {
    const PIECES: [&str; 11] =
        ["#", "k", " ", "\t", "\0", "\u{1b}[A", "é", "µ", "9e", "--", "hit;"];
    let length = 1 + random.below(60);
    format!("#{}", (0..length).map(|_| random.of(&PIECES)).collect::<String>())
}

fn is_report(line: &str) -> bool {
    const STARTS: [&str; 6] =
        ["ok ", "error: ", "walk ", "hit push ", "calibrate holds ", "selftest "];
    !is_answer(line) && STARTS.iter().any(|start| line.starts_with(start))
}

/// The only reply to a line.
fn reply(world: &mut World<'_>, line: &str) -> String {
    world.replies.clear();
    world.send(&format!("{line}\n")).unwrap();
    let mut found = Vec::new();
    for after in 0..100 {
        world.run(20).unwrap();
        let replies = std::mem::take(&mut world.replies);
        let (whole, rest) = replies.rsplit_once('\n').unwrap_or(("", &replies));
        found.extend(whole.lines().filter(|l| !is_report(l)).map(str::to_owned));
        world.replies = rest.to_owned();
        if !found.is_empty() && after > 0 {
            break;
        }
    }
    assert_eq!(found.len(), 1, "{line:?}: {found:?}");
    let only = found.remove(0);
    assert!(only.starts_with("ok") || only.starts_with("error"), "{line:?}: {only}");
    only
}

#[test]
fn every_command_works_in_any_order_with_garbage_between() {
    let firmware = Firmware::of(NUCLEO_F446RE);
    let mut world = firmware.armed();
    let mut random = Random(1);
    // Only other images have commands for the third to the last parameter of an estimator.
    let has =
        |usage: &&str| !usage.starts_with("tuning") || usage.split(' ').next() < Some("tuning3");
    let all: Vec<_> = usages().filter(has).collect();
    assert_ne!(all.len() % STEP, 0, "it would come back to the same few");
    let mut names = BTreeSet::new();
    let (mut obeyed, mut refused, mut changed) = (0, 0, 0);
    let mut settings = reply(&mut world, "get");
    for n in 0..LINES {
        let line = match random.below(12) {
            0 => garbage(&mut random),
            // Goes through all usages, so that each usage is tested.
            _ => command(&mut random, all[n * STEP % all.len()]),
        };
        let answer = reply(&mut world, &line);
        let is_ok = answer.starts_with("ok");
        if is_ok {
            obeyed += 1;
            names.insert(line.split_whitespace().next().unwrap().to_lowercase());
        } else {
            refused += 1;
        }
        let now = reply(&mut world, "get");
        assert!(is_ok || now == settings, "{line:?}, {answer}: {settings} became {now}");
        changed += u32::from(now != settings);
        settings = now;
        if n % 50 == 49 {
            // Switches the force on again, from any state after the commands.
            for line in
                ["stop", "disarm", "clear", "motor +", "encoder +", "fullscale 5.906", "stream on"]
            {
                reply(&mut world, line);
            }
            world.hold(world.position_m(), true); // at rest, so that the board accepts `zero`
            world.run(500).unwrap();
            world.hold(world.position_m(), false);
            for line in ["zero", "unlock envelope", "k 2000", "b 10", "wall 0.005", "arm"] {
                reply(&mut world, line);
            }
            world.run(4_000).unwrap();
            settings = reply(&mut world, "get");
        }
    }
    let mcu = &world.powered.mcu;
    assert!(mcu.hard_faults().is_empty() && mcu.resets() == 0);
    let mut decoder = Decoder::new();
    let telemetry = std::mem::take(&mut world.telemetry);
    let records = telemetry.into_iter().filter_map(|byte| decoder.push(byte));
    let records: Vec<_> = records.map(|frame| frame.record).collect();
    let armed = records.iter().filter(|record| record.flags.contains(Flags::ARMED)).count();
    let late = records.iter().filter(|record| matches!(record.fault, 20..30)).count();
    println!(
        "{obeyed} obeyed of {} commands, {refused} refused, {changed} changes, {armed} of {} outputs armed",
        names.len(),
        records.len()
    );
    assert_eq!(late, 0, "an output was missed");
    assert!(obeyed > 48 && refused > 30 && changed > 12 && armed > 300);
    assert!(names.len() > 25, "{names:?}");
}
