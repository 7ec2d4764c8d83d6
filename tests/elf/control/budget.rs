//! Limits of cycles and memory.

use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    mcu::{Cycles, LINK, RENDER, SAMPLE},
    world::World,
};
use zwidth::{period::GUARD, velocity::EstimatorName};

use super::session_of;
use crate::{
    figure::figure,
    firmware::{Firmware, ok, until_armed},
};

each_board!(
    no_sample_is_longer_than_its_budget_whatever_happens,
    no_sample_with_an_output_each_is_longer_than_the_periods_allow,
    tasks_and_memory_stay_in_their_budget
);

/// Largest number of cycles of the sampling task, from exception entry to return. Before the estimator's state had a
/// checksum, which takes 15 cycles in a quiet sample, the task took 261 cycles.
const SAMPLE_CYCLES: u64 = 295;
/// Largest number of cycles of `Sampler::sample` in the sampling task. It reads the encoder, computes the velocity, and
/// decides whether the sample has an output.
const CORE_CYCLES: u64 = 120;

fn tasks_and_memory_stay_in_their_budget(board: Board) {
    println!("board           sample      of it core  render      link        stack  flash   RAM");
    let (firmware, session) = session_of(board);
    let tasks = [SAMPLE, RENDER, LINK].map(|task| session.watch.tasks[&task]);
    let core = session.watch.marked;
    let elf = &firmware.elf;
    let flash: usize = elf.flash.iter().map(|(_, bytes)| bytes.len()).sum();
    let ram: u32 = [".data", ".bss", ".uninit"]
        .iter()
        .filter_map(|name| elf.section(name))
        .map(|(_, size)| size)
        .sum();
    let stack = 0x2000_0000 + 112 * 1024 - session.watch.lowest_stack;
    let range = |cycles: Cycles| format!("{}..{}", cycles.least, cycles.most);
    let [sample, render, link] = tasks.map(range);
    let core_range = range(core);
    let name = firmware.board.name;
    println!(
        "{name:15} {sample:11} {core_range:11} {render:11} {link:11} {stack:6} {flash:6} {ram:6}"
    );
    let leave = |key: &str, value: u64| figure(&format!("elf/control/{name}/{key}"), value);
    for (task, cycles) in
        [("sample", tasks[0]), ("core", core), ("render", tasks[1]), ("link", tasks[2])]
    {
        leave(&format!("{task}_least"), cycles.least);
        leave(&format!("{task}_most"), cycles.most);
    }
    leave("core_mean", core.mean().round() as u64);
    for (what, bytes) in [("stack", stack), ("flash", flash as u32), ("ram", ram)] {
        leave(what, u64::from(bytes));
    }
    println!("means: sample {:.0}, core {:.0}", tasks[0].mean(), core.mean());
    assert_eq!(core.runs, tasks[0].runs);
    assert!(core.least > 50 && core.most <= CORE_CYCLES, "{core:?}");
    assert!(tasks[0].most <= SAMPLE_CYCLES, "{:?}", tasks[0]);
    assert!(tasks[1].most <= 9_000, "half a period of samples: {:?}", tasks[1]);
    assert!(stack + ram < 112 * 1024 / 2);
    assert!(flash < 256 * 1024);
}

/// Sends the commands with the force off, then arms.
fn arm_after(world: &mut World<'_>, lines: &[&str]) {
    world.run(30).unwrap();
    for line in lines.iter().chain(&["zero", "arm"]) {
        ok(world, line);
    }
    until_armed(world);
}

/// Masks the output task for `samples` samples. Missing outputs are a fault.
fn hold_outputs_up(world: &mut World<'_>, samples: u64) {
    world.powered.mcu.mask(RENDER, true);
    world.run(samples).unwrap();
    world.powered.mcu.mask(RENDER, false);
    world.run(200).unwrap();
    assert!(ok(world, "status").contains("fault 20"));
}

