//! Damages RTT's control block, the end of the stack, the clock and the chip. The program must not write to a wrong
//! address. If the program waits, it must report the reason.

use board_trials::campaign::{
    place::{flip_word, words_of},
    verdict::hears_disarm,
};
use virtual_board::{
    board::{BOARDS, Board, Powered},
    mcu::Chip,
    world::World,
};

use super::registers::pressed;
use crate::firmware::{Firmware, ok, word};

each_board!(
    a_channel_whose_buffer_is_not_its_own_is_left_alone_and_ends_in_off,
    any_bit_of_the_control_block_ends_in_off_or_leaves_disarm_heard,
    a_console_that_waits_in_vain_ends_in_off,
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

/// Words of the control block before the first channel, and words of a channel. The first three of these are fixed.
const HEAD: u32 = 6;
const CHANNEL: u32 = 6;
const FIXED: u32 = 3;

fn any_bit_of_the_control_block_ends_in_off_or_leaves_disarm_heard(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = pressed(&firmware);
    let block = world.powered.rtt.address();
    let before = world.snapshot();
    for word in 0..HEAD + 4 * CHANNEL {
        let address = block + 4 * word;
        for bit in 0..32 {
            world.restore(&before);
            flip_word(&mut world, address, bit);
            if word >= HEAD && (word - HEAD) % CHANNEL >= FIXED {
                assert!(hears_disarm(&mut world), "word {word} bit {bit}: disarm is not heard");
                continue;
            }
            for _ in 0..30 {
                // A host that cannot find its channels does not stop the board.
                let _ = world.sample();
            }
            assert!(!world.powered.amplifier.is_enabled(), "word {word} bit {bit}: stays on");
            if u32::from(bit) == word {
                flip_word(&mut world, address, bit);
                let status = ok(&mut world, "status");
                assert!(status.contains("fault 44 (memory)"), "word {word} bit {bit}: {status}");
            }
        }
    }
    let (addresses, size) = firmware.elf.place_of("control_block9ADDRESSES").unwrap();
    for address in (addresses..addresses + size).step_by(4) {
        world.restore(&before);
        flip_word(&mut world, address, 9);
        world.run(30).unwrap();
        assert!(!world.powered.amplifier.is_enabled(), "{address:#x}: stays on");
    }
}

/// Flips the low bits of each word of `link` that has another value while an order is under way. One of these words says
/// whether the console waits for an answer.
fn a_console_that_waits_in_vain_ends_in_off(board: Board) {
    const STATE: &str = "local_resource_link";
    let firmware = Firmware::of(board);
    let mut world = pressed(&firmware);
    let before = world.snapshot();
    let words = |world: &World<'_>| words_of(&firmware.elf, world, STATE).unwrap();
    let (from, idle) = words(&world);
    world.send("k 8000\n").unwrap();
    let mut differs = vec![0; idle.len()];
    for _ in 0..100 {
        world.sample().unwrap();
        let now = words(&world).1;
        (0..idle.len()).for_each(|at| differs[at] += u32::from(now[at] != idle[at]));
    }
    let after = words(&world).1;
    let waits =
        (0..idle.len()).filter(|&at| (1..30).contains(&differs[at]) && after[at] == idle[at]);
    let mut ended = 0;
    for at in waits {
        for bit in 0..4 {
            world.restore(&before);
            flip_word(&mut world, from + 4 * u32::try_from(at).unwrap(), bit);
            assert!(hears_disarm(&mut world), "word {at} bit {bit}: disarm is not heard");
            if ended == 0 {
                let _ = world.run(700);
                ended = world.powered.mcu.resets();
            }
        }
    }
    assert!(ended > 0, "no flip makes the console wait");
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
