//! Reads the lines that a user types at `cargo board run`. A line is for the board or for the simulated hand.

use std::{
    io::{BufRead as _, Read as _},
    sync::mpsc::{Receiver, sync_channel},
    thread,
};

use host_sim::{error::Error, interrupt, output::terminal::print_text, scene::Units};

use virtual_board::world::World;

use crate::SLICE;

const WAIT_MAX_S: f64 = 3600.0;

/// Longest line that is accepted, in bytes. It is longer than the firmware's own limit.
const LINE_MAX: u64 = 1000;

/// Passes a typed line to the board or to the hand. Returns how many samples to wait.
pub(super) fn typed(world: &mut World<'_>, units: Units, line: &str) -> Result<u64, Error> {
    let mut words = line.split_whitespace();
    let number = |text: Option<&str>| text.and_then(|text| text.parse::<f64>().ok());
    match words.next() {
        Some("hand") => match words.next() {
            Some("off") => world.hold(world.position_m(), false),
            place => {
                let place_m = number(place).map(|place| units.from_reply("place_m", place));
                match place_m.filter(|place_m| place_m.abs() <= 1.0) {
                    Some(place_m) => move_by_hand(world, place_m)?,
                    None => {
                        let end = units.key("place_m").map_or(1.0, |(_, factor)| factor);
                        let [low, high] = zwidth::ends(&(-end..=end));
                        let place = place_name(units);
                        print_text(&format!("error: hand {place}, {low} to {high}, or hand off"))?;
                    }
                }
            }
        },
        Some("wait") => match number(words.next()).filter(|s| (0.0..=WAIT_MAX_S).contains(s)) {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "0 to 36 million"
            )]
            Some(seconds) => return Ok((seconds * 10_000.0) as u64),
            None => print_text(&format!("error: wait SECONDS, 0 to {WAIT_MAX_S}"))?,
        },
        _ => {
            let line = if line.is_empty() { "status" } else { line };
            world.send(&format!("{line}\n"))?;
        }
    }
    Ok(SLICE)
}

/// Word for a position of the hand in the help and in errors.
pub(super) fn place_name(units: Units) -> &'static str {
    if units.is_rotary() { "RADIANS" } else { "METRES" }
}

/// Speed of the hand, in m per sample. It is 0.1 m/s.
const HAND_M: f64 = 1e-5;

/// Moves the handle to `place_m` and holds it there.
fn move_by_hand(world: &mut World<'_>, place_m: f64) -> Result<(), Error> {
    let mut at_m = world.position_m();
    world.hold(at_m, true);
    while at_m != place_m {
        at_m += (place_m - at_m).clamp(-HAND_M, HAND_M);
        world.hold(at_m, true);
        world.run(1)?;
        interrupt::check()?;
    }
    Ok(())
}

/// Lines from the keyboard, up to the end of the input. If the board reads slower than the user types, the user has to
/// wait.
pub(super) fn stdin() -> Receiver<Result<String, Error>> {
    let (send, receive) = sync_channel(16);
    thread::spawn(move || {
        let mut input = std::io::stdin().lock();
        for number in 1.. {
            let mut line = vec![];
            let read = input.by_ref().take(LINE_MAX + 1).read_until(b'\n', &mut line);
            let what = match (read, line.len() as u64) {
                (Ok(0), _) => return,
                (Ok(_), length) if length > LINE_MAX => format!("longer than {LINE_MAX} bytes"),
                (Ok(_), _) => match String::from_utf8(line) {
                    Err(_) => "not UTF-8 text".into(),
                    Ok(line) => match send.send(Ok(line)) {
                        Ok(()) => continue,
                        Err(_) => return,
                    },
                },
                (Err(error), _) => format!("cannot be read: {error}"),
            };
            let _ = send.send(Err(Error::Input(format!("line {number} of the input is {what}"))));
            return;
        }
    });
    receive
}
