//! Faults that stop the processor, its interrupts or the sampling, and halts of the core by a debugger. Only hardware
//! can then switch the force off.

use virtual_board::{
    elf::{Elf, SAMPLE_STATE},
    mcu::{AfterHalt, LINK, SAMPLE},
    session::Failed,
    world::{Ended, World},
};

use super::{
    fault_case::{
        AT_ONCE_US, BROWN_OUT_US, Begin, Cause, FaultCase, LOOP, OUTPUT_WATCHDOG_US, RENDER_US,
        SAMPLE_US, UNUSED, WATCHDOG_US, lose_the_way,
    },
    place::{WATCHDOG_RELOAD, flip_register, flip_word, words_of},
};

/// Base address of TIM5's registers.
const TIM5: u32 = 0x4000_0C00;
const CR1: u32 = 0x00;
const DIER: u32 = 0x0C;
const ARR: u32 = 0x2C;
/// The register that holds the address of the vector table.
const VTOR: u32 = 0xE000_ED08;
/// An address in erased flash. If the vector table is moved there, all bits of all vectors are ones.
const ERASED: u32 = 0x0807_0000;
/// Exception numbers of PendSV and of TIM7's interrupt. The firmware has no task for either of them.
const PEND_SV: u16 = 14;
const TIM7: u16 = 16 + 55;

/// The bit in DBGMCU that stops the watchdog while a debugger halts the core.
const WATCHDOG_STOPS: u32 = 1 << 12;

pub(super) const NO_PROCESSOR: [FaultCase; 18] = [
    FaultCase::of("watchdog: link does not run", 22, WATCHDOG_US, |_, world| {
        world.powered.mcu.write(UNUSED, &LOOP);
        lose_the_way(world, LINK, UNUSED)
    })
    .resets(),
    FaultCase::of(
        "watchdog: its time is another, then link does not run",
        22,
        WATCHDOG_US,
        |_, world| {
            flip_register(world, WATCHDOG_RELOAD, 10); // one second longer
            world.run(20)?;
            world.powered.mcu.write(UNUSED, &LOOP);
            lose_the_way(world, LINK, UNUSED)
        },
    )
    .resets()
    .long(),
    FaultCase::of("debugger halt, 1.5 ms", 32, 1_500.0 + RENDER_US, |_, world| {
        halt(world, 15, AfterHalt::Kept)
    })
    .halted(1_500.0),
    FaultCase::of("debugger halt, 30 ms", 32, AT_ONCE_US, |_, world| {
        halt(world, 300, AfterHalt::Kept)
    })
    .halted(30_000.0),
    FaultCase::of("debugger halt, 30 ms, MOE reset", 32, AT_ONCE_US, |_, world| {
        halt(world, 300, AfterHalt::Reset)
    })
    .halted(30_000.0),
    FaultCase::of("debugger halt, 200 ms", 22, AT_ONCE_US, |_, world| {
        // A debugger's script sets the watchdog's bit when it connects. The program soon restores its own setting.
        world.powered.mcu.stop_in_halts(WATCHDOG_STOPS);
        world.run(20)?;
        halt(world, 2_000, AfterHalt::Kept)
    })
    .halted(200_000.0)
    .resets()
    .long(),
    FaultCase::of("debugger halt, 200 ms, watchdog stopped", 32, AT_ONCE_US, |_, world| {
        world.powered.mcu.stop_in_halts(WATCHDOG_STOPS);
        halt(world, 2_000, AfterHalt::Kept)
    })
    .halted(200_000.0)
    .long(),
    stopped("TIM5 disabled in the NVIC", |_, world| {
        world.powered.mcu.mask(SAMPLE, true);
        Ok(())
    }),
    stopped("TIM5 stands still", |_, world| poke(world, TIM5 + CR1, 0)),
    stopped("TIM5 asks for no interrupt", |_, world| poke(world, TIM5 + DIER, 0)).long(),
    stopped("TIM5 asks all the time", |_, world| poke(world, TIM5 + ARR, 10)).long(),
    stopped("interrupts masked", |_, world| {
        world.powered.mcu.run_into(0).map_err(Ended::from)?;
        world.powered.mcu.set_registers(|registers| registers.primask = true);
        Ok(())
    }),
    stopped("lock-up", |_, world| {
        world.powered.mcu.outlive_lock_up();
        world.powered.mcu.set_registers(|registers| registers.msp = 0x10);
        Ok(())
    }),
    // The fault occurs when the next exception stacks the registers.
    at_once("stack overrun", 42, SAMPLE_US, |elf, world| {
        world.powered.mcu.outlive_lock_up();
        let end = elf.place_of("__sheap")?.0.next_multiple_of(256);
        world.powered.mcu.set_registers(|registers| registers.msp = end + 0x80);
        Ok(())
    })
    .all(&[23, 42])
    .long(),
    stopped("vector table lost", |_, world| {
        world.powered.mcu.outlive_lock_up();
        poke(world, VTOR, ERASED)
    })
    .long(),
    stopped("no sample is due", |elf, world| {
        let address = next_due(elf, world)?;
        flip_word(world, address, 30);
        Ok(())
    })
    .long(),
    unexpected("PendSV", |_, world| pend(world, PEND_SV)).long(),
    unexpected("an unused interrupt", |_, world| pend(world, TIM7)).long(),
];

