//! The wall's passivity controller in the release image. Every frame equals the frame that the core computes on the
//! host. A contact supplies at most the reserve.

use host_sim::scene::{
    NamedScene, PassivityTable,
    record::{board_facts, words},
};
use virtual_board::board::{BOARDS, Board};
use zwidth::device::Device;

use crate::{
    figure::figure,
    firmware::{Firmware, ok, until_armed},
    period::hit_at,
};

each_board!(
    every_frame_is_the_cores_at_every_period,
    ignored: "a hit at every period; that at period 10 runs by default"
);

/// The board's own scene with the passivity controller. Returns the image, the device, and the reserve in J.
fn with_controller(board: Board, acceleration_m_per_s2: f64) -> (Firmware, Device<'static>, f64) {
    let firmware = Firmware::of(board);
    let mut scene = NamedScene::load(board.name).unwrap();
    let acceleration_m_per_s2 = Some(acceleration_m_per_s2);
    scene.scene.passivity = Some(PassivityTable { acceleration_m_per_s2 });
    let facts = board_facts(board.name).unwrap();
    let first = scene.scene.velocity.at(1500.0);
    let record = scene.prepared(&facts, first).unwrap().record(&[], &facts).unwrap();
    let elf = firmware.elf.with_record(&record).unwrap();
    let device = Device::from_record(words(&record).leak(), &facts).unwrap();
    (Firmware { elf, ..firmware }, device, scene.scene.reserve_j().unwrap())
}

/// Largest energy that a contact with a hard wall supplies, in J.
fn given_j(firmware: &Firmware) -> f64 {
    let mut world = firmware.boot();
    for line in
        ["zero", "unlock envelope", "wall 0.01", "k 40000", "b 20", "push 2.835", "settle 0.2"]
    {
        ok(&mut world, line);
    }
    ok(&mut world, "window 0.1");
    ok(&mut world, "arm");
    until_armed(&mut world);
    ok(&mut world, "hit");
    let over = world.reply(60_000).unwrap();
    let (_, given) = over.rsplit_once(", given ").unwrap();
    given.trim_end_matches(" J").parse().unwrap()
}

#[test]
fn a_contact_gives_at_most_the_reserve() {
    let plain = given_j(&Firmware::of(BOARDS[0]));
    let (firmware, _, reserve_j) = with_controller(BOARDS[0], 25.0);
    let given = given_j(&firmware);
    println!(
        "given {plain:.3e} J without the controller, {given:.3e} J with it, reserve {reserve_j:.3e} J"
    );
    figure("elf/passivity/plain", plain);
    figure("elf/passivity/given", given);
    figure("elf/passivity/reserve", reserve_j);
    assert!(plain > reserve_j && given <= reserve_j, "{plain} {given} {reserve_j}");
}

/// The reserve is six counts at full scale. With this reserve, the controller acts in every bounce.
#[test]
fn every_frame_is_the_cores() {
    let (firmware, device, _) = with_controller(BOARDS[0], 1e-3);
    hit_at(&firmware, &device, None, 10);
}

fn every_frame_is_the_cores_at_every_period(board: Board) {
    for (acceleration, period) in [(1e-3, 1), (25.0, 2), (0.1, 5), (25.0, 10)] {
        let (firmware, device, _) = with_controller(board, acceleration);
        let (watch, _) = hit_at(&firmware, &device, None, period);
        let register = watch.commands;
        println!(
            "{} period {period}: event to register {}..{}",
            board.name, register.least, register.most
        );
        figure(&format!("elf/passivity/{}/{period}/register_most", board.name), register.most);
    }
}
