//! Faults in which a value in RAM is changed.

use virtual_board::{
    elf::{Elf, SAMPLE_STATE},
    session::{Failed, ask},
    world::World,
};

use super::{
    place::{flip_word, words_of},
    row::{Row, SOON_S},
    situation::Situation,
};

/// The integer that the firmware stores for the full force of the motor.
const FULL_SCALE: u32 = 1 << 30;
/// Parts of symbol names. `QUEUES` finds the queues, `RENDER_STATE` finds the state of `render`.
const QUEUES: &str = "queues";
const RENDER_STATE: &str = "local_resource_render";

pub fn memory_rows() -> Vec<Row> {
    vec![
        Row::at_once("motor's sign in memory", SOON_S, motor_sign),
        Row::at_once("push of a hit in memory", SOON_S, push).only_free(),
        Row::at_once("phase of a hit in memory", SOON_S, phase).only_free(),
        Row::at_once("encoder's origin in memory", SOON_S, origin),
        Row::at_once("supervisor's state in memory", SOON_S, state),
        Row::at_once("an order comes again", SOON_S, order),
    ]
}

/// Converts the index that a search has found to `u32`. If the search has found none, the error has the text `nothing`.
fn found(place: Option<usize>, nothing: &str) -> Result<u32, Failed> {
    let place = place.and_then(|place| u32::try_from(place).ok());
    place.ok_or_else(|| Failed::Refused(nothing.into()))
}