/// A debugger halts the core for `samples` samples.
fn halt(world: &mut World<'_>, samples: u64, moe: AfterHalt) -> Result<u64, Failed> {
    let begun = world.powered.mcu.now();
    let last = world.powered.mcu.last_event().unwrap_or_default();
    let per_sample = world.powered.board.cycles_per_sample();
    let halted = samples * per_sample + per_sample / 3;
    world.halt(halted, moe);
    world.sample()?;
    // If the watchdog does not reset the board, sampling must continue at the same phase.
    if let Some(next) = world.powered.mcu.last_event() {
        let gap = next - last - halted;
        if gap > 2 * per_sample || !gap.is_multiple_of(per_sample) {
            return Err(Failed::Refused(format!("a sample {gap} cycles after the halt")));
        }
    }
    Ok(begun)
}

/// A case in which `cause` causes the fault at once. The fault ends in a reset of the board.
const fn at_once(name: &'static str, code: u32, limit_us: f64, cause: Cause) -> FaultCase {
    let begin: Begin = |_, world| Ok(world.powered.mcu.now());
    FaultCase { cause: Some(cause), ..FaultCase::of(name, code, limit_us, begin).resets() }
}

/// A case in which no task runs any more that could switch the force off. At the end the watchdog resets the board.
const fn stopped(name: &'static str, cause: Cause) -> FaultCase {
    at_once(name, 22, OUTPUT_WATCHDOG_US, cause)
}

/// A case in which `DefaultHandler` switches the force off as soon as no task runs.
const fn unexpected(name: &'static str, cause: Cause) -> FaultCase {
    at_once(name, 45, BROWN_OUT_US, cause).all(&[23, 45])
}

fn poke(world: &mut World<'_>, address: u32, value: u32) -> Result<(), Failed> {
    world.powered.mcu.poke(address, value);
    Ok(())
}

fn pend(world: &mut World<'_>, exception: u16) -> Result<(), Failed> {
    world.powered.mcu.run_into(0).map_err(Ended::from)?;
    world.powered.mcu.pend(exception);
    Ok(())
}

/// Finds the word in which `sample` stores the number of the next sample that has an output. Several words grow by 10
/// every 10 samples. The word with the largest value is the one.
fn next_due(elf: &Elf, world: &mut World<'_>) -> Result<u32, Failed> {
    let (from, size) = elf.place_of(SAMPLE_STATE)?;
    let mut seen = Vec::new();
    for _ in 0..21 {
        world.sample()?;
        seen.push(words_of(elf, world, SAMPLE_STATE)?.1);
    }
    let steps = |place: &usize| {
        let of = |n: usize| seen[n][*place];
        seen.windows(2).filter(|pair| pair[0][*place] != pair[1][*place]).count() == 2
            && of(10) == of(0).wrapping_add(10)
            && of(20) == of(10).wrapping_add(10)
    };
    let words = (0..seen[0].len()).filter(steps);
    let ahead = words.max_by_key(|place| seen[20][*place]);
    let addresses = (from..from + size).step_by(4);
    ahead
        .and_then(|place| addresses.into_iter().nth(place))
        .ok_or_else(|| Failed::Refused("no word of `sample` is ahead by an output".into()))
}
