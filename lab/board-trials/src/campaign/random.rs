//! Random flips of single bits. The file chooses place and time of each flip, and measures its result.

use host_sim::error::Error;
use virtual_board::world::World;

use super::{
    place::{
        CORE_REGISTERS, Places, REGIONS, Region, flip_core, flip_further, flip_register, flip_word,
        register_name,
    },
    situation::{Situation, Stage, Start},
    verdict::{Class, Measure, Verdict, hears_disarm},
};
use crate::random::Random;

/// Longest time for which the board is watched after a flip, in samples. If the force is right after half of this time,
/// the watch ends then. The independent watchdog needs less than half of this time.
pub const WATCHED: u64 = 1_200;
/// Number of start times from which flips are tried in each situation.
pub const STARTS: usize = 16;
/// Situations of the flips.
const FLIPPED: [Situation; 3] = [Situation::Free, Situation::Contact, Situation::Return];
/// Longest time for which a wrong force is allowed, in s.
const ALLOWED_S: f64 = 3e-3;

/// One of `FURTHER` flips in the core is in S0 to S31, FPSCR or CONTROL, each with the same probability. One of
/// `WATCHDOG` flips in the peripherals is in the watchdog, which has about this share of the bits. The other flips do
/// not depend on these two numbers.
const FURTHER: u64 = 8;
const WATCHDOG: u64 = 64;

pub struct Flip {
    pub region: Region,
    /// Where and when the bit flips, for printed results.
    pub what: String,
    pub verdict: Verdict,
}

/// Runs from a start to a random time in the next ten samples. If `working` is true, an instruction begins at this
/// time. Returns this time, and the time since the start, both in cycles.
///
/// # Errors
/// The program ended.
pub fn run_to_flip(
    world: &mut World<'_>,
    start: &Start,
    working: bool,
    random: &mut Random,
) -> Result<(u64, u64), Error> {
    world.restore(&start.snapshot);
    let begin = world.powered.mcu.now();
    let sample = world.powered.board.cycles_per_sample();
    let at = match working {
        true => *random.one(&start.code),
        false => begin + random.below(10 * sample),
    };
    world.run_to(at).map_err(|ended| Error::Internal(format!("before a fault: {ended:?}")))?;
    let begun = world.powered.mcu.now();
    Ok((begun, begun - begin))
}

/// Runs the flip with this number from this seed. The number decides the region and the situation. The rest is random.
pub fn flip(
    world: &mut World<'_>,
    (stages, places): (&[Stage], &Places),
    (seed, number): (u64, u64),
    full_m_per_s2: f64,
) -> Result<(Situation, Flip), Error> {
    let mut random = Random::of_case(seed, number);
    let region = REGIONS[usize::try_from(number % 8).unwrap_or_default()];
    let situation = FLIPPED[usize::try_from(number / 8 % 3).unwrap_or_default()];
    let stage = &stages[situation as usize];
    let start = random.one(&stage.starts);
    // Half of the flips come at any time, mostly while the core sleeps. The other half come while the core works. So
    // flips also reach state that only the working core uses.
    let working = matches!(region, Region::Core | Region::Stack) || random.below(2) == 0;
    let (begun, cycle) = run_to_flip(world, start, working, &mut random)?;
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
    let measure = Measure {
        begun,
        samples: WATCHED,
        half_if_right: true,
        reference: &stage.seen[start.index..],
        period: 10,
        from_memory: false,
        allowed_s: ALLOWED_S,
        from_fault: false,
        free: situation.is_free(),
        full_m_per_s2,
    };
    let mut verdict = measure.verdict(world);
    if verdict.off_s.is_none() && !hears_disarm(world) {
        verdict.class = Class::Unheard;
    }
    let what = format!("{}: {what} at cycle {cycle} of start {}", region.text(), start.index);
    Ok((situation, Flip { region, what, verdict }))
}
