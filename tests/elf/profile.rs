//! Prints the cycles that each instruction of `sample` takes. This helps a developer who makes `sample` faster.

use std::collections::BTreeMap;

use virtual_board::{board::Board, mcu::SAMPLE};

use crate::firmware::Firmware;

each_board!(the_cycles_of_sample_by_instruction, ignored: "prints a table, decides nothing");

const SAMPLES: u64 = 2000;

/// The handle moves freely with the force on. The sum of the printed cycles is less than the task's cycles, because the
/// cycles of the return belong to the task that continues.
fn the_cycles_of_sample_by_instruction(board: Board) {
    let firmware = Firmware::of(board);
    let lines = firmware.lines();
    let mut world = firmware.armed();
    let free_m = world.position_m();
    world.powered.mcu.watch_mut().clear();
    world.powered.mcu.watch_mut().profile = Some(BTreeMap::new());
    for n in 0..SAMPLES {
        world.hold(free_m + 1e-6 * (n % 200) as f64, true);
        world.sample().unwrap();
    }
    let watch = world.powered.mcu.watch();
    let task = watch.tasks[&SAMPLE];
    println!("{}: sample {}..{}, mean {:.1}", board.name, task.least, task.most, task.mean());
    let profile = watch.profile.as_ref().unwrap();
    let mut sum = 0.0;
    for (address, cycles) in profile {
        let mean = *cycles as f64 / task.runs as f64;
        sum += mean;
        let mut frames = lines.find_frames(u64::from(*address)).skip_all_loads().unwrap();
        let mut chain = vec![];
        while let Some(frame) = frames.next().unwrap() {
            let name = frame.function.map(|function| function.demangle().unwrap().into_owned());
            let line = frame.location.and_then(|location| location.line).unwrap_or(0);
            chain.push(format!("{}:{line}", name.unwrap_or_default()));
        }
        println!("{address:#x} {mean:7.2} {}", chain.join(" < "));
    }
    println!("{sum:.1} without the return");
    for (address, cycles) in &watch.longest {
        println!("longest {address:#x} {cycles}");
    }
}
