//! Nothing delays the sampling task.

use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    elf::Elf,
    mcu::Watch,
};

use super::{SAMPLES, session_of};
use crate::{
    code::{Code, Instruction},
    figure::figure,
    firmware::Firmware,
};

each_board!(the_sampling_task_enters_no_critical_section, nothing_delays_the_samples);

/// Largest allowed difference between the delays of two samples, in cycles. The difference comes from the longest
/// instructions, which cannot be interrupted.
const SPREAD: u64 = 64;

/// Longest time for which the logger masks `render` and `brown_out`, in us. It includes a sample that is taken during
/// the mask.
const MASK_US: f64 = 60.0;

/// Fails if something delays the samples. The error names the cause.
fn delayed(watch: &Watch) -> Result<(), String> {
    if watch.delay_spread() > SPREAD {
        return Err(format!("spread {} cycles", watch.delay_spread()));
    }
    match (watch.primask, watch.forbidden_basepri) {
        (0, 0) => Ok(()),
        (primask, basepri) => Err(format!("PRIMASK in {primask} steps, BASEPRI in {basepri}")),
    }
}

fn nothing_delays_the_samples(board: Board) {
    let (firmware, session) = session_of(board);
    let watch = &session.watch;
    println!("{}: cycles from event to count: {:?}", firmware.board.name, watch.delays);
    assert!(watch.delays.values().sum::<u64>() >= SAMPLES);
    assert_eq!(delayed(watch), Ok(()), "{:?}", watch.delays);
    // Shows that the test measures something: some samples came while the logger masked the lower tasks.
    let masked: u64 = watch.events_by_basepri.range(1..).map(|(_, n)| n).sum();
    println!("events by BASEPRI: {:?}", watch.events_by_basepri);
    let mask_us = watch.longest_mask as f64 / firmware.board.chip.core_hz as f64 * 1e6;
    println!("longest mask {} cycles, {mask_us:.1} us", watch.longest_mask);
    let leave = |key: &str, value: u64| {
        figure(&format!("elf/control/{}/{key}", firmware.board.name), value);
    };
    leave("delay_least", *watch.delays.keys().next().unwrap());
    leave("delay_most", *watch.delays.keys().last().unwrap());
    figure(&format!("elf/control/{}/mask_us", firmware.board.name), mask_us);
    assert!(mask_us <= MASK_US, "{mask_us}");
    assert!(masked >= 1, "{:?}", watch.events_by_basepri);
    assert!(session.lines > 500, "{}", session.lines);
}

/// Changes the firmware as if its logger used a critical section of `cortex-m`. Where BASEPRI was raised, all
/// interrupts are now disabled. Where BASEPRI was restored, all interrupts are enabled.
fn with_critical_sections(firmware: &Firmware) -> Elf {
    const MSR: u16 = 0xF380;
    let mut elf = firmware.elf.clone();
    let code = Code::of(&firmware.elf);
    let mut patched = [0; 2];
    for Instruction { at, first, second } in
        code.named("").into_iter().flat_map(|function| code.instructions(function))
    {
        let (n, instruction) = match (first & 0xFFF0, second) {
            (MSR, 0x8812) => (0, 0xB672_u16), // BASEPRI_MAX: cpsid i
            (MSR, 0x8811) => (1, 0xB662),     // BASEPRI: cpsie i
            _ => continue,
        };
        patched[n] += 1;
        let nop = 0xBF00_u16;
        let bytes = [instruction.to_le_bytes(), nop.to_le_bytes()].concat();
        let piece = elf.flash.iter_mut().rfind(|(base, _)| *base <= at).unwrap();
        piece.1[(at - piece.0) as usize..][..4].copy_from_slice(&bytes);
    }
    assert!(patched.iter().all(|&n| n > 0), "{patched:?}");
    elf.seal().unwrap();
    elf
}

/// With a critical section in the logger, as in `rtt-target` and `defmt-rtt`, the test must find the delays. The spread
/// alone must show them, and so must the mask.
#[test]
#[ignore = "the control of the test above: CI runs it"]
fn a_logger_with_a_critical_section_would_be_noticed() {
    let mut spreads = Vec::new();
    let mut firmware = Firmware::of(NUCLEO_F446RE);
    for sections in [false, true] {
        if sections {
            firmware.elf = with_critical_sections(&firmware);
        }
        let mut world = firmware.armed();
        world.powered.mcu.watch_mut().clear();
        for n in 0..4_000 {
            if n % 20 == 0 {
                world.send(["status\n", "get\n", "help\n"][n / 20 % 3]).unwrap();
            }
            world.sample().unwrap();
            if n % 50 == 0 {
                world.probe().unwrap();
            }
        }
        let watch = world.powered.mcu.watch();
        println!(
            "critical sections {sections}: spread {}, {:?}",
            watch.delay_spread(),
            delayed(watch)
        );
        assert_eq!(delayed(watch).is_ok(), !sections);
        assert_eq!(watch.primask == 0, !sections);
        spreads.push(watch.delay_spread());
    }
    figure("elf/control/nucleo-f446re/spread", spreads[0]);
    figure("elf/control/nucleo-f446re/spread_with_critical_sections", spreads[1]);
    assert!(spreads[0] <= SPREAD && spreads[1] > 10 * SPREAD, "{spreads:?}");
}

/// Checks the machine code of the sampling task and of the functions that it calls (rare cases of the guard). No
/// instruction disables interrupts, raises a mask or calls through a pointer.
fn the_sampling_task_enters_no_critical_section(board: Board) {
    let elf = Firmware::of(board).elf;
    let code = Code::of(&elf);
    let mut functions = vec![elf.address_of("TIM5").unwrap()];
    let mut n = 0;
    while n < functions.len() {
        for Instruction { at, first, second } in code.instructions(functions[n]) {
            assert!(first != 0xB672 && first != 0xB671, "cpsid at {at:#x}");
            // MSR PRIMASK or BASEPRI_MAX
            let msr = first & 0xFFF0 == 0xF380 && second & 0xFF00 == 0x8800;
            assert!(!(msr && matches!(second & 0xFF, 16 | 18)), "mask raised at {at:#x}");
        }
        let flow = code.flow(functions[n]);
        assert!(!flow.indirect, "{}", code.name(functions[n]));
        let new: Vec<u32> = flow.to.into_iter().filter(|f| !functions.contains(f)).collect();
        functions.extend(new);
        n += 1;
    }
    let names: Vec<_> = functions.iter().map(|&function| code.name(function)).collect();
    println!("{}: {names:?}", board.name);
    assert!(functions.len() <= 3, "{names:?}");
}
