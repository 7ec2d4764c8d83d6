//! Damages RTT's control block, the end of the stack, the clock and the chip. The program must not write to a wrong
//! address. If the program waits, it must report the reason.

use virtual_board::{
    board::{BOARDS, Board, Powered},
    mcu::Chip,
    world::World,
};

use crate::firmware::{Firmware, ok, word};

each_board!(
    a_channel_whose_buffer_is_not_its_own_is_left_alone_and_ends_in_off,
    a_board_without_its_clock_says_so,
    an_image_for_another_chip_says_so,
    the_stack_ends_in_a_guard
);

fn a_channel_whose_buffer_is_not_its_own_is_left_alone_and_ends_in_off(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    let block = firmware.elf.address_of("_SEGGER_RTT").unwrap();
    let mut symbols = firmware.elf.symbols.iter();
    let (_, render, _) = symbols.find(|(name, ..)| name.contains("local_resource_render")).unwrap();
    let before = world.snapshot();
    // Words of the control block: 24 bytes, then for each channel name, buffer, size, write offset, read offset, flags.
    // Up channel 1 carries telemetry all the time. Up channels 0 and 2 carry a reply.
    for (channel, place, value) in [
        (1, 1, *render),
        (1, 2, 8192 | 1 << 16),
        (0, 1, *render),
        (2, 2, 1 << 20),
        (3, 2, 256 | 1 << 20),
    ] {
        world.restore(&before);
        let base = block + 24 + 24 * channel;
        world.powered.mcu.write(base + 4 * place, &value.to_le_bytes());
        let written = word(&world, base + 12);
        let Powered { mcu, rtt, .. } = &mut world.powered;
        rtt.write(mcu, 0, b"get\n");
        for _ in 0..2_000 {
            world.sample().unwrap();
        }
        assert_eq!(word(&world, base + 12), written, "channel {channel}: something was written");
        assert!(!world.powered.amplifier.is_enabled(), "channel {channel}");
    }
    world.restore(&before);
    world.run(100).unwrap();
    ok(&mut world, "get");
}

fn a_board_without_its_clock_says_so(board: Board) {
    let firmware = Firmware::of(board);
    let rest_m = firmware.scene.device.rest_position_m;
    let mut world =
        World::new(board, &firmware.elf, &firmware.table, &firmware.scene, rest_m).unwrap();
    world.powered.mcu.kill_hse();
    world.run(1_000).unwrap();
    assert!(world.replies.starts_with("error: no 8 MHz clock, nothing runs"), "{}", world.replies);
    assert!(!world.powered.amplifier.is_enabled());
    assert_eq!(world.powered.mcu.events(), 0);
}

fn an_image_for_another_chip_says_so(board: Board) {
    let firmware = Firmware::of(board);
    let other = BOARDS.into_iter().find(|other| other.chip.id != board.chip.id).unwrap();
    let chip = Chip { id: other.chip.id, ..board.chip };
    let rest_m = firmware.scene.device.rest_position_m;
    let board = Board { chip, ..board };
    let mut world =
        World::new(board, &firmware.elf, &firmware.table, &firmware.scene, rest_m).unwrap();
    world.run(1_000).unwrap();
    assert!(world.replies.starts_with("error: another chip than this image"), "{}", world.replies);
    assert!(!world.powered.amplifier.is_enabled());
    assert_eq!(world.powered.mcu.events(), 0);
}

/// The memory protection unit blocks 256 bytes that the stack never reaches.
fn the_stack_ends_in_a_guard(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    let end = firmware.elf.address_of("__sheap").unwrap().next_multiple_of(256);
    let [control, base, size] =
        [0xE000_ED94, 0xE000_ED9C, 0xE000_EDA0].map(|at| world.powered.mcu.peek(at));
    assert_eq!((control & 1, base & !0x1F), (1, end));
    assert_eq!(size, 1 << 28 | 7 << 1 | 1, "no access, 256 bytes, on");
    assert!(world.powered.mcu.watch().lowest_stack > end + 256);
}
