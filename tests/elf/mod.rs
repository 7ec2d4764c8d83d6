//! What the tests of the ELF share.
#![allow(clippy::unwrap_used, reason = "a test may stop")]
#![allow(dead_code, reason = "each test uses a part of it")]

use defmt_decoder::Table;
use host_sim::scene::{NamedScene, Scene};
use virtual_board::{board::Board, elf::Elf, image, log, world::World};

/// A board's release ELF, built if need be.
pub struct Firmware {
    pub board: Board,
    pub elf: Elf,
    pub table: Table,
    pub scene: Scene,
}

impl Firmware {
    /// The firmware of that board.
    pub fn of(board: Board) -> Self {
        let path = image::build(board.name).unwrap();
        let elf = Elf::load(&path).unwrap();
        let table = log::table(&elf.bytes).unwrap();
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        Self { board, elf, table, scene }
    }

    /// Switched on and booted, with the handle at rest where the device rests.
    pub fn boot(&self) -> World<'_> {
        let rest_m = self.scene.device.rest_position_m;
        let mut world =
            World::new(self.board, &self.elf, &self.table, &self.scene, rest_m).unwrap();
        world.run(200).unwrap();
        world.hold(rest_m, false);
        world
    }
}

/// Asks, and insists on `ok`.
#[track_caller]
pub fn ok(world: &mut World<'_>, line: &str) -> String {
    let reply = world.ask(line).unwrap();
    assert!(reply.starts_with("ok"), "{line}: {reply}");
    reply
}

/// Armed at full force, free, 5 mm in front of a wall.
#[track_caller]
pub fn arm(world: &mut World<'_>) {
    for line in ["zero", "unlock envelope", "wall 0.005", "k 8000", "b 30", "push 2.835", "arm"] {
        ok(world, line);
    }
    world.run(4_000).unwrap();
    let status = ok(world, "status");
    assert!(status.contains("ok status armed"), "{status}");
}
