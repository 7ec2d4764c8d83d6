//! Single bits that flip at random: where, when, and what came of it.

use host_sim::error::Error;
use virtual_board::world::World;

use super::{
    place::{
        CORE_REGISTERS, Places, REGIONS, Region, flip_core, flip_further, flip_register, flip_word,
        register_name,
    },
    situation::{Situation, Stage},
    verdict::{Measure, Verdict},
};
use crate::random::Random;

/// Samples for which a flip is watched: longer than the independent watchdog takes, and twice that where the force is
/// not right by then.
pub const WATCHED: u64 = 1_200;
/// Moments of each situation.
pub const STARTS: usize = 16;
/// A wrong force has to be off within so long, s.
const ALLOWED_S: f64 = 3e-3;

/// One in so many flips of the core is in the registers of floats, FPSCR or CONTROL, each as often; and one in so many of
/// the peripherals in the watchdog, whose bits are about that part. All others are what they were before there were these.
const FURTHER: u64 = 8;
const WATCHDOG: u64 = 64;

pub struct Flip {
    /// Of the chip's state.
    pub region: Region,
    /// What and when, for people.
    pub what: String,
    /// What came of it.
    pub verdict: Verdict,
}

/// Number `number` of a seed: the regions in turn, then situations, the rest by chance.
pub fn flip(
    world: &mut World<'_>,
    (stages, places): (&[Stage], &Places),
    (seed, number): (u64, u64),
    full_m_per_s2: f64,
) -> Result<(Situation, Flip), Error> {
    let mut random = Random(seed.wrapping_mul(0xD134_2543_DE82_EF95).wrapping_add(number));
    let region = REGIONS[usize::try_from(number % 8).unwrap_or_default()];
    let contact = number / 8 % 2 == 1;
    let situation = if contact { Situation::Contact } else { Situation::Free };
    let stage = &stages[situation as usize];
    let start = random.one(&stage.starts);
    world.restore(&start.snapshot);
    let begin = world.powered.mcu.now();
    let sample = world.powered.board.cycles_per_sample();
    // Half of them at any time, in which the core mostly sleeps; half while it works. What is in use only then flips then.
    let working = matches!(region, Region::Core | Region::Stack) || random.below(2) == 0;
    let at = match working {
        true => *random.one(&start.code),
        false => begin + random.below(10 * sample),
    };
    world.run_to(at).map_err(|ended| Error::Internal(format!("before a fault: {ended:?}")))?;
    let begun = world.powered.mcu.now();
    let bit = random.small(32);
    let what = match region {
        Region::Core => {
            let register = random.small(CORE_REGISTERS);
            let name = match random.below(FURTHER) {
                0 => flip_further(world, (random.small(3), random.small(32)), bit),
                _ => flip_core(world, register, bit),
            };
            format!("{name} bit {bit}")
        }
        Region::Peripheral => {
            let at = random.one(&places.bits);
            let &(address, bit) = match random.below(WATCHDOG) {
                0 => random.one(&places.watchdog),
                _ => at,
            };
            flip_register(world, address, bit);
            format!("{} bit {bit}", register_name(address))
        }
        _ => {
            let from = world.powered.mcu.stack_pointer() & !3;
            let address = match region {
                Region::Stack => random.of(&Vec::from_iter((from..places.stack_end).step_by(4))),
                _ => random.of(places.words(region)),
            };
            flip_word(world, address, bit);
            format!("{address:#x} bit {bit}")
        }
    };
    let cycle = begun - begin;
    let measure = Measure {
        begun,
        samples: WATCHED,
        half_if_right: true,
        reference: &stage.seen[start.index..],
        from_memory: false,
        allowed_s: ALLOWED_S,
        from_fault: false,
        free: !contact,
        full_m_per_s2,
    };
    let verdict = measure.verdict(world);
    let what = format!("{}: {what} at cycle {cycle} of start {}", region.text(), start.index);
    Ok((situation, Flip { region, what, verdict }))
}