/// Types the lines one by one. After each line, calls a function with the board and collects its results.
fn after_each<T>(
    world: &mut World<'_>,
    lines: &[&str],
    look: impl Fn(&World<'_>) -> T,
) -> Result<Vec<T>, Failed> {
    let look = |line: &&str| {
        ask(world, line)?;
        world.run(37)?;
        Ok(look(world))
    };
    lines.iter().map(look).collect()
}

/// Flips the motor sign in memory. First the sign is changed on the console with the force off, which shows the byte
/// that stores the sign. Then this byte is flipped with the force on.
fn motor_sign(elf: &Elf, world: &mut World<'_>) -> Result<(), Failed> {
    let before = world.snapshot();
    let (from, size) = elf.place_of(RENDER_STATE)?;
    let lines = ["disarm", "motor +", "motor -", "motor +", "motor -"];
    let seen = after_each(world, &lines, |world| bytes_of(world, from, size))?;
    let turns = |at: &usize| seen[1..].iter().map(|bytes| bytes[*at]).eq([0, 1, 0, 1]);
    let place = found((0..size as usize).find(turns), "nothing in `render` turns with the motor")?;
    world.restore(&before);
    world.powered.mcu.write(from + place, &[1]);
    Ok(())
}

fn bytes_of(world: &World<'_>, from: u32, size: u32) -> Vec<u8> {
    let mut bytes = vec![0; size as usize];
    world.powered.mcu.read(from, &mut bytes);
    bytes
}

/// Flips a bit in the push of the running hit. The bit stands for half of the full-scale force.
fn push(elf: &Elf, world: &mut World<'_>) -> Result<(), Failed> {
    let (plan, words) = hit_plan(elf, world)?;
    let full_n = world.full_scale_n();
    let is_push = |&word: &u32| {
        [Situation::Free, Situation::Full].into_iter().any(|situation| {
            let wanted = situation.push_n(full_n) / full_n * f64::from(FULL_SCALE);
            (f64::from(word.cast_signed()) - wanted).abs() <= 1.0
        })
    };
    let place = found(words.iter().position(is_push), "no push is kept twice in `render`")?;
    flip_word(world, plan + 4 * place, 29); // half of FULL_SCALE
    Ok(())
}

/// Flips a bit of the word that stores the phase of a hit, which is return move or push. With the flipped bit the push
/// stops, and the hit never ends. The word is stored just before the hit's plan. Its value is 2 during the push, and 0
/// or 1 before the push.
fn phase(elf: &Elf, world: &mut World<'_>) -> Result<(), Failed> {
    let pushes = words_of(elf, world, RENDER_STATE)?.1;
    let before = world.snapshot();
    ask(world, "stop")?;
    world.run(2_000)?;
    ask(world, "hit")?;
    world.run(50)?;
    let (from, comes) = words_of(elf, world, RENDER_STATE)?;
    world.restore(&before);
    let place = comes.iter().zip(&pushes).position(|pair| matches!(pair, (0 | 1, 2)));
    let place = found(place, "no word says that a hit pushes")?;
    flip_word(world, from + 4 * place, 7);
    Ok(())
}

/// Finds the plan of the running hit. Returns the plan's offset in the memory of `render`, and the words of the plan.
/// The memory has two copies of the plan, one directly after the other.
fn hit_plan(elf: &Elf, world: &World<'_>) -> Result<(u32, [u32; 4]), Failed> {
    let (from, words) = words_of(elf, world, RENDER_STATE)?;
    let twice = |pair: &[u32]| {
        pair[..4] == pair[4..] && pair[..4].iter().all(|&word| word.cast_signed() > 1)
    };
    let place = words.windows(8).position(twice);
    let offset = found(place, "no plan is kept twice in `render`")?;
    Ok((from + 4 * offset, [0, 1, 2, 3].map(|n| words[offset as usize + n])))
}

/// Flips a bit of the word that stores the encoder's count at position 0. The bit stands for 128 counts. The search for
/// the word compares values with the force off. The word changes with each `zero`, but not while the handle moves. It
/// is always the difference of two other words: the last count, and the position.
fn origin(elf: &Elf, world: &mut World<'_>) -> Result<(), Failed> {
    let before = world.snapshot();
    let (from, _) = elf.place_of(SAMPLE_STATE)?;
    let mut seen = Vec::new();
    ask(world, "disarm")?;
    for (offset, zero) in [(40, true), (110, true), (70, true), (15, false)] {
        world.count_wrongly(offset, 1.0, 0.0);
        world.run(37)?;
        if zero {
            ask(world, "zero")?;
            world.run(37)?;
        }
        seen.push(words_of(elf, world, SAMPLE_STATE)?.1);
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
    let place = found(place, "nothing in `sample` follows `zero`")?;
    world.restore(&before);
    flip_word(world, from + 4 * place, 7);
    Ok(())
}

/// Flips a bit of the supervisor's state, which is stored in two equal bytes. Their values are 0 for off, 1 for the
/// sign test and 3 for armed. The flip changes one of the two bytes from 3 to 1.
fn state(elf: &Elf, world: &mut World<'_>) -> Result<(), Failed> {
    let before = world.snapshot();
    let (from, size) = elf.place_of(RENDER_STATE)?;
    let look = |world: &World<'_>| bytes_of(world, from, size);
    let mut seen = vec![look(world)];
    seen.extend(after_each(world, &["disarm", "wall 0.1", "arm"], look)?);
    world.restore(&before);
    let is_state = |&at: &usize| {
        [3, 0, 0, 1].iter().zip(&seen).all(|(state, bytes)| bytes[at..at + 2] == [*state, *state])
    };
    let place = (1..size as usize).map(|after| after - 1).find(is_state);
    let place = found(place, "no state is kept twice in `render`")?;
    world.powered.mcu.write(from + place, &[1]);
    Ok(())
}

/// Flips the index of the queue of orders. The index then points to the other entry of the queue, which is an old
/// order. The search for the index compares values with the force off, because the index changes with each order and at
/// no other time.
fn order(elf: &Elf, world: &mut World<'_>) -> Result<(), Failed> {
    let before = world.snapshot();
    ask(world, "disarm")?;
    world.run(200)?; // an experiment reports its end
    let (from, words) = words_of(elf, world, QUEUES)?;
    let mut seen = vec![words];
    for line in ["k 9000", "k 10000", "k 9000", "k 10000", "k 9000"] {
        ask(world, line)?;
        world.run(37)?;
        seen.push(words_of(elf, world, QUEUES)?.1);
    }
    let turns = |a: &usize| {
        let small = seen.iter().all(|words| words[*a] < 2);
        small && seen.windows(2).all(|pair| pair[0][*a] != pair[1][*a])
    };
    let place = (0..seen[0].len()).find(turns);
    world.restore(&before);
    flip_word(world, from + 4 * found(place, "no index turns with each order")?, 0);
    Ok(())
}
