//! What goes wrong outside of the chip, in RTT's block, and two faults at once: with the emergency stop.

use super::{
    rows::{Row, SOON_S},
    situation::PUSH_N,
};
use crate::{
    board::{Board, Force},
    elf::{Elf, SAMPLE_STATE},
    session::{Failed, ask},
    world::World,
};

/// An encoder whose count stays: the check of a push without motion, and an output.
const STUCK_S: f64 = 0.0525;
/// A count that moves too little: the rest of a span of 50 ms, and the next.
const SHORT_OF_S: f64 = 0.1025;
/// A current that differs by a third of full scale, in the mean of 13 ms.
const SENSED_S: f64 = 0.018;
/// All of the motor's force, in the firmware's unit.
const FULL_SCALE: i32 = 1 << 30;
/// Whatever the plant allows.
const EVER_S: f64 = 1.3;

/// All of them. `current_sense`: the amplifier says its current.
pub fn outside(board: Board, current_sense: bool) -> Vec<Row> {
    let mut rows = everywhere();
    let stuck_rows = [("amplifier gives all", 1.0), ("amplifier gives all, away", -1.0)];
    rows.extend(stuck_rows.map(|(name, part)| {
        let limit_s = if current_sense { SENSED_S } else { EVER_S };
        let row = Row::of(name, limit_s, move |_, world| stuck(world, part));
        if current_sense {
            row
        } else {
            row.never_in_contact("the hand leads the handle, whatever the force")
        }
    }));
    if matches!(board.wiring.force, Force::Dac { .. }) {
        rows.push(Row::of("DAC gives 10 % more", SOON_S, |_, world| {
            world.defects.dac = 0.1;
            Ok(world.powered.mcu.now())
        }));
    }
    rows
}

fn everywhere() -> Vec<Row> {
    let held = "a handle that is held looks the same";
    let moves = "a count that moves as a handle can is a handle that moves";
    vec![
        Row::of("count frozen", STUCK_S, |_, world| counts(world, 0, 0.0, 0.0))
            .never_in_contact(held),
        Row::of("count frozen, drifts by 1 in 10 ms", SHORT_OF_S, |_, world| {
            counts(world, 0, 0.0, 0.01)
        })
        .never_in_contact(held),
        Row::of("count follows 1/50 of the motion", SHORT_OF_S, |_, world| {
            counts(world, 0, 0.02, 0.0)
        })
        .never_in_contact(moves),
        Row::of("1 false count a sample", EVER_S, |_, world| counts(world, 0, 1.0, 1.0))
            .never_free(moves)
            .never_in_contact(moves),
        Row::of("10 false counts a sample", EVER_S, |_, world| counts(world, 0, 1.0, 10.0))
            .never_free(moves),
        Row::of("60 false counts a sample", EVER_S, |_, world| counts(world, 0, 1.0, 60.0)),
        Row::of("90 false counts a sample", EVER_S, |_, world| counts(world, 0, 1.0, 90.0)),
        Row::of("jump of 280 counts", SOON_S, |_, world| counts(world, 280, 1.0, 0.0))
            .never_free(moves)
            .never_in_contact(moves),
        Row::of("motor's sign in memory", SOON_S, motor_sign),
        Row::of("push of a hit in memory", SOON_S, push).only_free(),
        Row::of("encoder's origin in memory", SOON_S, origin),
        Row::of("RTT: up 1 larger", SOON_S, |elf, world| channel(elf, world, 8, 1 << 16)),
        Row::of("RTT: up 1 elsewhere", SOON_S, |elf, world| {
            let (render, _) = elf.place_of("local_resource_render")?;
            let block = elf.place_of("_SEGGER_RTT")?.0;
            let mut word = [0; 4];
            world.powered.mcu.read(block + CHANNEL_1 + 4, &mut word);
            channel(elf, world, 4, u32::from_le_bytes(word) ^ render)
        }),
        Row::of("RTT: block zeroed", SOON_S, |elf, world| {
            let (from, size) = elf.place_of("_SEGGER_RTT")?;
            world.powered.mcu.write(from, &vec![0; size as usize]);
            Ok(world.powered.mcu.now())
        }),
        Row::of("break input off, then stop", SOON_S, |_, world| {
            let bdtr = world.powered.mcu.peek(BDTR);
            world.powered.mcu.poke(BDTR, bdtr & !BREAK_ENABLE);
            stop(world)
        }),
        Row::of("enable's pin high, then stop", SOON_S, |_, world| {
            let pin = world.powered.board.wiring.enable;
            let port = GPIO + 0x400 * (pin.port as u32 - 'A' as u32);
            let (mode, set) = (world.powered.mcu.peek(port), 1u32 << pin.number);
            world.powered.mcu.poke(port + 0x18, set);
            world.powered.mcu.poke(port, mode & !(3 << (2 * pin.number)) | 1 << (2 * pin.number));
            stop(world)
        }),
    ]
}

const BDTR: u32 = 0x4001_0044;
const BREAK_ENABLE: u32 = 1 << 12;
const GPIO: u32 = 0x4002_0000;
/// Of RTT's block: up channel 1.
const CHANNEL_1: u32 = 24 + 24;