/// No sample takes longer than its limit. The test uses `zero`, `disarm`, faults at every phase of the output period,
/// and the commands that clear these faults. The maxima of the session do not include these events.
fn no_sample_is_longer_than_its_budget_whatever_happens(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    world.powered.mcu.watch_mut().clear();
    let recover = |world: &mut World<'_>| arm_after(world, &["clear"]);
    // Both boards have the same code at the same phase of the period.
    for phase in (0..10).step_by(if board == NUCLEO_F446RE { 1 } else { 3 }) {
        // A jump of the count is found in one sample and cleared in the next sample.
        world.run(phase).unwrap();
        world.hold(world.position_m() + 700e-6, true);
        world.run(30).unwrap();
        assert!(ok(&mut world, "status").contains("fault 10"));
        ok(&mut world, "zero"); // in a sample that also switches off
        world.hold(world.position_m(), false);
        recover(&mut world);
        if phase % 3 != 0 {
            continue;
        }
        // An emergency stop, and a zero at another time.
        world.run(phase).unwrap();
        world.emergency_stop(true);
        world.run(30).unwrap();
        world.emergency_stop(false);
        world.run(phase).unwrap();
        recover(&mut world);
    }
    // Missing outputs: one late output, many missing outputs in a row, and the outputs after the gap.
    for samples in [25, 150] {
        hold_outputs_up(&mut world, samples);
        recover(&mut world);
    }
    // Each estimator after every other estimator, with the force on and off.
    ok(&mut world, "unlock envelope");
    let known: Vec<_> = EstimatorName::ALL
        .iter()
        .map(|name| format!("estimator {}", name.text()))
        .filter(|line| world.ask(line).unwrap().starts_with("ok"))
        .collect();
    assert!(known.contains(&"estimator difference".to_owned()) && known.len() >= 5, "{known:?}");
    for off in [false, true] {
        for (n, before) in known.iter().enumerate() {
            for after in &known[n..] {
                for line in [before, "cutoff 1200", after, before] {
                    world.ask(line).unwrap(); // one estimator has no cutoff
                    world.run(20).unwrap();
                }
            }
        }
        if !off {
            ok(&mut world, "disarm");
        }
    }
    for line in ["save", "load", "zero"] {
        ok(&mut world, line);
        world.run(500).unwrap();
    }
    let sample = world.powered.mcu.watch().tasks[&SAMPLE];
    println!("{}: sample {}..{}", board.name, sample.least, sample.most);
    figure(&format!("elf/control/{}/sample_whatever", board.name), sample.most);
    assert!(sample.most <= SAMPLE_CYCLES, "{sample:?}");
}

/// At period 1 every sample is due. The sampling task itself then notes a fault and carries out a zero.
fn no_sample_with_an_output_each_is_longer_than_the_periods_allow(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    arm_after(&mut world, &["disarm", "unlock envelope", "period 1"]);
    world.powered.mcu.watch_mut().marks = firmware.core_of_sample();
    world.powered.mcu.watch_mut().clear();
    for phase in 0..3 {
        world.run(phase).unwrap();
        world.hold(world.position_m() + 700e-6, true);
        world.run(30).unwrap();
        assert!(ok(&mut world, "status").contains("fault 10"));
        ok(&mut world, "zero");
        world.hold(world.position_m(), false);
        arm_after(&mut world, &["clear", "unlock envelope"]);
    }
    for samples in [5, 150] {
        hold_outputs_up(&mut world, samples);
        arm_after(&mut world, &["clear", "unlock envelope"]);
    }
    let watch = world.powered.mcu.watch();
    let (sample, beside) = (watch.tasks[&SAMPLE], watch.unmarked);
    println!(
        "{}, period 1: sample {}..{}, beside the core {}..{}",
        board.name, sample.least, sample.most, beside.least, beside.most
    );
    let key = format!("elf/control/{}", board.name);
    figure(&format!("{key}/sample_period_1"), sample.most);
    figure(&format!("{key}/beside_period_1"), beside.most);
    assert!(beside.least > 80 && beside.most <= u64::from(GUARD), "{beside:?}");
}
