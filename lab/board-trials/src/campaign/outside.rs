//! Faults outside the chip, at its host and in RTT's control block. This file also has pairs of faults, in which the
//! emergency stop comes together with another fault.

use virtual_board::{
    board::{Board, Force, Powered},
    elf::Elf,
    world::{Ended, World},
};

use super::{
    fault_case::stop,
    memory::memory_rows,
    place::flip_word,
    row::{Row, SOON_S},
};

/// Time limit for an encoder whose count does not change, in s. It is the time after which a push without motion is a
/// fault, plus one output.
const STUCK_S: f64 = 0.0525;
/// Time limit for a count that moves less than the handle, in s. The check compares in spans of 50 ms, so the limit is
/// the rest of the present span plus the next span.
const SHORT_OF_S: f64 = 0.1025;
/// Time limit for a measured current that is wrong by a third of full scale, in s. The limit includes the 13 ms over
/// which the board takes the mean of the current.
const SENSED_S: f64 = 0.018;
/// Number of samples for which the host reads nothing and sends without a pause.
const FLOOD_SAMPLES: u64 = 4_000;
const FLOOD_S: f64 = FLOOD_SAMPLES as f64 * 1e-4;
/// Time limit for a fault that is found only by the motion of the plant, in s.
const EVER_S: f64 = 1.3;

/// All faults of this file, as rows of the campaign. `current_sense` tells whether the board measures the amplifier's
/// current.
pub fn outside(board: Board, current_sense: bool) -> Vec<Row> {
    let mut rows = memory_rows();
    rows.extend(everywhere());
    let stuck_rows = [("amplifier gives all", 1.0), ("amplifier gives all, away", -1.0)];
    rows.extend(stuck_rows.map(|(name, part)| {
        let stuck = move |_: &Elf, world: &mut World<'_>| {
            world.defects.stuck = Some(part);
            Ok(())
        };
        if current_sense {
            Row::at_once(name, SENSED_S, stuck)
        } else {
            Row::at_once(name, EVER_S, stuck)
                .never_in_contact("the hand leads the handle, whatever the force")
        }
    }));
    if matches!(board.wiring.force, Force::Dac { .. }) {
        let more = Row::at_once("DAC gives 10 % more", SOON_S, |_, world| {
            world.defects.dac = 0.1;
            Ok(())
        });
        rows.push(more.not_full());
    }
    rows
}

/// A row with a wrong encoder count. The tuple has the count's offset, the fraction of the motion that the count
/// follows, and the count's drift per sample.
fn counts(name: &str, limit_s: f64, (offset, ratio, per_sample): (i32, f64, f64)) -> Row {
    Row::at_once(name, limit_s, move |_, world| {
        world.count_wrongly(offset, ratio, per_sample);
        Ok(())
    })
}

fn everywhere() -> Vec<Row> {
    let held = "a handle that is held looks the same";
    let moves = "a count that moves as a handle can is a handle that moves";
    vec![
        counts("count frozen", STUCK_S, (0, 0.0, 0.0)).never_in_contact(held),
        counts("count frozen, drifts by 1 in 10 ms", SHORT_OF_S, (0, 0.0, 0.01))
            .never_in_contact(held),
        counts("count follows 1/50 of the motion", SHORT_OF_S, (0, 0.02, 0.0))
            .never_in_contact(moves),
        counts("1 false count a sample", EVER_S, (0, 1.0, 1.0))
            .never_free(moves)
            .never_in_contact(moves),
        counts("10 false counts a sample", EVER_S, (0, 1.0, 10.0)).never_free(moves),
        counts("60 false counts a sample", EVER_S, (0, 1.0, 60.0)),
        counts("90 false counts a sample", EVER_S, (0, 1.0, 90.0)),
        counts("jump of 280 counts", SOON_S, (280, 1.0, 0.0))
            .never_free(moves)
            .never_in_contact(moves),
        Row::of("RTT stall and flood, blocking", FLOOD_S, |_, world| {
            let begun = world.powered.mcu.now();
            flood(world, FLOOD_SAMPLES)?;
            Ok(begun)
        }),
        Row::at_once("a core that sleeps deep", SOON_S, |_, world| {
            let control = world.powered.mcu.peek(SCR);
            world.powered.mcu.poke(SCR, control | SLEEP_DEEP);
            Ok(())
        }),
        Row::at_once("RTT: up 1 larger", SOON_S, |elf, world| {
            flip_word(world, elf.place_of("_SEGGER_RTT")?.0 + CHANNEL_1 + 8, 16);
            Ok(())
        }),
        Row::at_once("RTT: up 1 elsewhere", SOON_S, |elf, world| {
            let (render, _) = elf.place_of("local_resource_render")?;
            let buffer = elf.place_of("_SEGGER_RTT")?.0 + CHANNEL_1 + 4;
            world.powered.mcu.write(buffer, &render.to_le_bytes());
            Ok(())
        }),
        Row::at_once("RTT: block zeroed", SOON_S, |elf, world| {
            let (from, size) = elf.place_of("_SEGGER_RTT")?;
            world.powered.mcu.write(from, &vec![0; size as usize]);
            Ok(())
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

const SCR: u32 = 0xE000_ED10;
const SLEEP_DEEP: u32 = 1 << 2;
const BDTR: u32 = 0x4001_0044;
const BREAK_ENABLE: u32 = 1 << 12;
const GPIO: u32 = 0x4002_0000;
/// Offset of up channel 1 in RTT's control block.
const CHANNEL_1: u32 = 24 + 24;

/// Simulates a host that reads nothing and sends without a pause. Every channel is set to blocking.
///
/// # Errors
/// The program ended.
pub fn flood(world: &mut World<'_>, samples: u64) -> Result<(), Ended> {
    for channel in 0..3 {
        let Powered { mcu, rtt, .. } = &mut world.powered;
        rtt.set_mode(mcu, channel, 2);
    }
    for n in 0..samples {
        let Powered { mcu, rtt, .. } = &mut world.powered;
        rtt.write(mcu, 0, if n % 2 == 0 { b"help\nget\n" } else { b"\xff\x00k 1e\n~~" });
        world.sample()?;
    }
    Ok(())
}
