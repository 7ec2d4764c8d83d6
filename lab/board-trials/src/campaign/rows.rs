//! The named faults and their time limits.

use virtual_board::{board::Board, elf::Elf, world::World};

use super::{
    fault_case::{Before, FAULT_CASES, FaultCase},
    kept::kept_rows,
    no_processor::NO_PROCESSOR,
    outside::outside,
    registers::register_rows,
    row::{GRID_S, Row, SOON_S},
};

pub fn fault_cases() -> Vec<&'static FaultCase> {
    FAULT_CASES.iter().chain(&NO_PROCESSOR).collect()
}

/// All rows of a board. `current_sense` tells whether the board measures the amplifier's current.
pub fn rows(board: Board, current_sense: bool) -> Vec<Row> {
    let cases = fault_cases().into_iter().map(|case| {
        let limit_s = (case.limit_us * 1e-6).max(SOON_S + GRID_S);
        let mut row = Row::of(case.name, limit_s, move |elf: &Elf, world: &mut World<'_>| {
            let mut begun = (case.begin)(elf, world)?;
            if let Some(cause) = case.cause {
                cause(elf, world)?;
                begun = world.powered.mcu.now();
            }
            Ok(begun)
        });
        row.from_off = case.before == Before::Off;
        if case.before == Before::Moving {
            row = row.never_in_contact("a handle that rests on the wall looks the same");
        }
        row
    });
    let registers = register_rows(board).into_iter().map(|register| {
        Row::at_once(register.name, SOON_S, move |_, world| {
            register.apply(world);
            Ok(())
        })
    });
    cases.chain(registers).chain(outside(board, current_sense)).chain(kept_rows()).collect()
}
