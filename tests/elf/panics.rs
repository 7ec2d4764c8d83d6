//! After the tasks have started, no panic can be reached. The test follows the call graph of the release ELF from every
//! entry of the vector table and from `idle`.
//!
//! Direct calls and jumps are read from the machine code. Formatting code calls functions through registers, with
//! addresses from tables. A call through a register counts as a call of **every** function whose address is in the
//! image: in a constant, after code, or built in a register. The graph then has more calls than can happen, so no call
//! is missed. The test also proves that no panic's address is stored anywhere.

use std::collections::{BTreeMap, BTreeSet};

use virtual_board::board::{Board, NUCLEO_F446RE};

use crate::{code::Code, firmware::Firmware};

each_board!(no_panic_is_reachable_after_init);

/// Parts of the names of functions that end in the panic handler, and of the handler itself.
const PANICS: [&str; 5] = ["9panicking", "rust_begin_unwind", "_failed", "_fail", "unwrap"];

/// All functions that can be reached. Each is stored with one function that reaches it.
fn reachable(code: &Code<'_>, entries: &BTreeSet<u32>) -> BTreeMap<u32, u32> {
    let taken = code.address_taken();
    let mut found: BTreeMap<u32, u32> = entries.iter().map(|&entry| (entry, entry)).collect();
    let mut open: Vec<u32> = entries.iter().copied().collect();
    while let Some(function) = open.pop() {
        let flow = code.flow(function);
        let indirect = if flow.indirect { taken.clone() } else { BTreeSet::new() };
        for next in flow.to.into_iter().chain(indirect) {
            found.entry(next).or_insert_with(|| {
                open.push(next);
                function
            });
        }
    }
    found
}

fn is_panic(name: &str) -> bool {
    PANICS.iter().any(|part| name.contains(part))
}

/// Checks the unmodified images.
fn no_panic_is_reachable_after_init(board: Board) {
    no_panic(board, &[]);
}

#[test]
#[ignore = "an image of its own; CI runs it"]
fn no_panic_is_reachable_with_edge_times() {
    no_panic(NUCLEO_F446RE, &["time-stamps"]);
}

fn no_panic(board: Board, features: &[&str]) {
    let firmware = Firmware::variant(board, features);
    let code = Code::of(&firmware.elf);
    let mut entries = code.handlers();
    let idle = code.named("3app4idle");
    assert_eq!(idle.len(), 1);
    entries.extend(idle);
    for task in ["TIM5", "SPI3", "SPI2", "HardFault"] {
        let task = code.named(task);
        assert!(task.iter().any(|address| entries.contains(address)), "{task:x?}");
    }
    let found = reachable(&code, &entries);
    println!("{} {features:?}: {} functions", board.name, found.len());
    // The result includes formatting and the logger, so the search is deep enough.
    for part in ["3fmt5write", "_defmt_release", "pad_integral"] {
        assert!(found.keys().any(|&function| code.name(function).contains(part)), "{part}");
    }
    let panics: Vec<_> = found
        .iter()
        .filter(|(function, _)| is_panic(code.name(**function)))
        .map(|(function, from)| (code.name(*function), code.name(*from)))
        .collect();
    assert!(panics.is_empty(), "{panics:#?}");
}

/// From the reset handler, the same search does find the panics of the set-up.
#[test]
fn the_look_finds_panics_where_there_are_some() {
    let firmware = Firmware::of(NUCLEO_F446RE);
    let code = Code::of(&firmware.elf);
    let found = reachable(&code, &BTreeSet::from([firmware.elf.address_of("Reset").unwrap()]));
    assert!(found.keys().any(|&function| code.name(function).contains("rust_begin_unwind")));
}
