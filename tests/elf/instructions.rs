//! Instructions that the virtual board runs without the emulator have the emulator's results, in a whole session.

use virtual_board::{board::Board, mcu::Registers, world::World};

use crate::{
    firmware::{Firmware, arm},
    snapshots::ACTS,
};

each_board!(a_session_is_the_same_without_the_emulators_steps_as_with_them);

/// Everything that is compared: registers, RAM, the handle, the time, the output and the observations of the board.
fn all_of(world: &mut World<'_>) -> (Registers, Vec<u8>, u64, [u64; 3], String) {
    let mut ram = vec![0; 0x2_0000];
    let position = world.position_m().to_bits();
    let said = format!("{:?}{}{:?}", world.lines, world.replies, world.telemetry);
    let mcu = &world.powered.mcu;
    mcu.read(0x2000_0000, &mut ram);
    let times = [mcu.now(), mcu.asleep(), mcu.instructions()];
    (mcu.core_registers(), ram, position, times, said + &format!("{:?}", mcu.watch()))
}

fn count(world: &World<'_>) -> [u64; 2] {
    let mcu = &world.powered.mcu;
    [mcu.instructions_here(), mcu.instructions()]
}

fn a_session_is_the_same_without_the_emulators_steps_as_with_them(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.boot();
    let mut other = firmware.boot();
    other.powered.mcu.emulate_all(true);
    arm(&mut world);
    arm(&mut other);
    for (what, act) in ACTS {
        let before = count(&world);
        act(&mut world);
        act(&mut other);
        assert!(all_of(&mut world) == all_of(&mut other), "{}: {what}", board.name);
        let after = count(&world);
        let [here, all] = [0, 1].map(|n| after[n] - before[n]);
        println!("{}: {what}: {here} of {all} instructions without the emulator", board.name);
        assert!(what != "runs" || 10 * here > 9 * all, "the virtual board is slow again");
    }
}
