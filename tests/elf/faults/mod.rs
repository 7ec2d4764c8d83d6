//! Causes faults that must switch the force off, on the unmodified release ELF. The tests check the latched fault and
//! the stored data. They also check the time until enable is inactive and the output code is that of zero force. Only
//! `clear` and `arm` bring the force back. docs/lab/campaigns.md has the table, and how each fault is caused.
//!
//! `cargo test --test elf -- --ignored --nocapture campaign` prints the whole table.

mod acts;
mod link;
mod memory;
mod registers;
mod run_case;

use self::run_case::{Depth, prepare, run_case};
use board_trials::campaign::{
    fault_case::{Before, FaultCase},
    kept, outside,
    rows::fault_cases,
};
use rayon::prelude::*;
use virtual_board::{
    board::{BOARDS, Board, NUCLEO_F446RE},
    session::Failed,
    world::World,
};

use crate::{figure::figure, firmware::Firmware};

each_board!(
    damaged_settings_and_power_cuts_leave_settings_that_were_saved,
    settings_that_are_not_allowed_leave_the_defaults_and_say_so,
    a_host_that_stalls_floods_or_blocks_changes_nothing_in_the_loop
);

struct Row {
    board: &'static str,
    name: String,
    off: String,
    limit: String,
    zero: String,
    fault: String,
    kept: String,
}

impl Row {
    fn print(&self) {
        let Self { board, name, off, limit, zero, fault, kept } = self;
        println!(
            "| {board:14} | {name:40} | {off:>9} | {limit:>9} | {zero:>9} | {fault:>5} | {kept} |"
        );
    }
}

fn header() {
    println!(
        "| board          | fault case                               | off       | allowed   | zero code | fault | kept |"
    );
    println!(
        "|----------------|------------------------------------------|----------:|----------:|----------:|------:|------|"
    );
}

fn ms(us: f64) -> String {
    format!("{:.3} ms", us / 1e3)
}

/// Runs each of `cases` on both boards in parallel. Returns the rows in the order of the cases.
fn rows(firmwares: &[Firmware], cases: &[&FaultCase], depth: Depth) -> Vec<Row> {
    let pairs: Vec<_> = firmwares.iter().flat_map(|f| cases.iter().map(move |t| (f, *t))).collect();
    let befores: Vec<_> =
        firmwares.iter().flat_map(|f| Before::ALL.map(|before| (f, before))).collect();
    let prepared: Vec<_> =
        befores.par_iter().map(|(firmware, before)| prepare(firmware, *before, depth)).collect();
    let results = pairs.par_iter().map(|(firmware, case)| {
        let at = befores
            .iter()
            .position(|(of, before)| of.board == firmware.board && *before == case.before);
        let result = run_case(firmware, &prepared[at.unwrap()], case, depth);
        if depth == Depth::Full {
            figure(&format!("elf/faults/{}/{}", case.name, firmware.board.name), result.off_us);
            figure(&format!("elf/faults/{}/allowed", case.name), case.limit_us);
        }
        Row {
            board: firmware.board.name,
            name: case.name.to_owned(),
            off: ms(result.off_us),
            limit: ms(case.limit_us),
            zero: ms(result.zero_us),
            fault: case.code.to_string(),
            kept: result.kept,
        }
    });
    results.collect()
}

/// The host stops reading and then sends without a pause, with every channel set to blocking and the force on. The
/// force must not change.
fn flood(firmware: &Firmware, samples: u64) -> Row {
    let mut world = firmware.armed();
    world.powered.mcu.watch_mut().clear();
    outside::flood(&mut world, samples).unwrap();
    let watch = world.powered.mcu.watch();
    assert!(watch.delay_spread() <= 64, "{:?}", watch.delays);
    assert_eq!((watch.primask, watch.forbidden_basepri), (0, 0));
    let render = watch.tasks[&virtual_board::mcu::RENDER];
    assert_eq!(render.runs, samples / 10);
    assert!(world.powered.amplifier.is_enabled(), "the loop did not survive");
    assert_eq!(world.powered.mcu.resets(), 0);
    Row {
        board: firmware.board.name,
        name: "RTT stall and flood, blocking".to_owned(),
        off: "stays on".to_owned(),
        limit: String::new(),
        zero: String::new(),
        fault: "none".to_owned(),
        kept: format!(
            "{} outputs of {}, delay spread {}",
            render.runs,
            samples / 10,
            watch.delay_spread()
        ),
    }
}

/// Damages stored data in many ways, which must all end as expected. Returns the number of cases.
fn cases(firmware: &Firmware, damage: impl Fn(&mut World<'_>) -> Result<usize, Failed>) -> usize {
    damage(&mut firmware.boot()).unwrap()
}

fn count(firmware: &Firmware, name: &str, cases: usize, kept: &str) -> Row {
    Row {
        board: firmware.board.name,
        name: format!("{name}, {cases} cases"),
        off: "stays off".to_owned(),
        limit: String::new(),
        zero: String::new(),
        fault: "none".to_owned(),
        kept: kept.to_owned(),
    }
}

/// The whole campaign as one table.
#[test]
#[ignore = "two minutes; CI runs it"]
fn campaign() {
    let firmwares = BOARDS.map(Firmware::of);
    header();
    rows(&firmwares, &fault_cases(), Depth::Full).iter().for_each(Row::print);
    for firmware in &firmwares {
        flood(firmware, 10_000).print();
        let flipped = cases(firmware, |world| kept::flip_every_byte(world, 1));
        count(firmware, "settings byte flipped", flipped, "older settings, and says so").print();
        let cut = cases(firmware, |world| kept::cut_every_word(world, 1));
        count(firmware, "power cut in a save", cut, "older settings or the new ones, whole")
            .print();
        let erased = cases(firmware, kept::cut_an_erase);
        for (what, cases) in
            [("flipped", flipped), ("cut in a save", cut), ("cut in an erase", erased)]
        {
            figure(&format!("elf/faults/{what}/cases"), cases);
        }
        count(firmware, "power cut in an erase", erased, "newest settings").print();
    }
}

/// The fault cases without a watchdog reset, on the default board.
#[test]
fn faults_take_the_force_away_in_time_and_say_why() {
    let firmware = Firmware::of(NUCLEO_F446RE);
    let short: Vec<_> = fault_cases().into_iter().filter(|case| case.short).collect();
    header();
    rows(&[firmware], &short, Depth::Short).iter().for_each(Row::print);
}

fn damaged_settings_and_power_cuts_leave_settings_that_were_saved(board: Board) {
    let firmware = Firmware::of(board);
    assert!(cases(&firmware, |world| kept::flip_every_byte(world, 12)) >= 8);
    assert!(cases(&firmware, |world| kept::cut_every_word(world, 6)) >= 8);
}

fn settings_that_are_not_allowed_leave_the_defaults_and_say_so(board: Board) {
    assert!(cases(&Firmware::of(board), kept::take_what_is_not_allowed) >= 8);
}

fn a_host_that_stalls_floods_or_blocks_changes_nothing_in_the_loop(board: Board) {
    header();
    flood(&Firmware::of(board), 4_000).print();
}