fn counts(world: &mut World<'_>, offset: i32, ratio: f64, per_sample: f64) -> Result<u64, Failed> {
    world.count_wrongly(offset, ratio, per_sample);
    Ok(world.powered.mcu.now())
}

fn stuck(world: &mut World<'_>, part: f64) -> Result<u64, Failed> {
    world.defects.stuck = Some(part);
    Ok(world.powered.mcu.now())
}

fn stop(world: &mut World<'_>) -> Result<u64, Failed> {
    let begun = world.powered.mcu.now();
    world.emergency_stop(true);
    Ok(begun)
}

/// Bits of a word of up channel 1 flip.
fn channel(elf: &Elf, world: &mut World<'_>, offset: u32, bits: u32) -> Result<u64, Failed> {
    let at = elf.place_of("_SEGGER_RTT")?.0 + CHANNEL_1 + offset;
    let mut word = [0; 4];
    world.powered.mcu.read(at, &mut word);
    world.powered.mcu.write(at, &(u32::from_le_bytes(word) ^ bits).to_le_bytes());
    Ok(world.powered.mcu.now())
}

/// The byte that says how the motor is wired: found by turning it with the force off, and then turned with the force on.
fn motor_sign(elf: &Elf, world: &mut World<'_>) -> Result<u64, Failed> {
    let before = world.snapshot();
    let (from, size) = elf.place_of("local_resource_render")?;
    let mut seen = Vec::new();
    for line in ["disarm", "motor +", "motor -", "motor +", "motor -"] {
        ask(world, line)?;
        world.run(37)?;
        let mut bytes = vec![0; size as usize];
        world.powered.mcu.read(from, &mut bytes);
        seen.push(bytes);
    }
    let turns = |at: &usize| seen[1..].iter().map(|bytes| bytes[*at]).eq([0, 1, 0, 1]);
    let place = (0..size as usize).find(turns);
    let place =
        place.ok_or_else(|| Failed::Refused("nothing in `render` turns with the motor".into()))?;
    world.restore(&before);
    world.powered.mcu.write(from + u32::try_from(place).unwrap_or_default(), &[1]);
    Ok(world.powered.mcu.now())
}

/// A bit of the running hit's push, worth half of full scale. It stands there beside its copy.
fn push(elf: &Elf, world: &mut World<'_>) -> Result<u64, Failed> {
    let (from, size) = elf.place_of("local_resource_render")?;
    let mut bytes = vec![0; size as usize];
    world.powered.mcu.read(from, &mut bytes);
    let words: Vec<_> =
        bytes.chunks_exact(4).map(|w| i32::from_le_bytes([w[0], w[1], w[2], w[3]])).collect();
    let wanted = PUSH_N / world.full_scale_n() * f64::from(FULL_SCALE);
    let is_push = |word: &i32| (f64::from(*word) - wanted).abs() <= 1.0;
    let place = words.windows(2).position(|pair| pair.iter().all(is_push));
    let place = place.ok_or_else(|| Failed::Refused("no push is kept twice in `render`".into()))?;
    let flipped = words[place] ^ (FULL_SCALE / 2);
    let at = from + 4 * u32::try_from(place).unwrap_or_default();
    world.powered.mcu.write(at, &flipped.to_le_bytes());
    Ok(world.powered.mcu.now())
}

/// A bit of the count at position 0, worth 128 counts. Found with the force off: it turns with each `zero`, stays while
/// the handle moves, and is always the difference of two other words, last count and position.
fn origin(elf: &Elf, world: &mut World<'_>) -> Result<u64, Failed> {
    let before = world.snapshot();
    let (from, size) = elf.place_of(SAMPLE_STATE)?;
    let mut seen = Vec::new();
    ask(world, "disarm")?;
    for (offset, zero) in [(40, true), (110, true), (70, true), (15, false)] {
        counts(world, offset, 1.0, 0.0)?;
        world.run(37)?;
        if zero {
            ask(world, "zero")?;
            world.run(37)?;
        }
        let mut bytes = vec![0; size as usize];
        world.powered.mcu.read(from, &mut bytes);
        let words = bytes.chunks_exact(4).map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]]));
        seen.push(words.collect::<Vec<_>>());
    }
    let words = seen[0].len();
    let turns = |a: usize| seen[0][a] != seen[1][a] && seen[1][a] != seen[2][a];
    let stays = |a: usize| seen[2][a] == seen[3][a];
    let moves = |a: usize| seen[2][a] != seen[3][a];
    let differ = |a: usize, count: usize, position: usize| {
        seen.iter().all(|words| words[count].wrapping_sub(words[position]) == words[a])
    };
    let place = (0..words).filter(|&a| turns(a) && stays(a)).find(|&a| {
        let moving = || (0..words).filter(|&b| moves(b));
        moving().any(|count| moving().any(|position| differ(a, count, position)))
    });
    let place =
        place.ok_or_else(|| Failed::Refused("nothing in `sample` follows `zero`".into()))?;
    world.restore(&before);
    let at = from + 4 * u32::try_from(place).unwrap_or_default();
    let mut word = [0; 4];
    world.powered.mcu.read(at, &mut word);
    world.powered.mcu.write(at, &(u32::from_le_bytes(word) ^ 1 << 7).to_le_bytes());
    Ok(world.powered.mcu.now())
}
