//! try
fn main() {
    let board = virtual_board::board::BOARDS[std::env::args().nth(1).map_or(0, |_| 1)];
    let path = virtual_board::image::build(board.name).unwrap();
    let elf = virtual_board::elf::Elf::load(&path).unwrap();
    let table = virtual_board::log::table(&elf.bytes).unwrap();
    let scene = host_sim::scene::NamedScene::load("paper-1um").unwrap().scene;
    let mut w = virtual_board::world::World::new(board, &elf, &table, &scene, 0.0517).unwrap();
    let t = std::time::Instant::now();
    w.run(1000).unwrap();
    println!("{}", w.replies);
    w.hold(0.0517, false);
    for c in ["status", "zero", "unlock envelope", "wall 0.005", "k 3000", "b 20", "get", "arm"] {
        println!("> {c}\n{:?}", w.ask(c));
    }
    w.run(4000).unwrap();
    w.powered.mcu.watch_mut().clear();
    for c in ["status", "push 2.835", "hit", "status"] {
        println!("> {c}\n{:?}", w.ask(c));
    }
    println!("{:?}", w.reply(80000));
    println!("{} {}", w.position_m(), w.ask("status").unwrap());
    for c in ["save", "disarm", "save", "load", "help", "faults", "version", "garbage", "walk"] {
        println!("> {c}\n{:?}", w.ask(c));
    }
    println!(
        "{:?} insns {} now {} asleep {} resets {} events {} hf {:x?} {:#?}",
        t.elapsed(),
        w.powered.mcu.instructions(),
        w.powered.mcu.now(),
        w.powered.mcu.asleep(),
        w.powered.mcu.resets(),
        w.powered.mcu.events(),
        w.powered.mcu.hard_faults(),
        w.powered.mcu.watch()
    );
    println!("{}", w.lines.join("\n"));
}
