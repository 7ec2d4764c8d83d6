//! Named faults, and how each is caused while the program in flash stays the same.

use virtual_board::{
    elf::{Elf, SAMPLE_STATE},
    mcu::{LINK, RENDER, SAMPLE},
    session::{Failed, ask},
    world::{Ended, World},
};

use super::place::{flip_word, word_at};

/// State of board and handle when the fault begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Before {
    /// Armed. The handle is held 0.3 mm inside the wall, with 40 % of the full force.
    Pressed,
    /// Armed. A push with 48 % of the full force moves the handle to the wall.
    Moving,
    /// Off. The fault begins before `arm`. The time of the fault is counted from the cycle at which enable becomes
    /// active.
    Off,
}

impl Before {
    pub const ALL: [Self; 3] = [Self::Pressed, Self::Moving, Self::Off];
}

/// Causes the fault. Returns the cycle at which it began.
pub type Begin = fn(&Elf, &mut World<'_>) -> Result<u64, Failed>;
/// Causes the fault at once, between two outputs.
pub type Cause = fn(&Elf, &mut World<'_>) -> Result<(), Failed>;
pub type End = fn(&mut World<'_>) -> Result<(), Failed>;

pub struct FaultCase {
    /// Name in reports, unique among the cases.
    pub name: &'static str,
    pub code: u32,
    /// All codes that `faults` must list. The list is empty if `faults` must list only `code`.
    pub all: &'static [u32],
    /// Longest allowed time from the fault until enable is inactive, in us. The output code is then zero too. If
    /// hardware alone has switched enable off, the code is zero within one more output.
    pub limit_us: f64,
    /// Time for which the program is halted, in us. A halted program cannot write an output code.
    pub halted_us: f64,
    pub before: Before,
    pub begin: Begin,
    /// If present, this function is called in place of `begin`. It causes the fault at once, between two outputs.
    pub cause: Option<Cause>,
    pub end: End,
    /// Whether the cause remains. The board then refuses `clear` until the cause has ended.
    pub stays: bool,
    /// Whether the fault ends in a reset, which clears RAM.
    pub resets: bool,
    pub short: bool,
}

impl FaultCase {
    /// A case with the default values. The handle is pressed into the wall, and only the fault `code` is expected.
    pub(super) const fn of(name: &'static str, code: u32, limit_us: f64, begin: Begin) -> Self {
        Self {
            name,
            code,
            all: &[],
            limit_us,
            halted_us: 0.0,
            before: Before::Pressed,
            begin,
            cause: None,
            end: |_| Ok(()),
            stays: false,
            resets: false,
            short: true,
        }
    }

    pub(super) const fn all(self, all: &'static [u32]) -> Self {
        Self { all, ..self }
    }

    const fn before(self, before: Before) -> Self {
        Self { before, ..self }
    }

    const fn until(self, end: End) -> Self {
        Self { end, ..self }
    }

    const fn stays(self) -> Self {
        Self { stays: true, ..self }
    }

    pub(super) const fn halted(self, halted_us: f64) -> Self {
        Self { halted_us, ..self }
    }

    pub(super) const fn resets(self) -> Self {
        Self { resets: true, ..self }
    }

    /// Takes the case out of the short campaign.
    pub(super) const fn long(self) -> Self {
        Self { short: false, ..self }
    }
}

/// Length of a sample, in us. The simulation runs in whole samples, so an observation may be one sample old.
const GRID_US: f64 = 100.0;
/// Time limit for a fault that the sampling task finds, in us.
pub const SAMPLE_US: f64 = 100.0 + GRID_US;
/// Time limit for a fault that an output finds, in us: one output period and one sample.
pub const RENDER_US: f64 = 1_100.0 + GRID_US;
/// Time limit for a fault that hardware handles without an instruction, in us.
pub const AT_ONCE_US: f64 = 1.0;
/// Time limit from a jump of the program counter to the first store of the fault handler, in us.
const HANDLER_US: f64 = 2.0;
/// Time limit for the interrupt of the supply detector, in us. The interrupt waits while `render` runs, and while the
/// logger masks interrupts.
pub const BROWN_OUT_US: f64 = 60.0;
/// Time limit for the watchdog, in us. It is the timeout at the nominal clock, plus the output period in which the
/// watchdog was last fed.
pub const WATCHDOG_US: f64 = 51_000.0;

/// Time limit for a fault that stops the processor, in us: the timeout of the output watchdog (contract.rs), plus one
/// sample.
pub const OUTPUT_WATCHDOG_US: f64 = zwidth::period::OUTPUT_WATCHDOG_US as f64 + GRID_US;

pub(super) const FAULT_CASES: [FaultCase; 29] = [
    FaultCase::of("count jump", 10, SAMPLE_US, |_, world| {
        // Run to a sample between two outputs.
        while world.powered.mcu.events() % 10 != 4 {
            world.sample()?;
        }
        let begun = world.powered.mcu.now();
        world.hold(world.position_m() + 700e-6, true);
        Ok(begun)
    }),
    // The limit includes the estimator's delay.
    FaultCase::of("over-speed", 11, RENDER_US, |_, world| {
        let begun = world.powered.mcu.now();
        let start_m = world.position_m();
        for n in 1..=20 {
            world.hold(start_m + 250e-6 * f64::from(n), true);
            world.sample()?;
            if !world.powered.amplifier.is_enabled() {
                break;
            }
        }
        Ok(begun)
    }),
    FaultCase::of("out of range", 12, RENDER_US, |elf, world| {
        for place in position_words(elf, world)? {
            flip_word(world, place, 30);
        }
        Ok(world.powered.mcu.now())
    })
    .all(&[12, 15, 44])
    .until(|world| ask(world, "zero").map(drop))
    .stays(),
    dead_channel("dead channel A, in free motion", kill::<0>, revive::<0>),
    dead_channel("dead channel B, in free motion", kill::<1>, revive::<1>),
    at_arm(
        "swapped channels at arm",
        |_, world| {
            world.swap_channels(true);
            enabled_by_arm(world)
        },
        |world| {
            world.swap_channels(false);
            Ok(())
        },
    ),
    at_arm(
        "wrong motor sign at arm",
        |_, world| {
            world.motor_reversed = true;
            enabled_by_arm(world)
        },
        |world| {
            world.motor_reversed = false;
            Ok(())
        },
    ),
    FaultCase::of("beyond travel", 15, RENDER_US, |_, world| {
        let zero_m = world.position_m() - 1e-6 * f64::from(counts(world)?);
        world.lead_to(zero_m - 0.039_99)?;
        let begun = world.powered.mcu.now();
        world.lead_to(zero_m - 0.040_02)?;
        Ok(begun)
    })
    .until(|world| Ok(world.lead_to(world.position_m() + 0.1)?)),
    FaultCase::of("late render", 20, RENDER_US, |_, world| mask_render(world, 15)),
    FaultCase::of("stuck render, 15 periods", 20, RENDER_US, |_, world| mask_render(world, 150))
        .all(&[20, 21]),
    // `render` must stay masked. Otherwise it would write code 20 into the fault memory.
    FaultCase::of("stuck render, for ever", 22, RENDER_US, |_, world| mask_render(world, 700))
        .resets()
        .long(),
    FaultCase::of("reset while armed", 23, AT_ONCE_US, |_, world| {
        let begun = world.powered.mcu.now();
        world.reset();
        Ok(begun)
    })
    .resets(),
    FaultCase::of("emergency stop, 0.2 ms", 30, AT_ONCE_US, |_, world| {
        let begun = stop(world)?;
        world.run(2)?;
        world.emergency_stop(false);
        Ok(begun)
    }),
    FaultCase::of("emergency stop", 30, AT_ONCE_US, |_, world| stop(world))
        .until(|world| {
            world.emergency_stop(false);
            Ok(())
        })
        .stays(),
    brown_out("brown-out, 0.2 ms", |_, world| {
        let begun = sag(world)?;
        world.run(2)?;
        recover(world)?;
        Ok(begun)
    }),
    brown_out("brown-out while the logger masks", |_, world| {
        world.send("help\n")?;
        world.powered.mcu.run_into_mask().map_err(Ended::from)?;
        sag(world)
    })
    .stays(),
    brown_out("brown-out", |_, world| sag(world)).stays(),
    panic("panic in idle", |elf, world| panic_in(elf, world, 0)),
    panic("panic in link", |elf, world| panic_in(elf, world, LINK)).long(),
    panic("panic in render", |elf, world| panic_in(elf, world, RENDER)).long(),
    panic("panic in sample", |elf, world| panic_in(elf, world, SAMPLE)).long(),
    hard_fault("HardFault in idle", |_, world| lose_the_way(world, 0, NOWHERE)).long(),
    hard_fault("HardFault in link", |_, world| lose_the_way(world, LINK, NOWHERE)).long(),
    hard_fault("HardFault in render", |_, world| lose_the_way(world, RENDER, NOWHERE)),
    hard_fault("HardFault in sample", |_, world| lose_the_way(world, SAMPLE, NOWHERE)).long(),
    hard_fault("undefined instruction", |_, world| lose_the_way(world, LINK, ERASED)).long(),
    FaultCase::of("crystal stops", 33, AT_ONCE_US, |_, world| {
        let begun = world.powered.mcu.now();
        world.powered.mcu.kill_hse();
        world.run(700)?; // the watchdog resets the board in this time
        Ok(begun)
    })
    .all(&[23, 33])
    .resets(),
    at_arm(
        "dead channel A at arm",
        |elf, world| kill::<0>(elf, world).and_then(|_| enabled_by_arm(world)),
        revive::<0>,
    )
    .long(),
    at_arm(
        "dead channel B at arm",
        |elf, world| kill::<1>(elf, world).and_then(|_| enabled_by_arm(world)),
        revive::<1>,
    )
    .long(),
];

/// RAM that the program does not use. A branch to itself is written there.
pub(super) const UNUSED: u32 = 0x2001_F000;
pub(super) const LOOP: [u8; 2] = [0xFE, 0xE7];
/// An address without memory.
const NOWHERE: u32 = 0x1000_0000;
/// Erased flash after the code. A word of ones is no instruction.
const ERASED: u32 = 0x0807_0000;

const fn panic(name: &'static str, begin: Begin) -> FaultCase {
    FaultCase::of(name, 41, HANDLER_US, begin).all(&[23, 41]).resets()
}

const fn hard_fault(name: &'static str, begin: Begin) -> FaultCase {
    FaultCase::of(name, 42, HANDLER_US, begin).all(&[23, 42]).resets()
}

/// A fault that the sign test after `arm` has to find.
const fn at_arm(name: &'static str, begin: Begin, end: End) -> FaultCase {
    FaultCase::of(name, 14, 100_000.0 + RENDER_US, begin).before(Before::Off).until(end)
}

const fn dead_channel(name: &'static str, begin: Begin, end: End) -> FaultCase {
    FaultCase::of(name, 13, 50_000.0 + RENDER_US, begin).before(Before::Moving).until(end)
}

fn kill<const CHANNEL: usize>(_: &Elf, world: &mut World<'_>) -> Result<u64, Failed> {
    world.powered.mcu.kill_channel(CHANNEL, true);
    Ok(world.powered.mcu.now())
}

fn revive<const CHANNEL: usize>(world: &mut World<'_>) -> Result<(), Failed> {
    world.powered.mcu.kill_channel(CHANNEL, false);
    Ok(())
}

/// Opens the emergency stop.
pub(super) fn stop(world: &mut World<'_>) -> Result<u64, Failed> {
    let begun = world.powered.mcu.now();
    world.emergency_stop(true);
    Ok(begun)
}

/// A fault in which the supply drops. The supply is restored at the end.
const fn brown_out(name: &'static str, begin: Begin) -> FaultCase {
    FaultCase::of(name, 31, BROWN_OUT_US, begin).until(recover)
}

fn sag(world: &mut World<'_>) -> Result<u64, Failed> {
    world.powered.mcu.set_supply_mv(2500);
    Ok(world.powered.mcu.now())
}

fn recover(world: &mut World<'_>) -> Result<(), Failed> {
    world.powered.mcu.set_supply_mv(world.powered.board.supply_mv);
    Ok(())
}

/// The firmware's position, in counts from the set zero.
fn counts(world: &mut World<'_>) -> Result<i32, Failed> {
    let status = ask(world, "status")?;
    let mut words = status.split(' ').skip_while(|word| *word != "position");
    let count = words.nth(1).and_then(|word| word.parse().ok());
    count.ok_or_else(|| Failed::Refused(format!("no position in: {status}")))
}

/// Addresses of the words in which `sample` stores the position. One word is in the encoder's state, another in the
/// report of the last output. The search compares their values while the handle is held.
fn position_words(elf: &Elf, world: &mut World<'_>) -> Result<Vec<u32>, Failed> {
    let (from, size) = elf.place_of(SAMPLE_STATE)?;
    let before = world.snapshot();
    world.hold(world.position_m(), true);
    world.run(20)?;
    let position = counts(world)?.cast_unsigned();
    let holds = |address: &u32| word_at(world, *address) == position;
    let places: Vec<_> = (from..from + size).step_by(4).filter(holds).collect();
    world.restore(&before);
    match places.len() {
        2 | 3 => Ok(places),
        n => Err(Failed::Refused(format!("the position stands in {n} words of `sample`"))),
    }
}

/// Sends `arm` and returns the cycle at which enable became active.
fn enabled_by_arm(world: &mut World<'_>) -> Result<u64, Failed> {
    world.send("arm\n")?;
    for _ in 0..100 {
        world.sample()?;
        if world.powered.amplifier.is_enabled() {
            return Ok(world.powered.mcu.now());
        }
    }
    Err(Failed::Refused("`arm` does not enable the amplifier".into()))
}

/// Masks `render` for `samples` samples. The mask begins just before `render` is due.
fn mask_render(world: &mut World<'_>, samples: u64) -> Result<u64, Failed> {
    while !world.powered.mcu.events().is_multiple_of(10) {
        world.sample()?;
    }
    let resets = world.powered.mcu.resets();
    world.powered.mcu.mask(RENDER, true);
    let begun = world.powered.mcu.now();
    for _ in 0..samples {
        world.sample()?;
    }
    if world.powered.mcu.resets() == resets {
        world.powered.mcu.mask(RENDER, false);
    }
    Ok(begun)
}

/// Makes the program counter jump to the panic handler while `exception` runs.
fn panic_in(elf: &Elf, world: &mut World<'_>, exception: u16) -> Result<u64, Failed> {
    lose_the_way(world, exception, elf.place_of("rust_begin_unwind")?.0)
}

/// Makes the program counter jump to `address` while `exception` runs. Then the watchdog resets the board.
pub(super) fn lose_the_way(
    world: &mut World<'_>,
    exception: u16,
    address: u32,
) -> Result<u64, Failed> {
    world.powered.mcu.run_into(exception).map_err(Ended::from)?;
    let begun = world.powered.mcu.now();
    world.powered.mcu.jump(address);
    world.run(700)?;
    Ok(begun)
}
