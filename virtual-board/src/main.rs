//! `cargo board`.

fn main() {
    let board = virtual_board::board::BOARDS[std::env::args().nth(1).map_or(0, |_| 1)];
    let path = virtual_board::image::build(board.name).unwrap();
    let elf = virtual_board::elf::Elf::load(&path).unwrap();
    let mut on = virtual_board::board::Powered::on(board, &elf).unwrap();
    let table = virtual_board::log::table(&elf.bytes).unwrap();
    let mut log = virtual_board::log::Decoder::new(&table);
    let t = std::time::Instant::now();
    for i in 1..=2000 {
        let r = on.mcu.run_until(i * board.chip.core_hz / 1000);
        if r.is_err() || !on.mcu.hard_faults().is_empty() {
            println!("{:x?}", on.mcu.hard_faults());
            println!("{r:?}");
            break;
        }
        on.mcu.settle();
        let bytes = on.rtt.read(&mut on.mcu, 0);
        for line in log.feed(&bytes).unwrap() {
            println!("{line}");
        }
    }
    let mut b = [0u8; 128];
    on.mcu.read(elf.address_of("_SEGGER_RTT").unwrap(), &mut b);
    println!("{:x} {b:x?}", elf.address_of("_SEGGER_RTT").unwrap());
    println!(
        "{:?} insns {} asleep {} resets {} events {} {:#?}",
        t.elapsed(),
        on.mcu.instructions(),
        on.mcu.asleep(),
        on.mcu.resets(),
        on.mcu.events(),
        on.mcu.watch()
    );
}
